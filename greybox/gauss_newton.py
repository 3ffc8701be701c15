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

from greybox.iterate import (
    PENALTY,
    SETTLED,
    SHORT,
    Move,
    Point,
    Progress,
    held_back,
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
LOOSE = 3.0  # first standard deviation of continuity, relative to the size of the states
PULLS = 4  # of nodes that leave the domain of the model
ITERATIONS = 100
SHORTEST, SHRINK = 1e-3, 0.4  # step, as a share of the whole, that is tried; and what the next is of the last
STUBBORN = 1e6  # damping beyond which nothing is tried any more
CLOSINGS = 5  # of gaps after a step
PROCESS_NOISE = 10.0 ** np.arange(-12, 1)  # variance a sample, as shares of that of the states
TOLERANCE = 1e-8  # of half a step's length squared, in standard errors, and of the decrease of the cost
CONTINUOUS = 1e-9  # gap relative to the largest value of the state
ROUNDING = 1e-9  # of the cost
UNNOTICED = 0.1  # of the cost
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
        added = {name for part in self._records for name in part.gain_names}
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
    def run(self, start: Array, iterations: int = ITERATIONS) -> Outcome:
        """Solve from the parameters `start` (p,) in so many `iterations`."""
        began = time.perf_counter()
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        before = 0
        if self._coarse is not None:
            first = self._coarse.run(start, iterations)
            z, before = self._nlp.scaling.to_solver(first.estimate), first.iterations
        try:
            point, status, last = self._descend(z, frozen=False, near=self._coarse is not None, iterations=iterations)
        except np.linalg.LinAlgError:
            return Outcome(start, "singular", before, time.perf_counter() - began, False, math.inf)
        estimate = np.clip(self._nlp.scaling.to_parameters(point.z), self._nlp.lower, self._nlp.upper)
        cost = self._cost(point, smoothing=0.0)
        if status == "converged" and self._limits.missed(point.z) > 0:
            status = "constraints missed"
        converged = status == "converged" and math.isfinite(cost)
        nodes = tuple(path.nodes for path in point.paths)
        seconds = time.perf_counter() - began
        return Outcome(estimate, status, before + last, seconds, converged, cost, self._trace(point), nodes)

    @DIVERGING
    def begins(self, start: Array) -> bool:
        """Tell whether the model is finite at the parameters `start` (p,), near the data."""
        if self._coarse is not None:
            return self._coarse.begins(start)
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        return self._point(z, [part.first_nodes(part.place(z)) for part in self._records]).finite

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

    @DIVERGING
    def flat(self, x: Array, nodes: Sequence[Array], factor: float) -> list[Array]:
        """Return directions (p,) of the solver's variables along which a change by `factor` would not be noticed."""
        z = self._nlp.scaling.to_solver(x)
        point = self._point(z, nodes)
        try:
            blocks = self._linearized(point, self._noise_weights(point))
            exact = [np.zeros(part.states) for part in self._records]
            hessian = self._move(point, blocks, exact, 0.0, still=False, exact=True).hessian
        except np.linalg.LinAlgError:
            return []
        values, vectors = np.linalg.eigh(hessian)
        unnoticed = values / np.abs(vectors).max(axis=0) ** 2 * math.log(factor) ** 2 / 2 < UNNOTICED
        return [v / np.abs(v).max() * math.log(factor) for v in vectors.T[unnoticed]]

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

    def _point(self, z: Array, nodes: Sequence[Array]) -> Point:
        places = tuple(part.place(z) for part in self._records)
        paths = tuple(part.path(n, place) for part, n, place in zip(self._records, nodes, places, strict=True))
        return Point(z, places, paths)

    def _cost(self, point: Point, smoothing: float) -> float:
        if not point.finite:
            return math.inf
        costs = (
            weight * part.noise.cost(path.products)
            for weight, part, path in zip(self._weights, self._records, point.paths, strict=True)
        )
        return float(sum(costs)) + float(self._smooth(point.z, smoothing))

    def _descend(
        self, z: Array, frozen: bool, near: bool = False, iterations: int = ITERATIONS
    ) -> tuple[Point, str, int]:
        """Iterate from z and the first nodes; with `frozen` the states alone; `near` where z is close to the answer."""
        point = self._point(z, [part.first_nodes(part.place(z)) for part in self._records])
        if not point.finite:
            return point, "not finite at the start", 0
        start = point
        assumed = [np.diag(1 / (SPREAD * part.noise.spread)) for part in self._records]
        blocks = self._linearized(point, assumed)
        at = self._begun(blocks, near)
        for iteration in range(iterations):
            exact, still = at.exact, frozen or at.patience > 0
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
            trial, length = self._search(point, move, merit, before, at)
            if trial is None and exact and settled and move.distance <= 1e3 * TOLERANCE:
                return point, "converged", iteration
            if trial is None and at.damping <= STUBBORN:
                at.damping = max(100 * at.damping, 1e-2)
                continue
            if exact and length < SHORT and (simulated := self._simulated(point, start, at)):
                point = simulated
                continue
            if exact and (trial is None or at.damping > STUBBORN):
                return point, "stalled", iteration
            gained = 0.0 if trial is None else before - merit(trial)
            before_step, point = point, trial or point
            kept = gained / move.predicted if move.predicted > 0 else 1.0
            at.damping = next_damping(at.damping, length, kept)
            if not exact:
                at.stepped(point, move.predicted, gained, length, trial is None or move.predicted <= SETTLED * abs(before))
                point = self._with_gains(point, at.soft) if at.exact and not frozen else point
            elif length == 1.0:
                # Gauss-Newton converges linearly at worst: the next decrease follows from the last two.
                predicted = max(move.predicted, move.distance)
                following = predicted**2 / at.last if predicted < at.last < 1 else math.inf
                if following <= TOLERANCE and self._is_continuous(point):
                    return point, "converged", iteration + 1
                farther = self._extrapolated(before_step, point, move, merit, at)
                at.last, at.step = (predicted, move.dz) if farther is None else (math.nan, None)
                point = farther or point
        return point, "iterations exceeded", iterations

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
        return Progress(variances, [np.zeros(part.states) for part in self._records], near)

    def _search(
        self, point: Point, move: Move, merit: Callable[[Point], float], before: float, at: Progress
    ) -> tuple[Point | None, float]:
        """Halve the step until the merit does not grow (None where no step does); exact continuity closes gaps first."""
        length, enough = 1.0, before + ROUNDING * max(1.0, abs(before))
        while length > SHORTEST:
            trial = self._moved(point, move, length)
            if at.simulated:
                trial = self._followed(trial)
            if merit(trial) <= enough:
                return trial, length
            if at.exact and not at.simulated:
                trial = self._closed(trial, move, at.force, 0.01 * length * move.predicted)
                if merit(trial) <= enough:
                    return trial, length
            length *= SHRINK
        return None, 0.0

    def _simulated(self, point: Point, start: Point, at: Progress) -> Point | None:
        """Return the best simulation where Newton steps do not close the gaps, None where it diverges.

        From here on every trial is simulated from its first nodes: a path that a stable model always has.
        """
        if at.simulated or at.loose is None:
            return None
        best = min(map(self._followed, (at.loose, start)), key=lambda p: self._cost(p, SMOOTHING))
        at.loose = None
        if not best.finite:
            return None
        at.simulated, at.damping, at.last = True, 0.0, math.nan
        at.force = [np.zeros_like(f) for f in at.force]
        return best

    def _extrapolated(
        self, before: Point, point: Point, move: Move, merit: Callable[[Point], float], at: Progress
    ) -> Point | None:
        """Return where slow steps lead to, if that is better than `point`, one step from `before`."""
        reach = move.reach(at.step)
        if reach == 1 or not move.dz.any():
            return None
        trial = self._moved(before, move, reach)
        trial = self._followed(trial) if at.simulated else self._closed(trial, move, at.force, 0.01 * move.predicted)
        return trial if merit(trial) < merit(point) else None

    def _followed(self, point: Point) -> Point:
        """Return the point with the nodes that follow from the first ones by simulation."""
        nodes = [part.predicted_nodes(path.nodes, place) for part, path, place in zip(self._records, point.paths, point.places, strict=True)]
        return self._point(point.z, nodes)

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
            closer = self._point(point.z, nodes)
            now = self._gap_cost(closer, force)
            if not closer.finite or now > 0.5 * cost:
                break
            point, cost = closer, now
        return point

    def _gap_cost(self, point: Point, force: Sequence[Array]) -> float:
        return sum(
            w * float((np.abs(p.gaps) * f).sum()) for w, p, f in zip(self._weights, point.paths, force, strict=True)
        )

    def _with_gains(self, point: Point, variances: Sequence[Array]) -> Point:
        """Return the point with the gains of a steady Kalman filter, the best of some sizes of the process noise.

        `variances` (n,) say for every record how much each state moves at all.
        """
        if not self._gains.any():
            return point
        best, least = point, math.inf
        for share in PROCESS_NOISE:
            z, nodes = point.z.copy(), []
            for part, path, place, variance in zip(self._records, point.paths, point.places, variances, strict=True):
                for k, value in part.steady_gains(path, place, share * variance).items():
                    of = np.flatnonzero(place.slope[k])
                    if len(of) == 1:
                        z[of] = value / place.slope[k, of]
                z = self._limits.clipped(z)
                nodes.append(part.predicted_nodes(path.nodes, part.place(z)))
            trial = self._point(z, nodes)
            cost = self._cost(trial, SMOOTHING)
            if cost < least and self._predicts(trial):
                best, least = trial, cost
        return best

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
            r = part.reduce(blocks[k], point.places[k], gaps, soft[k], damping)
            reduced.append(r)
            hessian, gradient = hessian + self._weights[k] * r.hessian, gradient + self._weights[k] * r.gradient
            promise += self._weights[k] * promised(blocks[k], r, gaps, soft[k])
        if still:
            return Move(blocks, reduced, np.zeros(p), promise, 0.0, penalty, hessian)
        g, H = (value.full() for value in self._curvature(point.z, SMOOTHING))
        values, vectors = np.linalg.eigh((H + H.T) / 2)
        hessian, gradient = hessian + (vectors * np.abs(values)) @ vectors.T, gradient + g.ravel()
        damped = hessian + damping * np.diag(np.diag(hessian))
        rows, limits = self._limits.around(point.z, None if exact else self._gains)
        dz = solve_small_qp(damped, gradient, rows, limits)
        penalty = max(penalty, 1.2 * largest_multiplier(damped @ dz + gradient, rows, rows @ dz - limits))
        half = 0.5 * float(dz @ hessian @ dz)
        promise += penalty * self._limits.missed(point.z) - float(gradient @ dz) - half
        promise += sum(w * held_back(r, dz) for w, r in zip(self._weights, reduced, strict=True))
        return Move(blocks, reduced, dz, promise, half, penalty, hessian)

    def _moved(self, point: Point, move: Move, length: float) -> Point:
        nodes = [
            part.moved(path.nodes, r, move.dz, length)
            for part, path, r in zip(self._records, point.paths, move.reduced, strict=True)
        ]
        z = self._limits.clipped(point.z + length * move.dz) if move.dz.any() else point.z
        return self._kept(point, self._point(z, nodes))

    def _kept(self, before: Point, after: Point) -> Point:
        """Return the point with the nodes pulled back from which a segment leaves the domain of the model.

        A root or logarithm of a single node would otherwise cut the steps of all nodes short.
        """
        share = 0.5
        for _ in range(PULLS):
            if after.finite:
                break
            nodes = [
                np.where(part.lost(path, place)[:, None], old.nodes + share * (path.nodes - old.nodes), path.nodes)
                for part, old, path, place in zip(self._records, before.paths, after.paths, after.places, strict=True)
            ]
            after, share = self._point(after.z, nodes), 0.25 * share
        return after

    def _merit(
        self, weights: Sequence[Array], soft: Sequence[Array], at: Progress, exact: bool
    ) -> Callable[[Point], float]:
        """Return what a step must not increase: the cost and the gaps, absolute where continuity is exact."""

        def missed(point: Point) -> float:
            return at.penalty * self._limits.missed(point.z)

        def exactly(point: Point) -> float:
            if not point.finite or not self._predicts(point):
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

    def _predicts(self, point: Point) -> bool:
        """Tell whether predictors are stable: an unstable one would look into the future through its free states."""
        if not self._gains.any():
            return True
        return all(
            part.predictor_radius(path, place) < 1
            for part, path, place in zip(self._records, point.paths, point.places, strict=True)
        )
