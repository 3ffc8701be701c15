"""Improve and rank starts on short segments of records, before the first run.

Some segments of the records are simulated, each from an initial state of its own. This state comes
from the data and is an unknown. Nothing can diverge within a segment, and neither instability nor
many periods of an oscillation hide the parameters. A few Gauss-Newton steps of the parameters and
of these states, over a few samples first and then over whole segments, lead from nearly everywhere
to a good start of a run. The remaining prediction errors give the order in which the starts are
tried; a run from a poor start begins where these steps lead.

The result is a start and no estimate, since the segments are not connected. All starts are
evaluated in one call, as if each were a record with its own parameters.

Shapes: r starts, m segments, n states and p parameters.
"""

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, diagonal, evenly_spread
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.segments import Course, Segments
from greybox.engine.compiled.transient_part import TransientPart
from greybox.engine.solve.constraints import Limits
from greybox.engine.solve.interruption import reason_to_end

# Most records that are used, evenly spread, and the number of their segments together. They are
# enough for a dozen parameters, and an evaluation takes less than a millisecond a start.
MOST_RECORDS = 8
SEGMENTS = 32

# Steps on short segments, and then on whole ones.
SHORT_STEPS = 4
WHOLE_STEPS = 3

# Damping of the first step, relative to the diagonal of the Hessian.
FIRST_DAMPING = 1e-3

# Ridge of a Hessian, relative to its largest entry, for what short segments do not show.
RIDGE = 1e-12


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

    @property
    def model(self) -> tuple[Array, ...]:
        """Everything but the point itself."""
        return self.cost, self.gradient, self.hessian, self.curvature, self.cross, self.slope

    def reduced(self, damping: Array) -> tuple[Array, Array, Array]:
        """Eliminate the states.

        Returns
        -------
        gradient, hessian : (r, p) and (r, p, p) arrays
            With respect to the parameters, for the best states.
        state_step : (r, m, n, 1 + p) array
            The step of the states: first its constant, then its derivatives by the parameters.
        """
        right = np.concatenate([self.slope[..., None], self.cross], axis=3)
        damped = _damped(self.curvature, damping[:, None])
        state_step = -np.linalg.solve(damped, right)
        eliminated = np.einsum("rmnp,rmnq->rpq", self.cross, state_step)
        return self.gradient + eliminated[..., 0], self.hessian + eliminated[..., 1:], state_step


def can_screen(nlp: CompiledProblem) -> bool:
    """Return whether starts can be compared on short segments.

    All records must have equally many states, and at least one. There must be no constraints on the
    parameters, and no spectra of manoeuvres.
    """
    if nlp.limits or nlp.parts_of(TransientPart):
        return False
    sizes = {part.states for part in nlp.parts_of(RecordPart)}
    return len(sizes) == 1 and 0 not in sizes


def can_move(nlp: CompiledProblem) -> bool:
    """Return whether short segments can lead a start to better parameters."""
    if not can_screen(nlp):
        return False
    for part in nlp.parts_of(RecordPart):
        # With fewer outputs in a segment than twice its states, the states explain nearly all
        # outputs. The steps then helped no start of a chain of masses, and took a third of the fit
        # of a rod with 20 states.
        if 2 * part.states > part.data.segment_length * len(part.outputs):
            return False
    return True


def improved(nlp: CompiledProblem, limits: Limits, z: Array) -> Points:
    """Return where a few steps lead from the points z (r, p), judged over whole segments.

    Where steps cannot lead to better parameters, see `can_move`, the points stay.
    """
    parts = nlp.parts_of(RecordPart)
    chosen = [parts[k] for k in evenly_spread(len(parts), MOST_RECORDS)]
    count = math.ceil(SEGMENTS / len(chosen))
    r = len(z)
    whole_segments = [ShortSegments(p, r, count, p.data.segment_length) for p in chosen]
    with np.errstate(all="ignore"):  # points that overflow stay where they are
        states = np.hstack([record.states_from_data(z) for record in whole_segments])
        initial = evaluated(z, states, whole_segments)
        # Steps took half of the fit of 20 states, and improved the order of the starts no further.
        if not can_move(nlp):
            return initial

        # Short segments have about twice as many outputs as states: half of them remain to be
        # predicted. Without these first steps, searches for an aircraft in wide boxes take twice
        # the time (`screened_starts.py`).
        short_segments = []
        for part in chosen:
            length = 1 + math.ceil(2 * part.states / len(part.outputs))
            short_segments.append(ShortSegments(part, r, count, length))
        points = evaluated(z, states, short_segments)
        points = descended(points, short_segments, limits, SHORT_STEPS)
        after_short = evaluated(points.z, points.states, whole_segments)
        return descended(lower(initial, after_short), whole_segments, limits, WHOLE_STEPS)


