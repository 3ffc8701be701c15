"""Frequency responses of sweeps and noise: by local polynomials, or by windows of several lengths.

By default `greybox.spectral.local_polynomials` estimates, whose error falls faster with the length
of the record and whose points are independent. Windows are there for comparison with COMPOSITE of
CIFER (Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 10): a
short window averages more but smears a resonance, a long one resolves it, and the combination
weighs them.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.files.arrays import Array
from greybox.spectral.local_polynomials import Lines, lines_of, points_at, tiled_points
from greybox.spectral.uniform_stretches import UniformStretch, uniform_stretches
from greybox.spectral.welch import (
    HZ,
    PERIODS,
    WindowedPoint,
    estimates,
    response_at,
    transforms,
    without_incoherent,
)

# Fewest periods in the longest stretch: below, a band of polynomials would reach the frequencies
# that removing a trend changes.
LOWEST = 6

HIGHEST = 0.4  # of the sampling rate

# Errors below come from `benchmarks/signal_constants.py`: five windows from a third to a 24th of the
# record, a sweep of 60 s, a resonance damped by 0.05 (by 0.3). The values in use give 1.6 % (0.8 %).
LEAKAGE_TERMS = 2  # with one 4.8 % (1.1 %), with none 9.3 % (2.2 %)

# Weight of a window length by its relative random error ε: (ε / ε_min)**-4, COMPOSITE of CIFER.
# With the exponent 1, 6.1 % (1.2 %); with 8 and more it makes no difference.
SHARPNESS = 4

SAMPLES = 8  # fewest samples of a window: two periods (`PERIODS`) of four samples

SMOOTHED = 0.3  # width of the band over which the excitation is averaged, over its frequency

# The excitation ends 20 dB below the largest ω S(ω), which a logarithmic sweep keeps constant. For
# white noise of 60 s through a resonance of 1 Hz, the grid begins at 0.64 Hz with 0.03,
# at 0.17 Hz with 0.01, and with 0.003 it extends to 15 Hz, where the output is noise.
EXCITED = 0.01

# The estimator for a short record of one doublet, 2-1-1 or step.
FOR_MANOEUVRES = "gb.spectral.transient_spectrum, which needs only one period"


def spectral_response(  # noqa: PLR0913 - every choice that an analyst makes
    records: Record | Sequence[Record],
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] = (),
    omega: ArrayLike | None = None,
    band: tuple[float, float] | None = None,
    points: int = 40,
    windows: Sequence[float] | None = None,
    overlap: float = 0.8,
    detrend: Literal["linear", "constant", "none"] = "linear",
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from sweeps or noise.

    By default response and transients are polynomials in bands of the transform of the whole record
    (see `greybox.spectral.local_polynomials`): bands become narrower until the polynomials hold,
    and each gives three points whose errors are independent, so that a likelihood may use them.

    With `windows`, Hann windows of these lengths. Every length gives an estimate with its variance,
    and they are combined at each frequency with the weights (ε / ε_min)⁻⁴ of their relative random
    errors ε, as in COMPOSITE of CIFER (there the spectra are combined, here the responses). Points
    closer than the resolution, about 1.5 / length in Hz, have correlated errors; a fit says so.

    Stretches between gaps or missing samples are transformed separately and used together, as are
    several records.

    Parameters
    ----------
    records : Record or sequence of Record
        Uniformly sampled.
    input, output : str
    instrument : str, optional
        The injected signal, for the joint input-output estimate; without it, the direct one.
    conditioned : sequence of str
        Further inputs that act on the output and are correlated with this one; their effect is
        removed (partial coherence, Bendat and Piersol, section 7.3).
    omega : (n,) array, rad/s, optional
        By default, frequencies where the excitation is strong. If they are closer than the
        resolution, about 8 / duration in Hz for a band of three points, the errors of neighbors are
        correlated.
    band : (low, high), rad/s, optional
        Band of the estimate, as far as the record resolves it; by default, where the excitation is
        strong.
    points : int
        Approximate number of frequencies: fewer where the record does not resolve them, more at
        resonances. With `windows`, the exact number, log spaced.
    windows : sequence of float, s, optional
        Window lengths.
    overlap : float
        The share of a window that the next one repeats.
    detrend : {"linear", "constant", "none"}
        Trend that is removed from each stretch.
    name : str
        Name of the response.

    Returns
    -------
    FrequencyResponse
        With coherence, variance E|P̂ - P|² and its degrees of freedom. Points are left out where too
        little remains to estimate the noise, or where the instrument hardly moves the input. The
        coherence is partial, without transients and conditioned inputs; with an instrument, it is
        the lower of its coherences with input and output. The variance assumes stationary noise.
        For combined windows, it is an upper bound (fully correlated parts), and includes the squared
        difference from the longest window where noise does not explain that difference.

    Raises
    ------
    ValueError
        If the records are too short or not uniform, or a frequency has fewer than two periods in
        the longest window.
    KeyError
        For a signal that a record does not hold.
    """
    stretches = uniform_stretches(
        records, [input, output, instrument or input, *conditioned], detrend
    )
    if not 0 <= overlap < 1:
        raise ValueError(f"overlap is {overlap:g}: it must be at least 0 and below 1.")
    lengths = [] if windows is None else _window_lengths(stretches, windows)
    longest = max(s.values.shape[1] * s.step for s in stretches)
    lowest = PERIODS * HZ / lengths[0] if lengths else LOWEST * HZ / longest
    lines = lines_of(stretches)
    if omega is None:
        limits = (lowest, HIGHEST * HZ / max(s.step for s in stretches))
        ends = _excited_band(lines, *limits) if band is None else _within(band, *limits)
        grid = np.geomspace(*ends, max(points, 2))
    else:
        grid = np.atleast_1d(np.asarray(omega, dtype=float))
        _check_periods(grid, lowest, lengths[0] if lengths else longest)

    if lengths:
        per_length = [
            estimates(
                transforms(stretches, length, overlap, grid, leakage_terms=LEAKAGE_TERMS),
                grid * length,
            )
            for length in lengths
        ]
        estimated = [_combined(row) for row in zip(*per_length, strict=True)]
    elif omega is None:
        grid, estimated = tiled_points(lines, float(grid[0]), float(grid[-1]), points)
    else:
        estimated = points_at(lines, grid)

    response = response_at(grid, estimated, (input, output, name), stretches)
    return response if omega is not None else without_incoherent(response)


