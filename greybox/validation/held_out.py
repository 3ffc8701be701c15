"""Predictions of several fits on their own data and on held-out records, over windows in which all are finite."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Record, share_samples
from greybox.data.text_table import counted
from greybox.estimate.result import Fit, FittedRecord
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.prediction import Prediction
from greybox.simulation.simulate import cure, predict_windows
from greybox.simulation.windows import cut, default_length

Predictions = tuple[tuple[Prediction, ...], ...]
"""Of every fit, of every record."""

# s, the shortest defaults: a choice, printed with every comparison. A second is twenty time constants of a rotor, so
# that the dynamics are seen, and short enough for an unstable plant; half of that is enough to estimate its state.
SHORTEST_WINDOW = 1.0
SHORTEST_LEAD = 0.5


def window_lengths(
    fits: Sequence[Fit], records: Sequence[Record], window: float | None, lead: float | None
) -> tuple[float, float]:
    """Return window and lead-in in s, by default as the records and the delays ask for; NaN without records."""
    if not records:
        return math.nan, math.nan

    if window is None:
        window = default_length(records, SHORTEST_WINDOW)
    if lead is None:
        models = [fit.at_estimate() for fit in fits]
        models += [_own_model(fit, k) for fit in fits for k in range(len(fit.records))]
        longest_delay = max(float(np.max(model.delays, initial=0.0)) for model in models)
        lead = default_length(records, SHORTEST_LEAD, longest_delay)
    return window, lead


def predict_same_windows(
    fits: Sequence[Fit],
    labels: Sequence[str],
    data: Sequence[Sequence[Record]],
    lengths: tuple[float, float],
    *,
    own: bool,
) -> tuple[Predictions, list[str]]:
    """Predict the records of `data` (of every fit, in the same order) by all fits over the same windows.

    With `own` they are the records that each was fitted to, and the k-th is predicted with what that part assumed.
    Returns the predictions, and in words which windows were left out.
    """
    window, lead = lengths
    by_record: list[list[Prediction]] = []
    notes: list[str] = []
    for k in range(len(data[0])):
        models = [_own_model(fit, k) if own else fit.at_estimate() for fit in fits]
        record = _with_all_signals([records[k] for records in data])
        inputs = dict.fromkeys(name for model in models for name in model.system.inputs)
        outputs = _shared_outputs(models, record)
        windows = cut(record, tuple(inputs), outputs, lead=lead, horizon=window, called="window")

        predictions, note = _where_all_are_finite([predict_windows(m, windows, outputs) for m in models], labels)
        by_record.append(predictions)
        notes += note
    return tuple(zip(*by_record, strict=True)), notes


def _shared_outputs(models: Sequence[ModelAtEstimate], record: Record) -> tuple[str, ...]:
    shared = [name for name in models[0].system.outputs if all(name in model.system.outputs for model in models)]
    outputs = tuple(name for name in shared if name in record.signals)
    if not outputs:
        raise ValueError(
            f"{record.name or 'the record'} has no output that all fits have ({', '.join(shared) or 'none'}); "
            f"it has {', '.join(record.signals)}."
        )
    return outputs


def _where_all_are_finite(
    results: Sequence[tuple[Prediction, NDArray[np.bool_], str]], labels: Sequence[str]
) -> tuple[list[Prediction], list[str]]:
    """Return the predictions in the windows in which all are finite, and a note on the windows left out.

    Of every fit come its prediction, which windows diverged (w,), and why.
    """
    diverged = np.any([lost for _, lost, _ in results], axis=0)
    if not diverged.any():
        return [prediction for prediction, _, _ in results], []

    label, reason = next((label, why) for label, (_, _, why) in zip(labels, results, strict=True) if why)
    reason = reason if reason.startswith(label) else f"{label}: {reason}"
    record = results[0][0].data.name or "the record"
    count = int(diverged.sum())
    if 2 * count >= diverged.size:
        raise ValueError(
            f"no comparison is possible where {counted(count, 'window')} of {diverged.size} in {record} "
            f"{'is' if count == 1 else 'are'} not finite ({reason}): {cure('window')}."
        )
    note = (
        f"warning: {counted(count, 'window')} of {diverged.size} in {record} left out for all models, since the "
        f"prediction of one is not finite ({reason})."
    )
    return [prediction.kept(~diverged) for prediction, _, _ in results], [note]


def _own_model(fit: Fit, record: int) -> ModelAtEstimate:
    """Return a fit as it is simulated for its own k-th record."""
    parts = [k for k, part in enumerate(fit.parts) if isinstance(part, FittedRecord)]
    return fit.at_estimate(part=parts[record])


def _with_all_signals(records: Sequence[Record]) -> Record:
    """Return one record with the signals of all, which are of the same data: each fit kept those that it used."""
    first = records[0]
    more = {name: r[name] for r in records[1:] for name in r.signals if name not in first.signals}
    if not more:
        return first
    units = {name: r.units.get(name, "") for r in records for name in r.signals}
    return Record(first.time, {**first.signals, **more}, units, first.name, first.source, first.checksum)


def not_held_out(fits: Sequence[Fit], labels: Sequence[str], records: Sequence[Record]) -> list[str]:
    """Say which of the records given as held out a fit was made with after all."""
    return [
        f"warning: {record.name or 'a record'} is not held out: {label} was fitted to samples of it."
        for record in records
        for fit, label in zip(fits, labels, strict=True)
        if any(share_samples(part.data, record) for part in fit.records)
    ]
