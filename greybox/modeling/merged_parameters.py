"""Parameters of the same name in several models or problems, as one unknown."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from greybox.data.files.arrays import Interval
from greybox.modeling.parameter import Parameter


def merge(name: str, a: Parameter, b: Parameter) -> Parameter:
    """Merge two declarations with the same name: bounds and start boxes intersect.

    Raises
    ------
    ValueError
        If the units differ, one is fixed and the other free, or the bounds do not overlap.
    """
    if a == b:
        return a
    conflict = ""
    if a.unit != b.unit:
        conflict = f"has the unit {a.unit!r} in one part and {b.unit!r} in the other"
    elif a.fixed != b.fixed:
        conflict = "is fixed in one part and free in the other"
    # Two constants with the same name and different values are two quantities.
    elif a.fixed and a.start != b.start:
        conflict = f"is fixed at {a.start:g} in one part and at {b.start:g} in the other"
    if conflict:
        raise ValueError(
            f"{name!r} {conflict}: they are one unknown only if alike in both; else give one "
            f"another name, rename={{{name!r}: ...}}."
        )

    low, high = _intersect(name, "bounds", a.bounds, b.bounds)
    first, last = _intersect(name, "start boxes", a.box, b.box)
    first, last = max(first, low), min(last, high)
    boxed = a.starts is not None or b.starts is not None
    return replace(
        a,
        bounds=(low, high),
        start=min(max(a.start, low), high),
        starts=(first, last) if boxed and first <= last else None,
    )


def merged_parameters(owners: Iterable[Any]) -> dict[str, Parameter]:
    """Merge the `parameters` of several models or problems; a common name is one unknown."""
    result: dict[str, Parameter] = {}
    for owner in owners:
        for name, parameter in owner.parameters.items():
            result[name] = merge(name, result.setdefault(name, parameter), parameter)
    return result


def _intersect(name: str, what: str, a: Interval, b: Interval) -> Interval:
    low, high = max(a[0], b[0]), min(a[1], b[1])
    if low > high or (low == high and what == "bounds"):
        raise ValueError(
            f"the {what} of {name!r}, ({a[0]:g}, {a[1]:g}) and ({b[0]:g}, {b[1]:g}), do not "
            f"overlap: widen them, or give one another name, rename={{{name!r}: ...}}."
        )
    return low, high
