"""Headings of columns: a name and a unit, ``pitch [deg]`` or ``pitch (deg)``."""

import re
from typing import NamedTuple

# An element of an array, as flight controllers write it: its brackets hold no unit.
INDEX = re.compile(r".*\w\[\d+\]")
BRACKETS = re.compile(r"^([^\[\]()]+?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))$")


class Heading(NamedTuple):
    """One column's name and unit."""

    name: str
    unit: str


def heading(cell: str) -> Heading:
    """Split ``pitch [deg]`` or ``pitch (deg)`` into name and unit; ``motor[0]`` is a name."""
    cell = cell.strip()
    match = BRACKETS.match(cell)
    if match is None or INDEX.fullmatch(cell):
        return Heading(cell, "")
    return Heading(match[1].strip(), (match[2] or match[3] or "").strip())
