"""Whether a sampled signal moves smoothly or only as noise does, from one sample to the next."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

SMOOTH = 1.0  # ratio below which a signal moves: variance of the movement above that of white noise
CERTAIN = 3.0  # standard deviations of the ratio of white noise


@dataclass(frozen=True)
class Movement:
    """The von Neumann ratio of a signal: mean squared successive difference over variance.

    It is 2 for white noise, near 0 for a smooth movement, and NaN for a constant or less than four samples.

    Source: von Neumann (1941), Distribution of the ratio of the mean square successive difference to the variance,
    Annals of Mathematical Statistics 12.
    """

    ratio: float
    samples: int

    @property
    def spread(self) -> float:
        """Standard deviation of the ratio of white noise."""
        n = self.samples
        return 2 * math.sqrt((n - 2) / (n**2 - 1)) if n > 2 else math.inf

    @property
    def smooth(self) -> bool:
        """True where the signal moves by more than white noise on top of it; few samples must do so more clearly."""
        return self.ratio < min(SMOOTH, 2 - CERTAIN * self.spread)

    @property
    def noisy(self) -> bool:
        """True where the signal is not told from white noise."""
        return not self.ratio < 2 - CERTAIN * self.spread

    @property
    def explicable(self) -> float:
        """The fit of the best model in percent, if what moves from one sample to the next is noise; NaN if unknown."""
        return 100 * (1 - math.sqrt(min(self.ratio / 2, 1.0)))


def movement(stretches: Sequence[ArrayLike]) -> Movement:
    """Return how stretches of samples (n,) move, each about its own mean; NaN among them are skipped."""
    series = [s[np.isfinite(s)] for s in (np.asarray(stretch, dtype=float) for stretch in stretches)]
    series = [s for s in series if s.size > 1]
    samples = sum(s.size for s in series)
    free = sum(s.size - 1 for s in series)
    squares = sum(float(np.sum((s - s.mean()) ** 2)) for s in series)
    if samples < 4 or not squares > 0:
        return Movement(math.nan, samples)
    return Movement(sum(float(np.sum(np.diff(s) ** 2)) for s in series) / squares, free + 1)
