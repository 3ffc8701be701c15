"""Whether an input moves a lightly damped mode that the model lacks."""

import itertools
from collections.abc import Iterator

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import Input, TestedRecord

MODE = Wording(
    "a lightly damped mode of {signal} near {level} rad/s",
    "a flexible part, or a slow motion such as a phugoid: states of a mass on a spring, which "
    "{signal} moves",
)
DAMPINGS = 0.05, 0.2
# Periods in the record of the slowest modes. They differ from a drift of the errors by following
# the input: of 20 plants with a phugoid, 5 were called wrong without those below five periods.
PERIODS = np.linspace(0.8, 5.0, 6)
FAST = 16  # number of faster modes
# Share of the power of an input up to the fastest mode, whose period has 5 to 21 samples.
POWER, SHORTEST, LONGEST = 0.95, 1.2, 0.3


def flexible_modes(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield modes of every input, each with both its factors, for motions of any phase."""
    for u in flight.inputs:
        slowest = 2 * np.pi / len(u.values)  # rad a sample
        fast = np.geomspace(PERIODS[-1] * slowest, _fastest(u), FAST)
        pairs = [(angle, DAMPINGS[0]) for angle in fast]
        pairs += itertools.product(PERIODS * slowest, DAMPINGS)
        for angle, damping in pairs:
            # The poles of s² + 2 ζ ω s + ω² by Tustin's rule, with ω where it is in the samples.
            w = 2 * float(np.tan(angle / 2))
            poles = [4 + w * (4 * damping + w), 2 * w**2 - 8, 4 + w * (w - 4 * damping)]
            # ω² and ω s over these: a mode is the sum of both.
            both = [
                flight.filtered(u.values, numerator, poles)
                for numerator in ([w**2, 2 * w**2, w**2], [2 * w, 0.0, -2 * w])
            ]
            yield u.term(MODE, np.array(both), level=angle / u.step)


def _fastest(u: Input) -> float:
    """Return the fastest mode that an input moves, rad a sample.

    Faster modes look like a delay, and follow the noise that a controller returns.
    """
    # The power of steps is in their differences.
    changes = np.diff(u.values) if u.has_steps else u.values - u.values.mean()
    power = np.cumsum(np.abs(np.fft.rfft(changes)) ** 2)
    return float(np.clip(np.pi * np.mean(power < POWER * power[-1]), LONGEST, SHORTEST))
