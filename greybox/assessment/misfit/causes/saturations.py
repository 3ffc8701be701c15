"""Whether an input saturates, or has a dead zone, on both sides or on one."""

from collections.abc import Iterator

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord

CURVE = Wording(
    "a saturation of {signal} near ±{level}",
    "in place of u.{signal}, gb.minimum(gb.maximum(u.{signal}, -p.limit), p.limit) for a "
    "saturation, or u.{signal} less that for a dead zone",
    opposite="a dead zone of {signal} near ±{level}",
)
ONE_SIDE = Wording(
    "a gain of {signal} that is larger beyond {level}",
    "u.{signal} + p.new * gb.maximum(u.{signal} - p.limit, 0) in place of u.{signal}, or "
    "gb.minimum below it",
    opposite="a gain of {signal} that is smaller beyond {level}, as with a saturation of one side",
)
LEVELS = (0.2, 0.4, 0.7)  # over the largest distance from the median


def saturations(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield an input cut at levels on both sides of its median, and what is beyond each."""
    for u in flight.inputs:
        middle = float(np.median(u.values))
        distance = u.values - middle
        for level in (np.abs(distance).max() * np.array(LEVELS)).tolist():
            yield u.term(CURVE, np.clip(distance, -level, level), level=level)
            yield u.term(ONE_SIDE, np.maximum(distance, level), level=middle + level)
            yield u.term(ONE_SIDE, np.minimum(distance, -level), level=middle - level)
