"""The grammar of headers: what a cell above a column says of it.

A heading is a name, which may have an index, and the column's unit in a bracket of any kind. A word
behind the unit, or in its place, states how the signal varies between its samples.

| heading | name | unit |
| --- | --- | --- |
| ``pitch [deg]``, ``pitch (deg)``, ``pitch {deg}`` | pitch | deg |
| ``u [1 held]``, ``pitch [deg sampled]``, ``u [held]`` | u, pitch, u | with its hold |
| ``pos[0] [mm]``, ``q(1) (rad)`` | pos[0], q(1): numbers behind a name are an index | mm, rad |
| ``Pos (X) [mm]``, ``pos [mm] (raw)`` | Pos (X), pos (raw) | mm, the last unit |
| ``Pitch (cmd)`` | Pitch (cmd): no unit stands in the bracket | |
| ``thrust [counts]`` | thrust: a square bracket at the end is always a unit | counts |
| ``V (N)`` beside ``V (E)`` | V (N) and V (E): they are components, not newtons | |

Names keep all their brackets where two columns would have one name. Columns of one heading have
their places in their names, ``x (column 3)``. Tables of text, data frames, files of named arrays
and the columns that a user names all follow this grammar.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from greybox.data.files.arrays import AnyArray
from greybox.data.files.decimal_marks import are_numbers
from greybox.data.files.delimited_text import DelimitedText
from greybox.data.files.spelling import alternatives
from greybox.data.intersample import CONTINUOUS, HELD
from greybox.data.units import is_unit

BETWEEN = {"held": HELD, "sampled": CONTINUOUS}  # words on how a signal varies between samples

INDEX = re.compile(r"(?<=\w)[\[(]\d+(, ?\d+)*[\])]")
# The last one may not be closed; the round ones may have one more pair inside, as in N/(m/s).
BRACKET = re.compile(
    r"\[([^\[\]]*)(?:\]|$)|\{([^{}]*)(?:\}|$)|<([^<>]*)(?:>|$)|\(((?:[^()]|\([^()]*\))*)(?:\)|$)"
)

# At the end, square brackets and braces are for units; numbers in them are an index, as in pos [0].
UNKNOWN_UNIT = re.compile(r"[\[{](?![\d, ]+[\]}]).*")

# Units that are labels where a neighbor has a label: V (N) and V (E), Temp (min) and Temp (max).
LABELS = re.compile(r"[A-Za-z]|\d+|in|min")

# Ends of names that mean nothing else: not "_in", "_min" and "_T", which may be an input, a minimum
# and a temperature. They are used where a user names the column.
UNITS_AT_THE_END = re.compile(
    r".+[_ /:](?:((?i:(?:deg|rad)(?:[_/]s(?:ec)?2?)?|dps|rpm))"
    r"|(mV|kV|mA|uA|kN|kW|mm|cm|km|ft|kPa|hPa|mbar|degC|degF|kts|mph|kmh|m/s|m/s2|ft/s|km/h|%))"
)


class Heading(NamedTuple):
    """One column's name and unit, which may end in a word on the hold."""

    name: str
    unit: str

    @property
    def base(self) -> str:
        """The name before its first bracket that is no index."""
        return _base(self.name)

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Column(NamedTuple):
    """The place of a column, from 0, and its unit."""

    place: int
    unit: str


def heading(cell: str) -> Heading:
    """Return the name and the unit in one cell of a header."""
    text = " ".join(cell.split())
    groups = _groups(text)
    for group in reversed(groups):
        if _is_unit(_content(group)):
            return _split_at(group)
    if groups and groups[-1].end() == len(text) and UNKNOWN_UNIT.fullmatch(groups[-1][0]):
        return _split_at(groups[-1])
    return Heading(text, "")


def headings(cells: Iterable[str]) -> list[Heading]:
    """Return the headings of all columns of a table; every name is that of one column.

    A cell that is empty gives an empty name, apart from the first one, which may be a clock.
    """
    texts = [" ".join(cell.split()) for cell in cells]
    texts[:1] = [text or "(column 1)" for text in texts[:1]]
    named = [heading(text) for text in texts]
    _keep_labels(texts, named)

    # Names that are alike keep their brackets; those that are alike then have their places.
    alike = _in_several(named)
    named = [
        Heading(text, h.unit) if h.name in alike else h
        for text, h in zip(texts, named, strict=True)
    ]
    alike = _in_several(named)
    return [
        Heading(f"{h.name} (column {k})", h.unit) if h.name in alike else h
        for k, h in enumerate(named, start=1)
    ]


def _keep_labels(texts: Sequence[str], named: list[Heading]) -> None:
    """Give units that are labels back to their names: beside V (E), V (N) is no force."""
    families: defaultdict[str, list[int]] = defaultdict(list)
    for place, text in enumerate(texts):
        families[_base(text)].append(place)
    for places in families.values():
        if any(_groups(texts[k]) and not named[k].unit for k in places):
            for k in places:
                if LABELS.fullmatch(named[k].unit):
                    named[k] = Heading(texts[k], "")


