"""Gauss-Newton steps for problems in time, alone or together with frequency responses.

Every iteration linearizes all records at their nodes, eliminates the nodes and solves a small quadratic program for the
parameters, within bounds and constraints. Far from the answer continuity is not demanded but weighted (the nodes stay
close to the data, so that an unstable or wrong model does not run away), and then more and more until it holds exactly.
Of a long record, some stretches lead to the neighborhood of the answer before all of it is used.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.nlp import Nlp
from greybox.record_part import Path, Place, RecordPart, Reduced
from greybox.shooting import Blocks
from greybox.small_qp import solve_small_qp
from greybox.solve import SMOOTHING, Outcome

Array = NDArray[np.float64]
SPREAD = 0.1  # of a signal's spread: the output error assumed until continuity holds
STAGES = 4  # in which continuity is tightened, each by TIGHTEN in the standard deviation that it may be missed by
TIGHTEN = 0.1
LOOSE = 3.0  # first standard deviation of continuity, relative to the size of the states
SETTLED = 0.1  # relative: how well a step must keep its promise for the next stage to begin
WELL = 0.01  # the same, for it to skip one
ITERATIONS = 100
TOLERANCE = 1e-8  # of half a step's length squared, in standard errors, and of the decrease of the cost
CONTINUOUS = 1e-9  # gap relative to the largest value of the state
ROUNDING = 1e-9  # of the cost
LONG = 20000  # samples from which some stretches go before the whole record
DIVERGING = np.errstate(over="ignore", invalid="ignore", divide="ignore")  # trial steps may, and are then shortened


@dataclass(frozen=True, eq=False)
class _Point:
    """Where an iteration stands: point z, and place and path of every record."""

    z: Array
    places: tuple[Place, ...]
    paths: tuple[Path, ...]

    @property
    def finite(self) -> bool:
        """True when nothing diverged."""
        return all(path.finite for path in self.paths)


@dataclass(frozen=True, eq=False)
class Profile:
    """The best states of every record at given parameters: those of the smallest cost with exact continuity."""

    places: tuple[Place, ...]
    paths: tuple[Path, ...]
    cost: float
    converged: bool


@dataclass(eq=False)
class _Progress:
    """What an iteration hands to the next: stage (-1: states alone), damping, multipliers, last predicted decrease."""

    soft: list[Array]
    force: list[Array]
    stage: int = -1
    damping: float = 0.0
    last: float = math.nan

    @property
    def exact(self) -> bool:
        """True when continuity is demanded."""
        return self.stage >= STAGES

    @property
    def softness(self) -> list[Array]:
        """The variances by which continuity may be missed now."""
        return [np.zeros_like(s) if self.exact else s * TIGHTEN ** (2 * max(self.stage, 0)) for s in self.soft]


class GaussNewton:
    """The solver of one compiled problem that has records."""

    def __init__(self, nlp: Nlp, records: tuple[RecordPart, ...] | None = None) -> None:
        """Build what every run shares; `records` stand in for those of the problem."""
        self._nlp = nlp
        self._records: tuple[RecordPart, ...] = records or nlp.records
        self._weights = [part.part.weight for part in self._records]
        self._low, self._high = nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper)
        z, s = nlp.expressions["x"], nlp.expressions["p"]
        f, g = nlp.expressions["f"], nlp.expressions["g"]
        self._smooth = ca.Function("f", [z, s], [f])
        self._curvature = ca.Function("curvature", [z, s], [*reversed(ca.hessian(f, z))])
        self._limits = ca.Function("limits", [z], [g, ca.densify(ca.jacobian(g, z))])
        samples = sum(part.experiment.measured.shape[1] for part in self._records)
        thinned = tuple(part.thinned(LONG // 2) for part in self._records) if samples > LONG else None
        self._coarse = GaussNewton(nlp, thinned) if thinned and records is None else None

    @DIVERGING
    def run(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        z = np.clip(self._nlp.scaling.to_solver(start), self._low, self._high)
        iterations = 0
        if self._coarse is not None:
            first = self._coarse.run(start)
            z, iterations = self._nlp.scaling.to_solver(first.estimate), first.iterations
        try:
            point, status, last = self._descend(z, frozen=False, near=self._coarse is not None)
        except np.linalg.LinAlgError:
            return Outcome(start, "singular", iterations, time.perf_counter() - began, False, math.inf)
        estimate = np.clip(self._nlp.scaling.to_parameters(point.z), self._nlp.lower, self._nlp.upper)
        cost = self._cost(point, smoothing=0.0)
        converged = status == "converged" and math.isfinite(cost)
        nodes = tuple(path.nodes for path in point.paths)
        seconds = time.perf_counter() - began
        return Outcome(estimate, status, iterations + last, seconds, converged, cost, self._trace(point), nodes)

    @DIVERGING
    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the best states at the parameters x (p,); `nodes`, if given, are known to be the best."""
        z = self._nlp.scaling.to_solver(x)
        status = "converged"
        if nodes is not None:
            point = self._point(z, nodes)
        else:
            try:
                point, status, _ = self._descend(z, frozen=True)
            except np.linalg.LinAlgError:
                point, status = self._point(z, self._rest(math.nan)), "singular"
        return Profile(point.places, point.paths, self._cost(point, smoothing=0.0), status == "converged")

    def smoothed(self, z: Array) -> tuple[list[Array] | None, list[Array]]:
        """Return states (n, samples) close to the data at z, None where they diverge; and weights to begin with."""
        point = self._point(z, self._rest(0.0))
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        try:
            for _ in range(3 if point.finite else 0):
                blocks = self._linearized(point, assumed)
                reduced, dz, *_ = self._step(point, blocks, self._begun(blocks).soft, 0.0, still=True)
                point = self._moved(point, reduced, dz, 1.0, still=True)
        except np.linalg.LinAlgError:
            return None, assumed
        if not point.finite:
            return None, assumed
        return [
            part.shooting.in_order(path.states) for part, path in zip(self._records, point.paths, strict=True)
        ], assumed

    def trace(self, x: Array) -> Array | None:
        """Return what `Outcome.trace` holds, at the best states for x (p,); None where there are none."""
        found = self.profile(x)
        if not found.converged:
            return None
        return self._trace(_Point(self._nlp.scaling.to_solver(x), found.places, found.paths))

    def _rest(self, value: float) -> list[Array]:
        return [np.full((part.experiment.segments, part.states), value) for part in self._records]

    def _trace(self, point: _Point) -> Array:
        """Return simulated outputs in units of the measured ones' spread, thinned, by which runs are told apart."""
        rows = []
        for part, path, place in zip(self._records, point.paths, point.places, strict=True):
            step = max(place.data.shape[1] // 500, 1)
            outputs = part.shooting.outputs(path.states[:, ::step], place.q, place.data[:, ::step])
            rows.append((outputs / part.noise.spread[:, None]).ravel())
        return np.concatenate(rows)

    def _point(self, z: Array, nodes: Sequence[Array]) -> _Point:
        places = tuple(part.place(z) for part in self._records)
        paths = tuple(part.path(n, place) for part, n, place in zip(self._records, nodes, places, strict=True))
        return _Point(z, places, paths)

    def _cost(self, point: _Point, smoothing: float) -> float:
        if not point.finite:
            return math.inf
        costs = (
            weight * part.noise.cost(path.products)
            for weight, part, path in zip(self._weights, self._records, point.paths, strict=True)
        )
        return float(sum(costs)) + float(self._smooth(point.z, smoothing))

    def _descend(self, z: Array, frozen: bool, near: bool = False) -> tuple[_Point, str, int]:
        """Iterate from z and states of zero; with `frozen` the states alone; `near` where z is close to the answer."""
        point = self._point(z, self._rest(0.0))
        if not point.finite:
            return point, "not finite at the start", 0
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        blocks = self._linearized(point, assumed)
        at = self._begun(blocks)
        for iteration in range(ITERATIONS):
            exact, still = at.exact, frozen or at.stage < 0
            weights = self._noise_weights(point) if exact else assumed
            blocks = self._linearized(point, weights) if iteration else blocks
            softness = at.softness
            reduced, dz, predicted, distance = self._step(point, blocks, softness, at.damping, still)
            if exact:
                at.force = [np.maximum(f, 1.2 * _largest(r, dz)) for f, r in zip(at.force, reduced, strict=True)]
            merit = self._merit(weights, softness, at.force, exact)
            before = merit(point)
            settled = predicted <= max(TOLERANCE, ROUNDING * abs(before)) and self._is_continuous(point)
            if exact and settled and distance <= TOLERANCE:
                return point, "converged", iteration
            trial, length = self._search(point, reduced, dz, still, merit, before)
            if trial is None and exact:
                return point, "converged" if settled and distance <= 1e3 * TOLERANCE else "stalled", iteration
            gained = 0.0 if trial is None else before - merit(trial)
            point = trial or point
            at.damping = _next_damping(at.damping, length)
            if not exact:
                kept = length == 1.0 and abs(gained - predicted) <= SETTLED * predicted
                done = trial is None or frozen or kept or predicted <= SETTLED * abs(before)
                well = trial is not None and length == 1.0 and abs(gained - predicted) <= WELL * predicted
                at.stage = STAGES if done and near else at.stage + done + (done and well and at.stage >= 0)
            elif length == 1.0:
                # Gauss-Newton converges linearly at worst: the next decrease follows from the last two.
                following = max(predicted, distance) ** 2 / at.last if predicted < at.last < 1 else math.inf
                if following <= TOLERANCE and self._is_continuous(point):
                    return point, "converged", iteration + 1
                at.last = max(predicted, distance)
        return point, "iterations exceeded", ITERATIONS

    def _linearized(self, point: _Point, weights: Sequence[Array]) -> list[Blocks]:
        return [
            part.linearize(path, place, weight)
            for part, path, place, weight in zip(self._records, point.paths, point.places, weights, strict=True)
        ]

    def _begun(self, blocks: Sequence[Blocks]) -> _Progress:
        variances = []
        for part, block in zip(self._records, blocks, strict=True):
            # The variance by which states must change to change the outputs of a segment by their spread.
            seen = np.nan_to_num(np.mean(block.corner.diagonal(axis1=1, axis2=2), axis=0))
            signal = part.experiment.segment * len(part.outputs) / SPREAD**2
            variances.append(LOOSE**2 * signal / np.maximum(seen, 1e-300))
        return _Progress(variances, [np.zeros(part.states) for part in self._records])

    def _search(
        self,
        point: _Point,
        reduced: Sequence[Reduced],
        dz: Array,
        still: bool,
        merit: Callable[[_Point], float],
        before: float,
    ) -> tuple[_Point | None, float]:
        """Halve the step until the merit does not grow; None where no step does."""
        length = 1.0
        while length > 1e-7:
            trial = self._moved(point, reduced, dz, length, still)
            if merit(trial) <= before + ROUNDING * max(1.0, abs(before)):
                return trial, length
            length /= 2
        return None, 0.0

    def _noise_weights(self, point: _Point) -> list[Array]:
        return [part.noise.weight(path.products) for part, path in zip(self._records, point.paths, strict=True)]

    def _is_continuous(self, point: _Point) -> bool:
        return all(
            np.all(np.abs(p.gaps).max(axis=0, initial=0.0) <= CONTINUOUS * np.abs(p.states).max(axis=1, initial=0.0))
            for p in point.paths
        )

    def _step(
        self, point: _Point, blocks: Sequence[Blocks], soft: Sequence[Array], damping: float, still: bool
    ) -> tuple[list[Reduced], Array, float, float]:
        """Return the reduced systems, the step (p,) of z, the decrease that it promises, and half its length squared.

        The length is in standard errors, where the cost is a likelihood.
        """
        p = len(point.z)
        reduced, promise = [], 0.0
        hessian, gradient = np.zeros((p, p)), np.zeros(p)
        for k, part in enumerate(self._records):
            gaps = point.paths[k].gaps
            r = part.reduce(blocks[k], point.places[k], gaps, soft[k])
            reduced.append(r)
            hessian, gradient = hessian + self._weights[k] * r.hessian, gradient + self._weights[k] * r.gradient
            promise += self._weights[k] * _promise(blocks[k], r, gaps, soft[k])
        if still:
            return reduced, np.zeros(p), promise, 0.0
        g, H = (value.full() for value in self._curvature(point.z, SMOOTHING))
        values, vectors = np.linalg.eigh((H + H.T) / 2)
        hessian, gradient = hessian + (vectors * np.abs(values)) @ vectors.T, gradient + g.ravel()
        limit, normal = (value.full() for value in self._limits(point.z))
        rows = np.vstack([np.eye(p), -np.eye(p), normal])
        limits = np.concatenate([self._low - point.z, point.z - self._high, -limit.ravel()])
        there = np.isfinite(limits)
        damped = hessian + damping * np.diag(np.diag(hessian))
        dz = solve_small_qp(damped, gradient, rows[there], np.minimum(limits[there], 0.0))
        half = 0.5 * float(dz @ hessian @ dz)
        return reduced, dz, promise - float(gradient @ dz) - half, half

    def _moved(self, point: _Point, reduced: Sequence[Reduced], dz: Array, length: float, still: bool) -> _Point:
        nodes = [
            part.moved(path.nodes, r, dz, length)
            for part, path, r in zip(self._records, point.paths, reduced, strict=True)
        ]
        z = point.z if still else np.clip(point.z + length * dz, self._low, self._high)
        return self._point(z, nodes)

    def _merit(
        self, weights: Sequence[Array], soft: Sequence[Array], force: Sequence[Array], exact: bool
    ) -> Callable[[_Point], float]:
        """Return what a step must not increase: the cost and the gaps, absolute where continuity is exact."""

        def exactly(point: _Point) -> float:
            gaps = sum(
                w * float((np.abs(p.gaps) * f).sum()) for w, p, f in zip(self._weights, point.paths, force, strict=True)
            )
            return self._cost(point, SMOOTHING) + gaps + self._violation(point.z)

        def softly(point: _Point) -> float:
            if not point.finite:
                return math.inf
            total = float(self._smooth(point.z, SMOOTHING)) + self._violation(point.z)
            for k, path in enumerate(point.paths):
                squares = float(np.trace(weights[k] @ path.products @ weights[k].T))
                squares += float((path.gaps**2 / soft[k]).sum())
                total += self._weights[k] * squares / 2
            return total

        return exactly if exact else softly

    def _violation(self, z: Array) -> float:
        limit = self._limits(z)[0].full()
        return 1e3 * float(np.maximum(-limit, 0).sum())


def _largest(reduced: Reduced, dz: Array) -> Array:
    return np.abs(reduced.force + reduced.force_follow @ (reduced.slope @ dz)).max(axis=0, initial=0.0)


def _promise(blocks: Blocks, reduced: Reduced, gaps: Array, soft: Array) -> float:
    """Return the decrease that the move of the nodes alone promises."""
    x = reduced.step
    curved = float((x * (blocks.corner @ x[:, :, None])[:, :, 0]).sum())
    change = float((blocks.gradient * x).sum()) + 0.5 * curved
    if np.all(soft > 0):
        missed = soft * reduced.force
        change += 0.5 * float(((missed**2 - gaps**2) / soft).sum())
    return max(-change, 0.0)


def _next_damping(damping: float, length: float) -> float:
    if length == 1.0:
        return damping / 10 if damping > 1e-6 else 0.0
    return max(10 * damping, 1e-4) if length < 0.2 else damping
