"""Harmonics that a linear plant does not explain, and the error of the response they imply.

A linear plant passes the harmonics of its control: y_k = P(kω) u_k. The difference e_k = y_k /
P(kω) - u_k comes from a nonlinearity between the logged control and the output, such as rounded or
saturated motors. It is referred to the control, since the plant would attenuate it in the output.
The P(kω) are interpolated from the measured response itself.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.spectral.demodulation import spectral_line

# Relative error of P(kω). Between measured frequencies, the magnitude of a plant is nearly straight
# over log frequency. Beyond the highest, another pole may begin: a first-order lag an octave below
# its corner gives 1 - 1/√(1 + 1/4) = 0.11 and 0.46 rad.
BETWEEN, BEYOND = 0.1, 0.5


class Harmonics(NamedTuple):
    """Amplitudes of control and output at 2ω, 3ω ... (h,), and on the lines beside, (h, 2, lines).

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
    """Return the harmonics in a window of whole periods, from fitted amplitudes and residuals."""
    orders = range(2, amplitudes.shape[1] + 1)
    # Lines on either side from which the noise is estimated, up to halfway to the next harmonic.
    reach = min(2, (periods - 1) // 2)
    places = [sign * m / periods for m in range(1, reach + 1) for sign in (1, -1)]
    lines = [
        [spectral_line(t, residual[:2], omega * (k + place)) for place in places] for k in orders
    ]
    beside = np.array(lines, dtype=complex).reshape(len(orders), len(places), 2).mT
    return Harmonics(omega, complex(amplitudes[1, 0]), amplitudes[0, 1:], amplitudes[1, 1:], beside)


def unexplained(omega: Array, response: ComplexArray, u: float, harmonics: Harmonics) -> float:
    """Return the unexplained harmonics of a test, as a share of the control's sine.

    NaN with a single frequency or a single period.

    Parameters
    ----------
    omega, response : (n,) arrays
        The measured response, from the lowest frequency up.
    u : float
        The amplitude of the control.
    harmonics : Harmonics
    """
    # One frequency has no neighbor between which the plant is interpolated.
    if omega.size < 2 or not harmonics.control.size or not harmonics.beside.shape[2] or u == 0:
        return math.nan
    at = harmonics.omega * np.arange(2, harmonics.control.size + 2)
    plant = interpolated(omega, response, at)
    error = np.where(at > omega[-1], BEYOND, BETWEEN)
    e = np.abs(harmonics.output / plant - harmonics.control)
    noise = np.sqrt(
        np.mean(
            np.abs(harmonics.beside[:, 1] / plant[:, None] - harmonics.beside[:, 0]) ** 2, axis=1
        )
    )
    # Errors of the interpolated response and of the sensor are not distortion. Far above the
    # bandwidth of the plant, harmonics of the sensor would mean large ones of the control: a flight
    # simulated with an attitude in steps of 0.01° has two of 0.4 % at its highest frequency.
    allowed = error * np.abs(harmonics.control) + 0.005 * abs(harmonics.sine) / np.abs(plant)
    # Noise alone exceeds three standard errors with the probability exp(-9) = 1e-4.
    excess = np.where(e > 3.0 * noise, np.maximum(e - allowed, 0), 0)
    return float(np.linalg.norm(excess) / u)


def interpolated(omega: Array, response: ComplexArray, at: NDArray[np.floating]) -> ComplexArray:
    """Return the response at other frequencies, log magnitude and phase linear in log frequency."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  (slow import)

    logs = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    # Beyond the highest frequency, the last slope continues.
    line = make_interp_spline(np.log(omega), logs, k=1)
    return np.exp(line(np.log(at)))
