"""Changes of a vehicle's parameters in a log."""

from collections.abc import Iterable


def parameter_changes(
    written: Iterable[tuple[float, str, float]],
) -> tuple[tuple[float, str, float, float], ...]:
    """Return (time, name, previous value, value) of every change of a parameter.

    `written` are all values in the log, (time, name, value), in the order of their times.
    """
    current: dict[str, float] = {}
    changes = []
    for time, name, value in written:
        if current.setdefault(name, value) != value:
            changes.append((time, name, current[name], value))
        current[name] = value
    return tuple(changes)
