"""Simulation and prediction of records with a model at one estimate."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.answer import Fit
from greybox.case import Case, Inputs, case
from greybox.experiment import gapless
from greybox.integrator import Integrator, RungeKutta
from greybox.model import Model, require_known
from greybox.prediction import Prediction
from greybox.record import Record
from greybox.runner import ERROR, Runner, has_left
from greybox.table import counted
from greybox.windows import Windows, cut, require_lengths

Array = NDArray[np.float64]


def simulate(
    model: Model | Fit,
    estimate: Mapping[str, float] | Fit | None = None,
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
    estimate : mapping of name to value, or Fit
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
        only where they are those of the fit; NaN where an unstable model runs too long to tell these. The noise of the
        sensors is not in it.

    Raises
    ------
    ValueError
        If an input is missing, the samples are not uniform, or the simulation leaves all bounds.
    """
    at = case(model, estimate, inputs=inputs, part=part)
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
    for k, stretch in enumerate(stretches):
        start = _initial(at, given, k, own)
        found = solver.free_run(stretch, start, own)
        rows = stretch.first + np.arange(len(stretch))
        _require_bounded(found, record.time[rows], at)
        for name, values in found.items():
            if name in columns:
                columns[name][rows] = values
    units = {n: record.units[n.removesuffix(ERROR)] for n in columns if n.removesuffix(ERROR) in record.units}
    return Record(record.time, columns, units, name=f"simulation of {at.label}")


def predict(
    model: Model | Fit,
    estimate: Mapping[str, float] | Fit | None = None,
    record: Record | None = None,
    *,
    horizon: float = 0.5,
    lead: float = 0.5,
    inputs: Inputs | None = None,
    integrator: Integrator | None = None,
    part: int | None = None,
) -> Prediction:
    """Predict the outputs over windows of a record, each from a state that a lead-in before it tells.

    The windows follow one another through every stretch without a gap. A free simulation of an unstable plant diverges
    whatever the model; over windows of about its time to double it shows what the model is worth. The state is the
    maximum a posteriori one (see `greybox.lead_in`), with the noise of the fit, or, where that is not known,
    of the residuals in the lead-ins; with innovations (`PredictionError`) the lead-in corrects the states and the
    horizon does not.

    Parameters
    ----------
    horizon, lead : float, s
        Lengths of what is predicted and of what is measured before it.

    The other parameters are those of `simulate`.

    Raises
    ------
    ValueError
        If an input or all outputs are missing, no stretch is long enough, the delay is longer than the lead-in, or the
        model runs away within a window.
    """
    require_lengths(horizon=horizon, lead=lead)
    at = case(model, estimate, inputs=inputs, part=part)
    record = _record(record, at)
    _require(record, at)
    outputs = tuple(name for name in at.system.outputs if name in record.signals)
    if not outputs:
        raise ValueError(
            f"the record has none of the outputs of {at.label} ({', '.join(at.system.outputs)}); "
            f"it has {', '.join(record.signals)}."
        )
    windows = cut(record, at.system.inputs, outputs, lead=lead, horizon=horizon)
    return predict_windows(at, windows, outputs, lead, horizon, integrator)


def predict_windows(
    at: Case,
    windows: Windows,
    outputs: tuple[str, ...],
    lead: float,
    horizon: float,
    integrator: Integrator | None = None,
    called: str = "horizon",
) -> Prediction:
    """Predict `outputs`, which the record has, over given windows: the same ones for models that are compared.

    The user knows the horizon as `called`.
    """
    if np.max(at.delays, initial=0.0) >= lead:
        raise ValueError(
            f"the delay of {at.label} is {np.max(at.delays):.3g} s and lead={lead:.3g} s does not cover it: give a "
            "longer lead."
        )
    solver = Runner(at, at.criterion, outputs, integrator or RungeKutta())
    found = solver.windows(windows)
    ahead = slice(windows.lead, None)
    if not np.all(np.isfinite(found.outputs[:, ahead])):
        raise ValueError(
            f"{at.label} runs away within {horizon:g} s of a state that its lead-in told: give a shorter {called}."
        )
    return Prediction(
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
    )


def _record(record: Record | None, at: Case) -> Record:
    if record is None and at.part is None:
        raise TypeError("record is missing: give the Record whose inputs are to drive the model.")
    record = at.part.data if record is None and at.part is not None else record
    if not isinstance(record, Record):
        raise TypeError(f"record is {record!r:.80}: give one Record; for several, call it for each.")
    return record


def _require(record: Record, at: Case) -> None:
    missing = [name for name in at.system.inputs if name not in record.signals]
    if missing:
        raise ValueError(
            f"{at.label} needs the input {missing[0]!r}, which the record does not have; "
            f"it has {', '.join(record.signals) or 'none'}."
        )


def _require_bounded(found: Mapping[str, Array], time: Array, at: Case) -> None:
    bad = has_left({name: values for name, values in found.items() if not name.endswith(ERROR)})
    if bad.any():
        raise ValueError(
            f"the simulation of {at.label} leaves all bounds at {time[np.argmax(bad)]:.6g} s: the model is unstable at "
            "this estimate; predict it over windows instead, gb.predict(..., horizon=0.5)."
        )


def _columns(at: Case) -> list[str]:
    outputs = at.system.outputs
    errors = [] if at.covariance is None else [name + ERROR for name in outputs]
    return list(dict.fromkeys((*outputs, *errors, *at.system.states)))


def _is_own(record: Record, at: Case) -> bool:
    """Tell whether the record is the one that the values were fitted to."""
    return at.part is not None and (
        record is at.part.data
        or (record.checksum == at.part.data.checksum and np.array_equal(record.time, at.part.data.time))
    )


def _checked(initial: Any, at: Case, stretches: int) -> dict[str, Array]:
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


def _initial(at: Case, initial: Mapping[str, Array] | None, k: int, own: bool) -> Array:
    """Return the states (n,) at the beginning of the k-th stretch."""
    given: Mapping[str, Array] = at.part.initial if own and at.part is not None else initial or {}
    values = [given.get(name, np.zeros(1)) for name in at.system.states]
    return np.array([value[k] if value.size > 1 else value[0] for value in values], dtype=float)
