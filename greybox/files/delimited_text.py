"""Tables of numbers as text: what separates their cells, their decimal mark, comments, encoding.

A spreadsheet writes what its country does: semicolons or tabs between cells and commas in numbers.
The separator follows from the header line, the decimal mark from all numbers together. Where these
allow two readings the table is refused, with the line to look at: a wrong number would be worse
than none.
"""

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from greybox.files.text_table import is_number

SEPARATORS = ";\t,"
COMMENTS = ("#", "%")
MISSING = frozenset(("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"))  # in lower case

WITH_COMMA = re.compile(r"[+-]?(\d*,\d+|\d+,)([eE][+-]?\d+)?")
WITH_POINT = re.compile(r"[+-]?(\d*\.\d+|\d+\.)([eE][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")  # 1,000 is a thousand or one
GROUPED = re.compile(
    r"[+-]?\d{1,3}((,\d{3})+\.\d+|(\.\d{3})+,\d+|(,\d{3}){2,})"
)  # certainly thousands


@dataclass(frozen=True, eq=False)
class DelimitedText:
    """The lines of a table of numbers, without comments and blank lines.

    Attributes
    ----------
    path : Path
        For messages.
    separator : str
    header : tuple of str
        The names in the first line, without blanks around them.
    lines : sequence of str
        Of the table's body.
    line_numbers : sequence of int
        Where each of them stands in the file, from 1.
    """

    path: Path
    separator: str
    header: tuple[str, ...]
    lines: Sequence[str]
    line_numbers: Sequence[int]

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the number of each line and its cells, without blanks around them; some have fewer than the header.

        Raises
        ------
        ValueError
            If a line has more cells than the header, as decimal commas between commas make them; or
            it is no CSV.
        """
        width = len(self.header)
        reader = csv.reader(self.lines, delimiter=self.separator, skipinitialspace=True)
        try:
            for row in reader:
                number = self.line_numbers[reader.line_num - 1]
                if len(row) > width:
                    while len(row) > width and not row[-1].strip():
                        row.pop()  # separators at the end of lines
                    if len(row) > width:
                        raise ValueError(self._too_long(number, len(row)))
                yield number, [cell.strip() for cell in row]
        except csv.Error as problem:
            raise ValueError(
                f"{self.path} is not a table of numbers ({problem}): save it as plain CSV."
            ) from None

    def _too_long(self, number: int, cells: int) -> str:
        cure = "name all columns"
        if self.separator == ",":
            cure += ", or, if its numbers have decimal commas, separate the cells by semicolons"
        return f"{self.path}, line {number}, has {cells} cells where the header has {len(self.header)}: {cure}."


def read_delimited(path: Path, raw: bytes) -> DelimitedText:
    """Return the table in a file that holds `raw`.

    The header is the first line that is neither blank nor a comment; or the last comment before the
    numbers, as `numpy.savetxt` writes it. Comments start with ``#`` or ``%``.

    Raises
    ------
    ValueError
        If it is no text.
    """
    if b"\0" in raw:
        raise ValueError(
            f"{path} is not a CSV text file (it contains zero bytes, as UTF-16 does): save it as UTF-8."
        )
    lines = _decoded(raw).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    first = lines[0].strip().lower()
    stated = first[4:] if re.fullmatch(r"sep=[;,]", first) else ""  # a hint of Excel's

    kept = [
        k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]
    kept = kept[1:] if stated else kept
    if not kept:
        return DelimitedText(path, ",", (), (), ())

    header, body = lines[kept[0]], kept[1:]
    names, separator = _split(header, stated)
    if _are_numbers(names):
        comment = (
            next((line for line in reversed(lines[: kept[0]]) if line.strip()), "")
            .lstrip()
            .lstrip("#%")
        )
        named, mark = _split(comment, stated)
        if len(named) == len(names) and mark == separator and not _are_numbers(named):
            names, body = named, kept
    return DelimitedText(
        path, separator, tuple(names), [lines[k] for k in body], [k + 1 for k in body]
    )


def _are_numbers(cells: Iterable[str]) -> bool:
    return all(is_number(cell.replace(",", ".")) for cell in cells)


def _decoded(raw: bytes) -> str:
    """Return the text, in UTF-8 or else in Western encodings; a typographic minus becomes a plain one."""
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding).replace("\u2212", "-")
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def _split(line: str, separator: str) -> tuple[list[str], str]:
    """Return the cells of a header and what separates them: what makes the most cells, unless it is stated."""
    best: list[str] = []
    chosen = separator or ","
    for mark in separator or SEPARATORS:
        try:
            cells = next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
        except csv.Error:
            continue
        if len(cells) > max(len(best), 1):
            best, chosen = cells, mark
    names = [cell.strip() for cell in (best or [line.strip().strip('"')])]
    while len(names) > 1 and not names[-1]:
        names.pop()  # separators at the end of the line
    return names, chosen


class DecimalMark:
    """The decimal mark of a table, which must be one: a point, or a comma."""

    def __init__(self, path: Path, cells: Iterable[tuple[int, Iterable[str]]]) -> None:
        """Find the mark in the cells of all lines, given with their numbers.

        Raises
        ------
        ValueError
            If numbers have both marks, or commas that separate thousands or may do so.
        """
        point: tuple[int, str] | None = None
        comma: tuple[int, str] | None = None
        certain = False  # that a comma is a decimal one
        for number, row in cells:
            for cell in row:
                if "," not in cell:
                    if point is None and "." in cell and WITH_POINT.fullmatch(cell):
                        point = number, cell
                    continue
                if GROUPED.fullmatch(cell):
                    raise ValueError(
                        f"{path}, line {number}: {cell!r} has a thousands separator: leave it out."
                    )
                if WITH_COMMA.fullmatch(cell):
                    comma = comma or (number, cell)
                    certain = certain or not THOUSANDS.fullmatch(cell)
        if comma and point:
            raise ValueError(
                f"{path}, line {comma[0]}, has {comma[1]!r} where line {point[0]} has {point[1]!r}: write all numbers "
                "with one decimal mark and without thousands separators."
            )
        if comma and not certain:
            raise ValueError(
                f"{path}, line {comma[0]}: {comma[1]!r} may have a decimal comma or a thousands separator: "
                "write a decimal point."
            )
        self.is_comma = comma is not None

    def number(self, cell: str) -> float:
        """Return the number in a cell.

        Raises
        ------
        ValueError
            If it is none.
        """
        if self.is_comma:
            cell = cell.replace(",", ".")
        if "_" in cell:  # which Python would read past
            raise ValueError(cell)
        return float(cell)
