"""The model of a fit at its estimate, with covariance and assumptions, to be run on records."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from greybox.assessment.fitted_part import FittedPart, FittedRecord
from greybox.assessment.simulation.model_at_estimate import ModelAtEstimate, criterion_of
from greybox.data.files.argument_checks import require_whole
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import array_of
from greybox.data.files.wording import counted
from greybox.data.record import Record, share_samples
from greybox.modeling.formulation.input_assumptions import Inputs
from greybox.modeling.formulation.restated_parameter import restated
from greybox.modeling.formulation.signal_bias import bias_name
from greybox.modeling.model import Model
from greybox.modeling.model_reference import reference
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import dynamics


def at_estimate(fit: Any, model: Model, part: FittedPart, inputs: Inputs | None) -> ModelAtEstimate:
    """Return a model with the values, covariance and assumptions that a `Fit` has for a part.

    Raises
    ------
    ValueError
        If the fit has no value for a parameter of the model.
    """
    record = part if isinstance(part, FittedRecord) else None
    biases: tuple[str, ...] = ()
    gains: tuple[tuple[str, str], ...] = ()
    if record is not None:
        biases, gains = record.biases, record.gains
    if inputs is None:
        inputs = "record" if record is None else record.inputs

    names = [*model.parameters]
    names += [bias_name(signal) for signal in biases]
    names += [f"K_{state}_{output}" for state, output in gains]
    # Names of these values in the fit, which a problem may rename.
    outside = {name: part.outside(name) for name in names}
    estimated = [part.outside(name) for name in (*model.parameters, *part.added)]

    for name in estimated:
        if name not in fit.estimate:
            raise ValueError(
                f"the fit has no {name!r}, which {model.label} needs; it has "
                f"{', '.join(fit.estimate)}: "
                "give the model that was fitted, or the values as {name: value}."
            )

    values = array_of(fit.estimate, estimated)
    covariance = _covariance(fit, estimated)

    # With process noise the gains are not parameters: they follow from the variances of the noise.
    if record is not None and record.gain is not None and record.gain_slope is not None:
        # `names` has parameters and biases, then gains; `estimated` has the same parameters and
        # biases, then variances. The fit has the derivatives of the gains by all of `estimated`.
        count = len(names) - len(gains)
        values = np.concatenate([values[:count], record.gain])
        slope = np.vstack([np.eye(count, len(estimated)), record.gain_slope])
        covariance = propagated(slope, covariance)

    # Free parameters have the bounds that the problem set.
    by_name = fit.by_name
    declared = {}
    for name, parameter in model.parameters.items():
        quantity = by_name[outside[name]]
        is_free = quantity.kind == "free"
        declared[name] = restated(name, parameter, bounds=quantity.bounds) if is_free else parameter

    return ModelAtEstimate(
        label=model.label,
        system=dynamics(model, delay_order(part.delay)),
        names=tuple(names),
        q=values,
        covariance=covariance,
        criterion=criterion_of(inputs, biases, gains),
        part=record,
        declared=declared,
        own=() if record is None else tuple(_own_names(fit, model, record, outside)),
    )


def _covariance(fit: Any, names: Sequence[str]) -> Array:
    """Return the covariance of estimates, zero for parameters whose bound is active."""
    # Standard errors of the fit count such a parameter as known. Predictions must do the same, or
    # their bands would contain an error that no parameter of the fit has.
    quantities = [fit.by_name[name] for name in names]
    is_known = np.array([q.kind == "free" and q.at_bound for q in quantities], dtype=bool)
    if fit.directions is not None:
        is_known &= fit.known_directions(names).is_known
    return np.where(is_known | is_known[:, None], 0.0, fit.covariance_of(names))


def propagated(slope: Array, covariance: Array) -> Array:
    """Return the covariance (m, m) of values with the derivatives `slope` (m, k); NaN stays NaN."""
    # NaN times a slope of zero would be NaN, although the result does not depend on that value.
    unknown = np.isnan(np.diag(covariance))
    result = slope @ np.where(unknown | unknown[:, None], 0.0, covariance) @ slope.T
    lost = (slope[:, unknown] != 0).any(axis=1)
    return np.where(lost | lost[:, None], np.nan, result)


def _own_names(
    fit: Any, model: Model, part: FittedRecord, outside: Mapping[str, str]
) -> Iterator[str]:
    """Yield the free values that belong to one record alone, by their names in the model.

    These are biases, unless records share them under one name, and parameters that have another
    name in other records.
    """
    # An excerpt of the same record is not another record: it shares the biases of its flight.
    same_model = [
        record
        for record in fit.records
        if _class_name(record.model) == _class_name(part.model)
        and not share_samples(record.data, part.data)
    ]
    biases = [bias_name(signal) for signal in part.biases]
    for name, known_as in outside.items():
        elsewhere = [record.outside(name) for record in same_model]
        if name in model.parameters:
            is_own = any(name_there != known_as for name_there in elsewhere)
        else:
            is_own = name in biases and known_as not in elsewhere
        if is_own and known_as in fit.free:
            yield name


def part_index(fit: Any, model: Model | None, part: int | None, record: Record | None) -> int:
    """Return the index of a part of a `Fit`; by default the part of the record, or the first one.

    Parts of the given model come first.

    Raises
    ------
    ValueError
        If the fit does not have this part.
    """
    count = len(fit.parts)
    if part is not None:
        require_whole(f"part of a fit with {counted(count, 'part')}", part, -count, count - 1)
        return part % count

    def preference(k: int) -> tuple[bool, bool, bool]:
        # False sorts before True: the part of the record, other records, other data, priors.
        data = fit.parts[k].data
        is_record = isinstance(data, Record)
        is_of_record = is_record and record is not None and share_samples(data, record)
        return fit.parts[k].is_prior, not is_record, not is_of_record

    # sorted() is stable, so that among equals the first part is chosen.
    records_first = sorted(range(count), key=preference)
    if model is not None:
        class_name = _class_name(reference(model))
        for k in records_first:
            if _class_name(fit.parts[k].model) == class_name:
                return k

    return records_first[0]


def _class_name(model: Mapping[str, object]) -> str:
    """Return the class without its module."""
    # A file has one module name when it is imported and another one when it is run as a script.
    return re.sub(r"^.*:", "", str(model["class"]))
