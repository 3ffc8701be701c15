"""Runs a model over stretches or windows: outputs, states and their standard errors."""

import math
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from functools import cache, cached_property, partial

import numpy as np

from greybox.assessment.simulation.model_at_estimate import ModelAtEstimate
from greybox.assessment.simulation.prediction import Windows, sample_data
from greybox.assessment.simulation.state_estimation import (
    TINY,
    StateEstimates,
    estimate_states,
    one_step_errors,
    whitening,
)
from greybox.data.files.arrays import (
    Array,
    BoolArray,
    IntArray,
    all_finite,
    evenly_spread,
    positive_or_one,
    real_root,
)
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import places_of
from greybox.data.files.wording import counted
from greybox.engine.compiled.initial_states import InitialStates
from greybox.engine.compiled.sample_step import SampleStep, sample_step
from greybox.engine.compiled.sampled_data import SampledData, Stretch
from greybox.engine.compiled.segments import Course, Segments
from greybox.engine.compiled.vectorized import Remembering
from greybox.modeling.implicit_integrators import Radau
from greybox.modeling.integrators import Integrator, RungeKutta, repeated
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.step_size import (
    MOST_SUBSTEPS,
    relative_change,
    stable_substeps,
    substep_growth,
)

# Allowed mean change of a state in one sample by halved substeps, relative to the size of the
# state. The errors of a lightly damped mode have the same sign in every sample, so that they add up
# to 3e-6 of the state over ten thousand samples. A single kink among the 400 checked samples may
# change the state by 400 times the tolerance, 1e-7.
TOLERANCE = 3e-10
# If the smallest steps still leave this mean change, they are unstable, even though the states stay
# finite. In stiff kinetics, for example, the states alternate about the solution by 0.01 in one of
# a hundred samples or more.
UNSTABLE = 1e-4
# Largest change of a state in a whole simulation by halved substeps, relative to its largest value.
# Steps are halved until the change is below the first limit; a change above the second is reported.
AGREEMENT = 1e-6
DISAGREEMENT = 1e-4
# Largest number of substeps of the first run. More may be unnecessary, because the fastest mode at
# rest may not occur in the simulation.
MOST_AT_FIRST = 8
# Number of samples at which halved substeps are tried: evenly spread samples, and the samples in
# which a state moves most.
CHECKED = 400
FASTEST = 100
# States beyond this limit count as diverged. Physical values, such as counts of cells and
# pressures, may exceed 1e9.
DIVERGED = 1e20
ERROR = "_error"


@frozen
class WindowSimulations:
    """Simulated windows, each from the initial state that its lead-in determines.

    The arrays contain every sample, including those of the lead-ins.

    Attributes
    ----------
    initial : StateEstimates
    measured, outputs : (w, samples, k) arrays
        NaN where nothing was measured.
    states : (w, samples, n) array
    in_lead : (w, samples, k) bool array
        Marks the measurements within the lead-ins.
    slopes : (w, samples, k, n + a) array
        Derivatives of the outputs with respect to the initial state and the active values.
    segments : Segments
    data : (width, w, samples) array
        See `sample_data`.
    """

    initial: StateEstimates
    measured: Array
    outputs: Array
    states: Array
    in_lead: BoolArray
    slopes: Array
    segments: Segments
    data: Array

    @property
    def not_finite(self) -> BoolArray:
        """Windows (w,) in which an output is not finite."""
        return self.initial.not_finite | ~np.all(np.isfinite(self.outputs), axis=(1, 2))


