"""Fourier integrals of inputs and outputs over one manoeuvre, not divided by one another."""

import math
from collections.abc import Mapping
from dataclasses import field
from typing import ClassVar

import numpy as np

from greybox.data.checked_array import finite_array, require_size
from greybox.data.checksum import checksum_of
from greybox.data.files.argument_checks import as_names
from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.control_characters import printable, write_out
from greybox.data.files.frozen_values import frozen
from greybox.data.files.normalization import normalize
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.frequency_response import Stretch


@public
@frozen
class TransientSpectrum:
    """Fourier integrals of the signals of one manoeuvre, at multiples of 2π over its duration.

    At these frequencies exp(-jωT) = 1, so that constants (trim values, sensor biases) vanish from
    the integrals, the errors of white noise are independent from line to line, and the integral of
    a derivative is jωX + x(T) - x(0).

    Parameters
    ----------
    omega : (n,) array, rad/s
        Multiples of 2π / duration, increasing.
    inputs, outputs : mapping of name to (n,) complex array
        Integrals from 0 to the duration of x(t) exp(-jωt) dt, in the signal's unit times s.
    duration : float, s
        From the first to the last sample.
    step : float, s
        Sampling interval.
    input_changes : mapping of name to (2, k) array
        When the last changes of each input ended, in s before the end, and by how much it changed,
        from which the integral of a delayed input follows. Changes are steps of held inputs and
        lines of one sample of others; inputs that are not listed are at rest.
    held : sequence of str
        Inputs whose values were held from sample to sample: samples of outputs then show more than
        their integrals, which the model takes into account.
    units : mapping of name to str
    name, source : str
    stretch : Stretch, optional
        The part of the record from which it was computed.

    Raises
    ------
    ValueError
        For frequencies off the grid, different lengths, or numbers that are not finite.
    """

    noun: ClassVar = "spectrum"
    omega: Array
    inputs: Mapping[str, ComplexArray]
    outputs: Mapping[str, ComplexArray]
    duration: float
    step: float
    input_changes: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = ""
    source: str = ""
    stretch: Stretch | None = None
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Convert to read-only arrays and check them."""
        write_out(self, "name", "source", "units")
        normalize(self, held=as_names(self.held))
        if not (np.isfinite(self.duration) and 0 < self.step < self.duration):
            raise ValueError(
                f"duration is {self.duration!r} s and step {self.step!r} s: give finite numbers, "
                "the step above 0 and shorter than the duration."
            )
        omega = finite_array("omega", self.omega)
        # Off this grid constants leak into the integrals, and errors are correlated.
        lines = omega * self.duration / math.tau
        whole = np.round(lines)
        is_whole = np.abs(lines - whole) <= 1e-6 * np.maximum(lines, 1)  # up to rounding
        if not (omega.size and is_whole.all() and np.all(np.diff(whole, prepend=0) >= 1)):
            raise ValueError(
                f"omega must be increasing multiples of {math.tau / self.duration:.6g} rad/s, 2π "
                "over the duration: use gb.spectral.transient_spectrum(record, ...)."
            )

        normalize(self, omega=omega)
        for kind in ("inputs", "outputs"):
            signals = getattr(self, kind)
            if not signals:
                raise ValueError(f"the spectrum has no {kind}: give at least one signal.")
            arrays = {printable(n): finite_array(n, x, complex) for n, x in signals.items()}
            for name, values in arrays.items():
                require_size(name, values, "omega", omega.size)
            normalize(self, **{kind: arrays})
        changes = {}
        for name, rows in self.input_changes.items():
            if np.ndim(rows) != 2 or len(rows) != 2:
                raise ValueError(
                    f"input_changes of {name} has shape {np.shape(rows)}: give two rows, the times "
                    "before the end and the changes."
                )
            numbers = finite_array("input_changes", np.ravel(rows))
            changes[printable(name)] = numbers.reshape(2, -1)
        normalize(self, input_changes=changes)

    def __len__(self) -> int:
        return self.omega.size

    def __repr__(self) -> str:
        band = f"{self.omega[0]:.4g} to {self.omega[-1]:.4g} rad/s"
        signals = f"{', '.join(self.inputs)} to {', '.join(self.outputs)}"

        return one_line(
            self,
            repr(self.name),
            f"{len(self)} frequencies",
            band,
            f"{self.duration:.4g} s",
            signals,
        )

    @property
    def signals(self) -> Mapping[str, ComplexArray]:
        """Inputs, then outputs."""
        return {**self.inputs, **self.outputs}

    @property
    def checksum(self) -> str:
        """SHA-256 of the numbers and the signal names, whatever file they came from."""
        # As for a response: the same numbers are the same data, whatever their name and source.
        names = f"{', '.join(self.inputs)}->{', '.join(self.outputs)}"
        numbers = [np.array([self.duration, self.step])]
        for signals in (self.inputs, self.outputs, self.input_changes):
            numbers += signals.values()
        return checksum_of(names, self.omega, *numbers)

    def is_same_as(self, other: "TransientSpectrum") -> bool:
        """Return whether another spectrum has the same data."""
        return self.checksum == other.checksum

    def delayed_input(self, name: str, delay: float) -> tuple[ComplexArray, ComplexArray]:
        """Return the integral of an input that acts `delay` seconds later, (n,).

        Also return its derivative with respect to the delay. The input is assumed to have its first
        value before the manoeuvre. What it does during the last `delay` seconds, it does later:

            ∫ u(t - τ) exp(-jωt) dt = exp(-jωτ) (U + V) - (u(T) - u(0)) (1 - exp(-jωτ)) / jω,

        where V = ∫ (u(T) - u(T - r)) exp(jωr) dr from 0 to τ.
        """
        s = 1j * self.omega
        rows = self.input_changes.get(name, np.zeros((2, 0)))
        shift, change = np.exp(-s * delay), np.sum(rows[1])
        # A step would be a corner of the cost where the delay reaches it, in which no search ends.
        # The input takes 2 % of a sample to change: half of it is the error of when it does.
        rise = self.step * (0.02 if name in self.held else 1.0)
        times, changes = rows[:, rows[0] < delay][..., None]
        share = np.clip((delay - times) / rise, 0, 1)
        ramp = rise * share**2 / 2 + np.maximum(delay - times - rise, 0)
        middle = times + rise / 2
        late = changes * np.exp(s * (middle + ramp))
        left = np.sum(late - changes * np.exp(s * middle), axis=0) / s
        delayed = shift * (self.inputs[name] + left) - change * (1 - shift) / s
        return delayed, shift * np.sum(share * late, axis=0) - s * delayed - change
