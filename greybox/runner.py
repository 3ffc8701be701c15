"""A model run over stretches or windows of a record: outputs and states, accurate in time, and standard errors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.case import Case
from greybox.experiment import Experiment, Stretch
from greybox.flow import Flow
from greybox.integrator import Integrator
from greybox.lead_in import LeadIn, estimate_states, one_step_errors
from greybox.output_error import PredictionError, TimeCriterion
from greybox.sample import SampleStep, sample_step
from greybox.windows import Windows, sample_data

Array = NDArray[np.float64]
ACCURATE, FIRST = 0.1, 8  # largest |pole| · substep to begin with, and most substeps then
TOLERANCE = 1e-7  # of a state's size: what half as long substeps may change in one sample
MOST = 64  # substeps
CHECKED = 400  # samples at which the substeps are checked
DIVERGED = 1e9  # no state in SI units is that large
LARGEST = 1e100  # derivative of an output that still means something
SINGULAR = 1e-10  # relative singular value from which a free simulation does not show its initial state
ERROR = "_error"


@dataclass(frozen=True, eq=False)
class Found:
    """Of every sample in the windows, lead-ins included: (w, samples, k) or (w, samples, n)."""

    lead_in: LeadIn
    outputs: Array
    states: Array
    error: Array
    one_step: Array


class Runner:
    """The compiled sample of a case, with as many substeps as it turns out to need."""

    def __init__(self, at: Case, criterion: TimeCriterion, outputs: tuple[str, ...], integrator: Integrator) -> None:
        if not isinstance(integrator, Integrator):
            raise TypeError(f"integrator is {integrator!r:.60}: give RungeKutta() or Rosenbrock().")
        self._at, self._criterion, self._outputs, self._integrator = at, criterion, outputs, integrator
        self._substeps = integrator.substeps or 0
        self._samples: dict[int, SampleStep] = {}

    def free_run(self, stretch: Stretch, start: Array, own: bool) -> dict[str, Array]:
        """Simulate one stretch from the states `start` (n,); return outputs, errors and states by name."""
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
        if at.covariance is not None and not has_left(found).any():
            slopes = flow.slopes(start[None], at.q, data)[0]
            error = _errors(*_initial_by_parameters(at, stretch, slopes, self._outputs, own), at)
            found |= {name + ERROR: row for name, row in zip(self._outputs, error.T, strict=True)}
        return found

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
                _first_guess(at, self._outputs, past),
                at.noise(self._outputs),
                spread,
            )
            whole, columns = Flow(step, w, length, at.uncertain), _columns(data, known, length)
            return (found, whole), columns, *whole.simulate(found.states, at.q, columns)

        (found, whole), columns, states, outputs = self._accurate(windows.record.step, run)
        slopes = whole.slopes(found.states, at.q, columns)
        error = _window_errors(found, slopes, known, at, n)
        e, by_state = measured - outputs, slopes[..., :n]
        if isinstance(self._criterion, PredictionError):  # whose corrections go on where one step ahead is meant
            columns = _columns(data, there, length)
            e = measured - whole.simulate(found.states, at.q, columns)[1]
            by_state = whole.slopes(found.states, at.q, columns)[..., :n]
        one_step = one_step_errors(e, by_state, found.mean - found.states, found.precision, found.noise)
        return Found(found, outputs, states, error, one_step)

    def _accurate(self, step: float, run: Any) -> Any:
        """Run with more and more substeps until half as long ones change no sample noticeably."""
        fixed = self._integrator.substeps is not None
        self._substeps = self._substeps or _substeps(self._at, step)
        while True:
            found, data, states, outputs = run(self._sample(self._substeps))
            if fixed or not states.size or self._substeps >= MOST or not np.all(np.isfinite(states)):
                return found, data, states, outputs
            error = self._local_error(states, data)
            if error <= TOLERANCE:
                return found, data, states, outputs
            growth = (error / TOLERANCE) ** (1 / self._integrator.order)
            self._substeps = min(MOST, self._substeps * int(np.clip(math.ceil(growth), 2, 8)))

    def _local_error(self, states: Array, data: ca.DM) -> float:
        """Return the largest change of a state in one sample by half as long substeps, relative to its size."""
        flat = states.reshape(-1, states.shape[2]).T
        count = flat.shape[1]
        some = np.unique(np.linspace(0, count - 1, min(count, CHECKED)).astype(int)).tolist()
        x = flat[:, some]
        coarse, fine = (
            np.asarray(self._sample(k).function(x, self._at.q, data[:, some])[0])
            for k in (self._substeps, 2 * self._substeps)
        )
        size = np.abs(x).max(axis=1, initial=0.0)
        size = np.maximum(size, 1e-6 * size.max(initial=0.0))
        size = np.where(size > 0, size, 1.0)
        return float(np.max(np.abs(fine - coarse) / size[:, None], initial=0.0))

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
    at: Case, stretch: Stretch, slopes: Array, outputs: tuple[str, ...], own: bool
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


def _errors(by_value: Array, variance: Array, at: Case) -> Array:
    """Return the standard errors (..., k) from derivatives (..., k, a) and the variance (..., k) of the states."""
    if at.covariance is not None and len(at.uncertain):
        covariance = at.covariance[np.ix_(at.uncertain, at.uncertain)]
        variance = variance + np.einsum("...a,ab,...b->...", by_value, covariance, by_value)
    return np.sqrt(np.maximum(variance, 0.0))


def _window_errors(found: LeadIn, slopes: Array, known: Array, at: Case, n: int) -> Array:
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


def _first_guess(at: Case, outputs: tuple[str, ...], past: Array) -> Array:
    """Return states (w, n) to begin with: zero, or what was first measured where an output bears the state's name."""
    start = np.zeros((len(past), len(at.system.states)))
    for i, name in enumerate(at.system.states):
        if name in outputs:
            values = past[:, :, outputs.index(name)]
            first = np.isfinite(values).argmax(axis=1)
            start[:, i] = np.nan_to_num(values[np.arange(len(values)), first])
    return start


def _spread(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(there.std()) or 1.0


def _substeps(at: Case, step: float) -> int:
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