@frozen
class _Run:
    """A simulation of segments from initial states (s, n), driven by data (width, columns)."""

    segments: Segments
    initial: Array
    q: Array
    data: Array
    estimates: StateEstimates | None = None

    @cached_property
    def along(self) -> Course:
        """The states (n, columns) at all samples, with q and data."""
        states, _ = self.segments.simulate(self.initial, self.q, self.data)
        return Course(states, self.q, self.data)

    @cached_property
    def outputs(self) -> Array:
        """The outputs (k, columns) at all samples."""
        return self.segments.outputs(self.along)

    def sensitivities(self) -> Array:
        """Return the derivatives of the outputs by first states and active values."""
        return self.segments.output_sensitivities(self.along)

    def stepped(self, step: SampleStep) -> "_Run":
        """Return the run with other steps from the same initial states."""
        old = self.segments
        return replace(self, segments=Segments(step, old.count, old.length, old.active))


class Simulator:
    """Simulates a model at an estimate, with the number of substeps that the motion requires.

    Attributes
    ----------
    doubt : str
        Warning for the user if halved substeps changed the motion; otherwise empty.
    """

    @one_thread_at_a_time
    def __init__(
        self,
        model: ModelAtEstimate,
        outputs: tuple[str, ...],
        integrator: Integrator | None,
    ) -> None:
        if not isinstance(integrator, Integrator | None):
            raise TypeError(f"integrator is {integrator!r:.60}: give RungeKutta() or Radau().")
        self._model = model
        self._outputs = outputs
        self._integrator = integrator or RungeKutta()
        self._is_automatic = integrator is None
        self._substeps = self._integrator.substeps or 0
        self.doubt = ""
        system = model.system.observed(outputs)
        self._initial = InitialStates(system)
        criterion = model.criterion
        # Compiled steps by integrator and number of substeps.
        self._step = cache(
            partial(
                sample_step,
                system,
                model.held,
                model.names,
                biases=tuple(criterion.biases),
                corrects_states=criterion.corrects_states,
            )
        )

    def at(self, q: Array) -> "Simulator":
        """Return the same simulator at other values (declared,)."""
        # A shallow copy: both share the compiled functions.
        simulator = copy(self)
        simulator._model = replace(self._model, q=q)
        return simulator

    def free_run(
        self, stretch: Stretch, initial: Array, fitted_initial: bool
    ) -> tuple[Mapping[str, Array], Mapping[str, Array], tuple[str, ...]]:
        """Simulate one stretch from the states `initial` (n,), which the fit may have estimated.

        Returns outputs and states by name, standard errors by name, and the parameters without a
        standard error on which an output depends.
        """
        model = self._model
        count = len(stretch)
        # A free run has no measurements that could correct its states.
        nothing_measured = np.full((len(self._outputs), count), np.nan)
        data = SampledData((replace(stretch, outputs=nothing_measured),)).rows(model.delays)

        def run(step: SampleStep) -> _Run:
            return _Run(Segments(step, 1, count, model.uncertain), initial[None], model.q, data)

        result = self._agreeing(float(stretch.steps.max()), run)
        signals = dict(zip(model.system.states, result.along.states, strict=True))
        signals |= dict(zip(self._outputs, result.outputs, strict=True))
        if model.covariance is None:
            return signals, {}, ()

        slopes = result.sensitivities()
        n = len(model.system.states)
        by_value = slopes[..., n:]
        variance = np.zeros(slopes.shape[:-1])
        # The products of three slopes above this limit would overflow.
        if not np.all(np.abs(slopes) < 1e100):
            by_value = np.full_like(by_value, np.nan)
        elif fitted_initial:
            part, rows = model.part, stretch.rows
            compared = np.array([np.isfinite(part.residual(name)[rows]) for name in part.outputs]).T
            if stretch.filled is not None:
                compared[stretch.filled] = False
            places = places_of(part.outputs, self._outputs)
            informing = np.where(compared[..., None], slopes[:, :, places], 0.0)
            by_value, variance = with_implied_states(slopes, informing, part.noise, np.zeros(n))
        error, unknown = _standard_errors(by_value[0], variance[0], model)
        return (
            signals,
            dict(zip([name + ERROR for name in self._outputs], error.T, strict=True)),
            unknown,
        )

    def windows(
        self, windows: Windows, active: IntArray | None = None, *, checked: bool = False
    ) -> WindowSimulations:
        """Estimate the state of every window from its lead-in, and simulate the window from there.

        Derivatives are by the `active` values, by default the uncertain ones. If `checked`,
        substeps are halved until this does not change the motion of a window.
        """
        model = self._model
        active = model.uncertain if active is None else active
        w, length = windows.rows.shape
        # Rows without a time have no lead-in: all of them show the size of the errors.
        lead = windows.lead or length
        data = sample_data(windows, model.system.inputs, model.delays, model.held)
        k = len(self._outputs)
        _, values, present, _ = np.split(data, [-1 - 2 * k, -1 - k, -1])
        measured = np.moveaxis(np.where(present, values, np.nan), 0, -1)
        # Innovations correct the states in the lead-in only: the rest is a prediction.
        correcting = present * (np.arange(length) < lead)
        predicting = data.copy()
        predicting[-1 - k : -1] = correcting
        in_lead = np.moveaxis(correcting > 0, 0, -1)
        past = measured[:, :lead]
        informing = in_lead[:, :lead, :, None]
        guess = self._first_states(windows, past)
        # A constant signal has no size of its own.
        spread = np.array([np.nanstd(windows.record[name]) or 1.0 for name in self._outputs])

        def run(step: SampleStep) -> _Run:
            # States are estimated at given values: no derivatives with respect to these are needed.
            segments = Segments(step, w, lead, np.zeros(0, dtype=int))
            columns = _columns(segments, predicting)
            # The outputs alone decide whether a step is accepted; only then are slopes computed.
            lead_in = Remembering(lambda x: _Run(segments, x, model.q, columns))
            estimates = estimate_states(
                lambda x: segments.by_segment(lead_in(x).outputs),
                lambda x: np.where(informing, lead_in(x).sensitivities(), 0.0),
                past,
                guess,
                model.noise(self._outputs),
                spread,
            )
            whole = Segments(step, w, length, active)
            return _Run(whole, estimates.states, model.q, _columns(whole, predicting), estimates)

        run_until = self._agreeing if checked else self._accurate
        result = run_until(float(data[-1].max()), run)
        assert result.estimates is not None
        segments = result.segments
        return WindowSimulations(
            initial=result.estimates,
            measured=measured,
            outputs=segments.by_segment(result.outputs),
            states=segments.by_segment(result.along.states),
            in_lead=in_lead,
            slopes=result.sensitivities(),
            segments=segments,
            data=data,
        )

    def standard_errors(self, simulated: WindowSimulations) -> tuple[Array, tuple[str, ...]]:
        """Return standard errors (w, samples, k) of the outputs, and values without such errors."""
        initial = simulated.initial
        informing = np.where(simulated.in_lead[..., None], simulated.slopes, 0.0)
        by_value, variance = with_implied_states(
            simulated.slopes, informing, initial.noise, initial.precision
        )
        return _standard_errors(by_value, variance, self._model)

    def one_step(self, simulated: WindowSimulations) -> Array:
        """Return the errors one sample ahead in standard deviations, (w, samples, k)."""
        estimates, outputs = simulated.initial, simulated.outputs
        by_state = simulated.slopes[..., : len(self._model.system.states)]
        if self._model.criterion.corrects_states:
            # For predictions one sample ahead, the corrections continue after the lead-in.
            segments, q = simulated.segments, self._model.q
            data = _columns(segments, simulated.data)
            corrected = _Run(segments, estimates.states, q, data)
            outputs = segments.by_segment(corrected.outputs)
            by_state = corrected.sensitivities()[..., : by_state.shape[-1]]
        return one_step_errors(
            simulated.measured - outputs,
            by_state,
            estimates.mean - estimates.states,
            estimates.precision,
            estimates.noise,
        )

    def _first_states(self, windows: Windows, past: Array) -> Array:
        """Return the initial states (w, n) of the windows where measurements show them."""
        model = self._model
        # The first measurement of every output, if it was measured at all.
        first = np.isfinite(past).argmax(axis=1)[:, None]
        measured = np.nan_to_num(np.take_along_axis(past, first, axis=1)[:, 0].T)
        names = model.system.inputs
        inputs = np.array([windows.record[name][windows.rows[:, 0]] for name in names])
        fitted = {} if model.part is None else model.part.initial
        known = [float(np.mean(fitted.get(name, np.nan))) for name in model.system.states]
        states = self._initial.at(
            measured, inputs.reshape(len(names), len(past)), model.p, np.array(known)
        )
        return self._initial.as_measured(states, measured).T

    def _accurate(self, step: float, run: Callable[[SampleStep], _Run]) -> _Run:
        """Run with an increasing number of substeps until the local error is within tolerance."""
        if not self._substeps:
            # The first number of substeps follows from the poles near rest. Exactly at rest, the
            # slope of |v| v would vanish and the slope of a square root would be infinite.
            model = self._model
            states = np.full((len(model.system.states), 1), 1e-3)
            inputs = np.zeros((len(model.system.inputs), 1))
            poles = self._initial.poles(states, inputs, model.p)
            needed = stable_substeps(poles, step, reach=self._integrator.reach)
            if self._is_automatic and needed > MOST_SUBSTEPS:
                self._is_automatic, self._integrator = False, Radau()
            # For a product z = 0.03 of pole and step, a Runge-Kutta step has an error of
            # z⁵ / 120 = 2e-10 of the state, which is just within TOLERANCE.
            self._substeps = stable_substeps(poles, step, reach=0.03, most=MOST_AT_FIRST)
        while True:
            result = run(self._step(self._integrator, self._substeps))
            states = result.along.states
            finite = all_finite(states)
            most = self._substeps >= MOST_SUBSTEPS
            if self._integrator.substeps or not states.size:
                return result
            # Steps that are too long may be the reason why states are not finite.
            error = self._local_error(result) if finite else np.inf
            # In predictions, states that are not finite come from a formula outside its domain.
            # Their windows are left out, so no other integrator is tried for them.
            if (
                self._is_automatic
                and most
                and error > UNSTABLE
                and (finite or not result.estimates)
            ):
                # The motion is stiff far from rest.
                explicit = self._integrator, self._substeps
                self._is_automatic, self._integrator = False, Radau()
                self._substeps = MOST_AT_FIRST
                implicit = self._accurate(step, run)
                if not finite or all_finite(implicit.along.states):
                    return implicit
                # A discontinuity, such as dry friction at rest, makes Newton's iteration fail, but
                # not an explicit step.
                self._integrator, self._substeps = explicit
                return result
            if most or error <= TOLERANCE:
                return result
            factor = substep_growth(error, TOLERANCE, self._integrator.order)
            self._substeps = min(MOST_SUBSTEPS, self._substeps * factor)

    def _agreeing(self, step: float, run: Callable[[SampleStep], _Run]) -> _Run:
        """Run with an increasing number of substeps until halving them gives the same motion.

        If no number of substeps is sufficient, `doubt` becomes a warning. Small errors in every
        sample add up where the motion is sensitive to them: a relaxation oscillation jumps too
        late, and a chaotic oscillation loses its phase.
        """
        result = self._accurate(step, run)
        is_open = not self._integrator.substeps and result.along.states.size
        if not is_open or self._integrator.implicit:
            return result
        result, change = self._refined(result, run)
        if change > DISAGREEMENT and self._is_automatic:
            # An explicit integrator would need too many steps for the fastest motion.
            explicit = self._integrator, self._substeps, result, change
            self._is_automatic, self._integrator = False, Radau()
            self._substeps = MOST_AT_FIRST
            result, change = self._refined(self._accurate(step, run), run)
            if not change < explicit[-1]:
                self._integrator, self._substeps, result, change = explicit
        if DISAGREEMENT < change < math.inf:
            kind = "prediction" if result.estimates else "simulation"
            shorter = "shorter windows" if result.estimates else "a shorter one"
            radau = "" if self._integrator.implicit else "integrator=gb.Radau(), "
            self.doubt = (
                f"the {kind} of {self._model.label} is not exact: halving its "
                f"{counted(self._substeps, 'step')} per sample changes a state by up to "
                f"{100 * change:.2g} % of its largest value. The motion is stiff or sensitive to "
                f"small errors: give {radau}a record with a higher rate, or {shorter}."
            )
        return result

    def _refined(self, result: _Run, run: Callable[[SampleStep], _Run]) -> tuple[_Run, float]:
        """Double the substeps until this changes no state noticeably; return the last change."""
        while True:
            states = result.along.states
            usable = np.all(np.abs(states) < DIVERGED, axis=0)
            if not (usable.any() if result.estimates else usable.all()):
                return result, math.inf
            finer = result.stepped(self._step(self._integrator, 2 * self._substeps))
            if result.estimates:
                # Windows in which a formula has left its domain are left out.
                usable &= np.all(np.abs(finer.along.states) < DIVERGED, axis=0)
            change = relative_change((finer.along.states - states)[:, usable], states[:, usable])
            # Implicit steps take ten times as long, so they are halved only once, as a check.
            is_last = self._integrator.implicit or self._substeps >= MOST_SUBSTEPS
            if change <= AGREEMENT or is_last:
                return result, change if math.isfinite(change) else math.inf
            self._substeps *= 2
            # States that were estimated with longer steps are estimated again.
            result = run(finer.segments.step) if result.estimates else finer

    def _local_error(self, result: _Run) -> float:
        """Return the mean change of the states in one sample by halved substeps, relative."""
        states = result.along.states
        usable = np.flatnonzero(np.all(np.abs(states) < DIVERGED, axis=0))
        if not usable.size:
            return 0.0
        # Every checked sample costs two evaluations of the model, so only some are checked: CHECKED
        # samples spread over the record, and the samples in which a state moves most. A relaxation
        # oscillation may jump in one of a thousand samples.
        even = usable[evenly_spread(usable.size, CHECKED)]
        moves = relative_moves(states)[usable]
        fastest = usable[np.argsort(-moves, kind="stable")[:FASTEST]]
        checked = np.concatenate([even, fastest])
        x, data = states[:, checked], result.data[:, checked]
        step, model = result.segments.step, self._model
        coarse = np.asarray(step.function(x, model.q, data)[0])
        # One substep is called repeatedly, because compiling a sample of halved substeps would take
        # longer than these few calls.
        begin, mean, slope, *_ = map(np.asarray, step.measurement(x, model.q, data))

        def substep(*at: Array) -> Array:
            return step.substep_of_columns(*at)[0]

        fine = repeated(substep, 2 * self._substeps, begin, mean, slope, model.p, data[-1:])
        change = np.abs(fine - coarse)
        change = np.where(np.isfinite(change), change, 0.0)
        mean = change[:, : even.size].mean(axis=1, keepdims=True)
        # The changes in the fastest samples give a lower limit for the mean over all samples.
        least = change[:, even.size :].sum(axis=1, keepdims=True) / usable.size
        return relative_change(np.maximum(mean, least), x)


