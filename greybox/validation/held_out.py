"""Predictions of several fits on their own data and on held-out records, over windows in which all are finite."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.data.record import Record, share_samples
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.arrays import BoolArray
from greybox.files.text_table import counted
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.prediction import Prediction
from greybox.simulation.simulate import cure, predict_windows
from greybox.simulation.windows import cut, default_length

Predictions = tuple[tuple[Prediction, ...], ...]
"""Of every fit, of every record."""

# s, the shortest defaults: a choice, printed with every comparison. A second is twenty time
# constants of a rotor, so that the dynamics are seen, and short enough for an unstable plant; half
# of that is enough to estimate its state.
SHORTEST_WINDOW = 1.0
SHORTEST_LEAD = 0.5


def window_lengths(
    fits: Sequence[Fit], records: Sequence[Record], window: float | None, lead: float | None
) -> tuple[float, float]:
    """Return window and lead-in in s, by default as records in time and delays ask for; NaN without such records."""
    records = [record for record in records if record.has_time]
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
    fitted: bool,
    own: Sequence[str] | None = None,
) -> tuple[Predictions, list[str]]:
    """Predict the records of `data` (of every fit, in the same order) by all fits over the same windows.

    With `fitted` they are the records that each was fitted to, and the k-th is predicted with what
    that part assumed. On others each estimates values of the record's own, by default those of its
    fit, else those named `own` that it has, see `greybox.predict`. Returns the predictions, and in
    words which windows were left out and what was estimated.
    """
    window, lead = lengths
    by_record: list[list[Prediction]] = []
    notes: list[str] = []
    for k in range(len(data[0])):
        record = _with_all_signals([records[k] for records in data])
        models = [_own_model(fit, k) if fitted else fit.at_estimate(record=record) for fit in fits]
        inputs = dict.fromkeys(name for model in models for name in model.system.inputs)
        outputs = _shared_outputs(models, record)
        windows = cut(record, tuple(inputs), outputs, lead=lead, horizon=window, called="window")

        owns = [() if fitted else _own(model, own) for model in models]
        results = [
            predict_windows(m, windows, outputs, own=names)
            for m, names in zip(models, owns, strict=True)
        ]
        predictions, note = _where_all_are_finite(results, labels)
        by_record.append(predictions)
        notes += note
        if not fitted:
            notes += [
                said if said.startswith("the standard errors") else f"{label}: {said}"
                for label, made in zip(labels, predictions, strict=True)
                for said in made.notes
            ]
    return tuple(zip(*by_record, strict=True)), notes


def _own(model: ModelAtEstimate, names: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return those of the named values that a model has; None for its own where none are named."""
    if names is None:
        return None
    possible = {
        *model.names,
        *(f"{signal}_bias" for signal in (*model.system.outputs, *model.system.inputs)),
    }
    return tuple(name for name in names if name in possible)


def require_own(fits: Sequence[Fit], own: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the names of values that are to be estimated from held-out records, each of which some model must have.

    Raises
    ------
    ValueError
        For a name that none has.
    """
    if own is None:
        return None
    names = (own,) if isinstance(own, str) else tuple(own)
    models = [fit.at_estimate() for fit in fits]
    unknown = [name for name in names if not any(_own(model, (name,)) for model in models)]
    if unknown:
        known = dict.fromkeys(name for model in models for name in model.names)
        raise ValueError(
            f"own names {unknown[0]!r}, which no fit has; they have {', '.join(known)}, and a bias of any signal."
        )
    return names


def _shared_outputs(models: Sequence[ModelAtEstimate], record: Record) -> tuple[str, ...]:
    shared = [
        name
        for name in models[0].system.outputs
        if all(name in model.system.outputs for model in models)
    ]
    outputs = tuple(name for name in shared if name in record.signals)
    if not outputs:
        raise ValueError(
            f"{record.name or 'the record'} has no output that all fits have ({', '.join(shared) or 'none'}); "
            f"it has {', '.join(record.signals)}."
        )
    return outputs


def _where_all_are_finite(
    results: Sequence[tuple[Prediction, BoolArray, str]], labels: Sequence[str]
) -> tuple[list[Prediction], list[str]]:
    """Return the predictions in the windows in which all are finite, and a note on the windows left out.

    Of every fit come its prediction, which windows diverged (w,), and why.
    """
    diverged = np.any([lost for _, lost, _ in results], axis=0)
    if not diverged.any():
        return [prediction for prediction, _, _ in results], []

    label, reason = next(
        (label, why) for label, (_, _, why) in zip(labels, results, strict=True) if why
    )
    reason = reason if reason.startswith(label) else f"{label}: {reason}"
    record = results[0][0].data.name or "the record"
    count = int(diverged.sum())
    window = results[0][0].window
    if 2 * count >= diverged.size:
        raise ValueError(
            f"no comparison is possible where {counted(count, window)} of {diverged.size} in {record} "
            f"{'is' if count == 1 else 'are'} not finite ({reason}): {cure('window')}."
        )
    note = (
        f"warning: {counted(count, window)} of {diverged.size} in {record} left out for all models, since the "
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
    hold = {name: seconds for r in records for name, seconds in r.hold.items()}
    return replace(first, signals={**first.signals, **more}, units=units, hold=hold)


def not_held_out(
    fits: Sequence[Fit], labels: Sequence[str], records: Sequence[Record]
) -> list[str]:
    """Say which of the records given as held out a fit was made with after all."""
    return [
        f"warning: {record.name or 'a record'} is not held out: {label} was fitted to samples of it."
        for record in records
        for fit, label in zip(fits, labels, strict=True)
        if any(share_samples(part.data, record) for part in fit.records)
    ]
