"""Reads and writes tables of numbers as text, with facts in the comments before the header.

A spreadsheet follows the conventions of its country, often semicolons or tabs between cells and
commas in numbers.
The header line decides the separator, or the last line where blanks separate its numbers. A header
has text above numbers; it is a line of its own or the comment above the numbers. All numbers
together decide the decimal mark. A table that can be read in two ways is refused, and the
message names the line: a wrong number would be worse than no number.
"""

import csv
import io
import math
import re
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
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
COMMENT_MARKS = "#% \t"
FACT = re.compile(r"#\s*(?P<key>[^:]+?)\s*:\s*(?P<value>.*?)\s*")
WIDER = ", or, if its numbers have decimal commas, separate cells by semicolons"
# A unit, possibly with a hold, behind a name: in a table whose cells are separated by blanks.
UNIT_OF_NAME = re.compile(r"\s+([\[({<][^\[\](){}<>]*[\])}>])")
NO_BREAK = "\xa0"
DATE_OR_TIME = re.compile(r"\d+[-:/]\d+[-:/]\d+[\d:.TZ+-]*")
# LabVIEW ends its settings with this line; the last name below it has no cells in most rows.
LABVIEW_END, LABVIEW_COMMENT = "***End_of_Header***", re.compile(r"[\t,]Comment\s*$")
# Fortran writes the exponents of double precision with a D.
FORTRAN = re.compile(r"(?<=\d\.\d)(\d*)[dD]([+-]\d{2,3})\b")
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
        The names in the first line, stripped; without a header the numbers of the columns, from 1.
    lines : sequence of str
        The lines of the body.
    line_numbers : sequence of int
        Their numbers in the file, from 1.
    facts : mapping of str to str
        The comments ``# key: value`` before the header.
    has_header : bool
    """

    path: Path
    separator: str
    header: tuple[str, ...]
    lines: Sequence[str]
    line_numbers: Sequence[int]
    facts: Mapping[str, str]
    has_header: bool = True

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
                if len(row) > width and not any(map(is_number, row)):
                    raise self.second_header(number)
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

    def second_header(self, number: int) -> ValueError:
        """Return the error of a line that has other names than the header."""
        return ValueError(
            f"{self.path}, line {number}, is the header of a second table: save each table in a "
            "file of its own, or begin a title above the only one with #."
        )

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

    The header is the first line that is neither blank nor a comment, has as many cells as the rows,
    and has text above numbers. Without such a line it is the last comment above the numbers, as
    `numpy.savetxt` and ROS write it. Comments start with ``#`` or ``%``.

    Raises
    ------
    ValueError
        If the contents are not text, or there is nothing but comments.
    """
    # A logger that lost power leaves zeros at the end of its file.
    raw = raw if raw.startswith(UTF_16) else raw.rstrip(b"\0")
    if b"\0" in raw and not raw.startswith(UTF_16):
        raise ValueError(
            f"{path} is not a CSV text file, since it contains zero bytes: save it as UTF-8."
        )
    lines = _decoded(raw).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = _without_labview_settings(lines)
    body = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)]
    if not body:
        raise ValueError(
            f"{path} is empty: write a header line with names, then one line of numbers per sample."
        )

    comments = map(FACT.fullmatch, lines[: body[0]])
    facts = {match["key"]: match["value"] for match in comments if match}
    if _are_separated_by_blanks(lines[body[-1]]):
        lines = list(map(_with_tabs, lines))
    header = _header(lines, body)
    above: list[int] = []
    if header is not None:
        body = body[body.index(header) :]
    else:
        body = _without_title(lines, body)
        above = _header_in_comments(lines, body[0])
        for k in above:
            lines[k] = lines[k].lstrip(COMMENT_MARKS)
        body = [*above, *body]
    has_header = header is not None or bool(above)
    names, separator = _split(lines[body[0]])
    if has_header:
        body = body[1:]
    else:
        names = [str(k) for k, _ in enumerate(_cells(lines[body[0]], separator), start=1)]

    return DelimitedText(
        path,
        separator,
        tuple(names),
        [lines[k] for k in body],
        [k + 1 for k in body],
        facts,
        has_header,
    )


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
    """Return the text, from Unicode or a Western encoding, with plain minus signs and exponents."""
    # Every text is valid Latin-1: it comes last. `float` does not read typographic minus signs.
    for encoding in ("utf-16",) if raw.startswith(UTF_16) else ("utf-8-sig", "cp1252"):
        try:
            return FORTRAN.sub(r"\1E\2", raw.decode(encoding).replace("\u2212", "-"))
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def _without_labview_settings(lines: list[str]) -> list[str]:
    """Return the lines with blank ones for the settings of LabVIEW; others as they are."""
    ends = [k for k, line in enumerate(lines[:200]) if line.startswith(LABVIEW_END)]
    if not ends:
        return lines
    names, *rows = lines[ends[-1] + 1 :] or [""]
    return [""] * (ends[-1] + 1) + [LABVIEW_COMMENT.sub("", names), *rows]


def _is_comment(line: str) -> bool:
    # A line of units may begin with an empty cell and a percent sign.
    return line.lstrip(" ").startswith(COMMENTS)


