"""Changes of a vehicle's parameters in a log."""

from collections.abc import Sequence

Changes = tuple[tuple[float, str, float, float], ...]


def parameter_changes(
    times: Sequence[float], names: Sequence[str], values: Sequence[float]
) -> Changes:
    """Return (time, name, previous, value) of every parameter written with another value."""
    current: dict[str, float] = {}
    changes = []
    for time, name, value in zip(times, names, values, strict=True):
        if current.setdefault(name, value) != value:
            changes.append((time, name, current[name], value))
        current[name] = value
    return tuple(changes)
