"""Reads and writes tables of numbers as text, with facts in the comments before the header.

A spreadsheet follows the conventions of its country, often semicolons or tabs between cells and
commas in numbers.
The header line decides the separator, or the last line where blanks separate its numbers. All
numbers together decide the decimal mark. A table that can be read in two ways is refused, and the
message names the line: a wrong number would be worse than no number.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.control_characters import printable
from greybox.data.files.decimal_marks import are_numbers, has_decimal_comma, number_in
from greybox.data.files.escapes import csv_cell
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import is_number
from greybox.data.files.safe_files import write_text
from greybox.data.files.wording import counted

COMMENTS = ("#", "%", "sep=", "SEP=")  # the last ones of Excel, for the separator
FACT = re.compile(r"#\s*(?P<key>[^:]+?)\s*:\s*(?P<value>.*?)\s*")
WIDER = ", or, if its numbers have decimal commas, separate cells by semicolons"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # first bytes of a text in UTF-16, as of Excel and PowerShell
MISSING = frozenset(("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"))  # in lower case


@frozen
class DelimitedText:
    """The lines of a table of numbers, without comments and blank lines.

    Attributes
    ----------
    path : Path
        For messages.
    separator : str
    header : tuple of str
        The names in the first line, stripped.
    lines : sequence of str
        The lines of the body.
    line_numbers : sequence of int
        Their numbers in the file, from 1.
    facts : mapping of str to str
        The comments ``# key: value`` before the header.
    """

    path: Path
    separator: str
    header: tuple[str, ...]
    lines: Sequence[str]
    line_numbers: Sequence[int]
    facts: Mapping[str, str]

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the number of each line and its stripped cells; a line may have too few of them.

        Raises
        ------
        ValueError
            If a line has more cells than the header (as with decimal commas in a file separated by
            commas), or if the file is not CSV.
        """
        width = len(self.header)
        reader = csv.reader(self.lines, delimiter=self.separator, skipinitialspace=True)
        try:
            for row in reader:
                number = self.line_numbers[reader.line_num - 1]
                while len(row) > width and not row[-1].strip():
                    row.pop()  # separators at the end of a line
                if len(row) > width:
                    commas = WIDER if self.separator == "," else ""
                    raise ValueError(
                        f"{self.path}, line {number}, has {len(row)} cells where the header, "
                        f"{self.separator.join(self.header):.40}, has {width}: name all columns, "
                        f"begin lines above them with #{commas}."
                    )
                yield number, [cell.strip() for cell in row]
        except csv.Error as problem:
            raise ValueError(
                f"{self.path} is not a table of numbers ({problem}): save it as plain CSV."
            ) from None

    def numbers(self, places: Mapping[str, int], texts: Mapping[str, str]) -> Mapping[str, Array]:
        """Return columns of numbers, (n,) arrays, by name from their places, from 0.

        Rows in which only the first of these columns has a value are left out, and rows without
        these `texts` in other columns of the header.

        Raises
        ------
        ValueError
            If a cell is missing, is not a number, or can be read as two different numbers.
        """
        rows = []
        for number, row in self.rows():
            if len(row) <= max(places.values()):
                raise ValueError(
                    f"{self.path}, line {number}, has {counted(len(row), 'cell')} where the header "
                    f"has {len(self.header)}."
                )
            cells = [row[place] for place in places.values()]
            # A matrix of responses has blanks at the frequencies of its other responses.
            named = dict(zip(self.header, row, strict=False))
            if any(cells[1:]) and texts.items() <= named.items():
                rows.append((number, cells))

        # All cells are read together, since 1,234 alone may be either.
        comma = has_decimal_comma(self.path, rows)
        values = []
        for number, cells in rows:
            for cell, place in zip(cells, places.values(), strict=True):
                values.append(number_in(cell, comma))
                if math.isnan(values[-1]):
                    raise ValueError(
                        f"{self.path}, line {number}: {self.header[place]} is {cell!r}, which is "
                        "not a number."
                    )

        return dict(zip(places, np.reshape(values, (-1, len(places))).T, strict=True))


