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

from greybox.gains import are_stable, best_gains, followed, predictor, within
from greybox.iterate import (
    PENALTY,
    SETTLED,
    Move,
    Point,
    Progress,
    largest_force,
    largest_multiplier,
    next_damping,
    promised,
)
from greybox.limits import Limits
from greybox.nlp import Nlp
from greybox.record_part import Path, Place, RecordPart
from greybox.shooting import Blocks
from greybox.small_qp import solve_small_qp
from greybox.solve import SMOOTHING, Outcome

Array = NDArray[np.float64]
SPREAD = 0.1  # of a signal's spread: the output error assumed until continuity holds
STAGES = 4  # in which continuity is tightened
PREDICTING = 1  # of them where there are only predictors, which are followed from then on
SHORT = 0.1  # of a step: where less is taken before, predictors had better be followed at once
LOOSE = 3.0  # first standard deviation of continuity, relative to the size of the states
PULLS = 4  # of nodes that leave the domain of the model
ITERATIONS = 100
STUBBORN = 1e6  # damping beyond which nothing is tried any more
CLOSINGS = 5  # of gaps after a step
TOLERANCE = 1e-8  # of half a step's length squared, in standard errors, and of the decrease of the cost
CONTINUOUS = 1e-9  # gap relative to the largest value of the state
ROUNDING = 1e-9  # of the cost
LONG = 20000  # samples from which some stretches go before the whole record
DIVERGING = np.errstate(over="ignore", invalid="ignore", divide="ignore")  # trial steps may, and are then shortened


