"""Sensor biases in a sum of problems: every record has its own, with its number in the name."""

import itertools
from collections.abc import Sequence
from typing import Any

from greybox.data.record import Record
from greybox.formulation.held_estimate import HeldEstimate


def with_numbered_biases(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Return the parts with biases numbered by the record, where several records have one.

    Parts of one record share its biases. A bias is not numbered, so that records can share it, if a
    part renames it (also to its own name) or fixes it at an earlier fit, which has that name.
    """
    records = _record_numbers([part.data for part in parts])
    outside = [{part.outside(name) for name in part.declared} for part in parts]
    names_in_use = set().union(*outside)

    numbered: dict[tuple[str, int], str] = {}
    for part, record in zip(parts, records, strict=True):
        for name in _unnamed_biases(part):
            # A bias that only one record has keeps its plain name.
            owners = {r for r, names in zip(records, outside, strict=True) if name in names}
            if len(owners) > 1 and (name, record) not in numbered:
                candidates = (f"{name}_{k}" for k in itertools.count(record))
                new = next(candidate for candidate in candidates if candidate not in names_in_use)
                numbered[name, record] = new
                names_in_use.add(new)

    result = []
    for part, record in zip(parts, records, strict=True):
        renamed = {
            name: numbered[name, record]
            for name in _unnamed_biases(part)
            if (name, record) in numbered
        }
        result.append(part.with_(rename={**part.rename, **renamed}) if renamed else part)

    return tuple(result)


def _unnamed_biases(part: Any) -> list[str]:
    """Return the biases that a part neither renames nor holds at an earlier estimate."""
    return [
        name
        for name in part.declared
        if name.endswith("_bias")
        and name not in {*part.model.parameters, *part.rename}
        and not isinstance(part.fixed_values.get(name), HeldEstimate)
    ]


def _record_numbers(data: Sequence[Any]) -> list[int]:
    """Return the number of every record among the different ones, from 1; 0 for other data."""
    numbers: dict[Any, int] = {}
    return [
        # Two stretches of one log have the same checksum, but not the same times.
        numbers.setdefault(
            (item.checksum, item.time.size, item.time[0], item.time[-1]), len(numbers) + 1
        )
        if isinstance(item, Record)
        else 0
        for item in data
    ]