def _within(band: tuple[float, float], lowest: float, highest: float) -> tuple[float, float]:
    """Return the part of a band that the records resolve."""
    low, high = band
    if not 0 < low < high < math.inf:
        raise ValueError(f"the band must be increasing: got {low:g} to {high:g} rad/s.")
    if not max(low, lowest) < min(high, highest):
        raise ValueError(
            f"these records resolve {lowest:.4g} to {highest:.4g} rad/s, not the band from {low:.4g} "
            f"to {high:.4g} rad/s: choose another band, record longer or faster, or use "
            f"{FOR_MANOEUVRES}."
        )
    return max(low, lowest), min(high, highest)


def _window_lengths(stretches: Sequence[UniformStretch], windows: Sequence[float]) -> list[float]:
    """Window lengths, s, the longest first."""
    longest = max(s.values.shape[1] * s.step for s in stretches)
    shortest = SAMPLES * max(s.step for s in stretches)
    if len(windows) == 0 or min(windows) < shortest or max(windows) > longest:
        raise ValueError(
            f"windows must have {shortest:.4g} to {longest:.4g} s (from {SAMPLES} samples to the "
            f"longest stretch): got {', '.join(f'{w:.4g}' for w in windows) or 'none'}."
        )
    return sorted(windows, reverse=True)


def _check_periods(omega: Array, lowest: float, longest: float) -> None:
    too_low = omega[~(omega >= lowest * (1 - 1e-9))]
    if too_low.size:
        raise ValueError(
            f"omega = {too_low[0]:g} rad/s has fewer than {round(lowest * longest / HZ)} periods in the "
            f"longest stretch or window, {longest:.4g} s: leave out frequencies below {lowest:.4g} "
            f"rad/s, record longer, or use {FOR_MANOEUVRES}."
        )


def _excited_band(lines: Lines, lowest: float, highest: float) -> tuple[float, float]:
    """Return the band around the strongest excitation, up to the first gap in it on either side."""
    if lowest >= highest:
        raise ValueError(
            f"the records are too short: their lowest frequency, {lowest:.4g} rad/s, is above the "
            f"highest that the sampling allows, {highest:.4g} rad/s; record longer, or use "
            f"{FOR_MANOEUVRES}."
        )
    fine = np.geomspace(lowest, highest, 200)
    reach = np.maximum(fine * SMOOTHED / 2, PERIODS * lines.spacing)  # noise has holes by chance
    first = np.searchsorted(lines.omega, fine - reach)
    last = np.searchsorted(lines.omega, fine + reach)
    total = np.concatenate([[0.0], np.cumsum(np.abs(lines.values[2]) ** 2)])
    power = fine * (total[last] - total[first]) / (last - first)

    weak = np.flatnonzero(power < EXCITED * power.max())
    strongest = int(power.argmax())
    first_strong = int(max(weak[weak < strongest], default=-1)) + 1
    last_strong = int(min(weak[weak > strongest], default=fine.size)) - 1
    return float(fine[first_strong]), float(fine[last_strong])


def _combined(estimates: Sequence[WindowedPoint]) -> WindowedPoint:
    """Weight the window lengths at one frequency by their random errors."""
    determined = [e for e in estimates if math.isfinite(e.variance)]
    if not determined:
        return WindowedPoint(weak=any(e.weak for e in estimates))
    response = np.array([e.response for e in determined])
    error = np.sqrt([e.variance for e in determined]) / np.abs(response)
    weight = (error / error.min()) ** -SHARPNESS
    weight /= weight.sum()

    deviation = float(weight @ np.sqrt([e.variance for e in determined]))
    dof = float(weight @ [e.dof for e in determined])
    coherence = float(weight @ [e.coherence for e in determined])
    combined = complex(weight @ response)
    # Short windows smear, the longest hardly. Noise explains a squared difference up to the variance
    # of the longest window.
    smeared = max(abs(combined - determined[0].response) ** 2 - determined[0].variance, 0.0)
    return WindowedPoint(combined, deviation**2 + smeared, dof, coherence)
