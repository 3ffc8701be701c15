"""Windows of equal length in a record: a lead-in, from which a state is estimated, and the samples to be predicted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.experiment import Experiment, gapless
from greybox.record import Record

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Windows:
    """Which samples of a record every window has; the predicted parts follow one another.

    Attributes
    ----------
    rows : (w, lead + horizon) int array
        Indices in the record.
    lead, horizon : int
        Samples.
    """

    record: Record
    rows: NDArray[np.integer]
    lead: int
    horizon: int

    def __len__(self) -> int:
        return len(self.rows)


def require_lengths(**lengths: Any) -> None:
    """Raise ValueError, naming it, for what is no length in s."""
    for name, value in lengths.items():
        real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        if not real or not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value!r}: give a length above 0, in s.")


def cut(
    record: Record,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    lead: float,
    horizon: float,
    called: str = "horizon",
) -> Windows:
    """Cut windows with a lead-in and a horizon in s, within stretches in which no input is missing.

    Windows in whose lead-in or horizon no output was measured are left out. The horizon is what the user knows as
    `called`.

    Raises
    ------
    ValueError
        If a length is not positive, or no stretch is long enough.
    """
    require_lengths(**{"lead": lead, called: horizon})
    _require_signals(record, inputs)
    stretches = gapless(record, tuple(inputs), tuple(outputs))
    first, after = (max(1, round(min(length / record.step, len(record)))) for length in (lead, horizon))
    places = []
    for stretch in stretches:
        starts = np.arange(0, len(stretch) - first - after + 1, after)
        rows = starts[:, None] + np.arange(first + after)
        there = np.any(np.isfinite(stretch.outputs), axis=0)[rows]
        usable = there[:, :first].any(axis=1) & there[:, first:].any(axis=1)
        places.append(stretch.first + rows[usable])
    found = np.concatenate([np.zeros((0, first + after), dtype=int), *places])
    if not len(found):
        longest = max((len(s) * s.step for s in stretches), default=0.0)
        raise ValueError(
            f"{record.name or 'the record'} has no room for lead={lead:g} and {called}={horizon:g} s with measured "
            f"outputs: its longest stretch without a gap lasts {longest:.3g} s; give a shorter lead or {called}, or a "
            "longer record."
        )
    return Windows(record, found, first, after)


def sample_data(windows: Windows, inputs: tuple[str, ...], outputs: tuple[str, ...], delays: Array) -> dict[str, Array]:
    """Return ``whole, around, measured, step``, each (rows, w, samples), of all samples in the windows.

    Inputs before a window are those of its stretch. What was measured before the delayed input has a past
    is left out, see `gapless`.
    """
    record = windows.record
    stretches = gapless(record, inputs, outputs, lead=np.maximum(delays, 0.0))
    whole, around = Experiment(tuple(stretches), outputs, 1).windows(delays)
    column = np.full(len(record), -1)
    column[np.concatenate([s.first + np.arange(len(s)) for s in stretches])] = np.arange(whole.shape[1])
    places = column[windows.rows]
    measured = np.concatenate([s.outputs for s in stretches], axis=1)
    step = np.repeat([s.step for s in stretches], [len(s) for s in stretches])[None]
    named = {"whole": whole, "around": around, "measured": measured, "step": step}
    return {name: values[:, places] for name, values in named.items()}


def _require_signals(record: Record, inputs: Sequence[str]) -> None:
    missing = [name for name in inputs if name not in record.signals]
    if missing:
        raise ValueError(
            f"the input {missing[0]!r} is needed and the record does not have it; "
            f"it has {', '.join(record.signals) or 'none'}."
        )
