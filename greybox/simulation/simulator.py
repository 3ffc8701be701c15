"""A model run over stretches or windows of a record: outputs and states, accurate in time, and standard errors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.sample_step import SampleStep, sample_step
from greybox.compiled.sampled_data import Experiment, Stretch
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.integrators import Integrator
from greybox.simulation.flow import Flow
from greybox.simulation.model_at_estimate import ModelAtEstimate
from greybox.simulation.state_estimation import LeadIn, estimate_states, one_step_errors
from greybox.simulation.windows import Windows, sample_data

Array = NDArray[np.float64]
ACCURATE, FIRST = 0.1, 8  # largest |pole| · substep to begin with, and most substeps then
TOLERANCE = 1e-7  # of a state's size: what half as long substeps may change in one sample
MOST = 64  # substeps
CHECKED = 400  # samples at which the substeps are checked
DIVERGED = 1e9  # no state in SI units is that large
LARGEST = 1e100  # derivative of an output that still means something
SINGULAR = 1e-10  # relative singular value from which a free simulation does not show its initial state
FACTORS = (1.0, 0.1, 10.0, -1.0)  # times the size of the outputs: states where a model may have finite values
DEPENDS = 1e-9  # of the largest effect on an output: a smaller one is rounding
ERROR = "_error"


@dataclass(frozen=True, eq=False)
class Found:
    """Of every sample in the windows, lead-ins included: (w, samples, k) or (w, samples, n).

    `unknown` are parameters without an error on which an output depends.
    """

    lead_in: LeadIn
    outputs: Array
    states: Array
    error: Array
    one_step: Array
    unknown: tuple[str, ...]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Windows (w,) in which an output is not finite."""
        return self.lead_in.lost | ~np.all(np.isfinite(self.outputs), axis=(1, 2))


