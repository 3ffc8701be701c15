"""A record for estimation in time: gapless stretches of samples, cut into segments of equal length.

Every sample carries its input over the coming step as three neighboring samples (windows) of the
measured input, from which `input_over_step` makes mean and slope of the delayed input: polynomials
of the fraction of the delay. For interpolated inputs the cost is so continuously differentiable in
an estimated delay. For held inputs it is between whole samples; where a held input reaches an
output directly, the sampled output jumps at whole samples, and so does the cost.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.clock import EXACT, JITTER, decimal_tick, off_uniform
from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import array_of
from greybox.data.files.wording import listed
from greybox.data.record import Record, unrounded
from greybox.modeling.cached_property import cached_property
from greybox.statistics.noise_ratio import noise_ratio

# Fewest samples of a usable stretch: an initial state and a slope explain any two samples.
ENOUGH = 3

# Share of a step by which a delay may exceed a whole number of samples and still count as that
# number: the steps of a log are not known more precisely.
WHOLE = 1e-3

# Samples at the beginning of a stretch over which an input must be constant to count as at rest
# before it: longer than a command at a quarter of the logging rate is held.
REST = 5

# Largest distance of time stamps from the uniform clock that they round, in units of their last
# digit. Rounding makes up one half; the rest is for the estimated rate of the clock.
HALF = 0.52

# Largest number of samples of a stretch with filled long steps, for each measured sample. With 20,
# a clock at 1 Hz may turn into one at 0.05 Hz. A stretch that needs more keeps its uneven steps.
MOST_FILLED = 20


@frozen
class Stretch:
    """Samples through which the inputs are known, on average `step` s apart.

    Inputs (m, n); outputs (k, n), NaN where missing.

    `rows` (n,) are the indices of its samples in the record. Long steps are filled with samples
    that have no outputs, and no row: `filled` (n,) marks them, and their entry of `rows` is that of
    the next sample. The first `masked` samples are not compared: inputs from before the stretch
    reach them. In a record without a time all rows that have their inputs are one stretch. `times`
    (n,), s, are those of samples that are not uniform.
    """

    inputs: Array
    outputs: Array
    rows: IntArray
    step: float
    masked: int = 0
    times: Array | None = None
    filled: BoolArray | None = None

    @property
    def own(self) -> BoolArray | slice:
        """Which samples (n,) are rows of the record."""
        return slice(None) if self.filled is None else ~self.filled

    @property
    def own_rows(self) -> IntArray:
        """The rows of the record, without filled samples."""
        return self.rows[self.own]

    def of_rows(self, values: Array) -> Array:
        """Return the samples (r, n) from rows (r, rows) of the whole record."""
        if self.filled is None or self.filled.all():
            return values[:, self.rows]
        places = np.flatnonzero(~self.filled)
        share = np.interp(np.arange(len(self)), places, np.arange(places.size))
        last = np.floor(share).astype(int)
        next_row = np.minimum(last + 1, places.size - 1)
        before = values[:, self.own_rows[np.minimum(last, places.size - 1)]]
        after = values[:, self.own_rows[next_row]]
        return before + (share - last) * (after - before)

    @property
    def steps(self) -> Array:
        """From every sample to the next (n,), s; the last is like the one before."""
        if self.times is None:
            return np.full(len(self), self.step)
        steps = np.diff(self.times)
        return np.append(steps, steps[-1])

    def __len__(self) -> int:
        return self.inputs.shape[1]

    def at(self, places: slice) -> "Stretch":
        """Return the samples at these places."""
        return Stretch(
            self.inputs[:, places],
            self.outputs[:, places],
            self.rows[places],
            self.step * places.step,
            times=None if self.times is None else self.times[places],
            filled=None if self.filled is None else self.filled[places],
        )


@frozen
class SampledData:
    """All stretches of a record, one after the other, in segments of `segment_length` samples.

    The last segment of a stretch is filled up with samples without outputs. `constant_inputs` is
    True if no input ever changes.
    """

    stretches: tuple[Stretch, ...]
    segment_length: int = 1
    constant_inputs: bool = False

    @cached_property
    def segment_counts(self) -> list[int]:
        """Return the number of segments of every stretch."""
        return [math.ceil(len(stretch) / self.segment_length) for stretch in self.stretches]

    @cached_property
    def segments(self) -> int:
        """Return the number of segments."""
        return sum(self.segment_counts)

    @cached_property
    def samples(self) -> int:
        """Return the number of samples, those that fill up segments included."""
        return self.segments * self.segment_length

    @cached_property
    def begins_stretch(self) -> BoolArray:
        """Which segments (s,) begin a stretch."""
        return np.concatenate([np.arange(count) == 0 for count in self.segment_counts])

    @cached_property
    def first_samples(self) -> IntArray:
        """Return the number of the first sample of every stretch."""
        return np.cumsum([0, *self.segment_counts[:-1]]) * self.segment_length

    @cached_property
    def coupled(self) -> BoolArray:
        """Which segments (s,) are followed by another of the same stretch."""
        return np.append(~self.begins_stretch[1:], False)

    @property
    def is_uniform(self) -> bool:
        """Whether every sample is nearest to its own place on a uniform clock of its stretch."""
        times = [stretch.times for stretch in self.stretches if stretch.times is not None]
        return all(off_uniform(values) <= JITTER for values in times)

    def excerpts(self, samples: int) -> "SampledData":
        """Return evenly spaced excerpts with this total number of samples; short data whole."""
        total = sum(map(len, self.stretches))
        if total <= samples:
            return self
        pieces = []
        for stretch in self.stretches:
            # Five in all, or one of every stretch if there are more.
            count = math.ceil(5 * len(stretch) / total)
            # Two segments at least: within one, the node alone explains the outputs.
            length = max(samples // (count * len(self.stretches)), 2 * self.segment_length)
            length = min(length, len(stretch) // count)
            for start in np.linspace(0, len(stretch) - length, count).astype(int):
                pieces.append(stretch.at(slice(start, start + length, 1)))

        return SampledData(tuple(pieces), self.segment_length)

    @np.errstate(invalid="ignore")  # a mean of none is missing
    def averaged(self, factor: int, held: BoolArray) -> "SampledData":
        """Return every sample of this number, with means of the outputs from there to the next.

        Inputs (m,) that are held have means, too. Missing values do not count.
        """

        def means(values: Array) -> Array:
            # Around the samples, they would overlap with inputs that return the noise at once, and
            # show a direct effect of these.
            firsts = np.arange(0, values.shape[1], factor)
            both = np.array([np.nan_to_num(values), np.isfinite(values)])
            return np.divide(*np.add.reduceat(both, firsts, axis=2))

        return replace(
            self,
            stretches=tuple(
                replace(
                    stretch.at(slice(0, None, factor)),
                    inputs=np.where(
                        held[:, None], means(stretch.inputs), stretch.inputs[:, ::factor]
                    ),
                    outputs=means(stretch.outputs),
                )
                for stretch in self.stretches
            ),
        )

    def padded(self, values: Sequence[Array], fill: float | None = None) -> Array:
        """Join one array (r, n) per stretch, each filled up to whole segments: (r, samples).

        Without a `fill` the last value is repeated: zero may be outside of a model's domain, as an
        airspeed.
        """
        joined = np.empty((len(values[0]), self.samples))
        ends = np.append(self.first_samples[1:], self.samples)
        for value, first, end in zip(values, self.first_samples, ends, strict=True):
            last = first + value.shape[1]
            joined[:, first:last] = value
            joined[:, last:end] = value[:, -1:] if fill is None else fill
        return joined

    def at_samples(self, values: Array) -> Array:
        """Choose the samples (r, samples) of all stretches from rows (r, n) of the whole record.

        Filled samples lie on lines between the rows.
        """
        rows = np.atleast_2d(values)
        return self.padded([stretch.of_rows(rows) for stretch in self.stretches])

    def unpadded(self, values: Array) -> list[Array]:
        """Cut (r, samples) into the samples of every stretch."""
        pairs = zip(self.first_samples, self.stretches, strict=True)
        return [values[..., first : first + len(stretch)] for first, stretch in pairs]

    @property
    def measured(self) -> Array:
        """Measured outputs (k, samples), NaN where nothing was measured."""
        return self.padded([stretch.outputs for stretch in self.stretches], np.nan)

    @property
    def steps(self) -> Array:
        """The step of every sample, (1, samples), s."""
        return self.padded([stretch.steps[None] for stretch in self.stretches])

    def rows(self, delays: Array) -> Array:
        """Return the data of all samples (width, samples), as `SampleStep` takes them."""
        inputs = self.delayed_inputs(delays)
        measured = self.measured
        return np.vstack([*inputs, np.nan_to_num(measured), np.isfinite(measured), self.steps])

    def whole_samples(self, delays: Array) -> Array:
        """Return the whole samples (stretches, m) of delays (m,), or (m, stretches), s."""
        steps = np.array([stretch.step for stretch in self.stretches])
        # Rounding must not turn a delay of whole samples into one sample less.
        return np.floor(delays.T / steps[:, None] + 1e-9)

    def delayed_inputs(self, delays: Array) -> tuple[Array, Array]:
        """Return the whole samples of delays (m, samples), and inputs around them (3 m, samples).

        Before its first sample an input is taken to have had that value, after its last one to keep
        it. The delays are those of all stretches, (m,), or of every one of them, (m, stretches).
        """
        whole, around = [], []
        for stretch, samples in zip(self.stretches, self.whole_samples(delays), strict=True):
            shift = np.clip(samples, -len(stretch), len(stretch))
            at = np.arange(len(stretch)) - shift[:, None].astype(int)
            places = np.clip(at[:, None, :] + np.array([-1, 0, 1])[:, None], 0, len(stretch) - 1)
            values = np.take_along_axis(stretch.inputs[:, None, :], places, axis=2)
            around.append(values.reshape(-1, len(stretch)))
            whole.append(np.repeat(shift[:, None], len(stretch), axis=1))

        return self.padded(whole), self.padded(around)


def joined(records: Sequence[SampledData]) -> SampledData:
    """Return the stretches of several records, one record after the other."""
    stretches = tuple(stretch for data in records for stretch in data.stretches)
    return SampledData(stretches, records[0].segment_length)


def sampled_data(  # noqa: PLR0913  (as many facts as a record and its model have)
    record: Record,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    *,
    lead: ArrayLike,
    complete: bool,
    held: ArrayLike = False,
    static: bool = False,
    states: int = ENOUGH,
    known_states: int = 0,
) -> SampledData:
    """Cut a record into stretches, in segments of one sample.

    The first `lead` (m,) seconds of a stretch give the delayed inputs their past and are not
    compared, and inputs are `held` (m,) or not in long steps, see `gapless`. With `complete`, a
    sample counts only where all outputs are there. For a `static` model every sample counts by
    itself, and nothing needs to move. Of a model with `states`, so many are known at the first
    sample of the record, see `is_informative`.

    Raises
    ------
    ValueError
        If the record is too short, empty, not uniformly sampled, or nothing ever moves.
    """
    names = ", ".join(inputs)
    empty = [name for name in inputs if not np.isfinite(record[name]).any()]
    if empty or not any(np.isfinite(record[name]).any() for name in outputs):
        raise ValueError(
            f"{_called(record)} has no measured value of "
            f"{empty[0] if empty else ', '.join(outputs)}: every sample is missing."
        )

    stretches = gapless(record, inputs, outputs, lead=lead, held=held, complete=complete)
    usable = tuple(
        stretch
        for stretch in stretches
        if is_informative(stretch, 0 if static else states, known_states)
    )
    if not usable:
        if static:
            what = "sample" if record.has_time else "row"
            raise ValueError(
                f"{_called(record)} has no {what} with all inputs and an output "
                f"({names}; {listed(outputs)})."
            )
        # A held input of a single sample is late by an unknown time.
        delay = np.nan_to_num(np.max(lead, initial=0.0), posinf=0.0)
        reason = f" after the longest delay in the bounds, {delay:.3g} s" if delay else ""
        raise ValueError(
            f"{_called(record)} has no usable stretch, {ENOUGH} samples in a row with all inputs"
            f"{reason}: give a longer record, known initial states, or inputs at every sample, as "
            "gb.prepare makes them"
            f"{', or a smaller upper bound' if delay else ''}. {' '.join(record.findings)}".strip()
        )

    # A system at rest with a constant input shows only its noise, which any parameters explain.
    constant = bool(inputs) and all(_is_constant(record[name]) for name in inputs)
    if constant and not static:
        # Where an experiment has a few samples, they look like noise even if the states move.
        signals = [noise_ratio([s.outputs[k] for s in stretches]) for k in range(len(outputs))]
        if all(signal.noisy and signal.samples > 35 for signal in signals if signal.samples):
            raise ValueError(
                f"the inputs of {_called(record)} never change ({names}) and {listed(outputs)} "
                f"{'is' if len(outputs) == 1 else 'are'} indistinguishable from noise: "
                "nothing can be estimated from it."
            )

    # A single value, as of a destroyed sample, is compared with what known initial states give.
    constant_outputs = [
        name
        for name in outputs
        if not static and _is_constant(record[name]) and np.isfinite(record[name]).sum() != 1
    ]
    if len(constant_outputs) == len(outputs):
        raise ValueError(
            f"the outputs of {_called(record)} never change ({', '.join(outputs)}): "
            "nothing can be estimated from it."
        )

    dead = [name for name in constant_outputs if np.isfinite(record[name]).any()]
    if dead:  # its residuals would decide the fit
        raise ValueError(
            f"{_called(record)} has {dead[0]} = {np.nanmax(record[dead[0]]):g} at all times, "
            "while other outputs change: if the sensor is dead, leave it out of the record."
        )

    return SampledData(usable, constant_inputs=constant)


def gapless(
    record: Record,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    *,
    lead: ArrayLike = 0.0,
    held: ArrayLike = False,
    complete: bool = False,
) -> list[Stretch]:
    """Return the stretches of a record with all inputs, without outputs that lack their past.

    A stretch ends where an input is missing, or where rows are lost and inputs are unknown, see
    `Record.stretches`. Rows without a time are one stretch, whatever is between them.

    Other long steps are filled with samples without outputs if the samples are uniform then:
    delays, filters and windows need that. A `held` (m,) input keeps its value there, unless rows
    are lost; other inputs run in a line.

    The values of an input before a stretch are unknown, so the outputs of its first seconds are
    left out, up to the longest delay that it may have, its entry of `lead` (m,). An input that
    rests, exactly constant, over the first 5 samples and clearly longer than it holds its values
    later, is taken to have rested before too.

    Raises
    ------
    ValueError
        If an input is delayed and a stretch is not uniformly sampled.
    """
    u = array_of(record, inputs).reshape(len(inputs), len(record))
    y = array_of(record, outputs).reshape(len(outputs), len(record))
    y = np.where(np.all(np.isfinite(y), axis=0), y, np.nan) if complete else y
    complete_inputs = np.all(np.isfinite(u), axis=0)
    # Rows without a time have no neighbors: a row that lacks an input is no gap.
    if not record.has_time:
        rows = np.flatnonzero(complete_inputs)
        return [Stretch(u[:, rows], y[:, rows], rows, record.step)] if rows.size else []

    time = unrounded(record).time
    leads = np.broadcast_to(lead, len(inputs))
    keeps = np.broadcast_to(np.asarray(held, dtype=bool), len(inputs))
    # Where rows are lost although the input is known, a line follows it best.
    lost = np.zeros(len(record), dtype=bool)
    lost[record.clock.holes] = record.gaps == "auto"
    ends = np.flatnonzero(np.diff(complete_inputs)) + 1
    stretches = []
    for known in record.stretches(inputs):
        for rows in np.split(known, ends[(ends > known[0]) & (ends <= known[-1])] - known[0]):
            if complete_inputs[rows[0]]:
                part = Stretch(u[:, rows], y[:, rows], rows, record.step, times=time[rows])
                stretches.append(_on_its_clock(part, leads, keeps, lost[rows]))
    return stretches


def is_informative(stretch: Stretch, states: int, known_states: int) -> bool:
    """Return whether a stretch can say anything of a model with so many states.

    With fewer measured values than unknown initial states, these explain everything. Of them,
    `known_states` are known at the first sample of the record.
    """
    numbers = int(np.isfinite(stretch.outputs).sum())
    unknown = states - known_states * (stretch.rows[0] == 0)
    return numbers > unknown or (numbers > 1 and len(stretch.own_rows) >= ENOUGH)


def _called(record: Record) -> str:
    return f"the record {record.name!r}" if record.name else "the record"


def _is_constant(values: Array) -> bool:
    present = values[np.isfinite(values)]
    return present.size == 0 or present.min() == present.max()


def _on_its_clock(given: Stretch, leads: Array, held: BoolArray, lost: BoolArray) -> Stretch:
    """Return a stretch of samples in time, uniform if its times are, or filled up to be so."""
    time, count = given.times, len(given)
    assert time is not None
    if count == 1:
        return replace(given, step=given.step if given.step > 0 else 1.0, times=None)
    if off_uniform(time) > JITTER:
        given = _filled(given, held, lost)
        time, count = given.times, len(given)
        assert time is not None

    # The mean step has more digits than a difference of two rounded times.
    step = float((time[-1] - time[0]) / (count - 1))
    off = off_uniform(time)
    if off > JITTER and np.any(leads > 0):
        raise ValueError(
            f"sampling is not uniform from {time[0]:g} s on (off by {off:.2g} steps), and a delay "
            "needs uniform sampling: prepare the record with rate=..., which resamples it; put a "
            "few irregular samples on a fine uniform time base, with NaN where nothing was "
            "measured."
        )

    moving = [lead for lead, row in zip(leads, given.inputs, strict=True) if not _rests(row)]
    masked = min(math.ceil(max(max(moving, default=0.0) / step - WHOLE, 0.0)), count)
    compared = given.outputs.copy()
    compared[:, :masked] = np.nan
    # Delays are whole samples, and stamps within half a unit of a uniform clock round it. Other
    # times count as they are, in a schedule of few samples above all.
    uniform = off <= (JITTER if np.any(leads > 0) else EXACT)
    uniform |= off <= JITTER and off * step <= HALF * decimal_tick(time)
    times = None if uniform else time
    return replace(given, outputs=compared, step=step, masked=masked, times=times)


def _filled(given: Stretch, held: BoolArray, lost: BoolArray) -> Stretch:
    """Return a stretch with samples in its long steps, if it is uniform then; else as it is.

    `lost` (n,) marks the samples after which rows are lost.
    """
    assert given.times is not None
    steps = np.diff(given.times)
    ordered = np.sort(steps)
    # The shortest step, or the usual one where some are short by chance.
    for step in (ordered[0], ordered[len(ordered) // 4]):
        parts = np.maximum(np.round(steps / step), 1).astype(int)
        if parts.sum() > MOST_FILLED * len(given):
            continue
        places = np.concatenate([[0], np.cumsum(parts)])
        share = np.interp(np.arange(places[-1] + 1), places, np.arange(len(given)))
        times = np.interp(share, np.arange(len(given)), given.times)
        if off_uniform(times) <= JITTER:
            break
    else:
        return given

    last = np.floor(share + 1e-9).astype(int)
    following = np.ceil(share - 1e-9).astype(int)
    fraction = np.where(last == following, 0.0, share - last)
    # Held until the next row.
    keeps = held[:, None] & ~lost[last]
    inputs = given.inputs[:, last]
    inputs = inputs + np.where(keeps, 0.0, fraction * (given.inputs[:, following] - inputs))
    filled = last != following
    return replace(
        given,
        inputs=inputs,
        outputs=np.where(filled, np.nan, given.outputs[:, last]),
        rows=given.rows[following],
        times=times,
        filled=filled,
    )


def _rests(values: Array) -> bool:
    """Return whether an input rests at first: constant for longer than its later values."""
    if values.size < REST or not _is_constant(values[:REST]):
        return False
    runs = np.diff(np.flatnonzero(np.diff(values)), prepend=-1)
    # Commands at a lower rate, or of random length, are constant for some samples in the middle of
    # their movement too. An input that returns to its first value after at most three holds had
    # rested there; for a single step nobody can tell. Otherwise the first hold must be twice as
    # long as the median of the later ones.
    few = runs.size < 2 or (runs.size <= 3 and values[0] == values[-1])
    return few or bool(runs[0] > 2 * sorted(runs[1:])[len(runs) // 2 - 1])


def input_over_step(window: Any, fraction: Any, held: bool) -> tuple[Any, Any, Any]:
    """Return mean and change of delayed inputs over the coming step, and the value at the sample.

    `window` (3,) holds the samples before, at and after the delayed sample; `fraction` of a step is
    the excess of the delay over whole samples. Mean and change (the slope of the best line) match
    the moments of the delayed input over the step.

    The value at the sample is exact. A held input changes a fraction of a step later: until then it
    has the value before, whatever the fraction is. The mean in its place would be differentiable,
    but with an input that reaches an output directly it draws the delay to the next whole sample.
    """
    a, b, c = window[0], window[1], window[2]
    f, r = fraction, 1 - fraction
    if held:
        late = f > WHOLE
        return f * a + r * b, 6 * f * r * (b - a), late * a + (1 - late) * b

    now = f * a + r * b
    first, last = f**2 / 2, r**2 / 2
    early, late = 2 * f**3 - 3 * f**2, 3 * r**2 - 2 * r**3
    return (
        first * a + (1 - first - last) * b + last * c,
        early * a - (early + late) * b + late * c,
        now,
    )
