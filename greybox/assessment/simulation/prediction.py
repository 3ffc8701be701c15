"""Predictions of a model over windows of a record, with the measurements there.

Windows of equal length in a record: a lead-in to estimate a state, then a part to predict.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.clock import JITTER, off_uniform
from greybox.data.files.argument_checks import is_finite_number
from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import places_of
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table, titled
from greybox.data.files.wording import counted
from greybox.data.record import Record
from greybox.engine.compiled.sampled_data import SampledData, Stretch, gapless
from greybox.statistics.metrics import fit_percent, rms

# Shares of the horizon at which the growth of the error is reported.
AHEAD = (0.1, 0.25, 0.5, 1.0)
# Share of a sample by which a length may be shorter than stated, since times are rounded.
ROUNDING = 1e-6


def samples_ahead(share: float, samples: int) -> int:
    """Return the number of samples in a share (0 to 1] of a horizon, at least one."""
    # Without the small number, rounding of the product could add a sample.
    return max(1, math.ceil(share * samples - 1e-9))


def reported_shares(horizon: int) -> list[float]:
    """Return the shares of a horizon (in samples) to report."""
    # A short horizon has several shares at one sample; the largest is reported.
    return list({samples_ahead(share, horizon): share for share in AHEAD}.values())


@public
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
        measurement that was used for it. -1 where a window has no sample: on an uneven clock, or
        where rows are missing. Its predictions are NaN.
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
    elapsed : (w, h) array, s, optional
        Time from the last sample of the lead-in to each predicted one; by default whole steps.
    """

    label: str
    data: Record
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    lead: float
    horizon: float
    rows: IntArray
    predicted: Array
    error: Array
    noise: Array
    trajectory: Array
    one_step: Array
    notes: tuple[str, ...] = ()
    own: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    elapsed: Array | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def ahead(self) -> Array:
        """How far ahead each sample of a window is predicted (h,), s; the most of all windows."""
        if self.elapsed is not None and len(self):
            return self.elapsed.max(axis=0)
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

        signals = {}
        units = {}
        is_sample = self.rows >= 0
        for name, values in named.items():
            column = np.full(len(self.data), np.nan)
            column[self.rows[is_sample]] = values[is_sample]
            signals[name] = column
            units[name] = self.data.units.get(name.removesuffix("_error"), "")
        return Record(self.data.time, signals, units, name=self.title, has_time=self.data.has_time)

    @property
    def title(self) -> str:
        """The model, and how far ahead it predicts."""
        if not self.data.has_time:
            return self.label
        return f"{self.label}, {seconds(self.horizon)} s ahead"

    @property
    def window(self) -> str:
        """The noun for a window: each row without a time is one."""
        return "window" if self.data.has_time else "row"

    def kept(self, windows: BoolArray) -> "Prediction":
        """Return the predictions of the windows that are marked in `windows` (w,)."""
        return replace(
            self,
            rows=self.rows[windows],
            elapsed=None if self.elapsed is None else self.elapsed[windows],
            predicted=self.predicted[:, windows],
            error=self.error[:, windows],
            trajectory=self.trajectory[:, windows],
            one_step=self.one_step[:, windows],
        )

    def measured(self, output: str) -> Array:
        """Return the measurements in the windows, (w, h), NaN if missing."""
        self._place(output)  # raises for an output that was not predicted
        return np.where(self.rows >= 0, self.data[output][self.rows], np.nan)

    def residual(self, output: str) -> Array:
        """Return measured less predicted, (w, h)."""
        return self.measured(output) - self.predicted[self._place(output)]

    def band(self, output: str, level: float = 0.95, noise: bool = False) -> tuple[Array, Array]:
        """Return the limits (w, h) within which an output, or with `noise` its measurement, lies.

        They assume the right model structure and normal errors. They do not include process noise
        (wind) and sensor errors that are correlated in time, with which fewer outputs lie within
        the limits.
        """
        if not 0 < level < 1:
            raise ValueError(f"level {level} must lie between 0 and 1, e.g. 0.95.")
        k = self._place(output)

        # A measurement contains the noise of its sensor, the output itself does not.
        sensor_variance = self.noise[k, k] if noise else 0.0
        quantile = NormalDist().inv_cdf(0.5 + level / 2)
        half = quantile * np.sqrt(self.error[k] ** 2 + sensor_variance)
        return self.predicted[k] - half, self.predicted[k] + half

    def rms(self, output: str, share: float | None = None) -> float:
        """Return the rms error over all samples, or at a share (0 to 1] of the horizon."""
        error = self.residual(output)
        if share is None:
            return rms(error)
        if self.elapsed is None:
            return rms(error[:, samples_ahead(share, error.shape[1]) - 1])
        # On an uneven clock, the first sample at this time counts, or else the last of the window.
        is_sample = self.rows >= 0
        is_later = is_sample & (self.elapsed >= (share - ROUNDING) * self.horizon)
        first_later = np.argmax(is_later, axis=1)
        last = is_sample.shape[1] - 1 - np.argmax(is_sample[:, ::-1], axis=1)
        place = np.where(is_later.any(axis=1), first_later, last)
        return rms(np.take_along_axis(error, place[:, None], axis=1))

    def fit_percent(self, output: str) -> float:
        """Return 100 (1 - |error| / |measured - mean|) over all windows."""
        return fit_percent(self.measured(output), self.predicted[self._place(output)])

    def _place(self, output: str) -> int:
        """Return the index of an output; raise ValueError for one that was not predicted."""
        if output not in self.outputs:
            raise ValueError(
                f"{output!r} was not predicted: give one of {', '.join(self.outputs)}."
            )
        return self.outputs.index(output)

    def __str__(self) -> str:
        # Rows without a time have no lead-in, and no error that grows.
        samples = self.rows.shape[1]
        shares = reported_shares(samples) if self.data.has_time else []
        ends = [f"after {seconds(self._reach(share))} s" for share in shares]
        name = self.data.name or "the record"
        head = f"{self.label}: {counted(len(self), self.window)} of {name}"
        if self.data.has_time:
            head = (
                f"{self.label}: {counted(len(self), 'window')} of {seconds(self.horizon)} s in "
                f"{name}, the state of each estimated from the {seconds(self.lead)} s before it"
            )

        header = ["output", "unit", "fit %", "error (rms)", *ends, "noise", "standard error"]
        rows = [self._row(name, shares) for name in self.outputs]
        lines = [text_table(header, rows, left=(0, 1))]
        if self.notes:
            lines += ["", *self.notes]
        return titled(head, lines)

    def _reach(self, share: float) -> float:
        """Return how far ahead a share of the horizon is, s."""
        if self.elapsed is not None:
            return share * self.horizon
        return float(self.ahead[samples_ahead(share, self.rows.shape[1]) - 1])

    def _row(self, name: str, shares: Sequence[float]) -> Sequence[str]:
        """Return the row of an output in the printed table."""
        k = self._place(name)
        return [
            name,
            self.data.units.get(name, ""),
            number(self.fit_percent(name), 4),
            number(self.rms(name), 3),
            *(number(self.rms(name, share), 3) for share in shares),
            number(math.sqrt(self.noise[k, k]), 3),
            number(rms(self.error[k]), 3),
        ]


