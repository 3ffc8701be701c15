"""Predictions of several fits over the same windows, which all of them can use and in which all are finite."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Record
from greybox.data.text_table import counted
from greybox.estimate.result import Fit, FittedRecord
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.prediction import Prediction
from greybox.simulation.simulate import cure, predict_windows
from greybox.simulation.windows import cut, default_length

Predictions = tuple[tuple[Prediction, ...], ...]  # of every fit, of every record
WINDOW, LEAD = 1.0, 0.5  # s: shortest defaults


def lengths_of(
    fits: Sequence[Fit], records: Sequence[Record], window: float | None, lead: float | None
) -> tuple[float, float]:
    """Return window and lead-in in s, by default as the records and the delays ask for."""
    if not records:
        return math.nan, math.nan
    window = default_length(records, WINDOW) if window is None else window
    if lead is None:
        cases = [at for fit in fits for at in (fit.at_estimate(), *(_case(fit, k) for k in range(len(fit.records))))]
        lead = default_length(records, LEAD, max(float(np.max(at.delays, initial=0.0)) for at in cases))
    return window, lead


def predicted(
    fits: Sequence[Fit],
    names: Sequence[str],
    data: Sequence[Sequence[Record]],
    lengths: tuple[float, float],
    own: bool,
) -> tuple[Predictions, list[str]]:
    """Return for every fit the predictions of every record, over windows that all can use, and what was left out."""
    window, lead = lengths
    columns, said = [], []
    for k in range(len(data[0])):
        cases = [_case(fit, k if own else None) for fit in fits]
        record = _joined([records[k] for records in data])
        inputs = dict.fromkeys(name for at in cases for name in at.system.inputs)
        common = [name for name in cases[0].system.outputs if all(name in at.system.outputs for at in cases)]
        outputs = tuple(name for name in common if name in record.signals)
        if not outputs:
            raise ValueError(
                f"{record.name or 'the record'} has no output that all fits have ({', '.join(common) or 'none'}); "
                f"it has {', '.join(record.signals)}."
            )
        windows = cut(record, tuple(inputs), outputs, lead=lead, horizon=window, called="window")
        column, left = _common([predict_windows(at, windows, outputs) for at in cases], names)
        columns.append(column)
        said += left
    return tuple(zip(*columns, strict=True)), said


def _common(
    found: Sequence[tuple[Prediction, NDArray[np.bool_], str]], names: Sequence[str]
) -> tuple[list[Prediction], list[str]]:
    """Return the predictions in the windows in which all are finite, and what is to be said of the others."""
    lost = np.any([gone for _, gone, _ in found], axis=0)
    if not lost.any():
        return [prediction for prediction, _, _ in found], []
    name, why = next((name, text) for name, (_, _, text) in zip(names, found, strict=True) if text)
    why = why if why.startswith(name) else f"{name}: {why}"
    record = found[0][0].data.name or "the record"
    count = int(lost.sum())
    if 2 * count >= lost.size:
        raise ValueError(
            f"no comparison is possible where {counted(count, 'window')} of {lost.size} in {record} "
            f"{'is' if count == 1 else 'are'} not finite ({why}): {cure('window')}."
        )
    said = f"warning: {counted(count, 'window')} of {lost.size} in {record} left out for all, since one is not finite"
    return [prediction.kept(~lost) for prediction, _, _ in found], [f"{said} ({why})."]


def _case(fit: Fit, record: int | None) -> ModelAtEstimate:
    """Return a fit as it is simulated, for its own k-th record or for one that it has not seen."""
    if record is None:
        return fit.at_estimate()
    return fit.at_estimate(part=[k for k, part in enumerate(fit.parts) if isinstance(part, FittedRecord)][record])


def _joined(records: Sequence[Record]) -> Record:
    """Return one record with the signals of all, which are of the same data."""
    first = records[0]
    more = {name: r[name] for r in records[1:] for name in r.signals if name not in first.signals}
    if not more:
        return first
    units = {name: r.units.get(name, "") for r in records for name in r.signals}
    return Record(first.time, {**first.signals, **more}, units, first.name, first.source, first.checksum)
