"""Fourier integrals over a manoeuvre (doublet, 2-1-1, step, manual inputs) on a chosen band."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.data.files.argument_checks import as_names
from greybox.data.files.arrays import Array, ComplexArray, Interval
from greybox.data.files.named_values import selected
from greybox.data.files.public import public
from greybox.data.frequency_band import require_band
from greybox.data.intersample import intersample
from greybox.data.record import Record
from greybox.data.spectral.uniform_stretches import uniform_stretches
from greybox.data.transient_spectrum import TransientSpectrum

# Highest frequency over the sampling rate: signals have little power above, and aliases there are
# weak.
HIGHEST = 0.4


@public
def transient_spectrum(
    record: Record,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    band: Interval,
) -> TransientSpectrum:
    """Return the Fourier integrals of a manoeuvre at the multiples of 2π / duration in `band`.

    A finer grid has no more information: its points are combinations of these. Held signals are
    integrated as held, others by the trapezoidal rule. This rule is inaccurate at high frequencies
    for the line from the first to the last sample, which is integrated in closed form.

    Parameters
    ----------
    record : Record
        A manoeuvre without gaps, uniformly sampled; see `Record.between`.
    inputs, outputs : str or sequence of str
    band : (low, high), rad/s

    Raises
    ------
    ValueError
        If the record has gaps or is not uniform, a signal is constant, or the band holds no
        frequency of the manoeuvre or ends beyond 0.4 of the sampling rate.
    KeyError
        For a signal that the record does not hold.

    Notes
    -----
    Klein and Morelli, Aircraft System Identification, section 7.1; Pintelon and Schoukens, System
    Identification, 2nd ed., section 6.3 (the grid on which transients take a simple form); Press et
    al., Numerical Recipes, section 13.9 (end corrections).
    """
    inputs, outputs = as_names(inputs), as_names(outputs)
    names = (*inputs, *outputs)
    stretches = uniform_stretches(record, names)
    if len(stretches) > 1:
        raise ValueError(
            f"{record.name or 'the record'} has {len(stretches)} stretches between gaps: cut out "
            "one with record.between(start, end); several manoeuvres are several spectra."
        )
    stretch = stretches[0]
    duration = stretch.origin.end - stretch.origin.start
    count = stretch.values.shape[1] - 1
    step = duration / count
    omega = lines_in_band(band, duration, step)

    readings = {name: intersample(record.hold.get(name, 0.0), step) for name in names}
    before_end = step * np.arange(count)
    transforms = {
        name: (_held if readings[name].held else _interpolated)(values, omega, step)
        for name, values in zip(names, stretch.values, strict=True)
    }
    spectrum = TransientSpectrum(
        omega,
        selected(transforms, inputs),
        selected(transforms, outputs),
        duration,
        step,
        {
            name: _changes(before_end - readings[name].late, values)
            for name, values in zip(inputs, stretch.values, strict=False)
        },
        units=selected(record.units, names),
        name=record.name,
        source=record.source,
        stretch=stretch.origin,
        held=tuple(name for name in inputs if readings[name].held),
    )
    # A value that lasts for part of a step acts half of that time later than a continuous signal.
    delayed = {name: spectrum.delayed_input(name, readings[name].late)[0] for name in inputs}
    return replace(spectrum, inputs=delayed)


def _changes(before_end: Array, values: Array) -> Array:
    """Return times before the end and changes of a signal (n,) there, (2, k), without zeros."""
    changes = np.diff(values)[::-1]
    return np.array([np.maximum(before_end, 0), changes])[:, changes != 0]


def lines_in_band(band: Interval, duration: float, step: float) -> Array:
    """Return the multiples of 2π / duration within the band, rad/s; refuse a band without any."""
    low, high = require_band(band)
    spacing = math.tau / duration
    highest = HIGHEST * math.tau / step
    if high > highest * (1 + 1e-9):  # rounding of the step
        raise ValueError(
            f"the band ends at {high:g} rad/s, but the signals are sampled at {1 / step:g} Hz: end "
            f"it at {highest:.4g} rad/s ({HIGHEST:g} of the sampling rate) at most."
        )
    lines = np.arange(
        max(1, np.ceil(low / spacing * (1 - 1e-9))), np.floor(high / spacing * (1 + 1e-9)) + 1
    )
    if not lines.size:
        raise ValueError(
            f"the band from {low:g} to {high:g} rad/s has no multiple of {spacing:.4g} rad/s, the "
            f"resolution of {duration:.4g} s: widen the band or use a longer part."
        )
    return lines * spacing


def _sums(values: Array, omega: Array, step: float) -> ComplexArray:
    """Return Σ x_k exp(-jω t_k) at multiples of the resolution of the values."""
    return np.fft.rfft(values)[np.rint(omega * step * values.size / math.tau).astype(int)]


def _held(values: Array, omega: Array, step: float) -> ComplexArray:
    # The integral over one step, times the sum over all; without the mean, rounding is smaller.
    one_step = (1 - np.exp(-1j * omega * step)) / (1j * omega)
    return one_step * _sums(values[:-1] - values[:-1].mean(), omega, step)


def _interpolated(values: Array, omega: Array, step: float) -> ComplexArray:
    # Constants vanish on this grid. Without the line, the signal is periodic without a jump, and
    # the trapezoidal rule is accurate.
    change = values[-1] - values[0]
    periodic = values[:-1] - values[0] - np.linspace(0.0, change, values.size)[:-1]
    return step * _sums(periodic, omega, step) + 1j * change / omega
