"""A declared parameter with other bounds, start or start box, for one problem."""

import math
from dataclasses import replace
from typing import Any

from greybox.data.files.argument_checks import is_finite_number
from greybox.data.files.arrays import Interval
from greybox.data.frequency_band import number_pair
from greybox.modeling.parameter import Parameter


def restated(
    name: str,
    parameter: Parameter,
    *,
    bounds: Interval | None = None,
    start: float | None = None,
    starts: Interval | None = None,
) -> Parameter:
    """Return a parameter with these bounds, start and start box in place of the declared ones.

    A declared start outside the new bounds or start box moves to their nearest end. A declared
    start box is cut to the new bounds; if nothing remains, starts are drawn within the bounds. If
    the new bounds have an infinite end, starts are drawn within the declared ones.

    Raises
    ------
    ValueError
        For values that a `Parameter` refuses; the message names the parameter.
    """
    try:
        limits = parameter.bounds if bounds is None else number_pair(bounds, "bounds")
        # Nothing can be drawn from infinite bounds.
        drawn = parameter.starts if all(map(math.isfinite, limits)) else parameter.box
        box = _cut(drawn, limits) if starts is None else number_pair(starts, "starts")
        low, high = limits if starts is None or box is None else box
        begin = min(max(parameter.start, low), high) if start is None else start
        return replace(parameter, bounds=limits, start=begin, starts=box)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def held_at(name: str, parameter: Parameter, value: Any) -> Parameter:
    """Return a parameter that is fixed at a value.

    Raises
    ------
    ValueError
        If the value is not a number within the bounds.
    """
    low, high = parameter.bounds
    if not is_finite_number(value):
        raise ValueError(
            f"fixed gives {name!r} the value {value!r}: give a finite number or a Fit."
        )
    if not low <= value <= high:
        raise ValueError(
            f"fixed gives {name!r} the value {value:g} outside its bounds ({low:g}, {high:g}): "
            "change the value, or the bounds of the parameter."
        )
    return replace(parameter, start=float(value), fixed=True)


def _cut(box: Interval | None, bounds: Interval) -> Interval | None:
    """Return the part of a start box within bounds; None if it is empty."""
    if box is None:
        return None
    low, high = max(box[0], bounds[0]), min(box[1], bounds[1])
    return (low, high) if low <= high and math.isfinite(high - low) else None