def relative_moves(states: Array) -> Array:
    """Return the largest relative move (samples,) of any state to the next sample.

    The moves of the `states` (n, samples) are divided by the largest magnitude of each state. The
    move is zero at the last sample.
    """
    usable = np.where(np.abs(states) < DIVERGED, states, 0.0)
    size = positive_or_one(np.abs(usable).max(axis=1, initial=0.0))
    moves = np.abs(np.diff(usable, axis=1, append=usable[:, -1:])) / size[:, None]
    return moves.max(axis=0, initial=0.0)


def diverged(signals: Mapping[str, Array]) -> BoolArray:
    """Return at which samples a signal is not finite or larger than any physical one."""
    return ~np.all([np.abs(values) < DIVERGED for values in signals.values()], axis=0)


def _columns(segments: Segments, data: Array) -> Array:
    """Return the data (width, w, samples) of all windows, up to the length of the segments."""
    return segments.columns(data[:, :, : segments.length].reshape(len(data), -1))


def with_implied_states(
    slopes: Array, informing: Array, noise: Array, precision: Array
) -> tuple[Array, Array]:
    """Return the derivatives of outputs by values, and the variances from the initial states.

    A change of a value also changes the initial state (n,) that the measurements imply. The
    returned derivatives (w, samples, k, a) include this effect. The variances (w, samples, k) come
    from the uncertainty of the initial states; they are NaN where the states are not determined.

    Parameters
    ----------
    slopes : (w, samples, k, n + a) array
        Derivatives of the outputs by the initial states and the values.
    informing : (w, samples, j, n + a) array
        The same derivatives of the measurements in the lead-in.
    noise : (j, j) array
        Covariance of the errors of the measurements.
    precision : (n,) array
        Precision of the prior of the initial states.
    """
    w = len(slopes)
    n = precision.size
    if not n:
        return slopes, np.zeros(slopes.shape[:-1])
    # Whitened, so that least squares weight every output by its noise.
    J = (whitening(noise) @ informing).reshape(w, -1, slopes.shape[-1])
    prior = np.broadcast_to(np.diag(np.sqrt(precision)), (w, n, n))
    # Slopes that are not finite are left out here. The outputs with such slopes still get a
    # standard error that is not finite.
    by_state = np.nan_to_num(np.hstack([J[..., :n], prior]), posinf=0.0, neginf=0.0)
    size = np.maximum(np.linalg.norm(by_state, axis=1, keepdims=True), TINY)
    inverse = np.linalg.pinv(by_state / size, 1e-10) / size.mT
    covariance = inverse @ inverse.mT

    outputs_by_state = slopes[..., :n]
    variance = np.sum(outputs_by_state @ covariance[:, None] * outputs_by_state, axis=-1)
    # Too few samples do not determine all initial states, so that no variance would be right.
    variance[np.linalg.matrix_rank(by_state / size, 1e-10) < n] = np.nan
    state_by_value = -inverse[..., : J.shape[1]] @ J[..., n:]
    return slopes[..., n:] + outputs_by_state @ state_by_value[:, None], variance


