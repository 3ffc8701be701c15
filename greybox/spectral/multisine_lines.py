"""Frequency responses of multisines from whole periods in steady state, free of leakage."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.files.arrays import Array
from greybox.spectral.uniform_stretches import UniformStretch, uniform_stretches
from greybox.spectral.welch import HZ, estimates, response_at, transforms, without_incoherent

# Amplitude of an excited line over the largest one. `greybox.experiment.multisine` gives all lines
# one amplitude; the limit of -30 dB only has to exceed noise and distortion between them.
EXCITED = 0.03

# Relative error of the period: after 100 periods the phase of the fundamental is off by 2π/1000.
WHOLE = 1e-5


def periodic_response(
    records: Record | Sequence[Record],
    period: float,
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] = (),
    omega: ArrayLike | None = None,
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from whole periods of a signal in steady state.

    Each period is one window without taper, so there is no leakage. The variance comes from the
    scatter of the periods, assumed independent (Pintelon and Schoukens, System Identification,
    2nd ed., chapter 2). An incomplete period is left out at the beginning. Arguments not listed here
    are those of `spectral_response`.

    Parameters
    ----------
    period : float, s
        A whole number of samples.
    omega : (n,) array, rad/s, optional
        Multiples of 2π / period; by default, the excited ones without those of low coherence.

    Raises
    ------
    ValueError
        If the period is not a whole number of samples, there are fewer than three periods, or
        `omega` holds other frequencies.
    """
    signals = [input, output, instrument or input, *conditioned]
    stretches = [whole_periods(s, period) for s in uniform_stretches(records, signals, "none")]
    stretches = [s for s in stretches if s.values.shape[1]]
    if sum(s.values.shape[1] * s.step for s in stretches) < 2.5 * period:
        raise ValueError(
            f"the records hold fewer than three periods of {period:g} s: record longer."
        )

    fundamental = HZ / period
    grid = (
        _excited_lines(stretches, period)
        if omega is None
        else np.atleast_1d(np.asarray(omega, dtype=float))
    )
    multiple = grid / fundamental
    odd = np.flatnonzero((np.abs(multiple - np.rint(multiple)) > 1e-6) | (grid < 0.5 * fundamental))
    if odd.size:
        raise ValueError(
            f"omega = {grid[odd[0]]:g} rad/s is not a multiple of 2π / period = {fundamental:g} "
            "rad/s: leave it out."
        )

    spectra = transforms(stretches, period, 0.0, np.rint(multiple) * fundamental, taper=False)
    points = estimates(spectra, np.full(grid.size, np.inf))
    response = response_at(grid, points, (input, output, name), stretches)
    return response if omega is not None else without_incoherent(response)


def whole_periods(stretch: UniformStretch, period: float) -> UniformStretch:
    """Return the last whole periods of a stretch."""
    count = round(period / stretch.step)
    if count < 2 or abs(count * stretch.step - period) > WHOLE * stretch.step * count:
        raise ValueError(
            f"a period of {period:g} s has {period / stretch.step:.6g} samples: resample the record so "
            "that it has a whole number."
        )
    remainder = stretch.values.shape[1] % count
    origin = stretch.origin
    if origin is not None:
        origin = replace(origin, start=min(origin.start + remainder * stretch.step, origin.end))
    return stretch._replace(
        values=stretch.values[:, remainder:], step=period / count, origin=origin
    )


def _excited_lines(stretches: Sequence[UniformStretch], period: float) -> Array:
    """Return the multiples of 2π / period that stand out in the excitation, rad/s."""
    count = round(period / max(s.step for s in stretches))
    lines: Array = HZ / period * np.arange(1.0, (count + 1) // 2)
    spectra = transforms(stretches, period, 0.0, lines, taper=False)
    amplitude = np.sqrt(np.sum(np.abs(spectra.r) ** 2, axis=0))
    return lines[amplitude > EXCITED * amplitude.max()]
