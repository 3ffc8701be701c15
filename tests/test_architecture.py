"""The map of the house: which file may import which, and what is forbidden everywhere."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# A file may import only files listed above it.
ORDER = """
table atomic parameter record frequency_response sealed response_file record_file
readers signals segment segments fourier spectra excitation multisine quality movement
symbolic model trace controller trim elimination linear dynamics virtual_flight criterion
sine harmonic output_error estimated own_biases given_data problem several
integrator experiment sample transcription noise tape compiled shooting chain first_states pace record_part
nlp levy starts solve small_qp limits iterate gains points gauss_newton cost whole_problem result hops multistart
integration_error not_finite smoothing equations regression regressors projection equation_error
residuals validation record_accuracy accuracy harmonic_error words reference answer fitted_record record_words
quantities store fit case windows flow lead_in prediction runner simulate same_windows comparison same_data
verdict compare
page nyquist histories plotting traces shelf command list_command log_commands cli __main__
""".split()

SOURCES = sorted(path for folder in ("greybox", "models", "problems") for path in (ROOT / folder).rglob("*.py"))


def files_of(name):
    """The file of that name, or the files of the folder."""
    folder = ROOT / "greybox" / name
    return sorted(folder.glob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


def imported(path):
    """Names of the modules that a file imports, wherever in the file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names if node.module == "greybox")


def test_every_file_is_on_the_map():
    files = {path.stem for path in (ROOT / "greybox").iterdir() if path.stem not in ("__init__", "__pycache__")}
    assert files == set(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_imports_point_one_way(name):
    above = ORDER[: ORDER.index(name)]
    modules = [module for path in files_of(name) for module in imported(path)]
    for module in modules:
        if module.startswith(f"greybox.{name}") and (ROOT / "greybox" / name).is_dir():
            continue
        if module.split(".")[0] == "greybox":
            parts = module.split(".")
            assert len(parts) > 1, f"{name} imports the whole package"
            assert parts[1] in above, f"{name} imports {parts[1]}, which is not listed above it"


def test_a_planted_import_is_found(tmp_path):
    planted = tmp_path / "parameter.py"
    planted.write_text("def f():\n    from greybox.fit import fit\n")
    assert "greybox.fit" in set(imported(planted))


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_no_file_imports_the_shelves_as_top_level_modules(path):
    roots = {module.split(".")[0] for module in imported(path)}
    assert not roots & {"models", "problems"}
    assert "pickle" not in roots


@pytest.mark.parametrize("path", [p for p in SOURCES if p.parent.name == "models"], ids=lambda p: p.name)
def test_models_hold_no_solver_data_or_plots(path):
    roots = {module.split(".")[0] for module in imported(path)}
    assert not roots & {"matplotlib", "h5py", "scipy"}


def test_files_stay_short():
    for path in SOURCES:
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 400, f"{path.name} is too long"


def test_import_is_light():
    code = "import sys, greybox; print([m for m in ('matplotlib', 'pymavlink', 'h5py', 'scipy') if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"
