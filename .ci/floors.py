"""Print the lowest declared versions of all requirements of greybox and its tests, for pip."""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["project"]
extras = project["optional-dependencies"]
tested = [
    requirement
    for name, group in extras.items()
    if name not in ("dev", "notebooks")
    for requirement in group
]
for requirement in [*project["dependencies"], *tested]:
    floor = re.fullmatch(r"([\w-]+)>=([\w.]+)", requirement)
    if floor:
        print(f"{floor[1]}=={floor[2]}")
    elif not requirement.startswith("greybox-id["):
        sys.exit(f"{requirement!r} declares no lowest version: write NAME>=VERSION.")
