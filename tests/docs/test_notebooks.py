"""Every notebook has public names only, and is kept with the outputs of its present code.

The documentation runs them all from top to bottom, in Jupyter, and fails where a cell does.
"""

import json
import re
from pathlib import Path

import pytest
from notebook_outputs import fingerprint

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def code_cells(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


@each
def test_the_stored_outputs_are_those_of_the_code(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cure = f"run `python tests/support/notebook_outputs.py {path.stem}`"
    assert notebook["metadata"].get("outputs_of") == fingerprint(notebook), cure
    cells = code_cells(path)
    assert [cell["execution_count"] for cell in cells] == [*range(1, len(cells) + 1)], cure
    outputs = [output for cell in cells for output in cell["outputs"]]
    # Neither errors nor warnings; a forge shows the figures of a file of this size.
    assert {output["output_type"] for output in outputs} <= {
        "stream",
        "display_data",
        "execute_result",
    }
    assert {output.get("name", "stdout") for output in outputs} == {"stdout"}
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert path.stat().st_size < 400_000


@each
def test_public_names_only(path):
    source = "\n".join("".join(cell["source"]) for cell in code_cells(path))
    imported = re.findall(r"^\s*(?:from|import) (greybox\S*)", source, re.MULTILINE)
    assert all(
        re.fullmatch(r"greybox|greybox\.(models|problems)(\.\w+)?", name) for name in imported
    )
    assert not re.findall(r"\bgb\._", source)
