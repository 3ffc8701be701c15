"""The plain values that an answer keeps of a record and of what was asked of it."""

from dataclasses import replace
from typing import Any

import numpy as np

from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.data.record import Record
from greybox.estimate.fitted_part import FittedRecord
from greybox.files.arrays import Array
from greybox.formulation.criterion import AnyCriterion
from greybox.formulation.problem import Problem
from greybox.modeling.model import equation
from greybox.modeling.model_reference import reference, source_text


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
        "condition": part.criterion.condition_on(part.data),
        "delay": part.delay,
        "weight": part.weight,
        "rename": dict(part.rename),
        "tied": {name: source_text(tie) for name, tie in part.tied.items()},
        "constraints": tuple(source_text(constraint) for constraint in part.constraints),
        "model": reference(part.model),
        "label": part.model.label,
        "equation": equation(part.model),
    }


def fitted_record(part: RecordPart, trajectory: Trajectory | None) -> FittedRecord:
    """Return the record of a part with the outputs along its best trajectory; NaN without one."""
    model = part.model
    data = model.record
    used = [*part.system.inputs, *part.outputs]
    kept = Record(
        data.time,
        {name: data[name] for name in used},
        units={name: data.units[name] for name in used if name in data.units},
        name=data.name,
        source=data.source,
        checksum=data.checksum,
        hold=data.hold,
        has_time=data.has_time,
    )
    count = len(part.outputs)
    noise = np.full((count, count), np.nan)
    gain = gain_slope = None
    nodes = np.full((part.data.segments, part.states), np.nan)
    signals = {name: np.full(len(data), np.nan) for name in part.outputs}
    if trajectory is not None:
        noise = part.covariance_along(trajectory).covariance(trajectory.products)
        steady = trajectory.detail.placed.filter
        if steady is not None:
            gain = steady.gain.ravel()
            estimated = model.active[
                : steady.gain_slope.shape[-1]
            ]  # behind them the gains themselves
            gain_slope = np.zeros((gain.size, len(model.parameters) - gain.size))
            gain_slope[:, estimated] = steady.gain_slope.reshape(gain.size, -1)
        nodes = trajectory.nodes
        signals = _simulated(part, trajectory)
    return FittedRecord(
        **stated(part.problem),
        data=kept,
        simulated=replace(
            kept, signals=signals, name=part.problem.model.label, source="", checksum=""
        ),
        outputs=part.outputs,
        noise=noise,
        initial={
            name: nodes[part.data.begins_stretch, i].copy()
            for i, name in enumerate(part.system.states)
        },
        method=part.description,
        inputs=model.criterion.inputs,
        biases=tuple(model.criterion.biases),
        gains=part.gains,
        driven=model.driven,
        gain=gain,
        gain_slope=gain_slope,
        nuisances=part.unknown_initial_states
        + covariance_unknowns(
            count,
            known=part.covariance.known is not None or bool(model.driven),
            full=part.covariance.full,
        ),
        is_static=part.is_static,
    )


def _simulated(part: RecordPart, trajectory: Trajectory) -> dict[str, Array]:
    """Return the outputs at the times of the record; NaN where none was compared."""
    data = part.model.record
    signals = {name: np.full(len(data), np.nan) for name in part.outputs}
    outputs = part.data.unpadded(part.simulated_outputs(trajectory))
    for stretch, values in zip(part.data.stretches, outputs, strict=True):
        rows = stretch.rows
        for name, row, measured in zip(part.outputs, values, stretch.outputs, strict=True):
            left_out = np.isfinite(data[name][rows]) & ~np.isfinite(measured)
            signals[name][rows] = np.where(left_out, np.nan, row)
    return signals


def covariance_unknowns(outputs: int, *, known: bool, full: bool) -> int:
    """Return how many numbers of the residual covariance are estimated."""
    if known:
        return 0
    return outputs * (outputs + 1) // 2 if full else outputs