class Runner:
    """The compiled sample of a case, with as many substeps as it turns out to need."""

    def __init__(
        self, at: ModelAtEstimate, criterion: TimeCriterion, outputs: tuple[str, ...], integrator: Integrator
    ) -> None:
        if not isinstance(integrator, Integrator):
            raise TypeError(f"integrator is {integrator!r:.60}: give RungeKutta() or Rosenbrock().")
        self._at, self._criterion, self._outputs, self._integrator = at, criterion, outputs, integrator
        self._substeps = integrator.substeps or 0
        self._samples: dict[int, SampleStep] = {}

    def free_run(self, stretch: Stretch, start: Array, own: bool) -> tuple[dict[str, Array], tuple[str, ...]]:
        """Simulate one stretch from the states `start` (n,).

        Returns outputs, errors and states by name, and the parameters without an error on which an output depends.
        """
        at, count = self._at, len(stretch)
        whole, around = Experiment((stretch,), (), 1).windows(at.delays)
        nothing = np.zeros((2 * len(self._outputs), count))
        data = ca.DM(np.vstack([whole, around, nothing, np.full((1, count), stretch.step)]))

        def run(step: SampleStep) -> tuple[Flow, ca.DM, Array, Array]:
            flow = Flow(step, 1, count, at.uncertain)
            return flow, data, *flow.simulate(start[None], at.q, data)

        flow, _, states, outputs = self._accurate(stretch.step, run)
        found = dict(zip(at.system.states, states[0].T, strict=True))
        found |= dict(zip(self._outputs, outputs[0].T, strict=True))
        unknown: tuple[str, ...] = ()
        if at.covariance is not None and not has_left(found).any():
            slopes = flow.slopes(start[None], at.q, data)[0]
            error, unknown = _errors(*_initial_by_parameters(at, stretch, slopes, self._outputs, own), at)
            found |= {name + ERROR: row for name, row in zip(self._outputs, error.T, strict=True)}
        return found, unknown

    def windows(self, windows: Windows) -> Found:
        """Estimate the state of every window and run on from it."""
        at, (w, length), lead = self._at, windows.rows.shape, windows.lead
        n = len(at.system.states)
        data = sample_data(windows, at.system.inputs, self._outputs, at.delays)
        measured = np.moveaxis(data["measured"], 0, -1)
        there = np.isfinite(data["measured"])
        known = there & (np.arange(length) < lead)
        spread = np.array([_spread(windows.record[name]) for name in self._outputs])

        def run(step: SampleStep) -> Any:
            first, before = Flow(step, w, lead, np.zeros(0, dtype=int)), _columns(data, known, lead)
            masked = np.moveaxis(known[:, :, :lead], 0, -1)
            past = np.where(masked, measured[:, :lead], np.nan)
            found = estimate_states(
                lambda x: first.simulate(x, at.q, before)[1],
                lambda x: np.where(masked[..., None], first.slopes(x, at.q, before), 0.0),
                past,
                _first_guesses(at, self._outputs, past),
                at.noise(self._outputs),
                spread,
            )
            whole, columns = Flow(step, w, length, at.uncertain), _columns(data, known, length)
            return (found, whole), columns, *whole.simulate(found.states, at.q, columns)

        (found, whole), columns, states, outputs = self._accurate(windows.record.step, run)
        slopes = whole.slopes(found.states, at.q, columns)
        error, unknown = _window_errors(found, slopes, known, at, n)
        e, by_state = measured - outputs, slopes[..., :n]
        if self._criterion.corrects_states:  # whose corrections go on where one step ahead is meant
            columns = _columns(data, there, length)
            e = measured - whole.simulate(found.states, at.q, columns)[1]
            by_state = whole.slopes(found.states, at.q, columns)[..., :n]
        one_step = one_step_errors(e, by_state, found.mean - found.states, found.precision, found.noise)
        return Found(found, outputs, states, error, one_step, unknown)

    def _accurate(self, step: float, run: Any) -> Any:
        """Run with more and more substeps until half as long ones change no sample noticeably."""
        fixed = self._integrator.substeps is not None
        self._substeps = self._substeps or _substeps(self._at, step)
        while True:
            found, data, states, outputs = run(self._sample(self._substeps))
            if fixed or not states.size or self._substeps >= MOST:
                return found, data, states, outputs
            error = self._local_error(states, data)
            if error <= TOLERANCE and np.all(np.isfinite(states)):
                return found, data, states, outputs
            # What is not finite may be so for steps that are too long.
            growth = (error / TOLERANCE) ** (1 / self._integrator.order) if error > TOLERANCE else FIRST
            self._substeps = min(MOST, self._substeps * int(np.clip(math.ceil(growth), 2, 8)))

    def _local_error(self, states: Array, data: ca.DM) -> float:
        """Return the largest change of a state in one sample by half as long substeps, relative to its size."""
        flat = states.reshape(-1, states.shape[2]).T
        usable = np.flatnonzero(np.all(np.abs(flat) < DIVERGED, axis=0))
        some = usable[np.unique(np.linspace(0, usable.size - 1, min(usable.size, CHECKED)).astype(int))].tolist()
        if not some:
            return 0.0
        x = flat[:, some]
        coarse, fine = (
            np.asarray(self._sample(k).function(x, self._at.q, data[:, some])[0])
            for k in (self._substeps, 2 * self._substeps)
        )
        size = np.abs(x).max(axis=1, initial=0.0)
        size = np.maximum(size, 1e-6 * size.max(initial=0.0))
        size = np.where(size > 0, size, 1.0)
        change = np.abs(fine - coarse) / size[:, None]
        return float(np.max(change, initial=0.0, where=np.isfinite(change)))

    def _sample(self, substeps: int) -> SampleStep:
        if substeps not in self._samples:
            at, scheme = self._at, self._integrator
            self._samples[substeps] = sample_step(at.system, self._criterion, self._outputs, at.names, scheme, substeps)
        return self._samples[substeps]


def _columns(data: Mapping[str, Array], present: Array, length: int) -> ca.DM:
    """Return the first `length` samples of every window as a sample takes them, with the outputs that are `present`."""
    rows = [data["whole"], data["around"], np.where(present, data["measured"], 0.0), present, data["step"]]
    return ca.DM(np.concatenate([row[:, :, :length].reshape(len(row), -1) for row in rows]))


