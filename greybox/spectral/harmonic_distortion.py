"""Harmonics that a linear plant does not explain, and what they tell of the error of the response.

A linear plant passes the harmonics of its control: y_k = P(kω) u_k. What differs, e_k = y_k / P(kω)
- u_k, comes from a nonlinearity between the logged control and the output, such as rounded or
saturated motors, and is referred to the control: the plant's own decline would hide it in the
output. The P(kω) are read off the measured response itself.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array, ComplexArray
from greybox.spectral.demodulation import spectral_line

# Error of P(kω), relative: read off between measured frequencies, where the magnitude of a plant is
# nearly straight over their logarithm, and beyond the highest, where another pole may begin: that
# of a first-order lag an octave below its corner, 1 - 1/√(1 + 1/4) = 0.11 and 0.46 rad.
BETWEEN, BEYOND = 0.1, 0.5

# Of the output's sine, its harmonics that are put down to the sensor, not to the plant: far above
# the bandwidth of the plant they would stand for large ones of the control. A flight of the
# simulator, whose attitude is in steps of 0.01°, has 0.4 % of two harmonics at its highest
# frequency.
SENSOR = 0.005

# Standard errors of noise that e_k must exceed: noise alone does with a probability of exp(-9) =
# 1e-4.
DETECTED = 3.0

LINES = 2  # beside a harmonic, on either side, from which its noise is taken


class Harmonics(NamedTuple):
    """Amplitudes of control and output at 2ω, 3ω ... (h,), and on the lines beside each of them, (h, 2, lines).

    `sine` is the amplitude of the output at ω.
    """

    omega: float
    sine: complex
    control: ComplexArray
    output: ComplexArray
    beside: ComplexArray


def harmonics_of(
    t: Array, amplitudes: ComplexArray, residual: Array, omega: float, periods: int
) -> Harmonics:
    """Return the harmonics in a window of whole periods, given the fitted amplitudes and what they leave."""
    orders = range(2, amplitudes.shape[1] + 1)
    reach = min(LINES, (periods - 1) // 2)  # half of the way to the next harmonic
    places = [sign * m / periods for m in range(1, reach + 1) for sign in (1, -1)]
    lines = [
        [spectral_line(t, residual[:2], omega * (k + place), float(t[0])) for place in places]
        for k in orders
    ]
    beside = np.array(lines, dtype=complex).reshape(len(orders), len(places), 2).swapaxes(1, 2)
    return Harmonics(omega, complex(amplitudes[1, 0]), amplitudes[0, 1:], amplitudes[1, 1:], beside)


def unexplained(
    omega: Array, response: ComplexArray, measured: Sequence[tuple[complex, Harmonics]]
) -> Array:
    """Return the harmonics that the plant does not explain, as a share of the control's sine, for each test.

    Parameters
    ----------
    omega, response : (n,) arrays
        The measured response, from the lowest frequency up.
    measured : sequence of (amplitude of the control, Harmonics)

    Returns
    -------
    (tests,) array
        NaN where it cannot be told: from a single frequency or a single period.
    """
    if omega.size < 2:
        return np.full(len(measured), math.nan)
    return np.array([_share(omega, response, abs(u), found) for u, found in measured])


def _share(omega: Array, response: ComplexArray, u: float, found: Harmonics) -> float:
    if not found.control.size or not found.beside.shape[2] or u == 0:
        return math.nan
    at = found.omega * np.arange(2, found.control.size + 2)
    plant = interpolated(omega, response, at)
    error = np.where(at > omega[-1], BEYOND, BETWEEN)
    e = np.abs(found.output / plant - found.control)
    noise = np.sqrt(
        np.mean(np.abs(found.beside[:, 1] / plant[:, None] - found.beside[:, 0]) ** 2, axis=1)
    )
    allowed = error * np.abs(found.control) + SENSOR * abs(found.sine) / np.abs(plant)
    excess = np.where(e > DETECTED * noise, np.maximum(e - allowed, 0), 0)
    return float(np.sqrt(np.sum(excess**2)) / u)


def interpolated(omega: Array, response: ComplexArray, at: NDArray[np.floating]) -> ComplexArray:
    """Return the response at other frequencies: straight lines of log magnitude and phase over log frequency."""
    x, wanted = np.log(omega), np.log(at)
    known = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    slope = (known[-1] - known[-2]) / (x[-1] - x[-2])
    beyond = known[-1] + slope * (wanted - x[-1])
    between = np.interp(wanted, x, known.real) + 1j * np.interp(wanted, x, known.imag)
    return np.exp(np.where(wanted > x[-1], beyond, between))
