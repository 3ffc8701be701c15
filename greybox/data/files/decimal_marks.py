"""Numbers in the cells of a table, with decimal points or decimal commas.

All numbers of a table together decide which of them it has. A number that can be read in two ways
is refused: a wrong number would be worse than no number.
"""

import math
import re
from collections.abc import Iterable
from pathlib import Path

from greybox.data.files.numbers_in_text import is_number

WITH_COMMA = re.compile(r"[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?")
WITH_POINT = re.compile(r"[+-]?(\d*\.\d+|\d+\.)([eE][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")  # 1,000 is a thousand or one
# 1,234.5 and 1.234,5 and 1,234,567 and 1 234 and 1'234 certainly have thousands separators.
GROUPED = re.compile(
    r"[+-]?\d{1,3}((,\d{3})+\.\d+|(\.\d{3})+,\d+|(,\d{3}){2,}|(\.\d{3}){2,}"
    r"|([ '’\u00a0\u2009\u202f]\d{3})+([.,]\d+)?)"
)


def are_numbers(cells: Iterable[str]) -> bool:
    """Return whether all cells are numbers, with a decimal point or comma."""
    return all(is_number(cell.strip().replace(",", ".")) for cell in cells)


def is_like_number(cell: str) -> bool:
    """Return whether a cell is a number, perhaps with separators of thousands."""
    return are_numbers([cell]) or GROUPED.fullmatch(cell) is not None


def has_decimal_comma(path: Path, rows: Iterable[tuple[int, Iterable[str]]]) -> bool:
    """Return whether the numbers in the cells of numbered lines have decimal commas.

    Raises
    ------
    ValueError
        If some numbers have decimal points and others commas, or if a comma separates thousands or
        may do so.
    """
    point: tuple[int, str] | None = None
    comma: tuple[int, str] | None = None
    certain = False  # some comma cannot be a thousands separator
    for number, row in rows:
        for cell in row:
            if GROUPED.fullmatch(cell):
                raise ValueError(
                    f"{path}, line {number}: {cell!r} has a thousands separator: leave it out."
                )
            if WITH_COMMA.fullmatch(cell):
                comma = comma or (number, cell)
                certain = certain or not THOUSANDS.fullmatch(cell)
            elif point is None and WITH_POINT.fullmatch(cell):
                point = number, cell
    if comma and point:
        raise ValueError(
            f"{path}, line {comma[0]}, has {comma[1]!r} where line {point[0]} has {point[1]!r}: "
            "write all numbers with one decimal mark and without thousands separators."
        )

    if comma and not certain:
        raise ValueError(
            f"{path}, line {comma[0]}: {comma[1]!r} may have a decimal comma or a thousands "
            "separator: write a decimal point."
        )

    return comma is not None


def number_in(cell: str, decimal_comma: bool) -> float:
    """Return the number in a cell; NaN if it is not a number."""
    plain = cell.replace(",", ".") if decimal_comma else cell
    # Python reads 1_5 as 15.
    return float(plain) if is_number(plain) and "_" not in plain else math.nan