def _standard_errors(
    by_value: Array, variance: Array, model: ModelAtEstimate
) -> tuple[Array, tuple[str, ...]]:
    """Return the standard errors (..., k) of the outputs, and values without a standard error.

    The `variance` (..., k) of the outputs comes from the initial states. The standard error of a
    sample is NaN if it depends on a value without a standard error. The second result contains the
    names of these values.
    """
    unknown: tuple[str, ...] = ()
    if model.covariance is not None:
        covariance = model.covariance[np.ix_(model.uncertain, model.uncertain)]
        undetermined = np.isnan(np.diag(covariance))
        variance = variance + np.einsum(
            "...a,ab,...b->...", by_value, np.nan_to_num(covariance), by_value
        )
        if undetermined.any():
            effect = np.abs(by_value) * positive_or_one(np.abs(model.q[model.uncertain]))
            every = (*range(effect.ndim - 2), -1)
            # The largest effect on every output: effects below 1e-9 of it are rounding errors.
            largest = np.nanmax(effect, axis=every, initial=0.0)
            depends = ~(effect <= 1e-9 * largest[:, None]) & undetermined
            variance = np.where(depends.any(axis=-1), np.nan, variance)
            involved = depends.reshape(-1, undetermined.size).any(axis=0)
            unknown = tuple(model.names[i] for i in model.uncertain[involved])

    # Rounding may make a variance negative.
    return real_root(variance), unknown
