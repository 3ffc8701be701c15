"""Complex amplitudes of a signal at one frequency, over whole periods: the paper's (3.16)."""

import math

import numpy as np

from greybox.data.clock import median_step
from greybox.data.files.arrays import Array, BoolArray, ComplexArray
from greybox.data.files.wording import counted


class UnusableSegmentError(ValueError):
    """A stretch of a signal cannot be demodulated; the message gives the reason."""


def whole_periods(time: Array, omega: float, settle: float) -> tuple[BoolArray, int]:
    """Return the rows of the last whole periods after `settle`, and how many periods they are.

    Raises
    ------
    UnusableSegmentError
        If there are too few samples or periods.
    """
    if not 0 < omega < math.inf:
        raise UnusableSegmentError(f"the frequency is {omega:g} rad/s: it must be above 0")
    period = math.tau / omega
    # The least squares have eight unknowns: a constant, a trend and three harmonics.
    if time.size < 8:
        raise UnusableSegmentError(f"only {counted(time.size, 'sample')}")
    step = median_step(time)
    if step > period / 4:
        raise UnusableSegmentError(
            f"a period of {period:.3g} s has fewer than four samples of {step:.3g} s"
        )

    count = math.floor((time[-1] - time[0] + step - settle) / period + 1e-6)
    if count < 1:
        raise UnusableSegmentError(
            f"{time[-1] - time[0]:.3g} s are too short for {settle:g} s of settling and a period "
            f"of {period:.3g} s"
        )
    # The last periods, in which transients have decayed most.
    # Half a step more, so that rounding takes no sample twice.
    rows = time > time[-1] + step / 2 - count * period
    in_each = np.histogram(time[rows], count, (time[-1] - count * period, time[-1]))[0]
    # Each period of a window must have three tenths of its samples.
    if in_each.min() < 0.3 * period / step:
        raise UnusableSegmentError(f"a whole period is missing after {time[rows][0]:.1f} s")
    return rows, count


def least_squares(
    t: Array, x: Array, omega: float, origin: float, harmonics: int
) -> tuple[ComplexArray, Array, Array]:
    """Fit constant, trend and harmonics to the rows of `x`.

    Returns
    -------
    amplitudes : (rows, h) complex array
        Amplitudes of the fundamental and the harmonics; phase relative to sin kω(t - origin).
    drift : (rows,) array
        Change of the trend over the window.
    residual : (rows, n) array
    """
    step = median_step(t)
    # Sine and cosine are no longer independent at the Nyquist frequency.
    count = max(1, min(harmonics, int(0.8 * math.pi / (omega * step))))
    # From -1/2 to 1/2: its coefficient is the drift over the window.
    trend = (t - t.mean()) / (t[-1] - t[0])
    waves = [sine_and_cosine(t, k * omega, origin) for k in range(1, count + 1)]
    columns = np.concatenate([[np.ones_like(t), trend], *waves])
    c = _coefficients(columns, x)
    return (c[2::2] + 1j * c[3::2]).T, c[1], x - c.T @ columns


def spectral_line(t: Array, x: Array, omega: float) -> ComplexArray:
    """Return the complex amplitudes (rows,) at one frequency, fitted with a constant alone.

    Phases count from the first time.
    """
    columns = np.vstack([np.ones_like(t), sine_and_cosine(t, omega, float(t[0]))])
    c = _coefficients(columns, x)
    return c[1] + 1j * c[2]


def _coefficients(columns: Array, x: Array) -> Array:
    # The columns are few and well scaled, so that normal equations are as accurate as QR.
    return np.linalg.lstsq(columns @ columns.T, columns @ x.T)[0]


def sine_and_cosine(time: Array, omega: float, origin: float) -> Array:
    """Return sin ω(t - origin) and cos ω(t - origin), (2, n)."""
    return np.stack([np.sin(omega * (time - origin)), np.cos(omega * (time - origin))])