@dataclass(frozen=True, eq=False)
class Profile:
    """The best states of every record at given parameters: those of the smallest cost with exact continuity."""

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
        z, s = nlp.expressions["x"], nlp.expressions["p"]
        f, g = nlp.expressions["f"], nlp.expressions["g"]
        self._smooth = ca.Function("f", [z, s], [f])
        self._curvature = ca.Function("curvature", [z, s], [*reversed(ca.hessian(f, z))])
        constraints = ca.Function("constraints", [z], [g, ca.densify(ca.jacobian(g, z))])
        self._limits = Limits(nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper), constraints)
        samples = sum(part.experiment.measured.shape[1] for part in self._records)
        thinned = tuple(part.thinned(LONG // 2) for part in self._records) if samples > LONG else None
        self._coarse = GaussNewton(nlp, thinned) if thinned and records is None else None

    @DIVERGING
    def run(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
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
        if status == "converged" and self._limits.missed(point.z) > 0:
            status = "constraints missed"
        if status == "converged" and not are_stable(self._predictors, point):
            status = "unstable predictor"
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

    @DIVERGING
    def smoothed(self, z: Array) -> tuple[list[Array] | None, list[Array]]:
        """Return states (n, samples) close to the data at z, None where they diverge; and weights to begin with."""
        point = self._point(z, [part.first_nodes(part.place(z)) for part in self._records])
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        try:
            for _ in range(3 if point.finite else 0):
                blocks = self._linearized(point, assumed)
                move = self._move(point, blocks, self._begun(blocks).soft, 0.0, still=True, exact=False)
                point = self._moved(point, move, 1.0)
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
        return self._trace(Point(self._nlp.scaling.to_solver(x), found.places, found.paths))

    def _rest(self, value: float) -> list[Array]:
        return [np.full((part.experiment.segments, part.states), value) for part in self._records]

    def _trace(self, point: Point) -> Array:
        """Return simulated outputs in units of the measured ones' spread, thinned, by which runs are told apart."""
        rows = []
        for part, path, place in zip(self._records, point.paths, point.places, strict=True):
            step = max(place.data.shape[1] // 500, 1)
            outputs = part.shooting.outputs(path.states[:, ::step], place.q, place.data[:, ::step])
            rows.append((outputs / part.noise.spread[:, None]).ravel())
        return np.concatenate(rows)

    def _point(self, z: Array, nodes: Sequence[Array], like: Point | None = None) -> Point:
        """Return the point z with the paths from the nodes, followed by predictors where those of `like` are."""
        places = tuple(part.place(z) for part in self._records)
        chosen = [p if like and like.paths[k].followed else None for k, p in enumerate(self._predictors)]
        ways = zip(self._records, chosen, nodes, places, strict=True)
        paths = tuple(part.path(n, place) if p is None else p.followed(n, place) for part, p, n, place in ways)
        return Point(z, places, paths)

    def _cost(self, point: Point, smoothing: float) -> float:
        if not point.finite:
            return math.inf
        costs = (
            weight * part.noise.cost(path.products)
            for weight, part, path in zip(self._weights, self._records, point.paths, strict=True)
        )
        return float(sum(costs)) + float(self._smooth(point.z, smoothing))

    def _descend(self, z: Array, frozen: bool, near: bool = False) -> tuple[Point, str, int]:
        """Iterate from z and the first nodes; with `frozen` the states alone; `near` where z is close to the answer."""
        point = self._point(z, [part.first_nodes(part.place(z)) for part in self._records])
        if not point.finite:
            return point, "not finite at the start", 0
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        blocks = self._linearized(point, assumed)
        at = self._begun(blocks, near)
        for iteration in range(ITERATIONS):
            exact, still = at.exact, frozen or at.stage < 0
            weights = self._noise_weights(point) if exact else assumed
            blocks = self._linearized(point, weights) if iteration else blocks
            softness = at.softness
            move = self._move(point, blocks, softness, at.damping, still, exact, at.penalty)
            if exact:
                at.force = [
                    np.maximum(f, 1.2 * largest_force(r, move.dz)) for f, r in zip(at.force, move.reduced, strict=True)
                ]
            at.penalty = move.penalty
            merit = self._merit(weights, softness, at, exact)
            before = merit(point)
            settled = move.predicted <= max(TOLERANCE, ROUNDING * abs(before)) and self._is_continuous(point)
            if exact and settled and move.distance <= TOLERANCE:
                return point, "converged", iteration
            trial, length = self._search(point, move, merit, before, at.force if exact else None)
            if trial is None and exact:
                if at.damping > STUBBORN or (settled and move.distance <= 1e3 * TOLERANCE):
                    return point, "stalled" if at.damping > STUBBORN else "converged", iteration
                at.damping = max(100 * at.damping, 1e-2)
                continue
            gained = 0.0 if trial is None else before - merit(trial)
            point = trial or point
            kept = gained / move.predicted if exact and move.predicted > 0 else 1.0
            at.damping = next_damping(at.damping, length, kept)
            if not exact:
                at.advance(move.predicted, gained, length, done=frozen or self._settled(move, before, length))
                point = self._with_gains(point, at) if at.exact and not frozen else point
            point = followed(self._predictors, point) if at.exact else point
            if exact and length == 1.0:
                # Gauss-Newton converges linearly at worst: the next decrease follows from the last two.
                predicted = max(move.predicted, move.distance)
                following = predicted**2 / at.last if predicted < at.last < 1 else math.inf
                if following <= TOLERANCE and self._is_continuous(point):
                    return point, "converged", iteration + 1
                at.last = predicted
        return point, "iterations exceeded", ITERATIONS

    def _linearized(self, point: Point, weights: Sequence[Array]) -> list[Blocks]:
        return [
            part.linearize(path, place, weight)
            for part, path, place, weight in zip(self._records, point.paths, point.places, weights, strict=True)
        ]

    def _begun(self, blocks: Sequence[Blocks], near: bool = False) -> Progress:
        variances = []
        for part, block in zip(self._records, blocks, strict=True):
            # The variance by which states must change to change the outputs of a segment by their spread.
            seen = np.nan_to_num(np.mean(block.corner.diagonal(axis1=1, axis2=2), axis=0))
            signal = part.experiment.segment * len(part.outputs) / SPREAD**2
            # A state that no output shows has no such scale: any will do.
            variances.append(np.where(seen > 1e-200, LOOSE**2 * signal / np.maximum(seen, 1e-200), 1.0))
        stages = 0 if near else PREDICTING if all(self._predictors) else STAGES
        return Progress(variances, [np.zeros(part.states) for part in self._records], stages)

    def _search(
        self, point: Point, move: Move, merit: Callable[[Point], float], before: float, force: Sequence[Array] | None
    ) -> tuple[Point | None, float]:
        """Halve the step until the merit does not grow (None where no step does); `force` closes gaps first."""
        length, enough = 1.0, before + ROUNDING * max(1.0, abs(before))
        while length > 1e-7:
            trial = self._moved(point, move, length)
            if merit(trial) <= enough:
                return trial, length
            if force is not None:
                trial = self._closed(trial, move, force, 0.01 * length * move.predicted)
                if merit(trial) <= enough:
                    return trial, length
            length /= 2
        return None, 0.0

    def _closed(self, point: Point, move: Move, force: Sequence[Array], enough: float) -> Point:
        """Return the point with the gaps closed that curvature has left, by the least changes of the outputs.

        They would cut every step short otherwise (Maratos effect; Nocedal and Wright, Numerical Optimization, 15.5).
        """
        cost = self._gap_cost(point, force)
        for _ in range(CLOSINGS):
            if not point.finite or cost <= enough:
                break
            nodes = [
                path.nodes + part.closing(blocks, path.gaps)
                for part, path, blocks in zip(self._records, point.paths, move.blocks, strict=True)
            ]
            closer = self._point(point.z, nodes, point)
            now = self._gap_cost(closer, force)
            if not closer.finite or now > 0.5 * cost:
                break
            point, cost = closer, now
        return point

    def _gap_cost(self, point: Point, force: Sequence[Array]) -> float:
        return sum(
            w * float((np.abs(p.gaps) * f).sum()) for w, p, f in zip(self._weights, point.paths, force, strict=True)
        )

    def _settled(self, move: Move, before: float, length: float) -> bool:
        """Tell whether a stage before continuity is exact has done its work."""
        return move.predicted <= SETTLED * abs(before) or (all(self._predictors) and length < SHORT)

    def _with_gains(self, point: Point, at: Progress) -> Point:
        """Return the point with gains to begin with; without stable ones, more stages follow."""
        if not self._gains.any():
            return point
        z = best_gains(self._predictors, self._weights, point, at.soft, self._limits.clipped)
        point = self._point(z, [path.nodes for path in point.paths])
        if at.stages == PREDICTING and not are_stable(self._predictors, point):
            at.stages = STAGES  # as without a predictor: the model alone has to lead to the neighborhood
        return point

    def _noise_weights(self, point: Point) -> list[Array]:
        return [part.noise.weight(path.products) for part, path in zip(self._records, point.paths, strict=True)]

    def _is_continuous(self, point: Point) -> bool:
        return all(
            np.all(np.abs(p.gaps).max(axis=0, initial=0.0) <= CONTINUOUS * np.abs(p.states).max(axis=1, initial=0.0))
            for p in point.paths
        )

    def _move(
        self,
        point: Point,
        blocks: Sequence[Blocks],
        soft: Sequence[Array],
        damping: float,
        still: bool,
        exact: bool,
        penalty: float = PENALTY,
    ) -> Move:
        """Return the step of nodes and z; with `still` of the nodes alone. Gains move where continuity is exact."""
        p = len(point.z)
        reduced, promise = [], 0.0
        hessian, gradient = np.zeros((p, p)), np.zeros(p)
        for k, part in enumerate(self._records):
            gaps = point.paths[k].gaps
            r = part.reduce(blocks[k], point.places[k], gaps, soft[k])
            reduced.append(r)
            hessian, gradient = hessian + self._weights[k] * r.hessian, gradient + self._weights[k] * r.gradient
            promise += self._weights[k] * promised(blocks[k], r, gaps, soft[k])
        if still:
            return Move(blocks, reduced, np.zeros(p), promise, 0.0, penalty)
        g, H = (value.full() for value in self._curvature(point.z, SMOOTHING))
        values, vectors = np.linalg.eigh((H + H.T) / 2)
        hessian, gradient = hessian + (vectors * np.abs(values)) @ vectors.T, gradient + g.ravel()
        damped = hessian + damping * np.diag(np.diag(hessian))
        rows, limits = self._limits.around(point.z, None if exact else self._gains)
        dz = solve_small_qp(damped, gradient, rows, limits)
        inside, left = within(self._predictors, point, dz)
        if len(left):
            rows, limits = np.vstack([rows, inside]), np.concatenate([limits, left])
            dz = solve_small_qp(damped, gradient, rows, limits)
        penalty = max(penalty, 1.2 * largest_multiplier(damped @ dz + gradient, rows, rows @ dz - limits))
        half = 0.5 * float(dz @ hessian @ dz)
        promise += penalty * self._limits.missed(point.z) - float(gradient @ dz) - half
        return Move(blocks, reduced, dz, promise, half, penalty)

    def _moved(self, point: Point, move: Move, length: float) -> Point:
        nodes = [
            part.moved(path.nodes, r, move.dz, length)
            for part, path, r in zip(self._records, point.paths, move.reduced, strict=True)
        ]
        z = self._limits.clipped(point.z + length * move.dz) if move.dz.any() else point.z
        return self._kept(point, self._point(z, nodes, point))

    def _kept(self, before: Point, after: Point) -> Point:
        """Return the point with the nodes pulled back from which a segment leaves the domain of the model.

        A root or logarithm of a single node would otherwise cut the steps of all nodes short.
        """
        share = 0.5
        for _ in range(PULLS):
            if after.finite or all(path.followed for path in after.paths):
                break
            nodes = [
                np.where(part.lost(path, place)[:, None], old.nodes + share * (path.nodes - old.nodes), path.nodes)
                for part, old, path, place in zip(self._records, before.paths, after.paths, after.places, strict=True)
            ]
            after, share = self._point(after.z, nodes, after), 0.25 * share
        return after

    def _merit(
        self, weights: Sequence[Array], soft: Sequence[Array], at: Progress, exact: bool
    ) -> Callable[[Point], float]:
        """Return what a step must not increase: the cost and the gaps, absolute where continuity is exact."""

        def missed(point: Point) -> float:
            return at.penalty * self._limits.missed(point.z)

        def exactly(point: Point) -> float:
            if not point.finite or not are_stable(self._predictors, point, followed=True):
                return math.inf
            return self._cost(point, SMOOTHING) + self._gap_cost(point, at.force) + missed(point)

        def softly(point: Point) -> float:
            if not point.finite:
                return math.inf
            total = float(self._smooth(point.z, SMOOTHING)) + missed(point)
            for k, path in enumerate(point.paths):
                squares = float(np.trace(weights[k] @ path.products @ weights[k].T))
                squares += float((path.gaps**2 / soft[k]).sum())
                total += self._weights[k] * squares / 2
            return total

        return exactly if exact else softly
