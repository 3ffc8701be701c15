"""Starts that are improved and compared on short segments, all of them together, before any run.

Some segments of the records are simulated, each from a state of its own that comes from the data
and is free to move. Nothing can diverge for long, and neither instability nor many turns of an
oscillation hide the parameters. A few Gauss-Newton steps of the parameters and of these states,
over a few samples first and then over whole segments, lead from nearly everywhere to a good start
of a run. The remaining prediction errors give the order in which the starts are tried; a run from a
poor start begins where these steps lead.

The result is a start and no estimate: free states at every segment leave out what connects the
segments. All starts are evaluated in one call, as if each were a record with its own parameters.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, diagonal, evenly_spread
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.segments import Course, Segments
from greybox.engine.compiled.transient_part import TransientPart
from greybox.engine.solve.constraints import Limits
from greybox.engine.solve.interruption import reason_to_end


class Points(NamedTuple):
    """Points z (r, p) of the parameters, and a quadratic model of the cost around each.

    Attributes
    ----------
    z : (r, p) array
    states : (r, m, n) array
        States that the m segments begin with.
    cost, gradient, hessian : (r,), (r, p) and (r, p, p) arrays
        With respect to the parameters; the cost of some may be infinite.
    curvature, cross, slope : (r, m, n, n), (r, m, n, p) and (r, m, n) arrays
        Hessian, mixed derivatives and gradient with respect to the states of every segment.
    """

    z: Array
    states: Array
    cost: Array
    gradient: Array
    hessian: Array
    curvature: Array
    cross: Array
    slope: Array

    def reduced(self, damping: Array) -> tuple[Array, Array, Array]:
        """Return gradient and Hessian without the states, and how these follow (r, m, n, 1 + p)."""
        right = np.concatenate([self.slope[..., None], self.cross], axis=3)
        damped = _damped(self.curvature, damping[:, None])
        follow = -np.linalg.solve(damped, right)
        eliminated = np.einsum("rmnp,rmnq->rpq", self.cross, follow)
        return self.gradient + eliminated[..., 0], self.hessian + eliminated[..., 1:], follow


def can_screen(nlp: CompiledProblem) -> bool:
    """Return whether all records have equally many states, and parameters no constraints."""
    sizes = {part.states for part in nlp.parts_of(RecordPart)}
    others = nlp.parts_of(TransientPart)
    return not (nlp.limits or others) and len(sizes) == 1 and 0 not in sizes


def can_move(nlp: CompiledProblem) -> bool:
    """Return whether short segments can lead a start to better parameters."""
    # With fewer outputs in a segment than twice its states, these explain nearly all by themselves:
    # no start of chains of masses arrives because of the steps, which for a rod of 20 states take
    # a third of the fit.
    return can_screen(nlp) and all(
        2 * part.states <= part.data.segment_length * len(part.outputs)
        for part in nlp.parts_of(RecordPart)
    )


def improved(nlp: CompiledProblem, limits: Limits, z: Array) -> Points:
    """Return where a few steps lead from the points z (r, p), judged over whole segments.

    Where steps cannot lead to better parameters, see `can_move`, the points stay.
    """
    parts = nlp.parts_of(RecordPart)
    # Some 32 segments, evenly over at most eight records, are enough for a dozen parameters, and an
    # evaluation takes less than a millisecond a start.
    chosen = [parts[k] for k in evenly_spread(len(parts), 8)]
    most = -(-32 // len(chosen))
    # About twice as many outputs as states: half of them are left to predict. Without these first
    # steps, searches for an aircraft in wide boxes take twice the time (`screened_starts.py`).
    r = len(z)
    whole_segments = [ShortSegments(p, r, most, p.data.segment_length) for p in chosen]
    with np.errstate(all="ignore"):  # points that overflow stay where they are
        states = np.hstack([record.states_from_data(z) for record in whole_segments])
        drawn = evaluated(z, states, whole_segments)
        # Steps took half of the fit of 20 states, and improved the order of the starts no further.
        if not can_move(nlp):
            return drawn
        short_segments = [
            ShortSegments(p, r, most, 1 + -(-2 * p.states // len(p.outputs))) for p in chosen
        ]
        short = descended(evaluated(z, states, short_segments), short_segments, limits, 4)
        moved = evaluated(short.z, short.states, whole_segments)
        return descended(lower(drawn, moved), whole_segments, limits, 3)


def descended(
    points: Points, records: Sequence["ShortSegments"], limits: Limits, steps: int
) -> Points:
    """Return where damped Gauss-Newton steps lead from every point."""
    damping = np.full(len(points.z), 1e-3)  # relative to the diagonal of the Hessian
    for _ in range(steps):
        if reason_to_end():
            break
        gradient, hessian, follow = points.reduced(damping)
        step = np.linalg.solve(_damped(hessian, damping), -gradient[:, :, None])[:, :, 0]
        z = limits.clipped(points.z + step)
        along = np.hstack([np.ones((len(z), 1)), z - points.z])
        trial = evaluated(z, points.states + np.einsum("rmnp,rp->rmn", follow, along), records)
        damping = np.where(trial.cost < points.cost, damping / 10, damping * 10)
        points = lower(points, trial)
    return points


class ShortSegments:
    """Some segments of a record, simulated for many values of the parameters at once."""

    def __init__(self, part: RecordPart, points: int, most: int, length: int) -> None:
        """Choose up to this many segments, evenly over the record, with up to this many samples.

        There is a copy of the record for each of the `points`, with its own parameters.
        """
        self._part = part
        self.chosen = evenly_spread(part.data.segments, most)
        self.length = min(length, part.data.segment_length)
        self._weight = part.initial_weight()
        copies = np.repeat(np.arange(points), len(self.chosen))
        self._segments = Segments(
            part.whole_step,
            len(copies),
            self.length,
            part.model.active,
            records=copies,
            own=True,
        )

    def states_from_data(self, z: Array) -> Array:
        """Return the first states (r, m, n), as measured where outputs show them."""
        part = self._part
        nodes = [part.initial_nodes(at.q, at.initial) for at in part.places(z)]
        return np.array(nodes)[:, self.chosen]

    def evaluated(self, z: Array, states: Array) -> Points:
        """Return the points z (r, p) with the segments simulated from these states (r, m, n)."""
        part, segments = self._part, self._segments
        r, m, n = states.shape
        placed = part.places(z)
        shape = (part.data.segment_length, part.data.segments)
        data = np.stack(
            [at.data.reshape(-1, *shape)[:, : self.length, self.chosen] for at in placed], axis=2
        )
        data = data.reshape(len(data), -1)
        q = np.repeat(np.array([at.q for at in placed]).T, m, axis=1)
        at = Course(segments.simulate(states.reshape(-1, n), q, data)[0], q, data)
        b = segments.linearize(at, self._weight)
        errors = self._weight @ segments.products(segments.residuals(at)) @ self._weight.T

        slope = np.array([at.slope for at in placed])
        model = (
            np.linalg.trace(errors) / 2,
            np.einsum("rap,ra->rp", slope, b.parameter_gradient),
            slope.mT @ b.parameter_hessian @ slope,
            b.node_hessian.reshape(r, m, n, n),
            b.cross_hessian.reshape(r, m, n, -1) @ slope[:, None],
            b.node_gradient.reshape(r, m, n),
        )
        return Points(z, states, *(part.weight * values for values in model))


def distinct(points: Points) -> list[int]:
    """Return the numbers of the distinct points with finite costs, in order of cost."""
    _, hessian, _ = points.reduced(np.zeros(len(points.z)))
    numbers: list[int] = []
    for k in np.argsort(points.cost, kind="stable").tolist():
        if not np.isfinite(points.cost[k]):
            break
        moved = points.z[numbers] - points.z[k]
        distance = np.einsum("fp,fpq,fq->f", moved, hessian[numbers], moved) / 2
        # Two points count as one if their costs, for errors of a tenth of every signal, differ by
        # less.
        if not np.any(distance <= 1.0):
            numbers.append(k)
    return numbers


def evaluated(z: Array, states: Array, records: Sequence[ShortSegments]) -> Points:
    """Return the points over all records, with an infinite cost where anything is not finite."""
    ends = np.cumsum([len(record.chosen) for record in records])[:-1]
    pieces = [
        record.evaluated(z, begins)
        for record, begins in zip(records, np.split(states, ends, axis=1), strict=True)
    ]
    _, _, *columns = zip(*pieces, strict=True)
    model: list[Any] = [*map(sum, columns[:3]), *map(np.hstack, columns[3:])]
    finite = np.all([np.isfinite(a).reshape(len(z), -1).all(axis=1) for a in model], axis=0)
    cost, *flat = (_select(finite, values, np.zeros(1)) for values in model)
    return Points(z, states, np.where(finite, cost, np.inf), *flat)


def lower(points: Points, others: Points) -> Points:
    """Return of every two points the one with the lower cost."""
    is_lower = others.cost < points.cost
    return Points(*(_select(is_lower, b, a) for a, b in zip(points, others, strict=True)))


def _select(flags: BoolArray, these: Array, others: Array) -> Array:
    return np.where(flags.reshape(-1, *[1] * (these.ndim - 1)), these, others)


def _damped(hessian: Array, damping: Array) -> Array:
    """Return regular Hessians (..., p, p), with damping (...) relative to their diagonal."""
    entries = np.linalg.diagonal(hessian)
    largest = np.max(np.abs(entries), axis=-1, keepdims=True, initial=0.0)
    # The ridge, 1e-12 of the largest entry, is for what short segments do not show.
    added = damping[..., None] * entries + 1e-12 * largest + (largest == 0)
    return hessian + diagonal(added)
