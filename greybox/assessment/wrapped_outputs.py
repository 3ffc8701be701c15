"""Outputs that jump by a full turn where the fitted ones do not."""

from typing import Any

import numpy as np

from greybox.data.wrapped_angles import wrapped_turn


def wrapped(fit: Any) -> tuple[str, ...]:
    """Return a sentence on outputs that jump by a full turn where the fitted ones do not."""
    texts = {}
    for part in fit.records:
        for name in part.outputs if part.data.has_time else ():
            turn = wrapped_turn(part.data[name], part.data.units.get(name, ""))
            fitted = part.simulated[name]
            # A model may wrap its angle, too, as gb.arctan2 does.
            if turn and not np.any(np.abs(np.diff(fitted)) > turn / 2):
                texts.setdefault(name, _unwrapping(name, turn, part.name))
    return tuple(texts.values())


def _unwrapping(name: str, turn: float, record: str) -> str:
    is_radian = abs(turn - 2 * np.pi) < 1e-9
    period, words = ("", "2π") if is_radian else (f", period={turn:g}", f"{turn:g}")
    return (
        f"the measured {name} of {record!r} jumps by a full turn ({words}), which the model does "
        f"not: unwrap it, numpy.unwrap({name}{period})."
    )
