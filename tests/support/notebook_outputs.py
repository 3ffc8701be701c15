"""Outputs of the notebooks, stored so that a forge shows their figures.

``python tests/support/notebook_outputs.py [NAME ...]`` runs the notebooks and stores what they print and draw; the
test of the notebooks says when this is due. It needs the extra `notebooks`.
"""

import hashlib
import io
import sys
import tempfile
from base64 import b64decode, b64encode
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
COLORS = 64  # of a figure: a third of the file, and no difference to be seen


def fingerprint(notebook):
    """The hash of the code of a notebook, which changes with the first edit."""
    sources = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
    return hashlib.sha256("\n".join(sources).encode()).hexdigest()[:16]


def renew(path):
    """Run a notebook and store its outputs."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, 4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(
            notebook, timeout=600, kernel_name="python3", resources=resources, record_timing=False
        ).execute()
    for cell in notebook.cells:
        if "outputs" in cell:
            # Progress bars appear on a slow machine only.
            cell.outputs = [each for each in cell.outputs if each.get("name") != "stderr"]
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = smaller(output.data["image/png"])
    notebook.metadata["outputs_of"] = fingerprint(notebook)
    nbformat.write(notebook, path)


def smaller(image):
    """Return a PNG in base64 with few colors."""
    from PIL import Image

    with Image.open(io.BytesIO(b64decode(image))) as drawn:
        paper = Image.new("RGB", drawn.size, "white")
        paper.paste(drawn, mask=drawn.getchannel("A") if drawn.mode == "RGBA" else None)
    file = io.BytesIO()
    paper.quantize(COLORS, dither=Image.Dither.NONE).save(file, "png", optimize=True)
    return b64encode(file.getvalue()).decode() + "\n"


if __name__ == "__main__":
    for notebook_path in NOTEBOOKS:
        if not sys.argv[1:] or notebook_path.stem in sys.argv[1:]:
            renew(notebook_path)
