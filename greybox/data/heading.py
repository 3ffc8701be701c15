"""Headings of columns: a name and a unit, ``pitch [deg]`` or ``pitch (deg)``."""

import re
from typing import NamedTuple

BRACKETS = re.compile(r"^([^\[\]()]+?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))$")


class Heading(NamedTuple):
    """One column's name and unit."""

    name: str
    unit: str


def heading(cell: str) -> Heading:
    """Split ``pitch [deg]`` or ``pitch (deg)`` into name and unit."""
    found = BRACKETS.match(cell.strip())
    return Heading(found[1].strip(), (found[2] or found[3] or "").strip()) if found else Heading(cell.strip(), "")