def descended(
    points: Points, records: Sequence["ShortSegments"], limits: Limits, steps: int
) -> Points:
    """Return where damped Gauss-Newton steps lead from every point."""
    damping = np.full(len(points.z), FIRST_DAMPING)
    for _ in range(steps):
        if reason_to_end():
            break
        gradient, hessian, state_step = points.reduced(damping)
        step = np.linalg.solve(_damped(hessian, damping), -gradient[:, :, None])[:, :, 0]
        z = limits.clipped(points.z + step)
        # A one multiplies the constant of the step of the states, the rest its derivatives.
        factors = np.hstack([np.ones((len(z), 1)), z - points.z])
        states = points.states + np.einsum("rmnp,rp->rmn", state_step, factors)
        trial = evaluated(z, states, records)
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
        data = np.stack([self._chosen_samples(point.data) for point in placed], axis=2)
        data = data.reshape(len(data), -1)
        q = np.repeat(np.array([point.q for point in placed]).T, m, axis=1)
        simulated, _ = segments.simulate(states.reshape(-1, n), q, data)
        course = Course(simulated, q, data)
        linearization = segments.linearize(course, self._weight)
        products = segments.products(segments.residuals(course))
        errors = self._weight @ products @ self._weight.T

        slope = np.array([point.slope for point in placed])
        weight = part.weight
        by_states = linearization.cross_hessian.reshape(r, m, n, -1)
        gradient = np.einsum("rap,ra->rp", slope, linearization.parameter_gradient)
        return Points(
            z=z,
            states=states,
            cost=weight * (np.linalg.trace(errors) / 2),
            gradient=weight * gradient,
            hessian=weight * (slope.mT @ linearization.parameter_hessian @ slope),
            curvature=weight * linearization.node_hessian.reshape(r, m, n, n),
            cross=weight * (by_states @ slope[:, None]),
            slope=weight * linearization.node_gradient.reshape(r, m, n),
        )

    def _chosen_samples(self, data: Array) -> Array:
        """Return the samples (width, length, m) of the chosen segments from data (width, ·)."""
        shape = (self._part.data.segment_length, self._part.data.segments)
        return data.reshape(-1, *shape)[:, : self.length, self.chosen]


def distinct(points: Points) -> list[int]:
    """Return the indices of the distinct points with finite costs, in order of cost."""
    _, hessian, _ = points.reduced(np.zeros(len(points.z)))
    indices: list[int] = []
    for k in np.argsort(points.cost, kind="stable").tolist():
        if not np.isfinite(points.cost[k]):
            break
        difference = points.z[indices] - points.z[k]
        # The quadratic models predict this difference of costs, for errors of a tenth of every
        # signal. Two points count as one if it is below one.
        distance = np.einsum("fp,fpq,fq->f", difference, hessian[indices], difference) / 2
        if not np.any(distance <= 1.0):
            indices.append(k)
    return indices


def evaluated(z: Array, states: Array, records: Sequence[ShortSegments]) -> Points:
    """Return the points over all records, with an infinite cost where anything is not finite."""
    ends = np.cumsum([len(record.chosen) for record in records])[:-1]
    states_by_record = np.split(states, ends, axis=1)
    parts = []
    for record, initial in zip(records, states_by_record, strict=True):
        parts.append(record.evaluated(z, initial))
    # Costs of the records add up; the states are those of all segments, one record after the other.
    sums = Points(
        z=z,
        states=states,
        cost=reduce(np.add, [part.cost for part in parts]),
        gradient=reduce(np.add, [part.gradient for part in parts]),
        hessian=reduce(np.add, [part.hessian for part in parts]),
        curvature=np.hstack([part.curvature for part in parts]),
        cross=np.hstack([part.cross for part in parts]),
        slope=np.hstack([part.slope for part in parts]),
    )
    is_finite = np.ones(len(z), dtype=bool)
    for values in sums.model:
        is_finite &= np.isfinite(values).reshape(len(z), -1).all(axis=1)

    def finite(values: Array) -> Array:
        return _where(is_finite, values, np.zeros(1))

    return Points(
        z=z,
        states=states,
        cost=np.where(is_finite, sums.cost, np.inf),
        gradient=finite(sums.gradient),
        hessian=finite(sums.hessian),
        curvature=finite(sums.curvature),
        cross=finite(sums.cross),
        slope=finite(sums.slope),
    )


def lower(points: Points, others: Points) -> Points:
    """Return the point with the lower cost of every pair."""
    is_lower = others.cost < points.cost
    return Points(*(_where(is_lower, b, a) for a, b in zip(points, others, strict=True)))


def _where(flags: BoolArray, values: Array, others: Array) -> Array:
    """Return rows of `values` (r, ...) where the flags (r,) are true, and of `others` elsewhere."""
    column = flags.reshape(-1, *[1] * (values.ndim - 1))
    return np.where(column, values, others)


def _damped(hessian: Array, damping: Array) -> Array:
    """Return regular Hessians (..., p, p), with damping (...) relative to their diagonal."""
    entries = np.linalg.diagonal(hessian)
    largest = np.max(np.abs(entries), axis=-1, keepdims=True, initial=0.0)
    # A Hessian of zeros gets ones on its diagonal.
    ones = np.where(largest == 0, 1.0, 0.0)
    added = damping[..., None] * entries + RIDGE * largest + ones
    return hessian + diagonal(added)
