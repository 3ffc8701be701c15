"""Every notebook runs from top to bottom, with public names only, and is kept without outputs.

Cells are run here as Jupyter runs them, which saves a kernel, and one figure of each notebook is
drawn; the documentation runs them in Jupyter and draws all.
"""

import ast
import re
from pathlib import Path

import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def code_cells(path):
    return [cell.source for cell in nbformat.read(path, 4).cells if cell.cell_type == "code"]


def shown(source, names):
    """Run a cell, and return the value of its last line."""
    *statements, last = ast.parse(source).body
    if not isinstance(last, ast.Expr):
        statements, last = [*statements, last], None
    exec(compile(ast.Module(statements, []), "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None


@pytest.mark.filterwarnings("default")
@each
def test_it_runs_and_draws(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    values = {source: shown(source, names) for source in code_cells(path)}
    assert not capsys.readouterr().err
    figures = [value for source, value in values.items() if "\ngb.plot" in f"\n{source}"]
    assert all(hasattr(figure, "_repr_png_") for figure in figures)
    assert figures[0]._repr_png_().startswith(b"\x89PNG")


@each
def test_outputs_are_stripped(path):
    for cell in nbformat.read(path, as_version=4).cells:
        assert cell.cell_type != "code" or (not cell.outputs and cell.execution_count is None)


@each
def test_public_names_only(path):
    source = "\n".join(code_cells(path))
    imported = re.findall(r"^\s*(?:from|import) (greybox\S*)", source, re.MULTILINE)
    assert all(
        re.fullmatch(r"greybox|greybox\.(models|problems)(\.\w+)?", name) for name in imported
    )
    assert not re.findall(r"\bgb\._", source)
