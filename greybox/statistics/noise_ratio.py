"""The von Neumann ratio: whether a sampled signal is smooth, or looks like white noise."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.data.files.arrays import Array, sum_of_squares

# Ratio below which a signal is smooth. For a smooth signal plus white noise it is twice the share
# of the noise in the variance: at 1, both are equally strong.
SMOOTH = 1.0


@dataclass(frozen=True)
class NoiseRatio:
    """The von Neumann ratio of a signal: mean squared successive difference over variance.

    It is 2 for white noise, near 0 for a smooth signal, and NaN for a constant or fewer than four
    samples.

    Source: von Neumann (1941), Distribution of the ratio of the mean square successive difference
    to the variance, Annals of Mathematical Statistics 12.
    """

    ratio: float
    samples: int

    @property
    def spread(self) -> float:
        """Standard deviation of the ratio of white noise."""
        n = self.samples
        return 2 * math.sqrt((n - 2) / (n**2 - 1)) if n > 2 else math.inf

    @property
    def noisy(self) -> bool:
        """True where the signal is indistinguishable from white noise."""
        # One in 740 signals of pure noise lies below (normal distribution).
        return self.ratio >= 2 - 3.0 * self.spread

    @property
    def attainable_fit_percent(self) -> float:
        """Fit of the best model in percent, if all that is not smooth is noise; NaN if unknown."""
        return 100 * (1 - math.sqrt(min(self.ratio / 2, 1.0)))


def noise_ratio(stretches: Sequence[Array]) -> NoiseRatio:
    """Return the ratio of stretches of samples (n,), each about its own mean; NaN are skipped."""
    measured = (stretch[np.isfinite(stretch)] for stretch in stretches)
    series = [s for s in measured if s.size > 1]
    samples = sum(s.size for s in series)
    # No difference is taken across the end of a stretch.
    squares = sum(sum_of_squares(s - s.mean()) for s in series)

    if samples < 4 or not squares > 0:
        return NoiseRatio(math.nan, samples)
    changes = sum(sum_of_squares(np.diff(s)) for s in series)
    return NoiseRatio(changes / squares, samples - len(series) + 1)
