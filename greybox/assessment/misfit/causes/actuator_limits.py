"""Whether an actuator follows its input at a limited rate, or with a backlash."""

from collections.abc import Iterator

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord

RATE_LIMIT = Wording(
    "a rate limit of {signal} near ±{level} per second",
    "a state {signal}_moved in place of u.{signal}, with the derivative gb.minimum(gb.maximum("
    "(u.{signal} - x.{signal}_moved) / T_short, -p.limit), p.limit), T_short a few samples",
)
BACKLASH = Wording(
    "a backlash of {signal} of about {level}",
    "a state {signal}_moved in place of u.{signal}, with the derivative (gb.maximum(u.{signal} - "
    "x.{signal}_moved - p.play / 2, 0) + gb.minimum(u.{signal} - x.{signal}_moved + p.play / 2, "
    "0)) / T_short, a few samples",
)
# Rate limits, over the mean speed of an input: with a lower one, steps are hardly followed, and a
# sine is nowhere faster than 1.6 times the mean. At 0.7 times a limit, backlash explains more.
RATES = np.geomspace(0.5, 2.5, 6)
PLAYS = (0.2, 0.4, 0.7)  # over the largest distance of an input from its median


def actuator_limits(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield rate limits and backlash of every input."""
    for u in flight.inputs:
        for rate in (np.mean(np.abs(flight.rate(u.values))) * RATES).tolist():
            moved = flight.following(u.values, rate * u.step, is_slow=True)
            yield u.term(RATE_LIMIT, moved, level=rate)
        largest = np.abs(u.values - np.median(u.values)).max()
        for play in (largest * np.array(PLAYS)).tolist():
            moved = flight.following(u.values, play / 2, is_slow=False)
            yield u.term(BACKLASH, moved, level=play)
