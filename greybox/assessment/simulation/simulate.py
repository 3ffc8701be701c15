"""Simulation and prediction of records with a model at one estimate."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from greybox.assessment.simulation.model_at_estimate import Estimate, ModelAtEstimate, model_at
from greybox.assessment.simulation.own_values import with_own_values
from greybox.assessment.simulation.prediction import (
    Prediction,
    Windows,
    cut,
    default_length,
    require_lengths,
    require_signals,
)
from greybox.assessment.simulation.simulator import (
    DIVERGED,
    ERROR,
    Simulator,
    WindowSimulations,
    diverged,
)
from greybox.data.files.argument_checks import as_names, require_kind
from greybox.data.files.arrays import Array, BoolArray, all_finite
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values, array_of, selected, without
from greybox.data.files.public import public
from greybox.data.files.wording import counted, some
from greybox.data.record import Record, share_samples
from greybox.engine.compiled.sampled_data import Stretch, gapless
from greybox.modeling.formulation.input_assumptions import Inputs
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import Model, require_known

# s: shortest default horizon and lead-in. The roll axis of the paper, whose unstable poles in
# (3.18) have the real part 1.7 1/s, doubles in 0.4 s.
SHORTEST = 0.5
DOMAINS = "keep its formulas within their domains, e.g. gb.sqrt(gb.maximum(x.level, 0))"


@public
def simulate(
    model: Model | Estimate,
    values: Values | Estimate | None = None,
    record: Record | None = None,
    *,
    initial: Mapping[str, ArrayLike] | None = None,
    inputs: Inputs | None = None,
    integrator: Integrator | None = None,
    part: int | None = None,
) -> Record:
    """Simulate a model freely with the inputs of a record: measured outputs are not used.

    Parameters
    ----------
    model : Model or Fit
        A transfer function is realized as states. A `Fit` gives both its model and its estimate.
    values : mapping of name to value, or Fit, optional
        Parameters that it leaves out have their declared starts; ``<signal>_bias`` is the constant
        error of a sensor. A `Fit` also gives covariance, biases, and how its inputs ran.
    record : Record
        With all inputs; by default that of the fit.
    initial : mapping of state to value, or to one value for each stretch of known inputs
        Other states begin where the model declares (`StateSpace.state_starts`), by default at
        zero; the name of the result says so. By default those of the fit where the record is its
        own.
    inputs : "record", "linear" or "held", optional
        How inputs vary between samples; by default as in the fit, else as the record says, see
        `OutputError`.
    integrator : Integrator, optional
        `RungeKutta()`, or `Radau()` for stiff models; by default as the model needs. Unless it has
        a number of substeps, they are halved until this changes no state by more than 3e-10 of its
        size in a sample, on average, and by more than 1e-6 of its largest value in a whole
        simulation (of explicit steps). A warning states a change of more than 1e-4.
    part : int, optional
        Part of the fit; by default that of `record`, else its first record.

    Returns
    -------
    Record
        At the times of `record`: the outputs as their sensors show them (with the biases of the
        fit), then the states that do not have the name of an output; NaN where an input is missing.
        A new simulation begins where the inputs are unknown, behind lost rows, see
        `greybox.data.clock`; the name of the result says so. With a `Fit` also
        ``<output>_error``, the standard error of an output, from those of the parameters (to first
        order) and of the initial states, if these are from the fit. It is NaN where an unstable
        model runs too long for that, and for an output that depends on a parameter which the data
        of the fit do not determine; the name of the record states which. A parameter that its
        bound holds is exact, as in the standard errors of the fit. The noise of the sensors is not
        included.

    Raises
    ------
    ValueError
        If an input is missing, the samples are not uniform, the simulation diverges, or a formula
        of the model is not finite.

    Examples
    --------
    >>> class Lag(gb.StateSpace):
    ...     states = outputs = ("y",)
    ...     inputs = ("u",)
    ...     T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    ...
    ...     def derivative(self, x, u, p):
    ...         return ((u.u - x.y) / p.T,)
    ...
    ...     def output(self, x, u, p):
    ...         return (x.y,)
    >>> time = np.linspace(0, 2, 201)
    >>> step = gb.Record(time, {"u": np.ones(201)}, hold={"u": np.inf})
    >>> motion = gb.simulate(Lag(), {"T": 0.5}, record=step)  # from y = 0
    >>> print(motion["y"][50].round(4))  # after one time constant
    0.6321
    """
    estimated, record = _model_and_record(model, values, record, inputs, part)
    estimated = estimated.driven_by(record)
    outputs = estimated.system.outputs

    stretches = gapless(
        record, estimated.system.inputs, (), lead=estimated.delays, held=estimated.held
    )
    # Without states and delays, samples are independent of one another. With them, a single sample
    # has no motion.
    is_static = not (estimated.system.states or estimated.system.delayed)
    fewest_samples = 1 if is_static else 2
    if max(map(len, stretches), default=0) < fewest_samples:
        what = "sample" if is_static else "two consecutive samples"
        raise ValueError(f"{record.name or 'the record'} has no {what} with all inputs.")

    fitted = estimated.part.data if estimated.part else None
    fitted_initial = initial is None and fitted is not None and fitted.is_same_as(record)
    if fitted_initial:
        stretches = _fitted_stretches(estimated, stretches)
    states = _initial_states(estimated, initial, len(stretches), fitted_initial)

    errors = [] if estimated.covariance is None else [name + ERROR for name in outputs]
    # A state with the name of an output is given once, as the sensor shows it.
    names = unique((*outputs, *errors, *estimated.system.states))
    columns = {name: np.full(len(record), np.nan) for name in names}
    simulator = Simulator(estimated, outputs, integrator)
    unknown: list[str] = []
    for stretch, start in zip(stretches, states, strict=True):
        signals, standard_errors, without_error = simulator.free_run(stretch, start, fitted_initial)
        _require_bounded(signals, stretch, record, estimated.label)
        unknown += without_error
        for name, row in {**signals, **standard_errors}.items():
            columns[name][stretch.own_rows] = row[stretch.own]
    if simulator.doubt:
        warnings.warn(simulator.doubt, stacklevel=2)

    units = {}
    for name in columns:
        signal = name.removesuffix(ERROR)
        if signal in record.units:
            units[name] = record.units[signal]

    # A user who simulates a fit expects the motion of the record, which hardly ever begins at rest.
    declared = {}
    if estimated.covariance is not None and not fitted_initial:
        declared = without(
            dict(zip(estimated.system.states, states[0], strict=True)), initial or {}
        )
    gaps = 0 if is_static else len(stretches) - 1
    title = _title(estimated, unique(unknown), declared, gaps)
    return Record(record.time, columns, units, name=title, has_time=record.has_time)


def _title(
    estimated: ModelAtEstimate, unknown: tuple[str, ...], declared: Values, gaps: int
) -> str:
    """Return the name of a simulation, with what a reader may not expect of it.

    This is: parameters without a standard error, states that begin where the model declares, and
    gaps behind which the simulation begins anew.
    """
    title = f"simulation of {estimated.label}"
    if unknown:
        title += f", {_unknown_errors(unknown, estimated)}"
    if declared:
        title += f", from {some([f'{name} = {start:.4g}' for name, start in declared.items()])}"
    if gaps > 0:
        title += f", begun anew behind {counted(gaps, 'gap')}"
    return title


def _require_bounded(
    signals: Mapping[str, Array], stretch: Stretch, record: Record, label: str
) -> None:
    """Raise ValueError for a simulation of a stretch that diverges."""
    has_diverged = diverged(signals)
    if not has_diverged.any():
        return
    when = np.argmax(has_diverged)
    # The negated comparison is also true for NaN.
    first = next(name for name, row in signals.items() if not abs(row[when]) < DIVERGED)
    raise ValueError(
        f"the simulation of {label} diverges at "
        f"{record.time[stretch.rows[when]]:.6g} s, {first} first: predict an unstable model "
        f"over windows instead of simulating it, or {DOMAINS}."
    )


@public
def predict(  # noqa: PLR0913  (as many questions as a prediction answers)
    model: Model | Estimate,
    values: Values | Estimate | None = None,
    record: Record | None = None,
    *,
    horizon: float | None = None,
    lead: float | None = None,
    inputs: Inputs | None = None,
    integrator: Integrator | None = None,
    part: int | None = None,
    own: Sequence[str] | None = None,
) -> Prediction:
    """Predict the outputs over windows of a record, each from the state that its lead-in gives.

    The windows follow one another through every stretch of known inputs, on an uneven clock by
    time; each row without a time is a window. A free simulation of an unstable plant diverges
    however good the model is. Over windows of about its time to double, prediction errors show the
    quality of the model. The first state is the maximum a posteriori one (see
    `greybox.assessment.simulation.state_estimation`), with the noise of the fit or, if unknown, of
    the residuals in the lead-ins. With innovations (`PredictionError`), the states are corrected in
    the lead-in but not in the horizon.

    If the model was not fitted to the record, values that belong to a record are estimated from it
    (see `greybox.assessment.simulation.own_values`), as `Prediction.notes` states: biases of
    sensors, parameters that each record of the fit has for itself (`several`), and those in `own`,
    such as trims.

    Parameters
    ----------
    horizon, lead : float, s
        Lengths of the predicted part and of the measured part before it, rounded to whole samples.
        By default 0.5 s (an eighth of a record of less than 4 s) or 10 samples, whichever is
        longer, for the lead-in also at least twice the longest delay. Rows have neither.
    own : sequence of str, optional
        Names of parameters, and of biases (``<signal>_bias``), to be estimated from the record. By
        default those named above, on a record that the fit does not have; with ``()``, the values
        of the fit are used.

    The other parameters are those of `simulate`, which also says how exact the integration is.

    Raises
    ------
    ValueError
        If an input or all outputs are missing, a length is shorter than a sample, no stretch is
        long enough, the delay is longer than the lead-in, or the model has no finite value in a
        window.

    Examples
    --------
    >>> class Lag(gb.StateSpace):
    ...     states = outputs = ("y",)
    ...     inputs = ("u",)
    ...     T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    ...
    ...     def derivative(self, x, u, p):
    ...         return ((u.u - x.y) / p.T,)
    ...
    ...     def output(self, x, u, p):
    ...         return (x.y,)
    >>> time = np.linspace(0, 2, 201)
    >>> step = gb.Record(time, {"u": np.ones(201)}, hold={"u": np.inf})
    >>> motion = gb.simulate(Lag(), {"T": 0.5}, record=step)
    >>> flown = gb.Record(time, {"u": step["u"], "y": motion["y"]}, hold=step.hold)
    >>> prediction = gb.predict(Lag(), {"T": 0.5}, record=flown)
    >>> prediction.rms("y") < 1e-6
    True
    """
    require_lengths(horizon=horizon, lead=lead)
    estimated, record = _model_and_record(model, values, record, inputs, part)
    horizon = horizon or default_length([record], SHORTEST)

    # Within the delay, outputs respond to inputs before the window.
    delay = float(np.max(estimated.delays, initial=0.0))
    lead = lead or default_length([record], SHORTEST, delay)
    outputs = tuple(name for name in estimated.system.outputs if name in record.signals)
    if not outputs:
        raise ValueError(
            f"the record has none of the outputs of {estimated.label} "
            f"({', '.join(estimated.system.outputs)}); it has {', '.join(record.signals)}."
        )
    windows = cut(record, estimated.system.inputs, outputs, lead=lead, horizon=horizon)
    prediction, _, trouble = predict_windows(estimated, windows, integrator, own)
    if trouble:
        raise ValueError(f"{trouble}: {cure('horizon')}.")
    return prediction


def predict_windows(
    model: ModelAtEstimate,
    windows: Windows,
    integrator: Integrator | None = None,
    own: Sequence[str] | None = None,
) -> tuple[Prediction, BoolArray, str]:
    """Predict the outputs of given windows.

    The values named by `own` are estimated first. By default they are `ModelAtEstimate.own`, if the
    record is not the one that was fitted.

    Returns
    -------
    prediction : Prediction
    not_finite : (w,) bool array
        Marks the windows in which the model is not finite.
    trouble : str
        How many these are, and where the first is lost, without a full stop; empty if none is.
    """
    model = model.driven_by(windows.record)
    lead, horizon = windows.lengths
    if windows.lead and np.max(model.delays, initial=0.0) >= lead:
        raise ValueError(
            f"the delay of {model.label} is {np.max(model.delays):.3g} s, and lead={lead:.3g} s "
            "does not cover it: give a longer lead."
        )

    if windows.repeated.any() and model.criterion.corrects_states:
        raise ValueError(
            f"{model.label} corrects its states by a constant gain, and "
            f"{windows.record.name or 'the record'} is not uniformly sampled: prepare it with "
            "rate=..., which resamples it."
        )

    # On its own record the fit has estimated these values already.
    if own is None:
        is_new = model.part is not None and not share_samples(model.part.data, windows.record)
        own = model.own if is_new else ()
    model, values, notes = with_own_values(model, windows, integrator, as_names(own))
    simulator = Simulator(model, windows.outputs, integrator)
    simulated = simulator.windows(windows, checked=True)
    if simulator.doubt:
        warnings.warn(simulator.doubt, stacklevel=3)
    error, unknown = simulator.standard_errors(simulated)
    if unknown:
        notes += (f"{_unknown_errors(unknown, model)}.",)

    is_in_record = ~(windows.repeated | windows.filled)
    is_predicted = is_in_record[:, windows.lead :]

    def ahead(values: Array) -> Array:
        """Return the values (w, samples, k) behind the lead-ins as (k, w, h), NaN between rows."""
        # Lead-ins were used for the states, and would look too good.
        later = np.moveaxis(values[:, windows.lead :], -1, 0)
        return later if is_predicted.all() else np.where(is_predicted, later, np.nan)

    prediction = Prediction(
        label=model.label,
        data=windows.record,
        inputs=model.system.inputs,
        outputs=windows.outputs,
        states=model.system.states,
        lead=lead,
        horizon=horizon,
        rows=np.where(is_predicted, windows.rows[:, windows.lead :], -1),
        predicted=ahead(simulated.outputs),
        error=ahead(error),
        noise=simulated.initial.noise,
        trajectory=ahead(simulated.states),
        one_step=ahead(simulator.one_step(simulated)),
        notes=notes,
        own=values,
        elapsed=windows.elapsed,
    )
    return prediction, simulated.not_finite, _trouble(simulated, windows, model)


def _trouble(simulated: WindowSimulations, windows: Windows, model: ModelAtEstimate) -> str:
    """Say how many windows are not finite, and which signal is lost first and when."""
    if not simulated.not_finite.any():
        return ""

    # The first signal that is lost points to the formula to mend.
    first = np.argmax(simulated.not_finite)
    names = (*model.system.states, *windows.outputs)
    is_lost = ~np.isfinite(np.hstack([simulated.states[first], simulated.outputs[first]]))
    when = np.argmax(is_lost.any(axis=1))
    name = names[np.argmax(is_lost[when])] if is_lost.any() else "the sensitivity of its outputs"
    time = windows.record.time[windows.rows[first, when]]
    # The time of rows without one is their number from 0.
    kind, place = "row", f"in row {time + 1:.0f}"
    if windows.lead:
        kind, place = "window", f"at {time:.6g} s"
    count = counted(int(simulated.not_finite.sum()), kind)
    return f"{model.label} is not finite in {count} of {len(windows)}: {name} {place}"


def cure(called: str) -> str:
    """Return the cure for a model that is not finite; `called` is the argument for the horizon."""
    return f"give a shorter {called} if the model is unstable, or {DOMAINS}"


def _unknown_errors(unknown: tuple[str, ...], model: ModelAtEstimate) -> str:
    """Say which parameters have no standard error, so that some outputs have none."""
    return (
        f"the standard errors of {model.label} are unknown if they depend on {', '.join(unknown)}, "
        "which the data of the fit do not determine"
    )


def _model_and_record(
    model: Any, values: Any, record: Any, inputs: Inputs | None, part: int | None
) -> tuple[ModelAtEstimate, Record]:
    """Return the model at its values, and the record, by default that of the fit."""
    require_kind("record", record, Record | None, "one Record; for several, call it for each")
    estimated = model_at(model, values, inputs=inputs, part=part, record=record)
    if record is None:
        if estimated.part is None:
            raise TypeError("record is missing: give the Record that drives the model.")
        record = estimated.part.data
    require_signals(record, estimated.system.inputs, estimated.label)
    return estimated, record


def _fitted_stretches(model: ModelAtEstimate, stretches: Sequence[Stretch]) -> list[Stretch]:
    """Return the stretches of the fit's record that the fit has used."""
    # The other stretches have too few measured values for the fit, which did not simulate them.
    simulated = array_of(model.part.simulated, model.part.outputs)
    used = np.flatnonzero(np.isfinite(simulated).any(axis=0))
    return [stretch for stretch in stretches if np.isin(stretch.own_rows, used).any()]


def _initial_states(
    model: ModelAtEstimate, initial: Any, stretches: int, fitted_initial: bool
) -> Array:
    """Return the initial states (stretches, n), by default those that the model declares."""
    # On the record of the fit, its initial states were estimated with the parameters.
    if fitted_initial:
        initial = selected(model.part.initial, model.system.states)
    initial = {} if initial is None else initial
    require_kind("initial", initial, Mapping, "{state: value}")
    require_known(initial, model.system.states, "state", model.label)
    states = np.repeat(model.system.starts(model.p).full().T, stretches, axis=0)
    for name, value in initial.items():
        values = np.asarray(value)
        is_number = values.dtype.kind in "iuf" and all_finite(values)
        if not is_number or values.ndim > 1 or values.size not in (1, stretches):
            raise ValueError(
                f"initial gives {name!r} the value {value!r:.60}: give a finite number, or one for "
                f"each stretch; the record has {counted(stretches, 'stretch', 'stretches')} "
                "without a gap."
            )
        states[:, model.system.states.index(name)] = values
    return states
