"""Write the Python of README.md, docs/guide/ and notebooks/, one file a page, for pyright."""

import json
import re
import sys
from pathlib import Path

target = Path(sys.argv[1])
target.mkdir()
pages = {
    page.stem: re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M)
    for page in [Path("README.md"), *sorted(Path("docs/guide").glob("*.md"))]
}
for notebook in sorted(Path("notebooks").glob("*.ipynb")):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    sources = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    pages[notebook.stem] = sources

# Tools beside which the guide puts greybox, and which no extra installs.
OTHERS = re.compile(r"^(import (?:emcee|pypesto)\b.*)$", re.M)

for name, blocks in pages.items():
    if blocks:
        text = OTHERS.sub(r"\1  # pyright: ignore[reportMissingImports]", "\n".join(blocks))
        (target / f"{name}.py").write_text(text + "\n", encoding="utf-8")
