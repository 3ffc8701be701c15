"""Every notebook runs from top to bottom, with public names only, and is kept without outputs."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


@pytest.fixture(scope="module")
def kernel():
    """One process for all notebooks."""
    client = NotebookClient(nbformat.v4.new_notebook(), timeout=300)
    with client.setup_kernel():
        yield client


@each
def test_it_runs_and_draws(path, tmp_path, kernel):
    notebook = nbformat.read(path, as_version=4)
    alone = nbformat.v4.new_code_cell(
        f"%reset -f\n%cd -q {tmp_path}"
    )  # without the names of the others
    kernel.nb = nbformat.v4.new_notebook(cells=[alone, *notebook.cells])
    for index, cell in enumerate(kernel.nb.cells):
        kernel.execute_cell(cell, index)
    outputs = [
        output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    ]
    assert not [o for o in outputs if o.output_type == "stream" and o.name == "stderr"]
    drawing = [
        cell
        for cell in notebook.cells
        if cell.cell_type == "code" and "\ngb.plot" in f"\n{cell.source}"
    ]
    assert drawing
    for cell in drawing:
        assert any("image/png" in output.get("data", {}) for output in cell.outputs), cell.source
    nbformat.write(notebook, tmp_path / path.name)


@each
def test_outputs_are_stripped(path):
    for cell in nbformat.read(path, as_version=4).cells:
        assert cell.cell_type != "code" or (not cell.outputs and cell.execution_count is None)


@each
def test_public_names_only(path):
    source = "\n".join(
        cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"
    )
    imported = re.findall(r"^\s*(?:from|import) (greybox\S*)", source, re.MULTILINE)
    assert all(
        re.fullmatch(r"greybox|greybox\.(models|problems)(\.\w+)?", name) for name in imported
    )
    assert not re.findall(r"\bgb\._", source)
