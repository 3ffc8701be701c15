"""Long lines of an answer, folded at blanks as a person would fold them."""

import re
from textwrap import wrap

WIDTH = 100
"""Columns of an answer: half of a wide screen, and all of a narrow one."""

# A narrower last column would become a tower of words.
NARROWEST = 30
# A cell of a table, or the text behind a label, begins behind two blanks.
CELL = re.compile(r" {2,}(?=\S)")
# Commands and names of files are there to be copied.
COPIED = re.compile(r"\s*([\w ]+: )?(greybox|saved|drew|wrote) ")


def folded(text: str, width: int = WIDTH) -> str:
    """Return text without lines of more than `width` columns, where they can be folded.

    What is folded goes on below where its cell of a table, or the text behind its label, begins;
    below a sentence it is indented by two more columns. Rules of dashes are cut. Rows of tables
    with too many columns, commands and names of files stay as they are.
    """
    return "\n".join(line for long in text.split("\n") for line in _lines(long, width))


def _lines(line: str, width: int) -> list[str]:
    """Return a line as lines that fit."""
    if len(line) <= width or COPIED.match(line):
        return [line]

    margin = len(line) - len(line.lstrip())
    cells = [found.end() for found in CELL.finditer(line, margin)]
    if cells and cells[-1] > width - NARROWEST:
        return [line]
    if not line.strip("- "):
        return [line[:width].rstrip()]
    return wrap(
        line,
        width,
        subsequent_indent=" " * (cells[-1] if cells else margin + 2),
        break_long_words=False,
        break_on_hyphens=False,
    )
