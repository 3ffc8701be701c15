"""Every notebook has public names only, and is kept without outputs.

The documentation runs them all from top to bottom, in Jupyter, and fails where a cell does.
"""

import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def code_cells(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


@each
def test_outputs_are_stripped(path):
    for cell in code_cells(path):
        assert not cell["outputs"]
        assert cell["execution_count"] is None


@each
def test_public_names_only(path):
    source = "\n".join("".join(cell["source"]) for cell in code_cells(path))
    imported = re.findall(r"^\s*(?:from|import) (greybox\S*)", source, re.MULTILINE)
    assert all(
        re.fullmatch(r"greybox|greybox\.(models|problems)(\.\w+)?", name) for name in imported
    )
    assert not re.findall(r"\bgb\._", source)
