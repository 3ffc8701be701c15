"""Parameters of a vehicle during a test: those in effect, and changes within it."""

from collections.abc import Sequence

from greybox.data.record import Recording


def parameters_during(
    recording: Recording, start: float, end: float, begin: Sequence[str]
) -> dict[str, float]:
    """Return the parameters in effect from `start` to `end`, s.

    Raises
    ------
    ValueError
        If the log has no parameters, or if one whose name begins with one of `begin` changes.
    """
    about = recording.metadata
    parameters = dict(about.get("parameters", {}))
    if not parameters:
        raise ValueError(
            f"{recording.source or 'the recording'} has no parameters, so the gains that flew are "
            "not known: log them, or give a controller with its gains."
        )
    changed = []
    for time, name, previous, value in reversed(about.get("parameter_changes", ())):
        if time > start:
            parameters[name] = previous
            if time <= end and name.startswith(tuple(begin)):
                changed.append(f"{name} from {previous:g} to {value:g} at {time:.1f} s")
    if changed:
        raise ValueError(
            f"gains changed during the test, {start:.1f} to {end:.1f} s: "
            f"{', '.join(reversed(changed))}; choose a test or a time without changes."
        )
    return parameters


def parameter_changes(
    times: Sequence[float], names: Sequence[str], values: Sequence[float]
) -> tuple[tuple[float, str, float, float], ...]:
    """Return (time, name, previous, value) of every change of a parameter."""
    current: dict[str, float] = {}
    changes = []
    for time, name, value in zip(times, names, values, strict=True):
        if current.setdefault(name, value) != value:
            changes.append((time, name, current[name], value))
        current[name] = value
    return tuple(changes)
