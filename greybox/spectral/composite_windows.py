"""Frequency responses of sweeps and noise: estimates with windows of several lengths, combined.

A short window averages more but smears a resonance; a long one resolves it. The combination is COMPOSITE of CIFER
(Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 10).
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.spectral.local_polynomials import Lines, lines_of, points_at, tiled_points
from greybox.spectral.uniform_stretches import UniformStretch, uniform_stretches
from greybox.spectral.welch import HZ, PERIODS, WindowedPoint, estimates, response_at, transforms

Array = NDArray[np.float64]

# Errors below are those of `benchmarks/signal_constants.py`, of a resonance damped by 0.05 in a sweep of 60 s (and by
# 0.3), with the values in use 1.6 % (0.8 %).

# Window lengths: five, as is usual with CIFER, from a third to a 24th of the longest stretch. With a fifth as the
# longest, the mode is smeared: 7.0 % (0.8 %). With a sixth as the shortest, the average is over fewer windows: 1.9 %
# (1.0 %). With two lengths: 1.6 % (1.2 %).
LENGTHS = 5
LONGEST = 3
SHORTEST = 24

LEAKAGE_TERMS = 2  # with one 4.8 % (1.1 %), with none 9.3 % (2.2 %)
COHERENT = 0.6  # below, a point of the automatic grid is left out: Tischler and Remple, section 5.5
# Weight of a window length by its relative random error ε: (ε / ε_min)**-4, COMPOSITE of CIFER. With the exponent 1,
# 6.1 % (1.2 %); with 8 and more it makes no difference.
SHARPNESS = 4

SAMPLES = 8  # in a window, at least: two periods (`PERIODS`) of four samples

SMOOTHED = 0.3  # octaves or so over which the excitation is averaged, as a share of the frequency

# Of the largest ω S(ω), which a logarithmic sweep keeps constant: 20 dB below it the excitation ends. For white noise
# of 60 s through a resonance of 1 Hz, the grid begins at 0.64 Hz with 0.03, at 0.17 Hz with 0.01, and with 0.003 it
# extends to 15 Hz, where the output is noise.
EXCITED = 0.01


def spectral_response(  # noqa: PLR0913 - every choice that an analyst makes
    records: Record | Sequence[Record],
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] = (),
    omega: ArrayLike | None = None,
    points: int = 40,
    windows: Sequence[float] | None = None,
    overlap: float = 0.8,
    detrend: Literal["linear", "constant", "none"] = "linear",
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from sweeps or noise, by Hann windows of several lengths.

    Every length gives an estimate with its variance; smearing a resonance raises the residuals of a short window. They
    are combined at each frequency with the weights (ε / ε_min)⁻⁴ of their relative random errors ε, as in COMPOSITE of
    CIFER (there the spectra are combined, here the responses). Stretches between gaps or missing samples are
    transformed separately and averaged, as are several records.

    Parameters
    ----------
    records : Record or sequence of Record
        Uniformly sampled.
    input, output : str
    instrument : str, optional
        The injected signal, for the joint input-output estimate; without it, the direct one.
    conditioned : sequence of str
        Further inputs that act on the output and are correlated with this one; their part is removed (partial
        coherence, Bendat and Piersol, section 7.3).
    omega : (n,) array, rad/s, optional
        By default `points` log spaced frequencies where the excitation is strong.
    points : int
    windows : sequence of float, s, optional
        Window lengths; by default five, from a third of the longest stretch to a 24th.
    overlap : float
        The share of a window that the next one repeats.
    detrend : {"linear", "constant", "none"}
        What is removed from each stretch.
    name : str
        Of the response.

    Returns
    -------
    FrequencyResponse
        With coherence, variance E|P̂ - P|² and its degrees of freedom; points with too few windows are left out. The
        coherence is partial, without leakage and conditioned inputs; with an instrument it is the lower one of
        instrument with input and with output. The variance of the combination is that of fully correlated parts, an
        upper bound. It assumes noise that is as strong in the quiet windows as in the excited ones.

    Raises
    ------
    ValueError
        For records that are too short or not uniform, or frequencies below two periods of the longest window.
    KeyError
        For a signal that a record does not hold.
    """
    stretches = uniform_stretches(records, [input, output, instrument or input, *conditioned], detrend)
    lengths = _window_lengths(stretches, windows)
    if not 0 <= overlap < 1:
        raise ValueError(f"overlap is {overlap:g}: it must be at least 0 and below 1.")
    lines = lines_of(stretches)
    longest = lengths[0]
    if omega is None:
        band = _excited_band(lines, PERIODS * HZ / longest, 0.4 * HZ / max(s.step for s in stretches))
    else:
        grid = _checked(omega, longest)

    if windows is None:
        grid, found = tiled_points(lines, *band, points) if omega is None else (grid, points_at(lines, grid))
    else:
        grid = np.geomspace(*band, points) if omega is None else grid
        per_length = [
            estimates(transforms(stretches, length, overlap, grid, leakage_terms=LEAKAGE_TERMS), grid * length)
            for length in lengths
        ]
        found = [_combined(row) for row in zip(*per_length, strict=True)]

    response = response_at(grid, found, (input, output, name), stretches)
    coherent = response.coherence >= COHERENT  # type: ignore[operator]
    return response.where(coherent) if omega is None and coherent.any() else response