def _are_separated_by_blanks(line: str) -> bool:
    """Return whether blanks separate the numbers in a line, and its date and time of day."""
    cells = line.split()
    is_marked = "\t" in line or ";" in line or any(cell.endswith(",") for cell in cells)
    numbers = [cell for cell in cells if not DATE_OR_TIME.fullmatch(cell)]
    return len(cells) > 1 and not is_marked and bool(numbers) and are_numbers(numbers)


def _with_tabs(line: str) -> str:
    """Return a line with tabs between its cells; a unit belongs to its name: ``pitch [deg]``."""
    line = line.strip()
    if not line.startswith(("[", "(", "{", "<")) and not line[:1].isdigit():
        line = UNIT_OF_NAME.sub(lambda match: match[1].replace(" ", NO_BREAK), line)
    return "\t".join(re.split(r"[ \t]+", line)).replace(NO_BREAK, " ")


def _header(lines: list[str], body: Sequence[int]) -> int | None:
    """Return the place of the header: below a title and settings, above the numbers."""
    # The last line may be cut, and one in the middle may be a second header.
    some = [lines[k] for k in body[len(body) // 3 :: max(len(body) // 9, 1)]]
    candidates = []
    # A short table may show no numbers; in a longer one, such a line is a title.
    doubtful = []
    is_short = len(body) < 10
    for k in body[:200]:
        names, mark = _split(lines[k])
        rows = [_filled(_cells(row, mark)) for row in some]
        width = statistics.mode(map(len, rows))
        if len(names) < width:
            continue
        columns = zip(*(row for row in rows if len(row) == width), strict=True)
        are_numeric = [_is_numeric(column) for column in columns]
        above_numbers = [name for name, is_so in zip(names, are_numeric, strict=False) if is_so]
        has_text = any(name and not _is_datum(name) for name in above_numbers)
        if not any(are_numeric) and is_short:
            doubtful.append(k)
        elif has_text and not _is_row(names):
            candidates.append(k)
        elif len(names) == width and any(map(_is_datum, names)):
            break
    # A line of settings may have as many cells.
    timed = [k for k in candidates if "time" in lines[k].lower()]
    return next(iter([*timed, *candidates, *doubtful]), None)


def _is_numeric(column: Sequence[str]) -> bool:
    """Return whether most of the cells that are not empty are numbers."""
    present = [cell for cell in column if cell.lower() not in MISSING]
    return sum(map(_is_datum, present)) > len(present) / 2


def _is_row(names: Sequence[str]) -> bool:
    """Return whether cells are a row with a damaged cell, and not names such as ``time, 0, 1``."""
    numbers = [name for name in names if _is_datum(name)]
    return not all(number.isdigit() and int(number) < len(names) for number in numbers)


def _without_title(lines: list[str], body: list[int]) -> list[int]:
    """Return the lines from the first row on, if a title and a comment stand above it."""
    width = len(_split(lines[body[-1]])[0])
    for place, k in enumerate(body[:200]):
        cells, _ = _split(lines[k])
        if len(cells) == width and any(map(_is_datum, cells)):
            has_comment = any(map(_is_comment, lines[body[0] : k]))
            return body[place:] if has_comment else body
    return body


def _header_in_comments(lines: list[str], first: int) -> list[int]:
    """Return the place of the comment that names the columns of the `first` row, and of its units.

    It is empty without such a comment.
    """
    cells, mark = _split(lines[first])
    # The first row may end in empty cells.
    widths = len(cells), len(_cells(lines[first], mark))
    alike = []
    for k in range(first):
        title = lines[k].strip("\n").lstrip(COMMENT_MARKS)
        titles, separator = _split(title)
        # Units may end in empty cells, too.
        is_wide = len(titles) in widths or len(_cells(title, mark)) in widths
        if is_wide and separator == mark and not any(map(_is_datum, titles)):
            alike.append(k)
    # The last comment may hold the units of the one above it.
    has_two = len(alike) > 1 and alike[-2:] == [first - 2, first - 1]
    return alike[-2:] if has_two else alike[-1:]


def _is_datum(cell: str) -> bool:
    """Return whether a cell has digits of a number; nan may be a name."""
    return are_numbers([cell]) and any(map(str.isdigit, cell))


def _cells(line: str, mark: str) -> list[str]:
    """Return the stripped cells of a line."""
    try:
        row = next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:
        return [line]
    return [cell.strip() for cell in row]


def _split(line: str) -> tuple[list[str], str]:
    """Return the cells of a line without empty ones at its end, and their separator.

    The separator is the one that makes most cells.
    """
    best = [line.strip().strip('"')]
    separator = ","
    # Commas come last: between semicolons they are decimal marks.
    for mark in ";\t,":
        cells = _cells(line, mark)
        if len(cells) > len(best):
            best = cells
            separator = mark
            # With decimal commas, there are more pieces between commas than cells.
            if are_numbers([cell for cell in cells if cell]):
                break
    return _filled(best), separator


def _filled(cells: list[str]) -> list[str]:
    """Return cells without empty ones at the end, where separators ended the line."""
    filled = cells[:]
    while len(filled) > 1 and not filled[-1]:
        filled.pop()
    return filled
