"""Families of error spectra that are compared by their likelihood, beside autoregressions.

Slow parts in white noise, and white noise with a part of the color of the sensitivities.
"""

import math
from dataclasses import dataclass

import numpy as np

from greybox.files.arrays import Array
from greybox.statistics.error_spectrum import ROUNDING
from greybox.statistics.frequency_grid import FrequencyGrid

# Shares of a colored part in the variance. A grid denser by 1.5 changes no standard error by 2 %.
SHARES = np.array([0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.55, 0.75, 0.9, 1.0])


@dataclass(frozen=True, eq=False)
class SpectralFamily:
    """Spectra of one form, (m, b) and of mean one, and the means (m,) of their logarithms."""

    shapes: Array
    logarithm: Array
    inverse: Array

    @classmethod
    def of(cls, shapes: Array, grid: FrequencyGrid) -> "SpectralFamily":
        """Prepare the mean over the frequencies of a periodogram over every shape."""
        return cls(shapes, grid.mean(np.log(shapes)), grid.band_weight / shapes)

    def scores(self, banded: Array, n: float) -> tuple[Array, Array]:
        """Return variances (m,) for n samples of a periodogram (b,), and -2 log likelihood."""
        # All members are equally likely before the data: a family counts with its mean likelihood,
        # whatever its number of members.
        scale = self.inverse @ np.maximum(banded, ROUNDING)
        return scale, n * (np.log(scale) + self.logarithm) + 2 * math.log(
            len(scale)
        ) + aicc_penalty(1, n)


def aicc_penalty(unknowns: float, n: float) -> float:
    """Return the penalty of AICc, which grows without limit as unknowns approach the numbers."""
    return 2 * unknowns * n / max(n - unknowns - 1, 1e-3)


def slow_parts(grid: FrequencyGrid) -> Array:
    """Return spectra (m, b), of mean one, of white noise with an exponentially correlated part."""
    # In a record of this length, slower errors look like a constant.
    times = np.geomspace(1.0, max(grid.longest / 3, 2.0), 14)
    phi = np.exp(-1 / times)[:, None]
    return with_white_noise((1 - phi**2) / (1 - 2 * phi * np.cos(grid.omega) + phi**2))


def sensitivity_shapes(grid: FrequencyGrid, power: Array) -> Array:
    """Return the spectra (m, b), of mean one, of the color of the sensitivities and of its root.

    The sensitivities pass through the dynamics twice, process noise once.
    """
    shapes = []
    # Twice, to smooth away the lines of a narrow-band input, which errors do not have.
    for width in (8, 32):
        smooth = moving_average(moving_average(power, width), width)
        shapes += [smooth, np.sqrt(smooth)]
    return np.array([shape / max(float(grid.mean(shape)), 1e-300) for shape in shapes])


def with_white_noise(shapes: Array) -> Array:
    """Return spectra of every share of the `shapes` (m, b) in white noise, (m shares, b)."""
    mixed = (1 - SHARES)[:, None] + SHARES[:, None] * shapes[:, None]
    return np.maximum(mixed.reshape(-1, shapes.shape[1]), ROUNDING)


def moving_average(values: Array, width: int) -> Array:
    """Return the moving average of values (b,), mirrored at their ends."""
    half = min(width // 2, len(values) - 1)
    window = np.full(2 * half + 1, 1 / (2 * half + 1))
    return np.convolve(np.pad(values, half, mode="reflect"), window, mode="valid")
