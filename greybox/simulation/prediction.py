"""Predictions of a model over windows of a record, with the measurements there.

Windows of equal length in a record: a lead-in to estimate a state, then a part to predict.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from greybox.compiled.sampled_data import SampledData, gapless
from greybox.data.record import Record
from greybox.files.arrays import (
    Array,
    ArrayPair,
    BoolArray,
    FloatPair,
    IntArray,
    Labels,
    Strings,
    frozen,
    nans,
)
from greybox.files.text_table import Printed, counted, is_finite_number, number, text_table, titled
from greybox.statistics.metrics import fit_percent, rms

AHEAD = (0.1, 0.25, 0.5, 1.0)  # shares of the horizon at which the growth of the error is reported


def samples_ahead(share: float, samples: int) -> int:
    """Return how many samples ahead a share (0 to 1] of a horizon is, at least one."""
    # Without the small number, rounding of the product could add a sample.
    return max(1, math.ceil(share * samples - 1e-9))


def reported_shares(horizon: int) -> list[float]:
    """Return the shares of a horizon (in samples) to report."""
    # A short horizon has several shares at one sample; the largest is reported.
    return list({samples_ahead(share, horizon): share for share in AHEAD}.values())


@frozen
class Prediction(Printed):
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
        state; the noise of the outputs is not included. A parameter that its bound holds is exact;
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
    own: Mapping[str, FloatPair] = field(default_factory=dict)

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

        signals = {name: nans(len(self.data)) for name in named}
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

    def __str__(self) -> str:
        # Rows without a time have no lead-in, and no error that grows.
        samples = self.rows.shape[1]
        shares = reported_shares(samples) if self.data.has_time else []
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
        return titled(head, [table, *(["", *self.notes] if self.notes else [])])

    def _row(self, name: str, shares: Sequence[float]) -> Labels:
        k = self._place(name)
        grown = [number(self.rms(name, share), 3) for share in shares]
        values = [number(self.fit_percent(name), 4), number(self.rms(name), 3), *grown]
        return [
            name,
            self.data.units.get(name, ""),
            *values,
            number(math.sqrt(self.noise[k, k]), 3),
            number(rms(self.error[k]), 3),
        ]


# Samples of a default length: two or more for each state of the models here, which have 2 to 5.
FEWEST = 10
ROUNDING = 1e-6  # of a sample, by which a length may be shorter: times are rounded


@frozen
class Windows:
    """The samples of a record in every window; the predicted parts follow one another.

    Attributes
    ----------
    outputs : tuple of str
        The outputs to predict, all in the record.
    rows : (w, lead + horizon) int array
        Indices in the record.
    lead, horizon : int
        Numbers of samples; 0 and 1 for rows without a time, where every row is a window.
    """

    record: Record
    outputs: Strings
    rows: IntArray
    lead: int
    horizon: int

    def __len__(self) -> int:
        return len(self.rows)


def require_lengths(**lengths: Any) -> None:
    """Raise ValueError for anything but a length in s, or None."""
    for name, value in lengths.items():
        if value is None:
            continue
        if isinstance(value, bool) or not is_finite_number(value) or value <= 0:
            raise ValueError(f"{name} is {value!r}: give a length above 0, in s.")


def default_length(records: Sequence[Record], at_least: float, delay: float = 0.0) -> float:
    """Return the longest of `at_least` s, ten samples of the slowest record, and two delays.

    A record that is shorter than eight times `at_least` allows an eighth of its length.
    """
    # NaN, the step of a single sample, compares as neither more nor less than the first number.
    slowest = max([0.0, *(record.step for record in records)])
    # A hydraulic drive is recorded for 0.2 s, in which there is no room for a second.
    length = min([at_least, *(len(record) * record.step / 8 for record in records)])
    # Within the longest delay, outputs respond to inputs before the lead-in.
    return max(length, FEWEST * slowest, 2.0 * delay)


def seconds(length: float) -> str:
    """Return a time in s as text, with three digits or more."""
    return f"{length:.0f}" if 1000 <= length < 1e6 else f"{length:.3g}"


def cut(
    record: Record,
    inputs: Strings,
    outputs: Strings,
    *,
    lead: float,
    horizon: float,
    called: str = "horizon",
) -> Windows:
    """Cut windows with a lead-in and a horizon in s, within stretches in which no input is missing.

    Lengths are rounded to whole samples. Windows are left out if no output was measured in the
    lead-in or in the horizon. `called` is the user's name of the horizon.

    Raises
    ------
    ValueError
        If a length is not positive or shorter than a sample, or no stretch is long enough.
    """
    require_signals(record, inputs)
    stretches = gapless(record, inputs, outputs)
    if record.is_irregular:
        raise ValueError(
            f"{record.name or 'the record'} is not uniformly sampled, as windows of equal length "
            "must be: use gb.simulate, or prepare the record with rate=..., which resamples it."
        )
    # Each row without a time is a window, and has no lead-in.
    lead_samples, horizon_samples = 0, 1
    if record.has_time:
        for name, length in (("lead", lead), (called, horizon)):
            if length < (1 - ROUNDING) * record.step:
                raise ValueError(
                    f"{name}={seconds(length)} s is shorter than a sample of "
                    f"{record.name or 'the record'}, {seconds(record.step)} s: give several "
                    f"samples, e.g. {name}={seconds(FEWEST * record.step)}, or omit it."
                )
        # Half a sample is rounded down in all records alike, however their times are rounded.
        lead_samples, horizon_samples = (
            max(1, math.floor(min(n / record.step, len(record)) + 0.5 - ROUNDING))
            for n in (lead, horizon)
        )
    # The empty part gives the result its width if no stretch is long enough.
    parts = [np.zeros((0, lead_samples + horizon_samples), dtype=int)]
    for stretch in stretches:
        starts = np.arange(0, len(stretch) - lead_samples - horizon_samples + 1, horizon_samples)
        rows = starts[:, None] + np.arange(lead_samples + horizon_samples)

        # Without a measurement the lead-in informs no state, and the horizon shows no error.
        measured = np.any(np.isfinite(stretch.outputs), axis=0)[rows]
        usable = measured[:, lead_samples:].any(axis=1)
        if lead_samples:
            usable &= measured[:, :lead_samples].any(axis=1)
        parts.append(stretch.rows[rows[usable]])

    rows = np.concatenate(parts)
    if not len(rows):
        if not record.has_time:
            raise ValueError(
                f"{record.name or 'the record'} has no row with all inputs and an output."
            )
        longest = max((len(s) * s.step for s in stretches), default=0.0)
        raise ValueError(
            f"{record.name or 'the record'} has no room for lead={lead:g} and {called}={horizon:g} "
            f"s with measured outputs: its longest stretch without a gap lasts {seconds(longest)} "
            f"s; give a shorter lead or {called}, or a longer record."
        )
    return Windows(record, outputs, rows, lead_samples, horizon_samples)


def sample_data(windows: Windows, inputs: Strings, delays: Array) -> Array:
    """Return the data of all samples in the windows, (width, w, samples), see `SampledData.rows`.

    The inputs before a window are those of its stretch. Outputs are left out as long as the delayed
    inputs are unknown, see `gapless`.
    """
    record = windows.record
    stretches = gapless(record, inputs, windows.outputs, lead=np.maximum(delays, 0.0))
    # Windows index the record, the data its stretches without gaps.
    columns = np.searchsorted(np.concatenate([s.rows for s in stretches]), windows.rows)
    return SampledData(tuple(stretches)).rows(delays)[:, columns]


def require_signals(record: Record, inputs: Labels, label: str = "the model") -> None:
    """Raise ValueError if an input of a model is missing."""
    missing = [name for name in inputs if name not in record.signals]
    if missing:
        raise ValueError(
            f"the record has no signal {missing[0]!r}, an input of {label}; it has "
            f"{', '.join(record.signals) or 'none'}: name it so when the record "
            f"is prepared, signals={{{missing[0]!r}: ...}}."
        )
