"""Records cut into uniformly sampled stretches without gaps, for transforms."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from greybox.data.clock import JITTER as JITTER_OF_CLOCK, Gaps
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.named_values import array_of
from greybox.data.frequency_response import Stretch
from greybox.data.record import Record, require_time, unrounded

# Largest deviation of a sample from a uniform time base, in sampling intervals. At 0.4 of the
# sampling rate, where the automatic frequencies end, the phase of such a sample is wrong by
# 2π · 0.4 · 0.05 = 0.13 rad, and a window averages it.
JITTER = 0.05

# Missing samples in a row that are interpolated, and the largest share of a stretch: a signal in
# every second row has a rate of its own. `benchmarks/results/damaged_records.txt` has the errors.
FILLED = 3
MOST_FILLED = 0.25


class UniformStretch(NamedTuple):
    """Values (signals, n) without gaps, the sampling interval in s, and where they come from."""

    values: Array
    step: float
    origin: Stretch
    record: Record


def uniform_stretches(
    records: Record | Sequence[Record], signals: Sequence[str]
) -> list[UniformStretch]:
    """Cut records at gaps; up to `FILLED` missing samples in a row are interpolated.

    Parameters
    ----------
    records : Record or sequence of Record
    signals : sequence of str
        Rows of the values; a sample counts as missing if one of them is.

    Raises
    ------
    ValueError
        If a record is not uniformly sampled, a signal is constant in all stretches, or no sample
        has all signals.
    KeyError
        For a signal that a record does not hold.
    """
    stretches = []
    for record in checked_items("records", records, Record, "a Record or several of them"):
        require_time(record, "a frequency response")
        stretches += _stretches_of(record, signals)

    if not stretches:
        raise ValueError(
            f"{', '.join(dict.fromkeys(signals))} are never all present in two samples in a row: "
            "gb.prepare(record, ..., rate=...) puts signals of different rates on one time base."
        )
    # A ratio of two constants would consist of rounding errors.
    for k, name in enumerate(signals):
        # 1e-12: rounding errors of resampling, for values of some thousands.
        if all(np.ptp(s.values[k]) <= 1e-12 for s in stretches):
            raise ValueError(
                f"{name} does not change in these records: choose a part that is excited."
            )
    return stretches


def check_uniform(time: Array, record: Record) -> None:
    """Raise ValueError if times (n,) without gaps deviate from a uniform time base."""
    # Errors of single steps may add up to more than their size.
    uniform, step = np.linspace(time[0], time[-1], time.size, retstep=True)
    deviation = np.abs(time - uniform)
    if deviation.max() > JITTER * step:
        raise ValueError(
            f"{record.name or 'the record'} is not uniformly sampled ({1e3 * deviation.max():.2g} "
            f"ms off at {time[deviation.argmax()]:.2f} s): prepare it with rate=..., which "
            "resamples it."
        )


def _stretches_of(record: Record, signals: Sequence[str]) -> Iterator[UniformStretch]:
    """Yield the stretches of one record."""
    timed = unrounded(record)
    values = array_of(timed, signals)
    present = np.flatnonzero(np.all(np.isfinite(values), axis=0))
    if present.size < 2:
        return
    time, values, step = timed.time[present], values[:, present], timed.clock.step

    jumps = np.diff(time) / step
    places = np.append(0, np.cumsum(np.maximum(np.rint(jumps), 1))).astype(int)
    for run in _runs(jumps, record.gaps):
        if run.size < 2:
            continue
        at = places[run] - places[run[0]]
        whole = np.arange(at[-1] + 1)
        stretch_time = np.interp(whole, at, time[run])
        check_uniform(stretch_time, record)
        filled = np.array(
            [
                _filled(row[run], at, whole, is_held=record.hold.get(name, 0.0) > 0)
                for name, row in zip(signals, values, strict=True)
            ]
        )
        origin = Stretch(record.checksum, float(stretch_time[0]), float(stretch_time[-1]))
        yield UniformStretch(filled, step, origin, record)


def longest_stretch(record: Record) -> float:
    """Return the duration of the longest stretch without a gap that is not interpolated, s."""
    jumps = np.diff(record.time) / record.step
    runs = _runs(jumps, record.gaps)
    return float(max(np.ptp(record.time[run]) for run in runs))


def is_interpolated(record: Record) -> BoolArray:
    """Return across which steps (n - 1,) of a record lost rows are interpolated."""
    return _is_filled(np.diff(record.time) / record.step, record.gaps)


def _runs(jumps: Array, gaps: Gaps) -> Sequence[IntArray]:
    """Return the samples of every stretch; `jumps` (n - 1,) are the steps in usual steps."""
    is_gap = (np.rint(jumps) > 1) & ~_is_filled(jumps, gaps)
    return np.split(np.arange(jumps.size + 1), np.flatnonzero(is_gap) + 1)


def _is_filled(jumps: Array, gaps: Gaps) -> BoolArray:
    """Return across which steps, in usual ones, rows are lost and interpolated."""
    missing = np.rint(jumps) - 1
    # Off the grid, the clock has started again.
    is_on_grid = np.abs(missing + 1 - jumps) < JITTER_OF_CLOCK
    is_short = (missing >= 1) & (missing <= FILLED) & is_on_grid
    lost = missing[is_short].sum()
    is_rare = lost <= MOST_FILLED * (lost + jumps.size + 1)
    return is_short & is_rare & (gaps != "cut")


def _filled(values: Array, at: IntArray, whole: IntArray, *, is_held: bool) -> Array:
    """Return values (n,), which are at these places, at all `whole` places."""
    if at.size == whole.size:
        return values
    # One that is held, but new in every row, is a smooth command: its values lie on a curve.
    if is_held and np.mean(np.diff(values) == 0) > 0.5:
        return values[np.searchsorted(at, whole, side="right") - 1]
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (slow to import)

    return CubicSpline(at, values)(whole)
