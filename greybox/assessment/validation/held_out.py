"""Predictions of the same windows by all fits, on their own data and on held-out records."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.result import Fit, Fits
from greybox.assessment.simulation.model_at_estimate import ModelAtEstimate
from greybox.assessment.simulation.prediction import Prediction, cut, default_length
from greybox.assessment.simulation.simulate import cure, predict_windows
from greybox.data.files.arrays import Array, BoolArray
from greybox.data.files.grouping import unique
from greybox.data.files.wording import counted
from greybox.data.record import Record, share_samples
from greybox.data.signal_faults import record_faults

Predictions = tuple[tuple[Prediction, ...], ...]
"""Predictions by every fit, of every record."""


def window_lengths(
    fits: Fits, records: Sequence[Record], window: float | None, lead: float | None
) -> tuple[float, float]:
    """Return the lengths of window and lead in s for these records; NaN without time."""
    records = [record for record in records if record.has_time]
    if not records:
        return math.nan, math.nan

    # One second is twenty time constants of a rotor: long enough for the dynamics, and short enough
    # for the prediction of an unstable plant. Half a second is enough to estimate the state.
    if window is None:
        window = default_length(records, 1.0)
    if lead is None:
        models = [fit.at_estimate() for fit in fits]
        models += [_own_model(fit, k) for fit in fits for k in range(len(fit.records))]
        longest_delay = max(float(np.max(model.delays, initial=0.0)) for model in models)
        lead = default_length(records, 0.5, longest_delay)
    return window, lead


def predict_same_windows(
    fits: Fits,
    labels: Sequence[str],
    data: Sequence[Sequence[Record]],
    lengths: tuple[float, float],
    *,
    fitted: bool,
) -> tuple[Predictions, list[str]]:
    """Predict the records of `data`, in the same order for every fit, over the same windows.

    If they are not the records of the `fitted` data, every fit first estimates the values that
    belong to one record, see `greybox.predict`. Returns the predictions, and notes on windows that
    were left out and on these values.
    """
    window, lead = lengths
    by_record: list[list[Prediction]] = []
    notes: list[str] = []
    for k in range(len(data[0])):
        record = with_all_signals([records[k] for records in data])
        models = [_own_model(fit, k) if fitted else fit.at_estimate(record=record) for fit in fits]
        inputs = unique(name for model in models for name in model.system.inputs)
        outputs = shared_outputs(models, record)
        windows = cut(record, inputs, outputs, lead=lead, horizon=window, called="window")
        results = [predict_windows(model, windows) for model in models]
        predictions, record_notes = where_all_are_finite(results, labels)
        by_record.append(predictions)
        notes += record_notes
        if not fitted:
            notes += _notes_with_labels(predictions, labels)
    return tuple(zip(*by_record, strict=True)), notes


def _notes_with_labels(predictions: Sequence[Prediction], labels: Sequence[str]) -> list[str]:
    """Return the notes of the predictions by all fits, each with the label of its fit."""
    notes = []
    for label, prediction in zip(labels, predictions, strict=True):
        for text in prediction.notes:
            # A note on standard errors names its model itself.
            has_label = text.startswith("the standard errors")
            notes.append(text if has_label else f"{label}: {text}")
    return notes


def shared_outputs(models: Sequence[ModelAtEstimate], record: Record) -> tuple[str, ...]:
    """Return the outputs of all models that the record has; ValueError if there are none."""
    shared = models[0].system.outputs
    for model in models[1:]:
        shared = [name for name in shared if name in model.system.outputs]
    outputs = tuple(name for name in shared if name in record.signals)
    if not outputs:
        raise ValueError(
            f"{record.name or 'the record'} has no output that all fits have "
            f"({', '.join(shared) or 'none'}); it has {', '.join(record.signals)}."
        )
    return outputs


def where_all_are_finite(
    results: Sequence[tuple[Prediction, BoolArray, str]], labels: Sequence[str]
) -> tuple[list[Prediction], list[str]]:
    """Return the predictions in the windows in which all are finite, and a note on the others.

    Each result is what `predict_windows` returns: a prediction, a mark of the windows (w,) that are
    not finite, and the reason.
    """
    # Such windows are left out for all models: otherwise the one that diverges would be judged by
    # easier windows.
    predictions, not_finite, texts = zip(*results, strict=True)
    is_lost = np.any(not_finite, axis=0)
    if not is_lost.any():
        return list(predictions), []

    reasons = []
    for label, reason in zip(labels, texts, strict=True):
        if reason:
            reasons.append(reason if reason.startswith(label) else f"{label}: {reason}")
    first = predictions[0]
    count = int(is_lost.sum())
    title = first.data.name or "the record"
    windows = f"{counted(count, first.window)} of {is_lost.size} in {title}"
    if 2 * count >= is_lost.size:
        raise ValueError(
            f"no comparison is possible where {windows} {'is' if count == 1 else 'are'} not finite "
            f"({reasons[0]}): {cure('window')}."
        )
    note = (
        f"warning: {windows} left out for all models, since the prediction of one is not finite "
        f"({reasons[0]})."
    )
    return [prediction.kept(~is_lost) for prediction in predictions], [note]


def _own_model(fit: Fit, record: int) -> ModelAtEstimate:
    """Return the model of a fit for its k-th record."""
    return fit.at_estimate(part=fit.parts.index(fit.records[record]))


def with_all_signals(records: Sequence[Record]) -> Record:
    """Return one record with the signals of all: each fit stores only those that it used."""
    signals: dict[str, Array] = {}
    units: dict[str, str] = {}
    hold: dict[str, float] = {}
    # The values of a signal are those of the first record that has it.
    for record in reversed(records):
        signals |= record.signals
    for record in records:
        units |= {name: record.units.get(name, "") for name in record.signals}
        hold |= record.hold
    return replace(records[0], signals=signals, units=units, hold=hold)


def damaged(fits: Fits, records: Sequence[Record]) -> list[str]:
    """Return a warning for every fault of a held-out record, see `greybox.data.signal_faults`."""
    models = [fit.model_of() for fit in fits if records]
    outputs = unique(name for model in models for name in model.output_names)
    inputs = unique(name for model in models for name in model.input_names)
    return [
        f"warning: in {record.name or 'a record'}, {fault}"
        for record in records
        for fault in record_faults(
            record,
            [name for name in outputs if name in record.signals],
            [name for name in inputs if name in record.signals],
        )
    ]


def not_held_out(fits: Fits, labels: Sequence[str], records: Sequence[Record]) -> list[str]:
    """Return a warning for every held-out record to which a fit was made after all."""
    warnings = []
    for record in records:
        for fit, label in zip(fits, labels, strict=True):
            if any(share_samples(part.data, record) for part in fit.records):
                warnings.append(
                    f"warning: {record.name or 'a record'} is not held out: {label} was fitted to "
                    "samples of it."
                )
    return warnings
