"""Signals as a person reads them: degrees for radians, and Greek letters."""

import math
from collections.abc import Mapping, Sequence

from greybox.data.files.greek_letters import in_greek
from greybox.data.files.grouping import Item
from greybox.data.files.wording import numbered_where_alike
from greybox.data.record import Record


def shown_unit(units: Mapping[str, str], name: str) -> tuple[float, str]:
    """Return the factor of a signal to the unit that a person reads, and that unit."""
    # Pilots and logs speak of degrees; models compute in radians.
    unit = units.get(name, "")
    degrees = {"rad": "°", "rad/s": "°/s"}.get(unit)
    return (1.0, unit) if degrees is None else (180 / math.pi, degrees)


def signal_label(record: Record, name: str) -> str:
    """Return the symbol of a signal and the unit that a person reads."""
    return with_unit(in_greek(name), shown_unit(record.units, name)[1])


def with_unit(label: str, unit: str) -> str:
    """Return the label of an axis with its unit, if it has one."""
    return label if unit in ("", "1") else f"{label}, {unit}"


def chosen(items: Sequence[Item], number: int, kind: str) -> Item:
    """Return the item with this number, counted from 0, or from the end if it is negative.

    Raises
    ------
    ValueError
        If it does not exist.
    """
    if not -len(items) <= number < len(items):
        raise ValueError(
            f"there is no {kind} {number}: the fit has {len(items)}, counted from 0; gb.plot draws "
            "all that it has."
        )
    return items[number]


def distinct_labels(defaults: Sequence[str], labels: Sequence[str]) -> Sequence[str]:
    """Return one label for each item, by default numbered where two are alike.

    Raises
    ------
    ValueError
        If there are no items, or the number of `labels` is wrong.
    """
    if not defaults:
        raise ValueError("there is nothing to draw: give at least one fit.")
    if labels and len(labels) != len(defaults):
        raise ValueError(
            f"there are {len(labels)} labels for {len(defaults)} items: give one for each."
        )
    return labels or numbered_where_alike(defaults)
