"""Angles that jump by a full turn where they leave their range, such as ±π or 0 to 360°."""

import math
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.record import Record
from greybox.data.units import known_unit

# Share of a turn by which a jump may differ from it, and by which an angle may move in a sample
# elsewhere: beyond, the signal may be one that really jumps.
NEARLY = 0.2


def wrapped_turn(values: Array, unit: str) -> float | None:
    """Return the full turn, in the signal's unit, by which values (n,) jump; None if they do not.

    Without a known unit, a turn is 2π or 360.
    """
    conversion = known_unit(unit)
    if conversion is None:
        turns = (2 * math.pi, 360.0)
    elif conversion.si == "rad":
        turns = (2 * math.pi / conversion.factor,)
    else:
        turns = ()

    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(values))
    steps = steps[np.isfinite(steps)]
    for turn in turns:
        jumps = steps > turn / 2
        leftover = np.where(jumps, np.abs(steps - turn), steps)
        # An angle in its range leaves it by noise at most.
        if jumps.any() and np.all(leftover < NEARLY * turn) and np.ptp(known) < 1.01 * turn:
            return turn
    return None


def unwrapped(record: Record) -> Record:
    """Return a record whose angles in rad run on where they jumped, as `gb.prepare` makes them."""
    signals = dict(record.signals)
    for name, values in record.signals.items():
        if record.units.get(name) == "rad" and wrapped_turn(values, "rad"):
            measured = np.isfinite(values)
            run_on = values.copy()
            run_on[measured] = np.unwrap(values[measured])
            signals[name] = run_on
    return replace(record, signals=signals)
