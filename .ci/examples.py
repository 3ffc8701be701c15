"""Write the Python examples of README.md and docs/guide/, one file a page, for the type checker."""

import re
import sys
from pathlib import Path

target = Path(sys.argv[1])
target.mkdir()
for page in [Path("README.md"), *sorted(Path("docs/guide").glob("*.md"))]:
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M)
    if blocks:
        (target / f"{page.stem}.py").write_text("\n".join(blocks), encoding="utf-8")
