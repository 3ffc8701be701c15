"""Complex amplitudes of a signal at one frequency, over whole periods: the paper's (3.16)."""

import math

import numpy as np

from greybox.data.clock import median_step
from greybox.data.files.arrays import Array, BoolArray, ComplexArray
from greybox.data.files.wording import counted

# A period counts as missing if fewer than this share of its samples is present.
FEWEST_SAMPLES = 0.3


class UnusableSegmentError(ValueError):
    """A stretch of a signal cannot be demodulated; the message gives the reason."""


def whole_periods(time: Array, omega: float, settle: float) -> tuple[BoolArray, int]:
    """Return a mask (n,) of the samples in the last whole periods, and the number of periods.

    The first `settle` seconds are excluded, in which transients decay.

    Raises
    ------
    UnusableSegmentError
        If there are too few samples or periods.
    """
    if not 0 < omega < math.inf:
        raise UnusableSegmentError(f"the frequency is {omega:g} rad/s: it must be above 0")
    period = math.tau / omega
    # Least squares have eight unknowns: a constant, a trend, and two for each of three harmonics.
    if time.size < 8:
        raise UnusableSegmentError(f"only {counted(time.size, 'sample')}")
    step = median_step(time)
    if step > period / 4:
        raise UnusableSegmentError(
            f"a period of {period:.3g} s has fewer than four samples of {step:.3g} s"
        )

    # Each sample covers one step, so the signal lasts a step longer than from its first to its last
    # sample. Without the small margin, rounding could lose a period.
    count = math.floor((time[-1] - time[0] + step - settle) / period + 1e-6)
    if count < 1:
        raise UnusableSegmentError(
            f"{time[-1] - time[0]:.3g} s are too short for {settle:g} s of settling and a period "
            f"of {period:.3g} s"
        )
    # Transients have decayed most in the last periods. The window begins half a step after the time
    # that is whole periods before the last sample, so that rounding cannot include a phase twice.
    rows = time > time[-1] + step / 2 - count * period
    bounds = (time[-1] - count * period, time[-1])
    samples_in_period = np.histogram(time[rows], count, bounds)[0]
    if samples_in_period.min() < FEWEST_SAMPLES * period / step:
        raise UnusableSegmentError(f"a whole period is missing after {time[rows][0]:.1f} s")
    return rows, count


def least_squares(
    t: Array, x: Array, omega: float, origin: float, harmonics: int
) -> tuple[ComplexArray, Array, Array]:
    """Fit a constant, a trend and harmonics to each row of `x` (rows, n) at the times `t` (n,), s.

    Returns
    -------
    amplitudes : (rows, h) complex array
        Amplitudes of the fundamental and the harmonics; phase relative to sin kω(t - origin).
    drift : (rows,) array
        Change of the trend over the window.
    residual : (rows, n) array
    """
    step = median_step(t)
    # At the Nyquist frequency, the samples of sine and cosine are linearly dependent. Harmonics
    # above 0.8 of it are left out.
    count = max(1, min(harmonics, int(0.8 * math.pi / (omega * step))))
    # The trend rises by 1 over the window, so its coefficient is the drift.
    trend = (t - t.mean()) / (t[-1] - t[0])
    waves = [sine_and_cosine(t, k * omega, origin) for k in range(1, count + 1)]
    columns = np.concatenate([[np.ones_like(t), trend], *waves])
    coefficients = _coefficients(columns, x)
    drift = coefficients[1]
    sines = coefficients[2::2]
    cosines = coefficients[3::2]
    return (sines + 1j * cosines).T, drift, x - coefficients.T @ columns


def spectral_line(t: Array, x: Array, omega: float) -> ComplexArray:
    """Return the complex amplitudes (rows,) of `x` (rows, n) at one frequency, rad/s.

    A sine and a constant are fitted by least squares. Phases are relative to a sine that begins at
    the first time.
    """
    columns = np.vstack([np.ones_like(t), sine_and_cosine(t, omega, float(t[0]))])
    _, sine, cosine = _coefficients(columns, x)
    return sine + 1j * cosine


def _coefficients(columns: Array, x: Array) -> Array:
    # The columns are few and well scaled, so that normal equations are as accurate as QR.
    return np.linalg.lstsq(columns @ columns.T, columns @ x.T)[0]


def sine_and_cosine(time: Array, omega: float, origin: float) -> Array:
    """Return sin ω(t - origin) and cos ω(t - origin), (2, n)."""
    return np.stack([np.sin(omega * (time - origin)), np.cos(omega * (time - origin))])
