"""The plain values that an answer keeps of a record and of what was asked of it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.record_part import Path, Place, RecordPart
from greybox.data.record import Record
from greybox.estimate.result import FittedRecord
from greybox.formulation.criterion import AnyCriterion
from greybox.formulation.problem import Problem
from greybox.modeling.model import equation
from greybox.modeling.model_reference import reference, source_text
from greybox.solve.gauss_newton.driver import Profile


def criterion_values(criterion: AnyCriterion) -> dict[str, Any]:
    """Return what identifies a criterion in an answer, in plain values."""
    return {
        "criterion": criterion.name,
        "criterion_class": criterion.class_path,
        "settings": criterion.settings,
        "is_likelihood": criterion.is_likelihood,
    }


def stated(part: Problem) -> dict[str, Any]:
    """Return what a fitted part says about its problem, whatever the data."""
    return {
        "name": part.name,
        **criterion_values(part.criterion),
        "rule": part.criterion.description,
        "condition": part.criterion.condition,
        "delay": part.delay,
        "weight": part.weight,
        "rename": dict(part.rename),
        "tied": {name: source_text(tie) for name, tie in part.tied.items()},
        "constraints": tuple(source_text(constraint) for constraint in part.constraints),
        "model": reference(part.model),
        "label": part.model.label,
        "equation": equation(part.model),
    }


def fitted_record(nlp: Nlp, part: Problem, profile: Profile | None) -> FittedRecord:
    """Return the record of a problem with the outputs at the states of `profile`; NaN without one."""
    k = next(i for i, record in enumerate(nlp.records) if record.part is part)
    record = nlp.records[k]
    nodes = profile.paths[k].nodes if profile else np.full((record.experiment.segments, record.states), np.nan)
    outputs = _simulated(record, profile.paths[k], profile.places[k]) if profile else None
    data = record.record
    used = [*record.system.inputs, *record.outputs]
    kept = Record(
        data.time,
        {name: data[name] for name in used},
        units={name: data.units[name] for name in used if name in data.units},
        name=data.name,
        source=data.source,
        checksum=data.checksum,
    )
    signals = {name: np.full(len(data), np.nan) for name in record.outputs}
    if outputs is not None:
        for stretch, values in zip(record.experiment.stretches, record.experiment.unpadded(outputs), strict=True):
            rows = stretch.first + np.arange(len(stretch))
            for name, row, measured in zip(record.outputs, values, stretch.outputs, strict=True):
                left_out = np.isfinite(data[name][rows]) & ~np.isfinite(measured)
                signals[name][rows] = np.where(left_out, np.nan, row)
    count = len(record.outputs)
    noise = record.noise.covariance(profile.paths[k].products) if profile else np.full((count, count), np.nan)
    return FittedRecord(
        **stated(part),
        data=kept,
        simulated=Record(data.time, signals, units=kept.units, name=part.model.label),
        outputs=record.outputs,
        noise=noise,
        initial={name: nodes[record.first, i].copy() for i, name in enumerate(record.system.states)},
        method=record.words,
        inputs=record.criterion.inputs,
        biases=tuple(record.criterion.biases),
        gains=record.criterion.gains(part.model, record.outputs),
        nuisances=record.unknown_initial + _noise_unknowns(record),
    )


def _noise_unknowns(record: RecordPart) -> int:
    count = len(record.outputs)
    if record.noise.known is not None:
        return 0
    return count * (count + 1) // 2 if record.noise.full else count


def _simulated(record: RecordPart, path: Path, place: Place) -> NDArray[np.float64]:
    return record.shooting.in_order(record.shooting.outputs(path.states, place.q, place.data))
