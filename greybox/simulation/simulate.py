"""Simulation and prediction of records with a model at one estimate."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.compiled.sampled_data import gapless
from greybox.data.record import Record
from greybox.data.text_table import counted
from greybox.modeling.integrators import Integrator, RungeKutta
from greybox.modeling.model import Model, require_known
from greybox.simulation.model_at_estimate import Estimate, Inputs, ModelAtEstimate, model_at
from greybox.simulation.prediction import Prediction
from greybox.simulation.simulator import DIVERGED, ERROR, Found, Runner, has_left
from greybox.simulation.windows import Windows, cut, default_length, require_lengths

Array = NDArray[np.float64]
GROWN = 1e6  # before a value that is not finite: what has grown so far is unstable, in SI units
USUAL = 0.5  # s: shortest default of a horizon and a lead-in


def simulate(
    model: Model | Estimate,
    values: Mapping[str, float] | Estimate | None = None,
    record: Record | None = None,
    *,
    initial: Mapping[str, ArrayLike] | None = None,
    inputs: Inputs | None = None,
    integrator: Integrator | None = None,
    part: int | None = None,
) -> Record:
    """Simulate a model freely with the inputs of a record: no measured output is looked at.

    Parameters
    ----------
    model : Model or Fit
        A transfer function is realized as states. A `Fit` stands for its model and its estimate.
    values : mapping of name to value, or Fit
        Parameters that a mapping leaves out have their declared starts; ``<signal>_bias`` is the constant error of a
        sensor. A `Fit` also gives covariance, biases, and how its inputs ran.
    record : Record
        With all inputs; by default that of the fit.
    initial : mapping of state to value, or to one value for each stretch without a gap
        Other states begin at zero. By default those of the fit where the record is its own, else zero.
    inputs : "linear" or "held", optional
        How inputs run between samples; by default as in the fit, else "linear".
    integrator : Integrator, optional
        `RungeKutta()` or, for stiff models, `Rosenbrock()`; substeps are halved until that changes no state by more
        than 1e-7 of its size in a sample, unless it says how many.
    part : int, optional
        Which part of the fit is meant; by default its first record.

    Returns
    -------
    Record
        At the times of `record`: the outputs as their sensors show them (biases included), then the states that do not
        bear the name of an output; NaN where an input is missing. A gap begins a new simulation. With a `Fit` also
        ``<output>_error``: the standard error of an output, of the parameters to first order; of the initial states
        only where they are those of the fit; NaN where an unstable model runs too long to tell these. A parameter at
        its bound counts as exact, as in the errors of the fit; an output that depends on a parameter which the data of
        the fit do not determine has NaN, and the name of the record says which. The noise of the sensors is not in it.

    Raises
    ------
    ValueError
        If an input is missing, the samples are not uniform, or the simulation leaves all bounds or the values in which
        the model's formulas are finite.
    """
    at = model_at(model, values, inputs=inputs, part=part)
    record = _record(record, at)
    _require(record, at)
    outputs = at.system.outputs
    stretches = gapless(record, at.system.inputs, ())
    if not stretches:
        raise ValueError(f"{record.name or 'the record'} has no two samples in a row with all inputs.")
    given = None if initial is None else _checked(initial, at, len(stretches))
    own = initial is None and _is_own(record, at)
    columns = {name: np.full(len(record), np.nan) for name in _columns(at)}
    solver = Runner(at, at.free_running(), outputs, integrator or RungeKutta())
    unknown: dict[str, None] = {}
    for k, stretch in enumerate(stretches):
        start = _initial(at, given, k, own)
        found, some = solver.free_run(stretch, start, own)
        unknown |= dict.fromkeys(some)
        rows = stretch.first + np.arange(len(stretch))
        _require_bounded(found, record.time[rows], at)
        for name, found_values in found.items():
            if name in columns:
                columns[name][rows] = found_values
    units = {n: record.units[n.removesuffix(ERROR)] for n in columns if n.removesuffix(ERROR) in record.units}
    said = f", {_not_known(tuple(unknown), at)}" if unknown else ""
    return Record(record.time, columns, units, name=f"simulation of {at.label}{said}")


def predict(
    model: Model | Estimate,
    values: Mapping[str, float] | Estimate | None = None,
    record: Record | None = None,
    *,
    horizon: float | None = None,
    lead: float | None = None,
    inputs: Inputs | None = None,
    integrator: Integrator | None = None,
    part: int | None = None,
) -> Prediction:
    """Predict the outputs over windows of a record, each from a state that a lead-in before it tells.

    The windows follow one another through every stretch without a gap. A free simulation of an unstable plant diverges
    whatever the model; over windows of about its time to double it shows what the model is worth. The state is the
    maximum a posteriori one (see `greybox.simulation.state_estimation`), with the noise of the fit, or, where that is
    not known, of the residuals in the lead-ins; with innovations (`PredictionError`) the lead-in corrects the states
    and the horizon does not.

    Parameters
    ----------
    horizon, lead : float, s
        Lengths of what is predicted and of what is measured before it, rounded to whole samples. By default 0.5 s or 10
        samples, whichever is longer, for the lead-in also at least twice the longest delay.

    The other parameters are those of `simulate`.

    Raises
    ------
    ValueError
        If an input or all outputs are missing, a length is shorter than a sample, no stretch is long enough, the delay
        is longer than the lead-in, or the model has no finite value in a window.
    """
    require_lengths(**{n: v for n, v in (("horizon", horizon), ("lead", lead)) if v is not None})
    at = model_at(model, values, inputs=inputs, part=part)
    record = _record(record, at)
    _require(record, at)
    horizon = default_length([record], USUAL) if horizon is None else horizon
    lead = default_length([record], USUAL, float(np.max(at.delays, initial=0.0))) if lead is None else lead
    outputs = tuple(name for name in at.system.outputs if name in record.signals)
    if not outputs:
        raise ValueError(
            f"the record has none of the outputs of {at.label} ({', '.join(at.system.outputs)}); "
            f"it has {', '.join(record.signals)}."
        )
    windows = cut(record, at.system.inputs, outputs, lead=lead, horizon=horizon)
    prediction, _, trouble = predict_windows(at, windows, outputs, integrator)
    if trouble:
        raise ValueError(f"{trouble}: {cure('horizon')}.")
    return prediction


def predict_windows(
    at: ModelAtEstimate, windows: Windows, outputs: tuple[str, ...], integrator: Integrator | None = None
) -> tuple[Prediction, NDArray[np.bool_], str]:
    """Predict `outputs`, which the record has, over given windows: the same ones for models that are compared.

    Returns also which windows (w,) are not finite, and what is not finite there, in words without an end.
    """
    lead, horizon = windows.lead * windows.record.step, windows.horizon * windows.record.step
    if np.max(at.delays, initial=0.0) >= lead:
        raise ValueError(
            f"the delay of {at.label} is {np.max(at.delays):.3g} s and lead={lead:.3g} s does not cover it: give a "
            "longer lead."
        )
    solver = Runner(at, at.criterion, outputs, integrator or RungeKutta())
    found = solver.windows(windows)
    ahead = slice(windows.lead, None)
    prediction = Prediction(
        label=at.label,
        data=windows.record,
        inputs=at.system.inputs,
        outputs=outputs,
        states=at.system.states,
        lead=lead,
        horizon=horizon,
        rows=windows.rows[:, ahead],
        predicted=np.moveaxis(found.outputs[:, ahead], -1, 0),
        error=np.moveaxis(found.error[:, ahead], -1, 0),
        noise=found.lead_in.noise,
        trajectory=np.moveaxis(found.states[:, ahead], -1, 0),
        one_step=np.moveaxis(found.one_step[:, ahead], -1, 0),
        notes=(f"{_not_known(found.unknown, at)}.",) if found.unknown else (),
    )
    return prediction, found.lost, _trouble(found, windows, outputs, at)


def _trouble(found: Found, windows: Windows, outputs: tuple[str, ...], at: ModelAtEstimate) -> str:
    """Say in how many windows something is not finite, and what in the first one, where and after which states."""
    if not found.lost.any():
        return ""
    first = int(np.argmax(found.lost))
    states, values = found.states[first], found.outputs[first]
    names = (*at.system.states, *outputs)
    lost = ~np.isfinite(np.hstack([states, values]))
    when = int(np.argmax(lost.any(axis=1)))
    what = names[int(np.argmax(lost[when]))] if lost.any() else "how the outputs follow from its states"
    place = "within its lead-in" if when < windows.lead else "beyond its lead-in"
    return (
        f"{at.label} is not finite in {counted(int(found.lost.sum()), 'window')} of {len(windows)}: {what} at "
        f"{windows.record.time[windows.rows[first, when]]:.6g} s, {place}{_after(at, states, when)}"
    )


def _after(at: ModelAtEstimate, states: Array, when: int) -> str:
    """Say which states (samples, n) were the last ones before a sample."""
    last = states[max(when - 1, 0)]
    said = ", ".join(f"{name} = {value:.4g}" for name, value in zip(at.system.states, last, strict=True))
    return f", {'after' if when else 'where'} {said}" if said else ""


def cure(called: str) -> str:
    """Say what helps where a model is not finite in a window; the user knows the horizon as `called`."""
    return (
        f"give a shorter {called} where the model is unstable, or keep its formulas within what they are defined for, "
        "e.g. gb.sqrt(gb.maximum(x.level, 0))"
    )


def _not_known(unknown: tuple[str, ...], at: ModelAtEstimate) -> str:
    """Say why an error is not known."""
    return (
        f"the errors of {at.label} are not known where they depend on {', '.join(unknown)}, which the data of the fit "
        "do not determine"
    )


def _record(record: Record | None, at: ModelAtEstimate) -> Record:
    if record is None and at.part is None:
        raise TypeError("record is missing: give the Record whose inputs are to drive the model.")
    record = at.part.data if record is None and at.part is not None else record
    if not isinstance(record, Record):
        raise TypeError(f"record is {record!r:.80}: give one Record; for several, call it for each.")
    return record


def _require(record: Record, at: ModelAtEstimate) -> None:
    missing = [name for name in at.system.inputs if name not in record.signals]
    if missing:
        raise ValueError(
            f"{at.label} needs the input {missing[0]!r}, which the record does not have; "
            f"it has {', '.join(record.signals) or 'none'}."
        )


def _require_bounded(found: Mapping[str, Array], time: Array, at: ModelAtEstimate) -> None:
    bad = has_left({name: values for name, values in found.items() if not name.endswith(ERROR)})
    if not bad.any():
        return
    when = int(np.argmax(bad))
    states = np.array([found[name] for name in at.system.states]).T.reshape(len(time), -1)
    before = _after(at, states, when)
    if any(abs(values[max(when - 1, 0)]) > GROWN or np.isfinite(values[when]) for values in _lost(found, when)):
        raise ValueError(
            f"the simulation of {at.label} leaves all bounds at {time[when]:.6g} s{before}: the model is unstable at "
            "this estimate; predict it over windows instead, gb.predict(..., horizon=...)."
        )
    name = next(name for name, values in found.items() if not np.isfinite(values[when]))
    raise ValueError(
        f"the simulation of {at.label} is not finite from {time[when]:.6g} s on, {name} first{before}: keep its "
        "formulas within what they are defined for, e.g. gb.sqrt(gb.maximum(x.level, 0)), or give other initial states."
    )


def _lost(found: Mapping[str, Array], when: int) -> list[Array]:
    """Return the signals that have left at a sample."""
    return [v for n, v in found.items() if not n.endswith(ERROR) and not abs(v[when]) < DIVERGED]


def _columns(at: ModelAtEstimate) -> list[str]:
    outputs = at.system.outputs
    errors = [] if at.covariance is None else [name + ERROR for name in outputs]
    return list(dict.fromkeys((*outputs, *errors, *at.system.states)))


def _is_own(record: Record, at: ModelAtEstimate) -> bool:
    """Tell whether the record is the one that the values were fitted to."""
    return at.part is not None and (
        record is at.part.data
        or (record.checksum == at.part.data.checksum and np.array_equal(record.time, at.part.data.time))
    )


def _checked(initial: Any, at: ModelAtEstimate, stretches: int) -> dict[str, Array]:
    """Return the initial states that a user gives, one value or one for each stretch."""
    if not isinstance(initial, Mapping):
        raise TypeError(f"initial is {initial!r:.60}: give {{state: value}}.")
    require_known(initial, at.system.states, "state", at.label)
    result = {}
    for name, value in initial.items():
        try:
            values = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            values = np.array([np.nan])
        if not np.all(np.isfinite(values)):
            raise ValueError(f"initial gives {name!r} the value {value!r:.60}: give a finite number.")
        if values.ndim != 1 or values.size not in (1, stretches):
            raise ValueError(
                f"initial gives {name!r} {values.size} values and the record has "
                f"{counted(stretches, 'stretch', 'stretches')} without a gap: give one value, or one for each."
            )
        result[name] = values
    return result


def _initial(at: ModelAtEstimate, initial: Mapping[str, Array] | None, k: int, own: bool) -> Array:
    """Return the states (n,) at the beginning of the k-th stretch."""
    given: Mapping[str, Array] = at.part.initial if own and at.part is not None else initial or {}
    values = [given.get(name, np.zeros(1)) for name in at.system.states]
    return np.array([value[k] if value.size > 1 else value[0] for value in values], dtype=float)
