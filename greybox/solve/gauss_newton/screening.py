"""Starts that are improved and compared on short segments, all of them together, before any run.

Some segments of the records are simulated, each from a state of its own that comes from the data and
is free to move. Nothing can diverge for long, and neither instability nor many turns of an
oscillation hide the parameters. A few Gauss-Newton steps of the parameters and of these states, over
a few samples first and then over whole segments, lead from nearly everywhere to a good start of a
run. The remaining prediction errors give the order in which the starts are tried.

The result is a start and no estimate: free states at every segment leave out what connects the
segments. All starts are evaluated in one call, as if each were a record with its own parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.record_part import RecordPart
from greybox.compiled.segments import Segments
from greybox.files.arrays import Array, BoolArray
from greybox.solve.constraints import Limits
from greybox.solve.interruption import reason_to_end

# Segments, evenly over at most so many records: they are enough for a dozen parameters, and an
# evaluation takes less than a millisecond a start.
SEGMENTS = 32
RECORDS = 8

STEPS = (4, 3)  # Gauss-Newton steps over a few samples, and over whole segments
FIRST_DAMPING, DAMPING_FACTOR = (
    1e-3,
    10.0,
)  # relative to the diagonal of the Hessian; when a step fails or succeeds
RIDGE = 1e-12  # of the largest diagonal entry, for what short segments do not show


@dataclass(frozen=True, eq=False)
class Points:
    """Points z (r, p), the states (r, m, n) that the m segments of every record begin with, and a quadratic model.

    Attributes
    ----------
    cost, gradient, hessian : (r,), (r, p) and (r, p, p) arrays
        By the parameters; the cost of some may be infinite.
    by_states : list of (hessian, cross_hessian, gradient)
        The same by the states of every segment, (r, m, n, n), (r, m, n, p) and (r, m, n).
    """

    z: Array
    states: list[Array]
    cost: Array
    gradient: Array
    hessian: Array
    by_states: list[tuple[Array, ...]]

    def reduced(self, damping: Array) -> tuple[Array, Array, list[Array]]:
        """Return gradient and Hessian with the states eliminated, and how these follow, (r, m, n, 1 + p)."""
        gradient, hessian, follow = self.gradient, self.hessian, []
        for curvature, cross, slope in self.by_states:
            right = np.concatenate([slope[..., None], cross], axis=3)
            moves = -np.linalg.solve(_damped(curvature, damping[:, None]), right)
            eliminated = np.einsum("rmnp,rmnq->rpq", cross, moves)
            gradient, hessian = gradient + eliminated[..., 0], hessian + eliminated[..., 1:]
            follow.append(moves)
        return gradient, hessian, follow


class Screening:
    """The prediction errors over short segments of the records of one problem."""

    def __init__(self, nlp: CompiledProblem, limits: Limits) -> None:
        """Choose the segments."""
        parts = [part for part in nlp.parts if isinstance(part, RecordPart)]
        numbers = np.unique(np.linspace(0, len(parts) - 1, RECORDS).round().astype(int))
        chosen = [parts[k] for k in numbers]
        most = -(-SEGMENTS // len(chosen))
        self._limits = limits
        self._short = [ShortSegments(part, most, _fewest_samples(part)) for part in chosen]
        self._whole = [ShortSegments(part, most, part.data.segment_length) for part in chosen]

    @staticmethod
    def serves(nlp: CompiledProblem) -> bool:
        """Tell whether all records have states, and no constraints bind the parameters."""
        parts = [part for part in nlp.parts if part.has_states]
        return not nlp.limits and all(
            isinstance(part, RecordPart) and part.states > 0 for part in parts
        )

    def improved(self, z: Array) -> Points:
        """Return where a few steps lead from the points z (r, p), with their costs over whole segments."""
        with np.errstate(all="ignore"):  # of points that are left where they are
            states = [record.states_from_data(z) for record in self._whole]
            short = self._descended(_evaluated(z, states, self._short), self._short, STEPS[0])
            drawn = _evaluated(z, states, self._whole)
            moved = _evaluated(short.z, short.states, self._whole)
            return self._descended(_lower(drawn, moved), self._whole, STEPS[1])

    def _descended(self, points: Points, records: Sequence["ShortSegments"], steps: int) -> Points:
        damping = np.full(len(points.z), FIRST_DAMPING)
        for _ in range(steps):
            if reason_to_end():
                break
            gradient, hessian, follow = points.reduced(damping)
            step = np.linalg.solve(_damped(hessian, damping), -gradient[:, :, None])[:, :, 0]
            z = self._limits.clipped(points.z + step)
            along = np.concatenate([np.ones((len(z), 1)), z - points.z], axis=1)
            states = [
                previous + np.einsum("rmnp,rp->rmn", moves, along)
                for previous, moves in zip(points.states, follow, strict=True)
            ]
            trial = _evaluated(z, states, records)
            damping = np.where(
                trial.cost < points.cost, damping / DAMPING_FACTOR, damping * DAMPING_FACTOR
            )
            points = _lower(points, trial)
        return points


class ShortSegments:
    """Some segments of a record, simulated for many values of the parameters at once."""

    def __init__(self, part: RecordPart, most: int, length: int) -> None:
        """Choose at most so many segments, evenly over the record, of at most so many samples."""
        self._part = part
        count = part.data.segments
        self._chosen = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
        self._length = min(length, part.data.segment_length)
        self._weight = part.initial_weight(part.model.strategies.assumed_error)
        self._segments: dict[int, Segments] = {}

    def states_from_data(self, z: Array) -> Array:
        """Return the states that the segments begin with, (r, m, n), as measured where outputs show them."""
        part = self._part
        measured, inputs = (values[:, self._chosen] for values in part.at_nodes)
        initial = part.model.initial_states
        begins = []
        for point in z:
            placed = part.place(point)
            p = placed.q[: len(part.system.parameters)]
            states = initial.at(measured, inputs, p, placed.initial)
            begins.append(initial.as_measured(states, measured).T)
        return np.array(begins)

    def evaluated(self, z: Array, states: Array) -> Points:
        """Return the points z (r, p) with the segments simulated from these states (r, m, n)."""
        part = self._part
        r, m, n = states.shape
        placed = [part.place(point) for point in z]
        segments = self._segments_of(r)
        shape = (part.data.segment_length, part.data.segments)
        data = np.stack(
            [at.data.reshape(-1, *shape)[:, : self._length, self._chosen] for at in placed],
            axis=2,
        )
        data = data.reshape(len(data), -1)
        q = np.repeat(np.array([at.q for at in placed]).T, m, axis=1)
        along, _ = segments.simulate(states.reshape(-1, n), q, data)
        b = segments.linearize(along, q, self._weight, data)
        errors = (
            self._weight @ segments.products(segments.residuals(along, q, data)) @ self._weight.T
        )
        slope = np.array([at.slope for at in placed])
        hessian = slope.transpose(0, 2, 1) @ b.parameter_hessian @ slope
        gradient = np.einsum("rap,ra->rp", slope, b.parameter_gradient)
        curvature = b.node_hessian.reshape(r, m, n, n)
        cross = b.cross_hessian.reshape(r, m, n, -1) @ slope[:, None]
        by_states = (
            part.weight * curvature,
            part.weight * cross,
            part.weight * b.node_gradient.reshape(r, m, n),
        )
        cost = np.trace(errors, axis1=1, axis2=2) / 2
        return Points(
            z,
            [states],
            part.weight * cost,
            part.weight * gradient,
            part.weight * hessian,
            [by_states],
        )

    def _segments_of(self, points: int) -> Segments:
        """Return the segments of so many copies of the record, each with parameters of its own."""
        if points not in self._segments:
            copies = np.repeat(np.arange(points), len(self._chosen))
            step, active = self._part.step, self._part.model.active
            every = tuple(range(step.function.numel_in(1)))
            self._segments[points] = Segments(
                step, len(copies), self._length, active, records=copies, own=every
            )
        return self._segments[points]


def distinct(points: Points) -> list[int]:
    """Return the numbers of the distinct points with finite costs, the lowest cost of each, in order of cost."""
    _, hessian, _ = points.reduced(np.zeros(len(points.z)))
    numbers: list[int] = []
    for k in np.argsort(points.cost, kind="stable").tolist():
        if not np.isfinite(points.cost[k]):
            break
        moved = points.z[numbers] - points.z[k]
        distance = np.einsum("fp,fpq,fq->f", moved, hessian[numbers], moved) / 2
        # Two points are one if the cost, with errors of a tenth of every signal, differs by less.
        if not np.any(distance <= 1.0):
            numbers.append(k)
    return numbers


def _fewest_samples(part: RecordPart) -> int:
    """Return the samples with about twice as many outputs as states: half of them are left to predict."""
    return 1 + -(-2 * part.states // len(part.outputs))


def _evaluated(z: Array, states: Sequence[Array], records: Sequence[ShortSegments]) -> Points:
    """Return the points over all records; where anything is not finite, the cost is infinite and flat."""
    r, p = z.shape
    total = Points(z, [], np.zeros(r), np.zeros((r, p)), np.zeros((r, p, p)), [])
    for record, begins in zip(records, states, strict=True):
        added = record.evaluated(z, begins)
        total = Points(
            z,
            [*total.states, *added.states],
            total.cost + added.cost,
            total.gradient + added.gradient,
            total.hessian + added.hessian,
            [*total.by_states, *added.by_states],
        )
    arrays = [
        total.cost,
        total.gradient,
        total.hessian,
        *(array for three in total.by_states for array in three),
    ]
    finite = np.all([np.isfinite(array).reshape(r, -1).all(axis=1) for array in arrays], axis=0)
    return _chosen(finite, replace(total, cost=np.where(finite, total.cost, np.inf)), None)


def _lower(points: Points, others: Points) -> Points:
    """Return of every two points the one with the lower cost."""
    return _chosen(others.cost < points.cost, others, points)


def _chosen(flags: BoolArray, those: Points, others: Points | None) -> Points:
    """Return those points where there is a flag, and the others elsewhere; None is a flat model."""

    def select(a: Array, b: Array | None) -> Array:
        return np.where(flags.reshape(-1, *[1] * (a.ndim - 1)), a, 0.0 if b is None else b)

    if others is None:
        by_states = [tuple(select(a, None) for a in three) for three in those.by_states]
        model = (select(those.gradient, None), select(those.hessian, None), by_states)
        return Points(those.z, those.states, those.cost, *model)
    return Points(
        select(those.z, others.z),
        [select(a, b) for a, b in zip(those.states, others.states, strict=True)],
        select(those.cost, others.cost),
        select(those.gradient, others.gradient),
        select(those.hessian, others.hessian),
        [
            tuple(select(a, b) for a, b in zip(three, rest, strict=True))
            for three, rest in zip(those.by_states, others.by_states, strict=True)
        ],
    )


def _damped(hessian: Array, damping: Array) -> Array:
    """Return Hessians (..., p, p) with damping (...) relative to their diagonal, and what keeps them regular."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    largest = np.max(np.abs(diagonal), axis=-1, keepdims=True, initial=0.0)
    added = damping[..., None] * diagonal + RIDGE * largest + (largest == 0)
    return hessian + added[..., None] * np.eye(hessian.shape[-1])
