"""Predictions of a model over windows of a record, with the measurements there."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from statistics import NormalDist

import numpy as np

from greybox.data.record import Record
from greybox.files.arrays import Array, ArrayPair, BoolArray, IntArray, Labels, Strings, frozen
from greybox.files.text_table import counted, number, one_line, text_table
from greybox.simulation.windows import seconds
from greybox.statistics.metrics import fit_percent, rms

AHEAD = (0.1, 0.25, 0.5, 1.0)  # shares of the horizon at which the growth of the error is reported


def samples_ahead(share: float, samples: int) -> int:
    """Return how many samples ahead a share (0 to 1] of a horizon is, at least one."""
    # Without the small number, rounding of the product could add a sample.
    return max(1, math.ceil(share * samples - 1e-9))


def reported_shares(horizons: Sequence[int]) -> list[float]:
    """Return the shares of horizons (in samples) to report."""
    # Short horizons have several shares at one sample; the largest is reported.
    places = {share: tuple(samples_ahead(share, h) for h in horizons) for share in AHEAD}
    return [
        share
        for share, place in places.items()
        if place not in [places[s] for s in AHEAD if s > share]
    ]


@frozen
class Prediction:
    """Predictions of k outputs over w windows of h samples; printing it shows their quality.

    Attributes
    ----------
    label : str
        Name of the model.
    data : Record
        The measured record.
    inputs, outputs, states : tuple of str
    lead, horizon : float
        Lengths in s, whole samples.
    rows : (w, h) int array
        Indices in `data` of the predicted samples; sample j is j + 1 steps after the last
        measurement that was used for it.
    predicted, error : (k, w, h) arrays
        The outputs as their sensors show them, and their standard errors, from those of the
        parameters (with the states and gains that they imply, to first order) and of the first
        state; the noise of the outputs is not included. A parameter at its bound counts as exact;
        NaN if an output depends on a parameter that the data of the fit do not determine.
    noise : (k, k) array
        Covariance of the outputs' errors, from the fit or else estimated from the lead-ins.
    trajectory : (n, w, h) array
        The states.
    one_step : (k, w, h) array
        Errors of predictions one sample ahead, from all earlier measurements in the window, in
        units of their theoretical standard deviations: white with unit variance for the right
        model. NaN if nothing was measured.
    notes : tuple of str
        Sentences on unknown errors, and on values that were estimated from the record.
    own : mapping of name to (value, standard error)
        Values that belong to the record and were estimated from it: biases, trims.
    """

    label: str
    data: Record
    inputs: Strings
    outputs: Strings
    states: Strings
    lead: float
    horizon: float
    rows: IntArray
    predicted: Array
    error: Array
    noise: Array
    trajectory: Array
    one_step: Array
    notes: Strings = ()
    own: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def ahead(self) -> Array:
        """How far ahead each sample of a window is predicted (h,), s."""
        return self.data.step * np.arange(1, self.rows.shape[1] + 1)

    @property
    def record(self) -> Record:
        """Outputs, standard errors ``<output>_error`` and states, NaN outside the windows.

        A state with the name of an output is given once, as the output.
        """
        named: dict[str, Array] = {}
        for name, predicted, error in zip(self.outputs, self.predicted, self.error, strict=True):
            named |= {name: predicted, f"{name}_error": error}
        states = zip(self.states, self.trajectory, strict=True)
        named |= {name: values for name, values in states if name not in named}

        signals = {name: np.full(len(self.data), np.nan) for name in named}
        for name, values in named.items():
            signals[name][self.rows] = values
        units = {n: self.data.units.get(n.removesuffix("_error"), "") for n in named}
        return Record(self.data.time, signals, units, name=self.title, has_time=self.data.has_time)

    @property
    def title(self) -> str:
        """The model, and how far ahead it predicts."""
        return (
            f"{self.label}, {seconds(self.horizon)} s ahead" if self.data.has_time else self.label
        )

    @property
    def window(self) -> str:
        """The noun for a window: each row without a time is one."""
        return "window" if self.data.has_time else "row"

    def kept(self, windows: BoolArray) -> "Prediction":
        """Return the predictions of selected windows, (w,)."""
        named = {
            name: getattr(self, name)[:, windows]
            for name in ("predicted", "error", "trajectory", "one_step")
        }
        return replace(self, rows=self.rows[windows], **named)

    def measured(self, output: str) -> Array:
        """Return the measurements in the windows, (w, h), NaN if missing."""
        self._place(output)  # raises for an output that was not predicted
        return self.data[output][self.rows]

    def residual(self, output: str) -> Array:
        """Return measured less predicted, (w, h)."""
        return self.measured(output) - self.predicted[self._place(output)]

    def band(self, output: str, level: float = 0.95, noise: bool = False) -> ArrayPair:
        """Return the limits (w, h) within which an output, or with `noise` its measurement, lies.

        They assume the right model structure and normal errors. They do not include process noise
        (wind) and sensor errors that are correlated in time, with which fewer outputs lie within
        the limits.
        """
        if not 0 < level < 1:
            raise ValueError(f"level {level} must lie between 0 and 1, e.g. 0.95.")
        k = self._place(output)

        # The noise of the sensors is in what is measured, not in the output itself.
        half = NormalDist().inv_cdf(0.5 + level / 2) * np.sqrt(
            self.error[k] ** 2 + (self.noise[k, k] if noise else 0.0)
        )
        return self.predicted[k] - half, self.predicted[k] + half

    def rms(self, output: str, share: float | None = None) -> float:
        """Return the rms error over all samples, or at a share (0 to 1] of the horizon."""
        e = self.residual(output)
        return rms(e if share is None else e[:, samples_ahead(share, e.shape[1]) - 1])

    def fit_percent(self, output: str) -> float:
        """Return 100 (1 - |error| / |measured - mean|) over all windows."""
        return fit_percent(self.measured(output), self.predicted[self._place(output)])

    def _place(self, output: str) -> int:
        if output not in self.outputs:
            raise ValueError(
                f"{output!r} was not predicted: give one of {', '.join(self.outputs)}."
            )
        return self.outputs.index(output)

    def __repr__(self) -> str:
        return one_line(self, self.title, counted(len(self), self.window), ", ".join(self.outputs))

    def __str__(self) -> str:
        # Rows without a time have no lead-in, and no error that grows.
        samples = self.rows.shape[1]
        shares = reported_shares([samples]) if self.data.has_time else []
        ends = [f"after {seconds(self.ahead[samples_ahead(s, samples) - 1])} s" for s in shares]
        name = self.data.name or "the record"
        head = f"{self.label}: {counted(len(self), self.window)} of {name}"
        if self.data.has_time:
            head = (
                f"{self.label}: {counted(len(self), 'window')} of {seconds(self.horizon)} s in "
                f"{name}, the state of each estimated from the {seconds(self.lead)} s before it"
            )

        rows = [self._row(name, shares) for name in self.outputs]
        table = text_table(
            ["output", "unit", "fit %", "error (rms)", *ends, "noise", "standard error"],
            rows,
            left=(0, 1),
        )
        notes = ["", *("  " + note for note in self.notes)] if self.notes else []
        return "\n".join([head, "", *("  " + line for line in table.splitlines()), *notes])

    def _row(self, name: str, shares: Sequence[float]) -> Labels:
        k = self._place(name)
        grown = [number(self.rms(name, share), 3) for share in shares]
        standard_error = float(np.sqrt(np.mean(self.error[k] ** 2)))
        values = [number(self.fit_percent(name), 4), number(self.rms(name), 3), *grown]
        return [
            name,
            self.data.units.get(name, ""),
            *values,
            number(math.sqrt(self.noise[k, k]), 3),
            number(standard_error, 3),
        ]
