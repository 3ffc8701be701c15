"""Gauss-Newton steps for problems in time, alone or together with frequency responses.

Every iteration linearizes all records at their nodes, eliminates the nodes and solves a small quadratic program for the
parameters, within bounds and constraints. Far from the answer continuity is not demanded but weighted (the nodes stay
close to the data, so that an unstable or wrong model does not run away), and then more and more until it holds exactly.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.nlp import Nlp
from greybox.record_part import Place, RecordPart, Reduced
from greybox.small_qp import solve_small_qp
from greybox.solve import SMOOTHING, Outcome

Array = NDArray[np.float64]
SMOOTH = 0.1  # of a signal's spread: output error taken for the first estimate of the states
STAGES = 4  # in which continuity is tightened, each by TIGHTEN in the standard deviation that it may be missed by
TIGHTEN = 0.1
LOOSE = 1.0  # first standard deviation of continuity, relative to the size of the states
SETTLED = 0.1  # predicted relative decrease below which the next stage begins
ITERATIONS = 100
TOLERANCE = 1e-8  # predicted decrease, in units of the cost, or 1e-3 of it relative to the cost


@dataclass(frozen=True, eq=False)
class _Point:
    """Where an iteration stands: point z, nodes of every record, and what follows from them."""

    z: Array
    nodes: tuple[Array, ...]
    places: tuple[Place, ...]
    gaps: tuple[Array, ...]
    products: tuple[Array, ...]
    finite: bool


@dataclass(frozen=True, eq=False)
class Profile:
    """The best node states (s, n) of every record at given parameters, with the sums of residual products (k, k)."""

    nodes: tuple[Array, ...]
    places: tuple[Place, ...]
    products: tuple[Array, ...]
    cost: float
    converged: bool


class GaussNewton:
    """The solver of one compiled problem that has records."""

    def __init__(self, nlp: Nlp) -> None:
        """Build what every run shares."""
        self._nlp = nlp
        self._records: tuple[RecordPart, ...] = nlp.records
        self._weights = [part.part.weight for part in self._records]
        self._low, self._high = nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper)
        z, s = nlp.expressions["x"], nlp.expressions["p"]
        f, g = nlp.expressions["f"], nlp.expressions["g"]
        self._smooth = ca.Function("f", [z, s], [f])
        self._curvature = ca.Function("curvature", [z, s], [*reversed(ca.hessian(f, z))])
        self._limits = ca.Function("limits", [z], [g, ca.densify(ca.jacobian(g, z))])

    def run(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        z = np.clip(self._nlp.scaling.to_solver(start), self._low, self._high)
        try:
            point, status, iterations = self._descend(z, frozen=False)
        except np.linalg.LinAlgError:
            return Outcome(start, "singular", 0, time.perf_counter() - began, False, math.inf)
        estimate = np.clip(self._nlp.scaling.to_parameters(point.z), self._nlp.lower, self._nlp.upper)
        cost = self._cost(point, smoothing=0.0)
        converged = status == "converged" and math.isfinite(cost)
        return Outcome(estimate, status, iterations, time.perf_counter() - began, converged, cost, self._trace(point))

    def profile(self, x: Array) -> Profile:
        """Return the best states at the parameters x (p,): those of the smallest cost with exact continuity."""
        z = self._nlp.scaling.to_solver(x)
        try:
            point, status, _ = self._descend(z, frozen=True)
        except np.linalg.LinAlgError:
            nothing = tuple(np.full((part.experiment.segments, part.states), np.nan) for part in self._records)
            point, status = self._point(z, nothing), "singular"
        cost = self._cost(point, smoothing=0.0)
        return Profile(point.nodes, point.places, point.products, cost, status == "converged")

    def _trace(self, point: _Point) -> Array:
        """Return simulated outputs in units of their residuals, thinned, by which runs are told apart."""
        rows = []
        for part, nodes, place in zip(self._records, point.nodes, point.places, strict=True):
            _, outputs = part.shooting.simulate(nodes, place.q, place.data)
            thinned = outputs[:, :: max(outputs.shape[1] // 500, 1)]
            rows.append((thinned / part.noise.spread[:, None]).ravel())
        return np.concatenate(rows) if rows else np.zeros(0)

    def _point(self, z: Array, nodes: Sequence[Array]) -> _Point:
        places = tuple(part.place(z) for part in self._records)
        pinned = tuple(part.pinned(n, place) for part, n, place in zip(self._records, nodes, places, strict=True))
        ends, products = [], []
        for part, n, place in zip(self._records, pinned, places, strict=True):
            end, product = part.shooting.ends(n, place.q, place.data)
            ends.append(part.gaps(end, n))
            products.append(product)
        finite = all(np.all(np.isfinite(v)) for v in (*ends, *products))
        return _Point(z, pinned, places, tuple(ends), tuple(products), finite)

    def _cost(self, point: _Point, smoothing: float) -> float:
        if not point.finite:
            return math.inf
        costs = (
            weight * part.noise.cost(products)
            for weight, part, products in zip(self._weights, self._records, point.products, strict=True)
        )
        return float(sum(costs)) + float(self._smooth(point.z, smoothing))

    def _descend(self, z: Array, frozen: bool) -> tuple[_Point, str, int]:
        """Iterate from z and states of zero; with `frozen` the states alone."""
        point = self._point(z, [np.zeros((part.experiment.segments, part.states)) for part in self._records])
        if not point.finite:
            return point, "not finite at the start", 0
        first = [np.diag(1 / (SMOOTH * part.noise.spread)) for part in self._records]
        soft = [LOOSE**2 * self._state_variance(part, point, k, first[k]) for k, part in enumerate(self._records)]
        stage, damping, force, hold = 0, 0.0, [np.zeros(part.states) for part in self._records], 3
        for iteration in range(ITERATIONS):
            exact = stage >= STAGES
            weights = (
                [part.noise.weight(products) for part, products in zip(self._records, point.products, strict=True)]
                if exact
                else first
            )
            softness = [np.zeros_like(s) if exact else s * TIGHTEN ** (2 * stage) for s in soft]
            still = frozen or hold > 0
            reduced, dz, predicted = self._step(point, weights, softness, damping, still)
            if exact:
                force = [np.maximum(f, 1.2 * _largest(r, dz)) for f, r in zip(force, reduced, strict=True)]
            merit = self._merit(weights, softness, force, exact)
            before, length = merit(point), 1.0
            trial = self._moved(point, reduced, dz, length, still)
            while not merit(trial) <= before + 1e-10 * max(1.0, abs(before)) and length > 1e-7:
                length /= 2
                trial = self._moved(point, reduced, dz, length, still)
            if length <= 1e-7:
                if not exact:
                    stage, hold = (stage, hold - 1) if hold > 0 else (stage + 1, 0)
                    continue
                return point, "converged" if predicted <= 1e3 * self._tolerance(before) else "stalled", iteration
            damping = _next_damping(damping, length)
            point = trial
            settled = length == 1.0 and predicted <= SETTLED * abs(before)
            if not exact:
                if hold > 0:
                    hold = 0 if settled else hold - 1
                elif settled or frozen:
                    stage += 1
            elif (
                length == 1.0
                and predicted <= self._tolerance(before)
                and self._missed(point, force) <= self._tolerance(before)
            ):
                return point, "converged", iteration + 1
        return point, "iterations exceeded", ITERATIONS

    def _tolerance(self, cost: float) -> float:
        return TOLERANCE * max(1.0, 1e-3 * abs(cost))

    def _missed(self, point: _Point, force: Sequence[Array]) -> float:
        return 1e-2 * sum(float((np.abs(gap) * f).sum()) for gap, f in zip(point.gaps, force, strict=True))

    def _state_variance(self, part: RecordPart, point: _Point, k: int, weight: Array) -> Array:
        """Return the variance (n,) by which states must change to change the outputs of a segment by their spread."""
        blocks = part.linearize(point.nodes[k], point.places[k], weight)
        seen = np.mean(blocks.hessian.diagonal(axis1=1, axis2=2)[:, : part.states], axis=0)
        signal = part.experiment.segment * len(part.outputs) / SMOOTH**2
        return signal / np.maximum(np.nan_to_num(seen), 1e-300)

    def _step(
        self, point: _Point, weights: Sequence[Array], soft: Sequence[Array], damping: float, still: bool
    ) -> tuple[list[Reduced], Array, float]:
        """Return the reduced systems, the step (p,) of z and the decrease that it promises."""
        p = 0 if still else len(point.z)
        reduced = []
        hessian, gradient = np.zeros((p, p)), np.zeros(p)
        promise = 0.0
        for k, part in enumerate(self._records):
            blocks = part.linearize(point.nodes[k], point.places[k], weights[k])
            r = part.reduce(blocks, point.gaps[k], soft[k], frozen=still)
            reduced.append(r)
            hessian, gradient = hessian + self._weights[k] * r.hessian, gradient + self._weights[k] * r.gradient
            promise += self._weights[k] * _promise(blocks, r, part, point.gaps[k], soft[k])
        if still:
            return reduced, np.zeros(0), promise
        g, H = (value.full() for value in self._curvature(point.z, SMOOTHING))
        values, vectors = np.linalg.eigh((H + H.T) / 2)
        hessian, gradient = hessian + (vectors * np.abs(values)) @ vectors.T, gradient + g.ravel()
        limit, normal = (value.full() for value in self._limits(point.z))
        rows = np.vstack([np.eye(p), -np.eye(p), normal])
        limits = np.concatenate([self._low - point.z, point.z - self._high, -limit.ravel()])
        there = np.isfinite(limits)
        damped = hessian + damping * np.diag(np.diag(hessian))
        dz = solve_small_qp(damped, gradient, rows[there], np.minimum(limits[there], 0.0))
        return reduced, dz, promise + float(-gradient @ dz - 0.5 * dz @ hessian @ dz)

    def _moved(self, point: _Point, reduced: Sequence[Reduced], dz: Array, length: float, still: bool) -> _Point:
        nodes = [part.moved(n, r, dz, length) for part, n, r in zip(self._records, point.nodes, reduced, strict=True)]
        z = point.z if still else np.clip(point.z + length * dz, self._low, self._high)
        return self._point(z, nodes)

    def _merit(self, weights: Sequence[Array], soft: Sequence[Array], force: Sequence[Array], exact: bool) -> Any:
        """Return what a step must not increase: the cost and the gaps, absolute where continuity is exact."""

        def exactly(point: _Point) -> float:
            gaps = sum(
                w * float((np.abs(g) * f).sum()) for w, g, f in zip(self._weights, point.gaps, force, strict=True)
            )
            return self._cost(point, SMOOTHING) + gaps + self._violation(point.z)

        def softly(point: _Point) -> float:
            if not point.finite:
                return math.inf
            total = float(self._smooth(point.z, SMOOTHING)) + self._violation(point.z)
            for k, (products, gaps) in enumerate(zip(point.products, point.gaps, strict=True)):
                squares = float(np.trace(weights[k] @ products @ weights[k].T)) + float((gaps**2 / soft[k]).sum())
                total += self._weights[k] * squares / 2
            return total

        return exactly if exact else softly

    def _violation(self, z: Array) -> float:
        limit = self._limits(z)[0].full()
        return 1e3 * float(np.maximum(-limit, 0).sum())


def _largest(reduced: Reduced, dz: Array) -> Array:
    return np.abs(reduced.force + reduced.force_follow @ dz).max(axis=0, initial=0.0)


def _promise(blocks: Any, reduced: Reduced, part: RecordPart, gaps: Array, soft: Array) -> float:
    """Return the decrease that the move of the nodes alone promises."""
    n = part.states
    g, H = blocks.gradient[:, :n], blocks.hessian[:, :n, :n]
    x = reduced.step
    change = float((g * x).sum()) + 0.5 * float(np.einsum("si,sij,sj->", x, H, x))
    if np.all(soft > 0):
        missed = soft * reduced.force
        change += 0.5 * float(((missed**2 - gaps**2) / soft).sum())
    return max(-change, 0.0)


def _next_damping(damping: float, length: float) -> float:
    if length == 1.0:
        return damping / 10 if damping > 1e-6 else 0.0
    return max(10 * damping, 1e-4) if length < 0.2 else damping
