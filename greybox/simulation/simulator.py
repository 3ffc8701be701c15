"""Runs a model over stretches or windows: outputs, states and their standard errors."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep, sample_step
from greybox.compiled.sampled_data import SampledData, Stretch
from greybox.compiled.segments import Segments
from greybox.files.arrays import Array, BoolArray, IntArray
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.integrators import Integrator
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.step_size import (
    MOST_SUBSTEPS,
    relative_change,
    stable_substeps,
    state_sizes,
    substep_growth,
)
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.state_estimation import (
    StateEstimates,
    estimate_states,
    one_step_errors,
    whitening,
    without_states,
)
from greybox.simulation.windows import Windows, sample_data

# Largest change of a state in one sample by halved substeps, relative to its size. A thousand such
# errors in one direction add up to 1e-4 of the state, below the noise of any sensor.
TOLERANCE = 1e-7
# First |pole| · substep: a Runge-Kutta step of z = 0.1 has an error of z⁵ / 120 = 8e-8 of the
# state, just within TOLERANCE.
FIRST_REACH = 0.1
# Most substeps to begin with: the fastest mode at rest may not occur in the simulation.
MOST_AT_FIRST = 8
DIVERGED = 1e9  # no state of a vehicle in SI units is that large
# Initial states to try if the model is not finite at zero (roots, logarithms), in units of the size
# of the outputs.
SIZES = (1.0, 0.1, 10.0, -1.0)
ERROR = "_error"


@dataclass(frozen=True, eq=False)
class WindowSimulations:
    """Windows run from the states that their lead-ins give; every sample, lead-ins included.

    Attributes
    ----------
    initial : StateEstimates
    measured, outputs : (w, samples, k) arrays
        NaN where nothing was measured.
    states : (w, samples, n) array
    in_lead : (w, samples, k) bool array
        Marks the measurements within the lead-ins.
    slopes : (w, samples, k, n + a) array
        Derivatives of the outputs by the window's first state and by the active values.
    segments : Segments
    data : mapping of name to (rows, w, samples) array
        See `sample_data`.
    """

    initial: StateEstimates
    measured: Array
    outputs: Array
    states: Array
    in_lead: BoolArray
    slopes: Array
    segments: Segments
    data: Mapping[str, Array]

    @property
    def not_finite(self) -> BoolArray:
        """Windows (w,) in which an output is not finite."""
        return self.initial.not_finite | ~np.all(np.isfinite(self.outputs), axis=(1, 2))


@dataclass(frozen=True, eq=False)
class _Run:
    """A run with one number of substeps, and the data (width, columns) that drove it.

    States (n, columns) and outputs (k, columns) are those of all samples.
    """

    segments: Segments
    data: Array
    states: Array
    outputs: Array
    estimates: StateEstimates | None = None

    @classmethod
    def of(
        cls,
        segments: Segments,
        initial: Array,
        q: Array,
        data: Array,
        estimates: StateEstimates | None = None,
    ) -> "_Run":
        states, _ = segments.simulate(initial, q, data)
        return cls(segments, data, states, segments.outputs(states, q, data), estimates)


class Simulator:
    """A model at an estimate, run with as many substeps as it turns out to need."""

    def __init__(
        self,
        model: ModelAtEstimate,
        criterion: TimeCriterion,
        outputs: tuple[str, ...],
        integrator: Integrator,
    ) -> None:
        if not isinstance(integrator, Integrator):
            raise TypeError(f"integrator is {integrator!r:.60}: give RungeKutta() or Rosenbrock().")
        self._model = model
        self._criterion = criterion
        self._outputs = outputs
        self._integrator = integrator
        self._substeps = integrator.substeps or 0
        self._steps: dict[int, SampleStep] = {}
        self._segments: dict[tuple[int, int, int, bytes], Segments] = {}

    def at(self, q: Array) -> "Simulator":
        """Return the same simulator at other values (declared,)."""
        # A shallow copy: both share the compiled functions.
        simulator = copy(self)
        simulator._model = replace(self._model, q=q)
        return simulator

    def free_run(
        self, stretch: Stretch, initial: Array, fitted_initial: bool
    ) -> tuple[dict[str, Array], tuple[str, ...]]:
        """Simulate one stretch from the states `initial` (n,), which the fit may have estimated.

        Returns outputs, standard errors and states by name, and the parameters without a standard
        error on which an output depends.
        """
        model = self._model
        count = len(stretch)
        delayed, around = SampledData((stretch,), (), 1).delayed_inputs(model.delays)

        # A free run has no measurements that could correct its states.
        nothing_measured = np.zeros((2 * len(self._outputs), count))
        data = np.vstack([delayed, around, nothing_measured, np.full((1, count), stretch.step)])

        def run(step: SampleStep) -> _Run:
            return _Run.of(Segments(step, 1, count, model.uncertain), initial[None], model.q, data)

        result = self._accurate(stretch.step, run)
        signals = dict(zip(model.system.states, result.states, strict=True))
        signals |= dict(zip(self._outputs, result.outputs, strict=True))
        unknown: tuple[str, ...] = ()
        if model.covariance is not None and not diverged(signals).any():
            slopes = result.segments.output_sensitivities(result.states, model.q, data)[0]
            by_value, variance = _free_run_sensitivities(
                model, stretch, slopes, self._outputs, fitted_initial
            )
            error, unknown = _standard_errors(by_value, variance, model)
            signals |= {name + ERROR: row for name, row in zip(self._outputs, error.T, strict=True)}
        return signals, unknown

    def windows(self, windows: Windows, active: IntArray | None = None) -> WindowSimulations:
        """Estimate the state of every window from its lead-in, and simulate the window from there.

        Derivatives are by the `active` values, by default the uncertain ones.
        """
        active = self._model.uncertain if active is None else active
        data, in_lead, result = self._from_lead_ins(windows, active)
        assert result.estimates is not None
        segments = result.segments
        return WindowSimulations(
            initial=result.estimates,
            measured=np.moveaxis(data["measured"], 0, -1),
            outputs=segments.by_segment(result.outputs),
            states=segments.by_segment(result.states),
            in_lead=np.moveaxis(in_lead, 0, -1),
            slopes=segments.output_sensitivities(result.states, self._model.q, result.data),
            segments=segments,
            data=data,
        )

    def standard_errors(self, simulated: WindowSimulations) -> tuple[Array, tuple[str, ...]]:
        """Return standard errors (w, samples, k) of the outputs, and values without such errors."""
        n = len(self._model.system.states)
        covariance = simulated.initial.covariance
        by_state, by_value = simulated.slopes[..., :n], simulated.slopes[..., n:]
        masked = np.where(simulated.in_lead[..., None], simulated.slopes, 0.0)
        J = whitening(simulated.initial.noise) @ masked
        mixed = np.einsum("wtin,wtia->wna", J[..., :n], J[..., n:])

        # A change of a value changes the state that the lead-in implies, and so the prediction.
        state_by_value = -np.einsum("wij,wja->wia", covariance, mixed)
        variance = np.einsum("wtkn,wnm,wtkm->wtk", by_state, covariance, by_state, optimize=True)
        by_value = by_value + np.einsum("wtkn,wna->wtka", by_state, state_by_value)
        return _standard_errors(by_value, variance, self._model)

    def one_step(self, simulated: WindowSimulations) -> Array:
        """Return the errors one sample ahead in standard deviations, (w, samples, k)."""
        estimates, outputs = simulated.initial, simulated.outputs
        by_state = simulated.slopes[..., : len(self._model.system.states)]
        if self._criterion.corrects_states:
            # One step ahead, the corrections continue after the lead-in.
            segments, q = simulated.segments, self._model.q
            data = _columns(segments, simulated.data, np.isfinite(simulated.data["measured"]))
            corrected = _Run.of(segments, estimates.states, q, data)
            outputs = segments.by_segment(corrected.outputs)
            slopes = segments.output_sensitivities(corrected.states, q, data)
            by_state = slopes[..., : by_state.shape[-1]]
        return one_step_errors(
            simulated.measured - outputs,
            by_state,
            estimates.mean - estimates.states,
            estimates.precision,
            estimates.noise,
        )

    def _from_lead_ins(
        self, windows: Windows, active: IntArray
    ) -> tuple[dict[str, Array], BoolArray, _Run]:
        """Run every window from the state that its lead-in gives, with the `active` values.

        Returns the data, which outputs were measured within lead-ins (k, w, samples), and the run.
        """
        model = self._model
        w, length = windows.rows.shape
        lead = windows.lead
        data = sample_data(windows, model.system.inputs, self._outputs, model.delays)
        measured = np.moveaxis(data["measured"], 0, -1)
        in_lead = np.isfinite(data["measured"]) & (np.arange(length) < lead)
        spread = np.array([_spread(windows.record[name]) for name in self._outputs])

        # Innovations correct the states in the lead-in only: the rest is a prediction.
        mask = np.moveaxis(in_lead[:, :, :lead], 0, -1)
        past = np.where(mask, measured[:, :lead], np.nan)

        def of_rows(step: SampleStep) -> _Run:
            segments = self._segments_of(step, w, length, active)
            result = _Run.of(segments, np.zeros((w, 0)), model.q, _columns(segments, data, in_lead))
            errors = measured - segments.by_segment(result.outputs)
            return replace(
                result, estimates=without_states(errors, model.noise(self._outputs), spread)
            )

        def run(step: SampleStep) -> _Run:
            # States are estimated at given values: no derivatives by these are needed.
            lead_in = self._segments_of(step, w, lead, np.zeros(0, dtype=int))
            lead_data = _columns(lead_in, data, in_lead)

            def simulate(x: Array) -> Array:
                return lead_in.by_segment(_Run.of(lead_in, x, model.q, lead_data).outputs)

            def sensitivities(x: Array) -> Array:
                states, _ = lead_in.simulate(x, model.q, lead_data)
                return np.where(
                    mask[..., None], lead_in.output_sensitivities(states, model.q, lead_data), 0.0
                )

            estimates = estimate_states(
                simulate,
                sensitivities,
                past,
                _initial_guesses(model, self._outputs, past),
                model.noise(self._outputs),
                spread,
            )
            segments = self._segments_of(step, w, length, active)
            return _Run.of(
                segments, estimates.states, model.q, _columns(segments, data, in_lead), estimates
            )

        return data, in_lead, self._accurate(windows.record.step, run if lead else of_rows)

    def _accurate(self, step: float, run: Callable[[SampleStep], _Run]) -> _Run:
        """Run with more and more substeps until halved ones change no sample noticeably."""
        chosen = self._integrator.substeps is not None
        self._substeps = self._substeps or _first_substeps(self._model, step)
        while True:
            result = run(self._step(self._substeps))
            if chosen or not result.states.size or self._substeps >= MOST_SUBSTEPS:
                return result
            error = self._local_error(result)
            if error <= TOLERANCE and np.all(np.isfinite(result.states)):
                return result
            # Steps that are too long may be the reason why states are not finite.
            error = error if error > TOLERANCE else np.inf
            factor = substep_growth(error, TOLERANCE, self._integrator.order)
            self._substeps = min(MOST_SUBSTEPS, self._substeps * factor)

    def _local_error(self, result: _Run) -> float:
        """Return the largest change of a state in one sample by halved substeps, over its size."""
        states = result.states
        usable = np.flatnonzero(np.all(np.abs(states) < DIVERGED, axis=0))
        # At 400 samples of all, since each costs two evaluations of the model.
        places = np.linspace(0, usable.size - 1, min(usable.size, 400)).astype(int)
        checked = usable[np.unique(places)].tolist()
        if not checked:
            return 0.0
        x = states[:, checked]
        coarse, fine = (
            np.asarray(self._step(count).function(x, self._model.q, result.data[:, checked])[0])
            for count in (self._substeps, 2 * self._substeps)
        )
        change = fine - coarse
        return relative_change(np.where(np.isfinite(change), change, 0.0), state_sizes(x))

    def _segments_of(self, step: SampleStep, count: int, length: int, active: IntArray) -> Segments:
        """Return segments of this shape, whose functions are compiled once."""
        key = (id(step), count, length, active.tobytes())
        if key not in self._segments:
            self._segments[key] = Segments(step, count, length, active)
        return self._segments[key]

    def _step(self, substeps: int) -> SampleStep:
        if substeps not in self._steps:
            model = self._model
            self._steps[substeps] = sample_step(
                model.system,
                model.held,
                self._criterion,
                self._outputs,
                model.names,
                self._integrator,
                substeps,
            )
        return self._steps[substeps]


def diverged(signals: Mapping[str, Array]) -> BoolArray:
    """Return at which samples a signal is not finite or larger than any physical one."""
    return ~np.all([np.abs(values) < DIVERGED for values in signals.values()], axis=0)


@one_thread_at_a_time
def _first_substeps(model: ModelAtEstimate, step: float) -> int:
    """Return the substeps of a sample by the poles near rest."""
    n = len(model.system.states)
    m = len(model.system.inputs)
    if not n:
        return 1
    x = ca.SX.sym("x", n)
    u = ca.SX.sym("u", m)
    jacobian = ca.Function(
        "A", [x, u], [ca.densify(ca.jacobian(model.system.derivative(x, u, model.p), x))]
    )
    # Not at zero itself, where the slope of |v| v vanishes and that of a root is infinite.
    matrix = jacobian(np.full(n, 1e-3), np.zeros(m)).full()
    if not np.all(np.isfinite(matrix)):
        return 1
    return stable_substeps(np.linalg.eigvals(matrix), step, reach=FIRST_REACH, most=MOST_AT_FIRST)


def _columns(segments: Segments, data: Mapping[str, Array], present: BoolArray) -> Array:
    """Return the data of all windows, up to the length of the segments; `present` are measured."""
    rows = [
        data["whole"],
        data["around"],
        np.where(present, data["measured"], 0.0),
        present,
        data["step"],
    ]
    cut = [row[:, :, : segments.length] for row in rows]
    # Without inputs there are no rows, from which `reshape` with -1 could not infer the length.
    joined = [row.reshape(len(row), row.shape[1] * row.shape[2]) for row in cut]
    return segments.columns(np.concatenate(joined))


def _free_run_sensitivities(
    model: ModelAtEstimate,
    stretch: Stretch,
    slopes: Array,
    outputs: tuple[str, ...],
    fitted_initial: bool,
) -> tuple[Array, Array]:
    """Return derivatives (samples, k, a) of the outputs by the uncertain values, and variances.

    The variances are those due to fitted initial states, which also follow the parameters.
    """
    n = len(model.system.states)
    part = model.part
    by_state = slopes[..., :n]
    by_value = slopes[..., n:]
    no_variance = np.zeros(slopes.shape[:2])
    # Products of three larger slopes would overflow.
    if not np.all(np.abs(slopes) < 1e100):
        return np.full_like(by_value, np.nan), no_variance
    if not fitted_initial or part is None or not n:
        return by_value, no_variance

    rows = stretch.rows
    compared = np.array([np.isfinite(part.residual(name)[rows]) for name in part.outputs]).T
    places = [outputs.index(name) for name in part.outputs]
    # Whitened, so that least squares weight every output by its noise.
    weight = whitening(part.noise)
    x = (weight @ np.where(compared[..., None], by_state[:, places], 0.0)).reshape(-1, n)
    q = weight @ np.where(compared[..., None], by_value[:, places], 0.0)
    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    _, singular, directions = np.linalg.svd(x / size, full_matrices=False)

    # Too few samples do not determine all initial states: no variance would be right.
    if len(x) < n or singular[-1] < 1e-10 * singular[0]:
        return by_value, no_variance * np.nan

    root = directions.T / singular / size[:, None]
    covariance = root @ root.T
    state_by_value = -covariance @ x.T @ q.reshape(len(x), -1)
    variance = np.einsum("tkn,nm,tkm->tk", by_state, covariance, by_state)
    return by_value + by_state @ state_by_value, variance


def _standard_errors(
    by_value: Array, variance: Array, model: ModelAtEstimate
) -> tuple[Array, tuple[str, ...]]:
    """Return the standard errors (..., k) of outputs with the variance (..., k) of the states.

    A sample that depends on a value without a standard error has none either; the names of these
    values are returned, too.
    """
    unknown: tuple[str, ...] = ()
    if model.covariance is not None and len(model.uncertain):
        covariance = model.covariance[np.ix_(model.uncertain, model.uncertain)]
        undetermined = np.isnan(np.diag(covariance))
        variance = variance + np.einsum(
            "...a,ab,...b->...", by_value, np.nan_to_num(covariance), by_value
        )
        if undetermined.any():
            depends = _depends(by_value, model.q[model.uncertain]) & undetermined
            variance = np.where(depends.any(axis=-1), np.nan, variance)
            involved = depends.reshape(-1, undetermined.size).any(axis=0)
            unknown = tuple(model.names[i] for i in model.uncertain[involved])

    # Rounding may make a variance negative.
    return np.sqrt(np.maximum(variance, 0.0)), unknown


def _depends(by_value: Array, q: Array) -> BoolArray:
    """Return which samples of an output depend on which values (..., k, a), beyond rounding."""
    effect = np.abs(by_value) * np.where(q != 0, np.abs(q), 1.0)
    largest = np.nanmax(effect, axis=(*range(effect.ndim - 2), -1), initial=0.0)  # of every output
    # Smaller effects are rounding errors.
    return ~(effect <= 1e-9 * largest[:, None])


def _initial_guesses(model: ModelAtEstimate, outputs: tuple[str, ...], past: Array) -> list[Array]:
    """Return first states (w, n), and alternatives for windows in which they are not finite.

    States with the name of an output begin at its first measurement; others at zero, at the values
    of the fit, or at the size of the outputs.
    """
    n = len(model.system.states)
    fitted = {} if model.part is None else model.part.initial
    size = float(np.nanmean(np.abs(past))) or 1.0
    levels = [np.zeros(n)]
    levels.append(np.array([float(np.mean(fitted.get(name, 0.0))) for name in model.system.states]))
    levels += [np.full(n, factor * size) for factor in SIZES]

    guesses = [np.tile(values, (len(past), 1)) for values in levels]

    # A measured state need not be guessed.
    for i, name in enumerate(model.system.states):
        if name in outputs:
            values = past[:, :, outputs.index(name)]
            first = np.isfinite(values).argmax(axis=1)
            for guess in guesses:
                guess[:, i] = np.nan_to_num(values[np.arange(len(values)), first])
    return guesses


def _spread(values: Any) -> float:
    present = values[np.isfinite(values)]

    # A constant signal has no size of its own.
    return float(present.std()) or 1.0
