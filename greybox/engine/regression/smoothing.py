"""Smoothing of a measured signal, and its derivative, with a cutoff chosen from the signal itself.

A stretch minus the line between its ends is a sum of sines (Lanczos, Applied Analysis, 1956;
Morelli and Klein, Aircraft System Identification, 2nd ed., chapter 11, who weight them by a Wiener
filter). Here the weight of a sine of angular frequency ω is 1 / (1 + (ω / cutoff)⁸), as for a
smoothing spline of order four on uniform samples. Generalized cross-validation (Craven and Wahba,
Numer. Math. 31 (1979) 377-403) chooses the cutoff.

Measured on multisines, chirps and friction with jumps (1500 and 6000 samples): the error of the
derivative was at most 1.25 times that of the best cutoff at white noise of 1 % and more, three
times at 0.01 %. It was below that of the best Savitzky-Golay window except at jumps, where both
were equal. Splines of order two and three were worse on smooth signals and little better at jumps.
`scipy.interpolate.make_smoothing_spline` takes 16 s for 60 000 samples, this method 0.2 s.
"""

import math

import numpy as np

from greybox.data.clock import clock_of
from greybox.data.files.arrays import Array, BoolArray, IntArray, sum_of_squares

POWER = 8  # twice the order of the smoothing spline
# Samples of a stretch: its 10 sines leave a few above any cutoff, from which the noise follows.
SHORTEST = 12


def smooth(time: Array, values: Array) -> tuple[Array, float]:
    """Smooth a signal, stretch by stretch, never across a gap.

    A single missing value is interpolated; two or more in a row are a gap, and so is a hole in the
    times, see `greybox.data.clock`. One cutoff serves all: generalized cross-validation takes
    everything but white noise for signal.

    Returns
    -------
    smoothed : (n,) array
        In the unit of the signal; NaN if the signal is missing or its stretch is too short. The
        first and last ``reach(cutoff)`` seconds of a stretch are less accurate.
    cutoff : float, rad/s
        Frequency at which half of the amplitude passes.

    Parameters
    ----------
    time : (n,) array, s
        Uniform between gaps.
    values : (n,) array
        NaN marks missing samples.

    Raises
    ------
    ValueError
        If no stretch has 12 samples.
    """
    values = without_holes(time, values)
    parts = [rows for rows in stretches(time, values) if rows.stop - rows.start >= SHORTEST]
    if not parts:
        raise ValueError(
            f"the signal has no stretch of {SHORTEST} samples without a gap among its "
            f"{values.size}, of which {int(np.isfinite(values).sum())} are finite: put it on the "
            "time base of its own sensor with gb.prepare."
        )
    sines = [_sines(values[rows], mean_step(time[rows])) for rows in parts]
    amplitude = np.concatenate([amplitude for amplitude, _ in sines])
    omega = np.concatenate([omega for _, omega in sines])
    # A straight line leaves nothing but rounding errors.
    is_line = sum_of_squares(amplitude) <= 1e-24 * float(np.nansum(values**2))
    cutoff = float(omega.max()) if is_line else _cross_validated(amplitude, omega)

    smoothed = np.full(values.size, np.nan)
    for rows in parts:
        smoothed[rows] = low_pass(values[rows], mean_step(time[rows]), cutoff)
    return smoothed, cutoff


def low_pass(values: Array, step: float, cutoff: float) -> Array:
    """Filter one stretch (n,) or (n, k) without a shift; a straight line passes."""
    from scipy.fft import idst  # noqa: PLC0415  (imports slowly)

    # Without the line, the sines would have to form the jump between both ends.
    line = np.linspace(values[0], values[-1], len(values))
    amplitude, omega = _sines(values, step)
    weight = _weight(omega, cutoff).reshape(-1, *[1] * (values.ndim - 1))
    line[1:-1] += idst(weight * amplitude, type=1, norm="ortho", axis=0)
    return line


def differentiate(time: Array, values: Array) -> Array:
    """Differentiate a smooth signal (n,), stretch by stretch, by cubic splines of order step⁴."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (imports slowly)

    result = np.full(values.size, np.nan)
    for rows in stretches(time, values):
        if rows.stop - rows.start > 3:
            result[rows] = CubicSpline(time[rows], values[rows])(time[rows], 1)
    return result


def reach(cutoff: float) -> float:
    """Return the time, s, of a decay to a tenth; the slowest pole of the filter is 0.38 cutoff."""
    return math.log(10) / (math.sin(math.pi / POWER) * cutoff)


def mean_step(time: Array) -> float:
    """Return the step of uniform times (n,), s."""
    return float((time[-1] - time[0]) / (time.size - 1))


def stretches(time: Array, values: Array) -> list[slice]:
    """Return the runs of rows in which no value is missing and time has no gap."""
    runs = _cut(time, np.isfinite(values), 1)
    return [slice(int(rows[0]), int(rows[-1]) + 1) for rows in runs if rows.size]


def without_holes(time: Array, values: Array) -> Array:
    """Return the signal with single missing samples interpolated by a cubic spline."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (imports slowly)

    filled = np.array(values, dtype=float)
    present = np.isfinite(values)
    for part in _cut(time, present, 2):
        if part.size < 4:  # a cubic needs four samples
            continue
        holes = np.setdiff1d(np.arange(part[0], part[-1]), part)
        if holes.size:
            filled[holes] = CubicSpline(time[part], values[part])(time[holes])
    return filled


def _cut(time: Array, present: BoolArray, apart: int) -> list[IntArray]:
    """Cut the rows that are present (n,) at holes in time and where they are further `apart`."""
    rows = np.flatnonzero(present)
    piece = np.searchsorted(clock_of(time).holes, rows)
    ends = (np.diff(rows) > apart) | (np.diff(piece) > 0)
    return np.split(rows, np.flatnonzero(ends) + 1)


def _sines(values: Array, step: float) -> tuple[Array, Array]:
    """Return the sine amplitudes of a stretch minus the line between its ends, and rad/s."""
    from scipy.fft import dst  # noqa: PLC0415  (imports slowly)

    n = len(values)
    inside = (values - np.linspace(values[0], values[-1], n))[1:-1]
    omega = np.arange(1, n - 1, dtype=np.float64) * (math.pi / ((n - 1) * step))
    return np.asarray(dst(inside, type=1, norm="ortho", axis=0), dtype=np.float64), omega


def _weight(omega: Array, cutoff: float) -> Array:
    return 1 / (1 + (omega / cutoff) ** POWER)


def _cross_validated(amplitude: Array, omega: Array) -> float:
    """Return the cutoff of least generalized cross-validation."""
    from scipy.optimize import brute  # noqa: PLC0415  (imports slowly)

    power = amplitude**2

    def score(logarithm: Array) -> float:
        removed = 1 - _weight(omega, math.exp(logarithm[0]))
        return math.log(removed**2 @ power + 1e-300) - 2 * math.log(np.sum(removed) + 1e-300)

    # A cutoff below the third sine would take nearly all of the signal for noise.
    low, high = np.log([np.sort(omega)[2], omega.max()])
    # The score has several local minima: a grid finds the lowest, and a search refines it.
    best = brute(score, [(low, high)], Ns=60)
    return math.exp(np.clip(best, low, high)[0])