def _window_lengths(stretches: Sequence[UniformStretch], windows: Sequence[float] | None) -> list[float]:
    """Window lengths, s, the longest first."""
    longest = max(s.values.shape[1] * s.step for s in stretches)
    shortest = SAMPLES * max(s.step for s in stretches)
    if windows is None:
        windows = list(np.geomspace(longest / LONGEST, longest / SHORTEST, LENGTHS))
    if not windows or min(windows) < shortest or max(windows) > longest:
        raise ValueError(
            f"windows of {', '.join(f'{w:.4g}' for w in windows) or 'no'} s do not fit: give lengths from "
            f"{shortest:.4g} to {longest:.4g} s, from {SAMPLES} samples to the longest stretch, or record longer."
        )
    return sorted(windows, reverse=True)


def _checked(omega: ArrayLike, longest: float) -> Array:
    grid = np.atleast_1d(np.asarray(omega, dtype=float))
    lowest = PERIODS * HZ / longest
    too_low = grid[~(grid >= lowest * (1 - 1e-9))]
    if too_low.size:
        raise ValueError(
            f"omega = {too_low[0]:g} rad/s has fewer than {PERIODS} periods in the longest window of {longest:.4g} s: "
            f"leave out what is below {lowest:.4g} rad/s, lengthen the windows or record longer."
        )
    return grid


def _excited_band(lines: Lines, lowest: float, highest: float) -> tuple[float, float]:
    """Return the band around the strongest excitation, up to the first gap in it on either side."""
    fine = np.geomspace(lowest, highest, 200)
    reach = np.maximum(fine * SMOOTHED / 2, PERIODS * lines.spacing)  # noise has holes by chance
    first = np.searchsorted(lines.omega, fine - reach)
    last = np.searchsorted(lines.omega, fine + reach)
    total = np.concatenate([[0.0], np.cumsum(np.abs(lines.values[2]) ** 2)])
    power = fine * (total[last] - total[first]) / np.maximum(last - first, 1)

    weak = np.flatnonzero(power < EXCITED * power.max())
    strongest = int(power.argmax())
    left = int(max(weak[weak < strongest], default=-1)) + 1
    right = int(min(weak[weak > strongest], default=fine.size)) - 1
    return float(fine[left]), float(fine[right])


def _combined(estimates: Sequence[WindowedPoint]) -> WindowedPoint:
    """Weight the window lengths at one frequency by their random errors."""
    known = [e for e in estimates if math.isfinite(e.variance)]
    if not known:
        return WindowedPoint()
    response = np.array([e.response for e in known])
    error = np.sqrt([e.variance for e in known]) / np.abs(response)
    weight = (error / error.min()) ** -SHARPNESS
    weight /= weight.sum()

    deviation = float(weight @ np.sqrt([e.variance for e in known]))
    dof = float(weight @ [e.dof for e in known])
    coherence = float(weight @ [e.coherence for e in known])
    return WindowedPoint(complex(weight @ response), deviation**2, dof, coherence)
