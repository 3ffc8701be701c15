"""Windows of equal length in a record: a lead-in to estimate a state, then a part to predict."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.compiled.sampled_data import SampledData, gapless
from greybox.data.record import Record
from greybox.files.arrays import Array, IntArray, Labels, Strings, frozen
from greybox.modeling.parameter import is_finite_number

# Samples of a default length: two or more for each state of the models here, which have 2 to 5.
FEWEST = 10
ROUNDING = 1e-6  # of a sample, by which a length may be shorter: times are rounded


@frozen
class Windows:
    """The samples of a record in every window; the predicted parts follow one another.

    Attributes
    ----------
    rows : (w, lead + horizon) int array
        Indices in the record.
    lead, horizon : int
        Numbers of samples; 0 and 1 for rows without a time, where every row is a window.
    """

    record: Record
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

    Of a record that is shorter than eight times `at_least`, it is an eighth.
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
    inputs: Labels,
    outputs: Labels,
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
    stretches = gapless(record, tuple(inputs), tuple(outputs))
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
    if not len(rows) and not record.has_time:
        raise ValueError(f"{record.name or 'the record'} has no row with all inputs and an output.")
    if not len(rows):
        longest = max((len(s) * s.step for s in stretches), default=0.0)
        raise ValueError(
            f"{record.name or 'the record'} has no room for lead={lead:g} and {called}={horizon:g} "
            f"s with measured outputs: its longest stretch without a gap lasts {seconds(longest)} "
            f"s; give a shorter lead or {called}, or a longer record."
        )
    return Windows(record, rows, lead_samples, horizon_samples)


def sample_data(
    windows: Windows, inputs: Strings, outputs: Strings, delays: Array
) -> dict[str, Array]:
    """Return ``whole, around, measured, step`` of all samples in the windows, (rows, w, samples).

    The inputs before a window are those of its stretch. Outputs are left out as long as the delayed
    inputs are unknown, see `gapless`.
    """
    record = windows.record
    stretches = gapless(record, inputs, outputs, lead=np.maximum(delays, 0.0))
    data = SampledData(tuple(stretches))
    delayed, around = data.delayed_inputs(delays)

    # Windows index the record, the data its stretches without gaps.
    column = np.full(len(record), -1)
    column[np.concatenate([s.rows for s in stretches])] = np.arange(delayed.shape[1])
    places = column[windows.rows]
    named = {"whole": delayed, "around": around, "measured": data.measured, "step": data.steps}
    return {name: values[:, places] for name, values in named.items()}


def require_signals(record: Record, inputs: Labels, label: str = "the model") -> None:
    """Raise ValueError if an input of a model is missing."""
    missing = [name for name in inputs if name not in record.signals]
    if missing:
        raise ValueError(
            f"the record has no signal {missing[0]!r}, an input of {label}; it has "
            f"{', '.join(record.signals) or 'none'}: name it so when the record "
            f"is prepared, signals={{{missing[0]!r}: ...}}."
        )
