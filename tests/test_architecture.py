"""The house: which folder may import which, and what is forbidden everywhere."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# A folder may import only folders listed above it; CONTRIBUTING.md says what each is for.
FOLDERS = """
files data statistics logs spectral modeling formulation compiled regression solve simulation estimate validation
experiment interop identification study plotting html_report cli
""".split()

SOURCES = sorted(
    path for folder in ("greybox", "models", "problems") for path in (ROOT / folder).rglob("*.py")
)
HOUSE = sorted(path for folder in FOLDERS for path in (ROOT / "greybox" / folder).rglob("*.py"))


@cache
def imported(path):
    """Names of the modules that a file imports, wherever in the file."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            names += [node.module]
            names += [
                f"{node.module}.{alias.name}" for alias in node.names if node.module == "greybox"
            ]
    return names


def module(path):
    """The dotted name of a file of the house."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def not_above(folder, names):
    """Those of the modules that a file of this folder may not import."""
    allowed = FOLDERS[: FOLDERS.index(folder) + 1]
    parts = [name.split(".") for name in names]
    return [".".join(p) for p in parts if p[0] == "greybox" and (len(p) < 2 or p[1] not in allowed)]


def test_contributing_has_the_same_folders_in_the_same_order():
    table = (
        (ROOT / "CONTRIBUTING.md")
        .read_text(encoding="utf-8")
        .split("<!-- folders -->")[1]
        .split("<!-- end -->")[0]
    )
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == FOLDERS


def test_every_file_is_in_a_folder_of_the_list():
    there = {path.name for path in (ROOT / "greybox").iterdir() if path.name != "__pycache__"}
    assert there == {*FOLDERS, "__init__.py", "__main__.py", "py.typed"} & there | set(FOLDERS)


@pytest.mark.parametrize("path", HOUSE, ids=module)
def test_imports_point_one_way(path):
    folder = path.relative_to(ROOT / "greybox").parts[0]
    assert not_above(folder, imported(path)) == []


def test_a_planted_import_is_found(tmp_path):
    planted = tmp_path / "parameter.py"
    planted.write_text(
        "def f():\n    from greybox.estimate.fit import fit\n    from greybox import fit\n"
    )
    assert not_above("modeling", imported(planted)) == [
        "greybox.estimate.fit",
        "greybox",
        "greybox.fit",
    ]


def test_no_file_imports_itself_through_others():
    modules = {module(path): path for path in HOUSE}
    graph = {
        name: {m for m in imported(path) if m in modules and m != name}
        for name, path in modules.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"imports in a circle: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize("folder", sorted({path.parent for path in HOUSE}), ids=lambda p: p.name)
def test_every_folder_says_what_is_in_it(folder):
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    assert text
    missing = [
        path.stem
        for path in folder.glob("*.py")
        if path.stem != "__init__" and f"`{path.stem}`" not in text
    ]
    assert not missing, f"the docstring of {folder.name}/ does not mention {', '.join(missing)}"


def test_no_folder_is_named_like_a_public_name():
    import greybox as gb

    public = {name for name in dir(gb) if not name.startswith("_")}
    shadowed = [f for f in FOLDERS if f in public and not hasattr(getattr(gb, f), "__path__")]
    assert shadowed == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_no_file_imports_models_or_problems_as_top_level_modules(path):
    roots = {name.split(".")[0] for name in imported(path)}
    assert not roots & {"models", "problems"}
    # What goes to the workers of the user's own executor, and to nobody else.
    assert "pickle" not in roots or path.parts[-2:] == ("solve", "executors.py")


@pytest.mark.parametrize(
    "path", [p for p in SOURCES if p.parent.name == "models"], ids=lambda p: p.name
)
def test_models_hold_no_solver_data_or_plots(path):
    roots = {name.split(".")[0] for name in imported(path)}
    assert not roots & {"matplotlib", "h5py", "scipy"}


def test_import_is_light():
    code = "import sys, greybox; print([m for m in ('matplotlib', 'pymavlink', 'h5py', 'scipy') if m in sys.modules])"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert loaded.strip() == "[]"
