"""A declared parameter with other bounds, start or start box, for one problem."""

import math
from dataclasses import replace

from greybox.modeling.parameter import Parameter, number_pair


def restated(
    name: str,
    parameter: Parameter,
    *,
    bounds: tuple[float, float] | None = None,
    start: float | None = None,
    starts: tuple[float, float] | None = None,
) -> Parameter:
    """Return a parameter with these bounds, start and start box in place of the declared ones.

    A declared start outside the new bounds or start box moves to their nearest end. A declared
    start box is cut to the new bounds; if nothing is left of it, starts are drawn within the
    bounds. If the new bounds have an infinite end, starts are drawn within the declared ones.

    Raises
    ------
    ValueError
        For what a `Parameter` cannot have; the sentence names the parameter.
    """
    if bounds is None and start is None and starts is None:
        return parameter
    try:
        limits = parameter.bounds if bounds is None else number_pair(bounds, "bounds")
        # Without finite bounds nothing could be drawn.
        drawn = parameter.starts if all(map(math.isfinite, limits)) else parameter.box
        box = _cut(drawn, limits) if starts is None else number_pair(starts, "starts")
        low, high = limits if starts is None or box is None else box
        begin = min(max(parameter.start, low), high) if start is None else start
        return replace(parameter, bounds=limits, start=begin, starts=box)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _cut(
    box: tuple[float, float] | None, bounds: tuple[float, float]
) -> tuple[float, float] | None:
    """Return the part of a start box within bounds, None where there is none."""
    if box is None:
        return None
    low, high = max(box[0], bounds[0]), min(box[1], bounds[1])
    return (low, high) if low <= high and math.isfinite(high - low) else None
