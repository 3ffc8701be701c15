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
TABLE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
TABLE = TABLE.split("<!-- folders -->")[1].split("<!-- end -->")[0]

# A folder may import itself and the folders above it in the table of CONTRIBUTING.md.
FOLDERS = re.findall(r"^\| `(\w+)` \|", TABLE, re.MULTILINE)
SOURCES = sorted(p for top in ("greybox", "models", "problems") for p in (ROOT / top).rglob("*.py"))
HOUSE = [path for path in SOURCES if path.relative_to(ROOT).parts[1] in FOLDERS]

# A stored result names an included model, a study names included models and problems, and the
# command line is above both.
PLUG_INS = {"greybox.modeling.model_reference", "greybox.workflows.study.catalog"}


@cache
def imported(path):
    """Names of the modules that a file imports, wherever and however in the file."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            names += [node.module]
            names += [f"{node.module}.{a.name}" for a in node.names if node.module == "greybox"]
        elif isinstance(node, ast.Call) and name_of(node.func).endswith("import_module"):
            names += literal_start(node.args[0])
    return names


def name_of(function):
    """The last part of the name of a function that is called."""
    return getattr(function, "attr", getattr(function, "id", ""))


def literal_start(argument):
    """The module that an argument of `import_module` names, or the part of it before a variable."""
    if isinstance(argument, ast.JoinedStr):
        argument = argument.values[0]
    if isinstance(argument, ast.Constant) and str(argument.value).strip("."):
        return [argument.value.rstrip(".")]
    return []


def module(path):
    """The dotted name of a file of the house."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def forbidden(folder, names):
    """The modules among the names that a file of this folder may not import."""
    allowed = FOLDERS[: FOLDERS.index(folder) + 1]
    parts = [name.split(".") for name in names]
    return [".".join(p) for p in parts if p[0] == "greybox" and (len(p) < 2 or p[1] not in allowed)]


def test_every_folder_is_in_the_table_of_contributing():
    there = {path.name for path in (ROOT / "greybox").iterdir() if path.name != "__pycache__"}
    assert there - {"__init__.py", "__init__.pyi", "__main__.py", "py.typed"} == set(FOLDERS)


def test_imports_point_one_way():
    wrong = {}
    for path in HOUSE:
        floor = path.relative_to(ROOT / "greybox").parts[0]
        if floor != "cli" and module(path) not in PLUG_INS:
            wrong[module(path)] = forbidden(floor, imported(path))
    assert {name: names for name, names in wrong.items() if names} == {}


def test_a_planted_import_is_seen(tmp_path):
    planted = tmp_path / "parameter.py"
    planted.write_text(
        "def f(name):\n    from greybox.assessment.fit import fit\n    from greybox import fit\n"
        "    importlib.import_module(f'greybox.models.{name}')\n"
    )
    names = ["greybox.assessment.fit", "greybox", "greybox.fit", "greybox.models"]
    assert forbidden("modeling", imported(planted)) == names


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


def test_every_folder_says_what_is_in_it():
    for folder in {path.parent for path in HOUSE}:
        text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
        files = {path.stem for path in folder.glob("*.py")} - {"__init__"}
        missing = [name for name in files if f"`{name}`" not in (text or "")]
        assert not missing, f"the docstring of {folder.name}/ does not mention {missing}"


def test_no_folder_is_named_like_a_public_name():
    import greybox as gb

    public = {name for name in dir(gb) if not name.startswith("_")}
    assert [f for f in FOLDERS if f in public and not hasattr(getattr(gb, f), "__path__")] == []


def test_forbidden_modules():
    for path in SOURCES:
        roots = {name.split(".")[0] for name in imported(path)}
        assert not roots & {"models", "problems"}, f"{path} imports a folder of this repository"

        # Only what goes to the workers of the user's own executor is pickled, and what becomes a key
        # that nobody reads.
        if path.name not in ("worker_payload.py", "fingerprint.py"):
            assert "pickle" not in roots, f"{path} imports pickle"
        if path.parent.name == "models":
            assert not roots & {"matplotlib", "h5py", "scipy"}, f"{path} is more than a model"


def test_import_is_light():
    heavy = ("matplotlib", "pymavlink", "h5py", "scipy")
    code = f"import sys, greybox; print([m for m in {heavy} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
