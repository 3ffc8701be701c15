"""The values that a fit keeps of each part, from the compiled part and its best trajectory."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial, singledispatch
from typing import Any

import numpy as np

from greybox.assessment.fitted_part import FittedRecord, FittedResponse, FittedSpectrum
from greybox.assessment.pade_error import pade_error
from greybox.assessment.response_band import response_and_slope
from greybox.data.files.arrays import Array, all_finite
from greybox.data.files.named_values import Values, selected
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.compiled.part import Part, Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.transient_part import Along, TransientPart
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, equation
from greybox.modeling.model_reference import reference, source_text
from greybox.modeling.traced_once import traced_once


@singledispatch
def fitted_part(
    part: Part, trajectory: Trajectory | None, x: Array, values: Values
) -> FittedResponse | FittedRecord | FittedSpectrum:
    """Return the values of a part that are stored in an answer.

    Parameters
    ----------
    part : Part
    trajectory : Trajectory or None
        The best one; None where no run converged: the fitted values are then NaN.
    x : (k,) array
        All values of the problem.
    values : mapping of name to float
        The values of the model's parameters by its own names.
    """
    raise TypeError(f"{type(part).__name__} has no fitted part: register one here.")


@fitted_part.register
def fitted_response(
    part: ResponsePart, trajectory: Trajectory | None, x: Array, values: Values
) -> FittedResponse:
    """Return a response with the fitted one."""
    problem = part.problem
    response = part.response(x)
    fitted = FittedResponse(
        **_of_problem(problem),
        data=problem.response,
        response=response,
        curve=partial(_curve, problem.model, values, problem.sampled_hold),  # type: ignore[arg-type]
        pade_error=pade_error(problem, values) if all_finite(response) else None,
        nuisances=problem.criterion.nuisances,
    )
    if not problem.sampled_hold:
        # Curves of linear responses take a hundredth of a fit, because all responses share what is
        # traced. One by one, later, they would take a third. Those of samples are compiled, and
        # wait until they are drawn.
        _ = fitted.curve
    return fitted


@traced_once()
def _curve(
    model: Model, values: Values, hold: float, part: FittedResponse
) -> FrequencyResponse | None:
    """Return the fitted model for figures; None if an undamped resonance is on the grid."""

    def at(omega: Array) -> FrequencyResponse:
        if hold:  # samples were compared with those of the model
            return response_and_slope(model, values, omega, hold, **part.signals)[0]
        return frequency_response(model, values, omega, **part.signals)

    with contextlib.suppress(ValueError):
        return refined_curve(at, part.data.omega) if all_finite(part.response) else None
    return None


def refined_curve(
    response: Callable[[Array], FrequencyResponse], omega: Array
) -> FrequencyResponse:
    """Evaluate a response over the band of `omega` for figures, in finer steps at a resonance."""
    # 60 points draw most curves. Near a lightly damped peak the grid is refined until a step is 2 %
    # of the figure or 5 degrees of phase.
    grid = omega
    if omega.size > 1:
        grid = np.geomspace(omega.min(), omega.max(), 60)
        grid[1:-1] = _rounded(grid[1:-1], 8)
    curve = response(grid)
    values = curve.response
    for _ in range(12):
        steps = np.abs(np.diff(values))
        turns = np.abs(np.angle(values[1:] * values[:-1].conj()))
        coarse = np.flatnonzero((steps > 0.02 * np.abs(values).max()) | (turns > np.radians(5)))
        if not coarse.size or grid.size > 2000:
            break
        between = np.sqrt(grid[coarse] * grid[coarse + 1])
        values = np.insert(values, coarse + 1, response(between).response)
        grid = np.insert(grid, coarse + 1, between)

    # A figure shows four digits, and a curve of all digits is half of what a study stores. The
    # frequencies keep more: beside a resonance their steps are small.
    rounded = _rounded(values.real, 6) + 1j * _rounded(values.imag, 6)
    return replace(curve, omega=grid, response=rounded)


def _rounded(values: Array, digits: int) -> Array:
    """Return values (n,) with this number of significant digits, large ones as whole numbers."""
    # A whole number over a power of ten has the shortest text. Zero has no logarithm.
    places = digits - 1 - np.floor(np.log10(np.abs(values) + 1e-290))
    unit = 10.0 ** np.maximum(places, 0)
    return np.rint(values * unit) / unit


@fitted_part.register
def fitted_record(
    part: RecordPart, trajectory: Trajectory | None, x: Array, values: Values
) -> FittedRecord:
    """Return a record with the fitted outputs, states and noise."""
    model = part.model
    data = model.record
    used = [*part.system.inputs, *part.outputs]

    # Only signals that the fit used: a log may have hundreds, and a saved fit contains its data.
    stored = replace(
        data,
        signals={name: data[name] for name in used},
        units=selected(data.units, used),
        hold=selected(data.hold, used),
        metadata={},
        filters={},
        findings=(),
    )
    count = len(part.outputs)
    noise = np.full((count, count), np.nan)
    gain = gain_slope = None
    nodes = np.full((part.data.segments, part.states), np.nan)

    if trajectory is not None:
        noise = part.covariance_along(trajectory).covariance(trajectory.products)
        steady = trajectory.detail.filter
        if steady is not None:
            # Stored with the fit: predictions then need no Riccati equation.
            gain = steady.gain.ravel()
            # The gains depend on other parameters, and change with these.
            estimated = model.active[: steady.gain_slope.shape[-1]]
            gain_slope = np.zeros((gain.size, len(model.parameters) - gain.size))
            gain_slope[:, estimated] = steady.gain_slope.reshape(gain.size, -1)
        nodes = trajectory.nodes

    return FittedRecord(
        **_of_problem(part.problem),
        data=stored,
        simulated=replace(
            stored,
            signals=_simulated(part, trajectory),
            units=selected(stored.units, part.outputs),
            hold=selected(stored.hold, part.outputs),
            name=part.problem.model.label,
            source="",
            checksum="",
        ),
        outputs=part.outputs,
        noise=noise,
        initial=dict(zip(part.system.states, nodes[part.data.begins_stretch].T, strict=True)),
        method=(
            "no integration, since the model is static"
            if part.is_static
            else model.method.described(part.data.segment_length, part.substeps)
        ),
        inputs=model.criterion.inputs,
        biases=tuple(model.criterion.biases),
        gains=part.gains,
        driven=model.driven,
        gain=gain,
        gain_slope=gain_slope,
        # With process noise the covariance follows from its variances.
        nuisances=part.unknown_initial_states + (0 if model.driven else part.covariance.unknowns),
        is_static=part.is_static,
    )


def _simulated(part: RecordPart, trajectory: Trajectory | None) -> Mapping[str, Array]:
    """Return the outputs at the times of the record; NaN where none was compared."""
    record = part.model.record
    signals = {name: np.full(len(record), np.nan) for name in part.outputs}
    if trajectory is None:
        return signals
    outputs = part.data.unpadded(part.simulated_outputs(trajectory))
    # An output that was measured, but whose past the delay hides, was not compared.
    for stretch, values in zip(part.data.stretches, outputs, strict=True):
        for name, row, measured in zip(part.outputs, values, stretch.outputs, strict=True):
            left_out = np.isfinite(record[name][stretch.rows]) & ~np.isfinite(measured)
            compared = np.where(left_out, np.nan, row)
            signals[name][stretch.own_rows] = compared[stretch.own]
    return signals


@fitted_part.register
def fitted_spectrum(
    part: TransientPart, trajectory: Trajectory | None, x: Array, values: Values
) -> FittedSpectrum:
    """Return a spectrum with the fitted outputs and ends."""
    count = len(part.outputs)
    noise = np.full((count, count), np.nan)
    fitted = np.full((count, len(part.data)), np.nan, complex)
    ends = np.full(len(part.states), np.nan)
    nuisances = len(part.states)

    if trajectory is not None:
        at: Along = trajectory.detail
        noise = at.covariance.covariance(trajectory.products)
        fitted = at.modeled
        ends = at.ends
        nuisances += at.covariance.unknowns

    return FittedSpectrum(
        **_of_problem(part.problem),
        data=part.data,
        fitted=dict(zip(part.outputs, fitted, strict=True)),
        outputs=part.outputs,
        noise=noise,
        ends=dict(zip(part.states, ends.tolist(), strict=True)),
        nuisances=nuisances,
    )


def _of_problem(part: Problem) -> dict[str, Any]:
    """Return the fields of a fitted part that all kinds of data share."""
    return {
        "name": part.name,
        "criterion": part.criterion.name,
        "criterion_class": part.criterion.class_path,
        "settings": part.criterion.settings,
        "is_likelihood": part.criterion.is_likelihood,
        "rule": part.criterion.description,
        "condition": part.criterion.condition_on(part.data),
        "delay": part.delay,
        "at": {name: float(value) for name, value in part.at.items()},
        "weight": part.weight,
        "rename": dict(part.rename),
        "tied": {name: source_text(tie) for name, tie in part.tied.items()},
        "constraints": tuple(map(source_text, part.constraints)),
        "model": reference(part.model),
        "label": part.model.label,
        "equation": equation(part.model),
    }