def has_left(found: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return at which samples a signal is not finite or has grown beyond all bounds."""
    return ~np.all([np.abs(values) < DIVERGED for values in found.values()], axis=0)


def _initial_by_parameters(
    at: ModelAtEstimate, stretch: Stretch, slopes: Array, outputs: tuple[str, ...], own: bool
) -> tuple[Array, Array]:
    """Return the derivatives of the outputs (samples, k, a) by the uncertain values, and (samples, k) of variance.

    Initial states that were fitted to the record follow the parameters and have an error of their own.
    """
    n, part = len(at.system.states), at.part
    by_state, by_value = slopes[..., :n], slopes[..., n:]
    still = np.zeros(slopes.shape[:2])
    if not np.all(np.abs(slopes) < LARGEST):
        return np.full_like(by_value, np.nan), still
    if not own or part is None or not n:
        return by_value, still
    rows = stretch.first + np.arange(len(stretch))
    there = np.array([np.isfinite(part.residual(name)[rows]) for name in part.outputs]).T
    places = [outputs.index(name) for name in part.outputs]
    weight = np.linalg.inv(np.linalg.cholesky(part.noise))
    x = np.einsum("ij,tjn->tin", weight, np.where(there[..., None], by_state[:, places], 0.0)).reshape(-1, n)
    q = np.einsum("ij,tja->tia", weight, np.where(there[..., None], by_value[:, places], 0.0))
    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    _, singular, rows = np.linalg.svd(x / size, full_matrices=False)
    if len(x) < n or singular[-1] < SINGULAR * singular[0]:
        return by_value, still * np.nan
    half = rows.T / singular / size[:, None]
    inverse = half @ half.T
    follow = -inverse @ x.T @ q.reshape(len(x), -1)
    own_error = np.einsum("tkn,nm,tkm->tk", by_state, inverse, by_state)
    return by_value + by_state @ follow, own_error


def _errors(by_value: Array, variance: Array, at: ModelAtEstimate) -> tuple[Array, tuple[str, ...]]:
    """Return the standard errors (..., k) from derivatives (..., k, a) and the variance (..., k) of the states.

    A value without an error takes that of the samples which depend on it; their names are returned too.
    """
    unknown: tuple[str, ...] = ()
    if at.covariance is not None and len(at.uncertain):
        covariance = at.covariance[np.ix_(at.uncertain, at.uncertain)]
        blind = np.isnan(np.diag(covariance))
        variance = variance + np.einsum("...a,ab,...b->...", by_value, np.nan_to_num(covariance), by_value)
        if blind.any():
            depends = _depends(by_value, at.q[at.uncertain]) & blind
            variance = np.where(depends.any(axis=-1), np.nan, variance)
            met = depends.reshape(-1, blind.size).any(axis=0)
            unknown = tuple(at.names[i] for i in at.uncertain[met])
    return np.sqrt(np.maximum(variance, 0.0)), unknown


def _depends(by_value: Array, q: Array) -> NDArray[np.bool_]:
    """Tell which samples of an output depend on which values (..., k, a), beyond rounding."""
    effect = np.abs(by_value) * np.where(q != 0, np.abs(q), 1.0)
    largest = np.nanmax(effect, axis=(*range(effect.ndim - 2), -1), initial=0.0)  # of every output
    return ~(effect <= DEPENDS * largest[:, None])


def _window_errors(
    found: LeadIn, slopes: Array, known: Array, at: ModelAtEstimate, n: int
) -> tuple[Array, tuple[str, ...]]:
    """Return the standard errors (w, samples, k) of the outputs; the states follow the parameters by the lead-in."""
    by_state, by_value = slopes[..., :n], slopes[..., n:]
    weight = np.linalg.inv(np.linalg.cholesky(found.noise))
    masked = np.where(np.moveaxis(known, 0, -1)[..., None], slopes, 0.0)
    lead = int(np.flatnonzero(np.logical_or.reduce(known.reshape(-1, known.shape[2]))).max(initial=0)) + 1
    J = np.einsum("ij,wtjv->wtiv", weight, masked[:, :lead])
    mixed = np.einsum("wtin,wtia->wna", J[..., :n], J[..., n:])
    follow = -np.einsum("wij,wja->wia", found.covariance, mixed)
    variance = np.einsum("wtkn,wnm,wtkm->wtk", by_state, found.covariance, by_state, optimize=True)
    return _errors(by_value + np.einsum("wtkn,wna->wtka", by_state, follow), variance, at)


def _first_guesses(at: ModelAtEstimate, outputs: tuple[str, ...], past: Array) -> list[Array]:
    """Return states (w, n) to begin with, the next ones for windows in which a model has no finite value there.

    States of an output's name are what was first measured; others zero, as the fit found them, or of the outputs' size.
    """
    initial = {} if at.part is None else at.part.initial
    size = float(np.nanmean(np.abs(past))) or 1.0
    others = [np.zeros(len(at.system.states))]
    others.append(np.array([float(np.mean(initial.get(name, 0.0))) for name in at.system.states]))
    others += [np.full(len(at.system.states), factor * size) for factor in FACTORS]
    guesses = [np.tile(values, (len(past), 1)) for values in others]
    for i, name in enumerate(at.system.states):
        if name in outputs:
            values = past[:, :, outputs.index(name)]
            first = np.isfinite(values).argmax(axis=1)
            for guess in guesses:
                guess[:, i] = np.nan_to_num(values[np.arange(len(values)), first])
    return guesses


def _spread(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(there.std()) or 1.0


def _substeps(at: ModelAtEstimate, step: float) -> int:
    """Return the substeps of a sample that the poles at rest ask for."""
    n, m = len(at.system.states), len(at.system.inputs)
    if not n:
        return 1
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", m)
    jacobian = ca.Function("A", [x, u], [ca.densify(ca.jacobian(at.system.derivative(x, u, at.p), x))])
    matrix = jacobian(np.full(n, 1e-3), np.zeros(m)).full()
    if not np.all(np.isfinite(matrix)):
        return 1
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
    return int(np.clip(math.ceil(fastest * step / ACCURATE), 1, FIRST))
