"""Records cut into uniformly sampled stretches without gaps, for transforms."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import array_of
from greybox.data.frequency_response import Stretch
from greybox.data.record import Record, require_time, runs_between_gaps, unrounded

# Largest deviation of a sample from a uniform time base, in sampling intervals. At 0.4 of the
# sampling rate, where the automatic frequencies end, the phase of such a sample is wrong by
# 2π · 0.4 · 0.05 = 0.13 rad, and a window averages it.
JITTER = 0.05


class UniformStretch(NamedTuple):
    """Values (signals, n) without gaps, the sampling interval in s, and where they come from."""

    values: Array
    step: float
    origin: Stretch
    record: Record


def uniform_stretches(
    records: Record | Sequence[Record], signals: Sequence[str]
) -> list[UniformStretch]:
    """Cut records at gaps and missing samples.

    Parameters
    ----------
    records : Record or sequence of Record
    signals : sequence of str
        Rows of the values; only samples at which all are present are used.

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
        for piece in unrounded(record).pieces:
            values = array_of(piece, signals)
            present = np.flatnonzero(np.all(np.isfinite(values), axis=0))
            for run in runs_between_gaps(present, 1):
                if run.size > 1:
                    rows = present[run]
                    time = piece.time[rows]
                    check_uniform(time, record)
                    origin = Stretch(record.checksum, float(time[0]), float(time[-1]))
                    stretches.append(UniformStretch(values[:, rows], piece.step, origin, record))

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
