"""Gauss-Newton steps for problems in time, alone or together with frequency responses.

Every iteration linearizes all records at their nodes, eliminates the nodes and solves a small quadratic program for the
parameters, within bounds and constraints. Far from the answer continuity is not demanded but weighted (the nodes stay
close to the data, so that an unstable or wrong model does not run away), and then more and more until it holds exactly.
Where Newton steps cannot close what is left, the records are simulated from their first states instead, and predictors,
which forget them, always are. Of a long record, some stretches lead to the neighborhood of the answer before all of it
is used.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.kalman_gain import predictor
from greybox.compiled.record_part import Path, Place, RecordPart
from greybox.compiled.sensitivities import Blocks
from greybox.solve.constraints import Limits
from greybox.solve.gauss_newton.evaluation import Points
from greybox.solve.gauss_newton.iterate import (
    LAST,
    SETTLED,
    SHORT,
    TIGHTEN,
    Move,
    Point,
    Progress,
    held_back,
    largest_multiplier,
    next_damping,
    promised,
)
from greybox.solve.gauss_newton.predictors import are_stable, best_gains, followed, within
from greybox.solve.ipopt import SMOOTHING, Outcome
from greybox.solve.quadratic_program import solve_small_qp

Array = NDArray[np.float64]
SPREAD = 0.1  # of a signal's spread: the output error assumed until continuity holds
LOOSE = 3.0  # first standard deviation of continuity, relative to the size of the states
ITERATIONS = 100
SHORTEST, SHRINK = 1e-3, 0.4  # step, as a share of the whole, that is tried; and what the next is of the last
BLOCKED = 1e2  # damping from which steps may be blocked by a jump of the cost
STUBBORN = 1e6  # damping beyond which nothing is tried any more
PREDICTING = 0.5  # scale of continuity below which predictors alone are followed
BRIEF = 0.1  # of a step: where less is taken before, predictors had better be followed at once
TOLERANCE = 1e-8  # of half a step's length squared, in standard errors, and of the decrease of the cost
ROUNDING = 1e-9  # of the cost
STILL = 1e-10  # curvature by which a parameter that changes nothing keeps its value
UNNOTICED = 0.1  # of the cost
NEAR = 1.0  # decrease of the cost below which the estimated noise is known to follow the parameters
LONG = 20000  # samples from which some stretches go before the whole record
DIVERGING = np.errstate(over="ignore", invalid="ignore", divide="ignore")  # trial steps may, and are then shortened


@dataclass(frozen=True, eq=False)
class Profile:
    """The best states of every record at given parameters: those of the smallest cost with exact continuity."""

    z: Array
    places: tuple[Place, ...]
    paths: tuple[Path, ...]
    cost: float
    converged: bool


class GaussNewton:
    """The solver of one compiled problem that has records."""

    def __init__(self, nlp: Nlp, records: tuple[RecordPart, ...] | None = None) -> None:
        """Build what every run shares; `records` stand in for those of the problem."""
        self._nlp = nlp
        self._records: tuple[RecordPart, ...] = records or nlp.records
        self._weights = [part.part.weight for part in self._records]
        self._predictors = [predictor(part) for part in self._records]
        added = {name for p in self._predictors if p is not None for name in p.names}
        self._gains = np.array([name in added for name in nlp.free])
        jumping = {name for part in self._records for name in part.jumping}
        self._jumping = np.array([name in jumping for name in nlp.free])
        z, s = nlp.expressions["x"], nlp.expressions["p"]
        f, g = nlp.expressions["f"], nlp.expressions["g"]
        self._smooth = ca.Function("f", [z, s], [f])
        self._curvature = ca.Function("curvature", [z, s], [*reversed(ca.hessian(f, z))])
        constraints = ca.Function("constraints", [z], [g, ca.densify(ca.jacobian(g, z))])
        self._limits = Limits(nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper), constraints)
        self._points = Points(self._records, lambda z, smoothing: float(self._smooth(z, smoothing)), self._limits)
        samples = sum(part.experiment.measured.shape[1] for part in self._records)
        thinned = tuple(part.thinned(LONG // 2) for part in self._records) if samples > LONG else None
        self._coarse = GaussNewton(nlp, thinned) if thinned and records is None else None

    @DIVERGING
    def run(self, start: Array, iterations: int = ITERATIONS) -> Outcome:
        """Solve from the parameters `start` (p,) in so many `iterations`."""
        began = time.perf_counter()
        z, before = self._limits.nearest(self._nlp.scaling.to_solver(start)), 0
        if self._coarse is not None:
            first = self._coarse.run(start, iterations)
            z, before = self._nlp.scaling.to_solver(first.estimate), first.iterations
        return self._solved(
            self._points.near_data(z), Progress(near=self._coarse is not None), iterations, before, began
        )

    @DIVERGING
    def run_simulated(
        self, start: Array, nodes: Sequence[Array] | None = None, iterations: int = ITERATIONS
    ) -> Outcome | None:
        """Solve from a simulation at the parameters `start` (p,); None where it diverges.

        It begins with the first of the `nodes` of every stretch, those that the data show by default. Limits that a
        model reaches at times, and nodes close to the data would hide, are so seen at once.
        """
        began = time.perf_counter()
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        first = self._points.near_data(z) if nodes is None else self._points.at(z, nodes)
        point = self._points.simulated(*first.origin) if first.finite else first
        if not self._points.stays(point) or not are_stable(self._predictors, point):
            return None
        return self._solved(point, Progress(patience=0, scale=0.0), iterations, 0, began)

    def _solved(self, point: Point, at: Progress, iterations: int, before: int, began: float) -> Outcome:
        start = point
        try:
            point, status, last = self._descend(point, at, frozen=False, iterations=iterations)
        except np.linalg.LinAlgError:
            x = self._nlp.scaling.to_parameters(start.z)
            return Outcome(x, "singular", before, time.perf_counter() - began, False, math.inf)
        estimate = np.clip(self._nlp.scaling.to_parameters(point.z), self._nlp.lower, self._nlp.upper)
        cost = self._points.cost(point, 0.0)
        if status == "converged" and self._limits.missed(point.z) > 0:
            status = "constraints missed"
        if status == "converged" and not are_stable(self._predictors, point):
            status = "unstable predictor"
        converged = status == "converged" and math.isfinite(cost)
        nodes = tuple(path.nodes for path in point.paths)
        seconds = time.perf_counter() - began
        return Outcome(estimate, status, before + last, seconds, converged, cost, self._points.trace(point), nodes)

    @DIVERGING
    def begins(self, start: Array) -> bool:
        """Tell whether the model is finite at the parameters `start` (p,), near the data."""
        if self._coarse is not None:
            return self._coarse.begins(start)
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        return self._points.near_data(z).finite

    @DIVERGING
    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the best states at the parameters x (p,); `nodes`, if given, are known to be the best."""
        z = self._nlp.scaling.to_solver(x)
        status = "converged"
        if nodes is not None:
            point = self._points.at(z, nodes)
        else:
            try:
                point, status, _ = self._descend(self._points.near_data(z), Progress(), frozen=True)
            except np.linalg.LinAlgError:
                point, status = self._points.at(z, self._rest(math.nan)), "singular"
        found = status == "converged" and are_stable(self._predictors, point)
        return Profile(z, point.places, point.paths, self._points.cost(point, 0.0), found)

    @DIVERGING
    def smoothed(self, z: Array) -> tuple[list[Array] | None, list[Array]]:
        """Return states (n, samples) close to the data at z, None where they diverge; and weights to begin with."""
        point = self._points.near_data(z)
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        at = Progress()
        try:
            for k in range(3 if point.finite else 0):
                blocks = self._points.linearized(point, assumed)
                if k == 0:
                    at.begin(point, self._soft(blocks))
                point = self._points.moved(point, self._move(point, blocks, at, still=True), 1.0)
        except np.linalg.LinAlgError:
            return None, assumed
        if not point.finite:
            return None, assumed
        return [
            part.shooting.in_order(path.states) for part, path in zip(self._records, point.paths, strict=True)
        ], assumed

    @DIVERGING
    def flat(self, x: Array, nodes: Sequence[Array], factor: float) -> list[Array]:
        """Return directions (p,) of the solver's variables along which a change by `factor` would not be noticed."""
        z = self._nlp.scaling.to_solver(x)
        point = self._points.at(z, nodes)
        try:
            blocks = self._points.linearized(point, self._points.noise_weights(point))
            at = Progress(patience=0, scale=0.0)
            at.begin(point, self._soft(blocks))
            hessian = self._move(point, blocks, at, still=False).hessian
        except np.linalg.LinAlgError:
            return []
        values, vectors = np.linalg.eigh(hessian)
        unnoticed = values / np.abs(vectors).max(axis=0) ** 2 * math.log(factor) ** 2 / 2 < UNNOTICED
        return [v / np.abs(v).max() * math.log(factor) for v in vectors.T[unnoticed]]

    def trace(self, x: Array) -> Array | None:
        """Return what `Outcome.trace` holds, at the best states for x (p,); None where there are none."""
        found = self.profile(x)
        point = Point(self._nlp.scaling.to_solver(x), found.places, found.paths)
        return self._points.trace(point) if found.converged else None

    def _rest(self, value: float) -> list[Array]:
        return [np.full((part.experiment.segments, part.states), value) for part in self._records]

    def _descend(
        self, point: Point, at: Progress, frozen: bool, iterations: int = ITERATIONS, again: bool = False
    ) -> tuple[Point, str, int]:
        """Iterate from a point; with `frozen` the states alone."""
        if not point.finite:
            return point, "not finite at the start", 0
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        blocks = self._points.linearized(point, assumed)
        at.begin(point, self._soft(blocks))
        at.least = PREDICTING if all(self._predictors) else at.least
        end, status, count = self._iterate(point, None if at.exact else blocks, at, assumed, frozen, iterations)
        if status != "stalled" or frozen or again:
            return end, status, count
        left = iterations - count  # the parameters that were found may do with nodes that are closer to the data
        later, status, more = self._descend(self._points.near_data(end.z), Progress(), frozen, left, again=True)
        return (later, status, count + more) if status == "converged" else (end, "stalled", count + more)

    def _iterate(
        self,
        point: Point,
        blocks: list[Blocks] | None,
        at: Progress,
        assumed: Sequence[Array],
        frozen: bool,
        iterations: int,
    ) -> tuple[Point, str, int]:
        for iteration in range(iterations):
            weights = self._points.noise_weights(point) if at.exact else assumed
            move = self._move(
                point, blocks or self._points.linearized(point, weights, at.last < NEAR), at, frozen or at.patience > 0
            )
            blocks = None
            merit = self._merit(weights, at)
            before = merit(point)
            settled = self._is_settled(point, move, before, at)
            if settled and move.distance <= TOLERANCE:
                return point, "converged", iteration
            trial, length = self._search(point, move, merit, before, at)
            if trial is None and settled and move.distance <= 1e3 * TOLERANCE:
                return point, "converged", iteration
            if trial is None and at.damping <= STUBBORN:
                at.damping = max(100 * at.damping, 1e-2)
                continue
            if length < SHORT and (simulated := self._simulated(point, at)):
                point = simulated
                continue
            if at.damping >= BLOCKED and self._jumping.any() and at.hold():
                continue
            if at.exact and (trial is None or at.damping > STUBBORN):
                return point, "stalled", iteration
            gained = 0.0 if trial is None else before - merit(trial)
            point = trial or point
            at.damping = next_damping(at.damping, length, gained / move.predicted if move.predicted > 0 else 1.0)
            if not at.exact:
                point = self._tightened(point, move, at, gained, length, before, frozen)
                continue
            point = followed(self._predictors, point)
            if self._has_converged(point, move, at, length):
                return point, "converged", iteration + 1
        return point, "iterations exceeded", iterations

    def _is_settled(self, point: Point, move: Move, before: float, at: Progress) -> bool:
        """Tell whether little is left to gain, also by a step that is not damped."""
        small = max(TOLERANCE, ROUNDING * abs(before))
        return at.exact and (1 + at.damping) * move.predicted <= small and self._points.is_continuous(point)

    def _tightened(
        self, point: Point, move: Move, at: Progress, gained: float, length: float, before: float, frozen: bool
    ) -> Point:
        """Demand more continuity where it is time; gains are chosen once it is exact."""
        done = move.predicted <= SETTLED * abs(before) or length == 0
        at.damping = at.damping if length else 0.0
        at.stepped(point, move.predicted, gained, length, done or (all(self._predictors) and length < BRIEF))
        if not at.exact:
            return point
        return followed(self._predictors, point if frozen else self._with_gains(point, at))

    def _has_converged(self, point: Point, move: Move, at: Progress, length: float) -> bool:
        """Tell whether the step to `point` was the last: at worst, the next decrease follows from the last two."""
        if length < 1 or at.damping:
            at.last = math.nan
            return False
        predicted = max(move.predicted, move.distance)
        following = predicted**2 / at.last if predicted < at.last < 1 else math.inf
        at.last = predicted
        return following <= TOLERANCE and self._points.is_continuous(point)

    def _soft(self, blocks: Sequence[Blocks]) -> list[Array]:
        """Return the variances by which states must change to change the outputs of a segment by their spread."""
        variances = []
        for part, block in zip(self._records, blocks, strict=True):
            seen = np.nan_to_num(np.mean(block.corner.diagonal(axis1=1, axis2=2), axis=0))
            signal = part.experiment.segment * len(part.outputs) / SPREAD**2
            # A state that no output shows has no such scale: any will do.
            variances.append(np.where(seen > 1e-200, LOOSE**2 * signal / np.maximum(seen, 1e-200), 1.0))
        return variances

    def _search(
        self, point: Point, move: Move, merit: Callable[[Point], float], before: float, at: Progress
    ) -> tuple[Point | None, float]:
        """Shorten the step until the merit does not grow (None where no step does), gaps closed where that helps."""
        length, enough = 1.0, before + ROUNDING * max(1.0, abs(before))
        while length > SHORTEST:
            trial = self._points.moved(point, move, length)
            if merit(trial) <= enough:
                return trial, length
            if at.exact:
                trial = self._points.closed(trial, move, at.force, 0.01 * length * move.predicted)
                if merit(trial) <= enough:
                    return trial, length
            length *= SHRINK
        return None, 0.0

    def _simulated(self, point: Point, at: Progress) -> Point | None:
        """Return the best simulation where Newton steps do not close the gaps, None where it diverges.

        From here on every trial is simulated from its first nodes: a path that a stable model always has.
        """
        if at.loose is None or at.start is None:
            return None
        best = min((self._points.simulated(*origin) for origin in (at.loose, at.start)), key=self._points.cost)
        at.loose = None
        if not self._points.stays(best) or not are_stable(self._predictors, best):
            return None
        at.damping, at.last = 0.0, math.nan
        at.force = [np.zeros_like(f) for f in at.force]
        return best

    def _with_gains(self, point: Point, at: Progress) -> Point:
        """Return the point with gains to begin with; without stable ones, continuity is tightened more slowly."""
        if not self._gains.any():
            return point
        z = best_gains(self._predictors, self._weights, point, at.soft, self._limits.clipped)
        point = self._points.at(z, [path.nodes for path in point.paths])
        if at.least == PREDICTING and not are_stable(self._predictors, point):
            at.scale, at.least = TIGHTEN, LAST  # as without a predictor: the model alone leads to the neighborhood
        return point

    def _move(self, point: Point, blocks: Sequence[Blocks], at: Progress, still: bool) -> Move:
        """Return the step of nodes and z; with `still` of the nodes alone. Gains move where continuity is exact."""
        p, soft = len(point.z), at.softness
        reduced, promise = [], 0.0
        hessian, gradient = np.zeros((p, p)), np.zeros(p)
        for k, part in enumerate(self._records):
            gaps = point.paths[k].gaps
            r = part.reduce(blocks[k], point.places[k], gaps, soft[k], at.damping)
            reduced.append(r)
            hessian, gradient = hessian + self._weights[k] * r.hessian, gradient + self._weights[k] * r.gradient
            promise += self._weights[k] * promised(blocks[k], r, gaps, soft[k])
        if still:
            return at.aimed(Move(blocks, reduced, np.zeros(p), promise, 0.0, hessian))
        g, H = (value.full() for value in self._curvature(point.z, SMOOTHING))
        values, vectors = np.linalg.eigh((H + H.T) / 2)
        hessian, gradient = hessian + (vectors * np.abs(values)) @ vectors.T, gradient + g.ravel()
        damped = hessian + at.damping * np.diag(np.diag(hessian)) + STILL * np.eye(p)
        kept = np.zeros(p, dtype=bool) if at.exact else self._gains
        rows, limits = self._limits.around(point.z, kept | self._jumping if at.held else kept)
        dz = solve_small_qp(damped, gradient, rows, limits)
        inside, left = within(self._predictors, point, dz)
        if len(left):
            rows, limits = np.vstack([rows, inside]), np.concatenate([limits, left])
            dz = solve_small_qp(damped, gradient, rows, limits)
        at.penalty = max(at.penalty, 1.2 * largest_multiplier(damped @ dz + gradient, rows, rows @ dz - limits))
        half = 0.5 * float(dz @ hessian @ dz)
        promise += at.penalty * self._limits.missed(point.z) - float(gradient @ dz) - half
        promise += sum(w * held_back(r, dz) for w, r in zip(self._weights, reduced, strict=True))
        return at.aimed(Move(blocks, reduced, dz, promise, half, hessian))

    def _merit(self, weights: Sequence[Array], at: Progress) -> Callable[[Point], float]:
        """Return what a step must not increase: the cost and the gaps, absolute where continuity is exact."""
        soft = at.softness

        def missed(point: Point) -> float:
            return at.penalty * self._limits.missed(point.z)

        def exactly(point: Point) -> float:
            if not point.finite or not are_stable(self._predictors, point, followed=True):
                return math.inf
            return self._points.cost(point) + self._points.gap_cost(point, at.force) + missed(point)

        def softly(point: Point) -> float:
            if not point.finite:
                return math.inf
            total = float(self._smooth(point.z, SMOOTHING)) + missed(point)
            for k, path in enumerate(point.paths):
                squares = float(np.trace(weights[k] @ path.products @ weights[k].T))
                squares += float((path.gaps**2 / soft[k]).sum())
                total += self._weights[k] * squares / 2
            return total

        return exactly if at.exact else softly