# Fewest samples of a default length: two or more for each state of the models here, which have 2
# to 5.
FEWEST = 10


@frozen
class Windows:
    """The samples of a record in every window; the predicted parts follow one another.

    Where samples are uneven, windows of equal duration have different numbers of samples. A window
    with fewer samples repeats its first sample at the beginning and its last one at the end.

    Attributes
    ----------
    inputs : tuple of str
        The inputs of all models that are compared, which are present in every window.
    outputs : tuple of str
        The outputs to predict, all in the record.
    rows : (w, lead + horizon) int array
        Index of each sample in the record; the index of the next one for a row that is missing.
    lead, horizon : int
        Numbers of samples; 0 and 1 for rows without a time, where every row is a window.
    columns : (w, lead + horizon) int array
        Index of each sample among the samples of all stretches, see `sample_data`.
    repeated, filled : (w, lead + horizon) bool array
        Mark repeated samples, and samples that are not in the record, see `Stretch`.
    lengths : (float, float), s
        Durations of the lead-in and of the predicted part.
    elapsed : (w, horizon) array, s, or None
        Time from the last sample of the lead-in to each sample of the predicted part; None if that
        is whole steps of the record.
    """

    record: Record
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rows: IntArray
    lead: int
    horizon: int
    columns: IntArray
    repeated: BoolArray
    filled: BoolArray
    lengths: tuple[float, float]
    elapsed: Array | None = None

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

    A record that is shorter than eight times `at_least` allows an eighth of its length; one of few
    samples half, so that there is room for a lead-in and a window.
    """
    # The step of a single sample is NaN. `max` and `min` begin with another number, which no
    # comparison with NaN replaces.
    slowest = max([0.0, *(record.step for record in records)])
    # A hydraulic drive is recorded for 0.2 s, in which there is no room for a second.
    length = min([at_least, *(len(record) * record.step / 8 for record in records)])
    ten_samples = FEWEST * slowest
    for record in records:
        if len(record) > 1:
            # Half of the time from the first sample to a step behind the last one.
            step = min(record.step, record.duration / (len(record) - 1))
            ten_samples = min(ten_samples, (record.duration + step) / 2)
    # Within the longest delay, outputs respond to inputs before the lead-in.
    return max(length, ten_samples, slowest, 2.0 * delay)


def seconds(length: float) -> str:
    """Return a time in s as text, with three digits or more."""
    return f"{length:.0f}" if 1000 <= length < 1e6 else f"{length:.3g}"


def cut(
    record: Record,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    *,
    lead: float,
    horizon: float,
    called: str = "horizon",
) -> Windows:
    """Cut windows with a lead-in and a horizon in s, within stretches in which no input is missing.

    Lengths are rounded to whole samples where these are uniform. Windows are left out if no output
    was measured in the lead-in or in the horizon. `called` is the user's name of the horizon.

    Raises
    ------
    ValueError
        If a length is not positive or shorter than a sample, or no stretch is long enough.
    """
    require_signals(record, inputs)
    stretches = gapless(record, inputs, outputs)
    title = record.name or "the record"
    if record.has_time:
        for name, length in (("lead", lead), (called, horizon)):
            if length < (1 - ROUNDING) * record.step:
                raise ValueError(
                    f"{name}={seconds(length)} s is shorter than a sample of "
                    f"{title}, {seconds(record.step)} s: give several "
                    f"samples, e.g. {name}={seconds(FEWEST * record.step)}, or omit it."
                )

    begin, middle, end = _usable_windows(stretches, record, lead, horizon).T
    if not begin.size:
        if not record.has_time:
            raise ValueError(f"{title} has no row with all inputs and an output.")
        longest = max((float(s.steps.sum()) for s in stretches), default=0.0)
        raise ValueError(
            f"{title} has no room for lead={lead:g} and {called}={horizon:g} "
            f"s with measured outputs: its longest stretch without a gap lasts {seconds(longest)} "
            f"s; give a shorter lead or {called}, or a longer record."
        )

    # All windows have as many samples as the longest: shorter ones repeat their ends.
    lead_samples = int((middle - begin).max())
    horizon_samples = int((end - middle).max())
    places = middle[:, None] + np.arange(-lead_samples, horizon_samples)
    columns = np.clip(places, begin[:, None], end[:, None] - 1)
    repeated = columns != places
    rows = np.concatenate([stretch.rows for stretch in stretches])[columns]
    are_filled = []
    for stretch in stretches:
        nothing = np.zeros(len(stretch), dtype=bool)
        are_filled.append(nothing if stretch.filled is None else stretch.filled)
    filled = np.concatenate(are_filled)[columns]

    elapsed = None
    if repeated.any() or filled.any() or record.clock.kind != "uniform":
        times = np.concatenate([_times(stretch) for stretch in stretches])
        elapsed = times[columns[:, lead_samples:]] - times[middle - 1, None]
    lengths = (lead, horizon)
    if not repeated.any():
        step = stretches[0].step if filled.any() else record.step
        lengths = (lead_samples * step, horizon_samples * step)
    return Windows(
        record=record,
        inputs=tuple(inputs),
        outputs=outputs,
        rows=rows,
        lead=lead_samples,
        horizon=horizon_samples,
        columns=columns,
        repeated=repeated,
        filled=filled,
        lengths=lengths,
        elapsed=elapsed,
    )


def _usable_windows(
    stretches: Sequence[Stretch], record: Record, lead: float, horizon: float
) -> IntArray:
    """Return begin, end of the lead-in, and end (w, 3) of all windows with measured outputs.

    They are indices among the samples of all stretches.
    """
    windows = [np.zeros((0, 3), dtype=int)]
    first = 0
    for stretch in stretches:
        ends = _windows_of(stretch, record, lead, horizon)
        # Without a measurement the lead-in informs no state, and the horizon shows no error.
        count = np.concatenate([[0], np.cumsum(np.any(np.isfinite(stretch.outputs), axis=0))])
        is_measured = np.diff(count[ends], axis=1) > 0
        lead_is_measured, horizon_is_measured = is_measured.T
        if not record.has_time:
            # Rows without a time have no lead-in.
            lead_is_measured = True
        windows.append(ends[lead_is_measured & horizon_is_measured] + first)
        first += len(stretch)
    return np.concatenate(windows)


def _times(stretch: Stretch) -> Array:
    """Return the times (n,) of the samples of a stretch from its first one, s."""
    return np.concatenate([[0.0], np.cumsum(stretch.steps[:-1])])


def _windows_of(stretch: Stretch, record: Record, lead: float, horizon: float) -> IntArray:
    """Return the begin of each window of a stretch, the end of its lead-in, and its end (w, 3)."""
    # Each row without a time is a window, and has no lead-in.
    if not record.has_time:
        rows = np.arange(len(stretch))
        return np.array([rows, rows, rows + 1]).T
    times = _times(stretch)
    if off_uniform(times) <= JITTER:
        lead_samples = _whole_samples(lead, stretch)
        horizon_samples = _whole_samples(horizon, stretch)
        starts = np.arange(0, len(stretch) - lead_samples - horizon_samples + 1, horizon_samples)
        return starts[:, None] + [0, lead_samples, lead_samples + horizon_samples]

    # A sample belongs to the window in which it lies; rounding must not decide.
    margin = ROUNDING * stretch.step
    room = times[-1] + stretch.step + margin - lead - horizon
    starts = np.arange(math.floor(room / horizon) + 1) * horizon if room >= 0 else np.zeros(0)
    ends = np.searchsorted(times, starts[:, None] + [0, lead, lead + horizon] - margin)
    return ends[np.all(np.diff(ends, axis=1) > 0, axis=1)]


def _whole_samples(length: float, stretch: Stretch) -> int:
    """Return the nearest number of samples to a length in s, at least one."""
    # Half a sample is rounded down in all records alike, however their times are rounded.
    samples = min(length / stretch.step, len(stretch))
    return max(1, math.floor(samples + 0.5 - ROUNDING))


def sample_data(
    windows: Windows, inputs: tuple[str, ...], delays: Array, held: ArrayLike = False
) -> Array:
    """Return the data of all samples in the windows, (width, w, samples), see `SampledData.rows`.

    The inputs before a window are those of its stretch. Outputs are left out as long as the delayed
    inputs are unknown, see `gapless`. Before and after a repeated sample no time passes, and it is
    measured once.
    """
    record = windows.record
    # The stretches are those from which the windows were cut: the inputs of all compared models
    # determine them, not of this model alone.
    places = places_of(inputs, windows.inputs)
    leads = np.zeros(len(windows.inputs))
    leads[places] = np.maximum(delays, 0.0)
    are_held = np.zeros(len(windows.inputs))
    are_held[places] = held
    stretches = gapless(record, windows.inputs, windows.outputs, lead=leads, held=are_held)
    stretches = [replace(stretch, inputs=stretch.inputs[places]) for stretch in stretches]
    data = SampledData(tuple(stretches)).rows(delays)[:, windows.columns]
    if windows.repeated.any():
        # The last rows are the k outputs, k marks of measured outputs, and the step to the next
        # sample.
        k = len(windows.outputs)
        outputs_and_marks = slice(-1 - 2 * k, -1)
        data[outputs_and_marks, windows.repeated] = 0.0
        # No time passes from a sample to its repetition. The step is not exactly zero, since it
        # divides the slope of an input.
        is_repetition = np.diff(windows.columns, axis=1) == 0
        data[-1, :, :-1][is_repetition] = ROUNDING**2 * record.step
    return data


def require_signals(record: Record, inputs: Sequence[str], label: str = "the model") -> None:
    """Raise ValueError if an input of a model is missing."""
    missing = [name for name in inputs if name not in record.signals]
    if missing:
        raise ValueError(
            f"the record has no signal {missing[0]!r}, an input of {label}; it has "
            f"{', '.join(record.signals) or 'none'}: name it so when the record "
            f"is prepared, signals={{{missing[0]!r}: ...}}."
        )