def _in_several(named: Iterable[Heading]) -> set[str]:
    """Return the names of several columns."""
    counts = Counter(h.name for h in named)
    return {name for name, count in counts.items() if name and count > 1}


def split_names(
    columns: Mapping[str, AnyArray], units: Mapping[str, str]
) -> tuple[dict[str, AnyArray], dict[str, str]]:
    """Return the columns of a file that has names only, by their names without units, and units."""
    named = headings(columns)
    split = {h.name: x for h, x in zip(named, columns.values(), strict=True)}
    texts = {h.name: units.get(n) or h.unit for h, n in zip(named, columns, strict=True)}
    return split, texts


def with_units_in_header(text: DelimitedText) -> DelimitedText:
    """Return a table in whose header are the units that the line below it has, as in flight tests.

    In such a line, a unit stands above a number, and no number but a 1 stands in it.
    """
    rows = text.rows()
    _, row = next(rows, (0, []))
    _, below = next(rows, (0, []))
    units = [cell.strip("[](){} ") for cell in row]
    is_above_number = any(
        is_unit(unit) and not are_numbers([unit]) and are_numbers([number])
        for unit, number in zip(units, below, strict=False)
    )
    has_numbers = any(are_numbers([unit]) and unit != "1" for unit in units)
    if not is_above_number or has_numbers or len(units) < len(text.header):
        return text

    return replace(
        text,
        header=tuple(
            f"{name} [{unit}]" if unit else name
            for name, unit in zip(text.header, units, strict=True)
        ),
        lines=text.lines[1:],
        line_numbers=text.line_numbers[1:],
    )


def find_column(text: str, columns: Sequence[Heading]) -> Column:
    """Return the column that ``name`` or ``name:unit`` means, with or without brackets.

    Commas separate the names that a column has in several files: ``pitch:deg,Theta``.

    Raises
    ------
    ValueError
        If there is no such column, or two. The caller puts the name of the file before the message.
    """
    places = [place for part in (text, *text.split(",")) if (place := _place(part, columns))]
    if len(set(places)) > 1:
        raise ValueError(f"has all of the columns {text!r}: name one of them.")
    if not places:
        # A name may have a colon of its own.
        wanted = text.rpartition(":")[0] or text
        names = alternatives(wanted, map(str, columns))
        raise ValueError(f"has no column {wanted!r}; it has {names}")
    return places[0]


def _place(text: str, columns: Sequence[Heading]) -> Column | None:
    """Return the column that one name means, with its unit; None if there is none."""
    name, _, unit = text.rpartition(":")
    # The whole text is tried first: a name may have a colon of its own. No unit has a comma.
    for wanted, stated in ((text, ""), (name, unit))[: 1 if "," in unit else 2]:
        meant = heading(wanted)
        alike = [
            [k for k, h in enumerate(columns) if h.name == wanted],
            [k for k, h in enumerate(columns) if h == meant],
            [k for k, h in enumerate(columns) if h.base == wanted],
        ]
        places = next(filter(None, alike), [])
        if len(places) > 1:
            names = " and ".join(repr(columns[k].name) for k in places[:4])
            raise ValueError(f"has several columns {wanted!r}: name one of {names}.")
        if places:
            return Column(places[0], stated or columns[places[0]].unit)
    return None


def unit_and_hold(text: str) -> tuple[str, str]:
    """Split ``deg sampled``, a unit and a word on the hold; either may be empty."""
    unit, _, hold = text.strip().rpartition(" ")
    hold = hold.lower()
    return (unit, hold) if hold in BETWEEN else (text.strip(), "")


def units_and_holds(statements: Mapping[str, str]) -> tuple[dict[str, str], dict[str, float]]:
    """Return units, and the holds that are stated, by name from texts such as ``deg sampled``."""
    parts = {name: unit_and_hold(text) for name, text in statements.items()}
    units = {name: unit for name, (unit, _) in parts.items()}
    holds = {name: BETWEEN[word] for name, (_, word) in parts.items() if word}
    return units, holds


def unit_in_name(name: str) -> str:
    """Return the unit at the end of a name, as in ``pitch_deg``; empty without one."""
    match = UNITS_AT_THE_END.fullmatch(name)
    if match is None:
        return ""
    return match[2] or match[1].lower().replace("_", "/")


def _groups(text: str) -> list[re.Match[str]]:
    """Return the brackets of a heading that are no indices."""
    return [group for group in BRACKET.finditer(text) if not INDEX.match(text, group.start())]


def _base(text: str) -> str:
    groups = _groups(text)
    return text[: groups[0].start()].strip() if groups else text


def _split_at(group: re.Match[str]) -> Heading:
    """Return the heading whose unit is in this bracket, and whose name is the text around it."""
    text = group.string
    name = f"{text[: group.start()].rstrip()} {text[group.end() :].lstrip()}".strip()
    return Heading(name, _content(group)) if name else Heading(text, "")


def _content(group: re.Match[str]) -> str:
    return next(filter(None, group.groups()), "").strip()


def _is_unit(content: str) -> bool:
    """Return whether the content of a bracket is a unit, a word on the hold, or nothing."""
    unit, hold = unit_and_hold(content)
    return is_unit(unit) or (not unit and (bool(hold) or not content))