def read_delimited(path: Path, raw: bytes) -> DelimitedText:
    """Return the table in a file with the contents `raw`.

    The header is the first line that is neither blank nor a comment and has as many cells as the
    rows, or the last comment before the numbers, as `numpy.savetxt` writes it. Comments start with
    ``#`` or ``%``.

    Raises
    ------
    ValueError
        If the contents are not text, or there is nothing but comments.
    """
    if b"\0" in raw and not raw.startswith(UTF_16):
        raise ValueError(
            f"{path} is not a CSV text file, since it contains zero bytes: save it as UTF-8."
        )
    lines = _decoded(raw).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    body = [
        k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]
    if not body:
        raise ValueError(
            f"{path} is empty: write a header line with names, then one line of numbers per sample."
        )

    header = _header(lines, body)
    body = body[body.index(header) :]
    matches = map(FACT.fullmatch, lines[:header])
    _, separator = _split(lines[header])
    cells = lines[body[-1]].split()
    if separator not in lines[header] and len(cells) > 1 and are_numbers(cells):
        # A unit belongs to its name: ``pitch [deg]``.
        lines[header] = re.sub(r"\s+([\[(])", r"\1", lines[header])
        lines = ["\t".join(line.split()) for line in lines]
    names, separator = _split(lines[header])
    # `numpy.savetxt` writes the names as a comment.
    if are_numbers(names):
        comment = next((line for line in reversed(lines[:header]) if line.strip()), "")
        titles, mark = _split(comment.strip("#% \t"))
        if len(titles) == len(names) and mark == separator and not are_numbers(titles):
            names = titles
            body = [header, *body]

    return DelimitedText(
        path,
        separator,
        tuple(names),
        [lines[k] for k in body[1:]],
        [k + 1 for k in body[1:]],
        {match["key"]: match["value"] for match in matches if match},
    )


def _header(lines: list[str], body: Sequence[int]) -> int:
    """Return the place of the header: below a title and settings, above the numbers."""
    # The last line may be cut, so the middle one shows the width.
    row = lines[body[len(body) // 2]]
    texts = []
    for k in body[:200]:
        names, mark = _split(lines[k])
        if len(names) < len(row.split(mark)):
            continue
        if are_numbers(names):
            break
        if not any(map(is_number, names)):
            texts.append(k)
    # A line of settings may have as many cells.
    return next((k for k in texts if "time" in lines[k].lower()), (*texts, body[0])[0])


def numbered(text: DelimitedText) -> DelimitedText:
    """Return a table without a header line with the numbers of its columns as names."""
    if not are_numbers(text.header):
        return text
    # What was taken for the header is the first row.
    lines = [text.separator.join(text.header), *text.lines]
    names = tuple(str(k) for k in range(1, len(text.header) + 1))
    numbers = [text.line_numbers[0] - 1 if text.line_numbers else 1, *text.line_numbers]

    return replace(text, header=names, lines=lines, line_numbers=numbers)


def write_delimited(
    path: Path, facts: Mapping[str, str], columns: Mapping[str, Iterable[object]]
) -> None:
    """Write facts as comments ``# key: value``, then columns of numbers, for `read_delimited`."""
    text = io.StringIO()
    # A comment ends with its line.
    text.writelines(f"# {printable(f'{key}: {value}')}\n" for key, value in facts.items())
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(csv_cell, columns))
    writer.writerows(map(csv_cell, row) for row in zip(*columns.values(), strict=True))
    write_text(path, text.getvalue())


def _decoded(raw: bytes) -> str:
    """Return the text, from Unicode or a Western encoding, with plain minus signs."""
    # Every text is valid Latin-1: it comes last. `float` does not read typographic minus signs.
    for encoding in ("utf-16",) if raw.startswith(UTF_16) else ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding).replace("\u2212", "-")
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def _split(line: str) -> tuple[list[str], str]:
    """Return the cells of a header and their separator, the one with most cells."""
    best: list[str] = []
    separator = ","
    # Commas come last: between semicolons they are decimal marks.
    for mark in ";\t,":
        try:
            cells = next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
        except csv.Error:
            continue
        if len(cells) > max(len(best), 1):
            best = cells
            separator = mark
    names = [cell.strip() for cell in (best or [line.strip().strip('"')])]
    while len(names) > 1 and not names[-1]:
        names.pop()  # separators at the end of the line

    return names, separator
