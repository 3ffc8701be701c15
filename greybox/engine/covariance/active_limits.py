"""Which bounds and constraints hold at an estimate, and which directions they leave."""

from collections.abc import Sequence
from itertools import compress

import numpy as np

from greybox.data.files.arrays import (
    Array,
    IntArray,
)
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.covariance.known_directions import BLIND
from greybox.engine.covariance.part_accuracy import Share, root_of_inverse, stacked_roots
from greybox.engine.solve.discretization_error import quadratic_model
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.statistics.column_space import open_directions, triangle_of

# Singular value of the Jacobian below which a combination is not determined at all, with columns of
# unit length before the initial states were fitted too.
DEAD = 1e-7


def determined_directions(jacobian: Array, active: Array, bounded: IntArray) -> tuple[Array, Array]:
    """Split the space of the unknowns (p,) into seen and unseen directions.

    Directions closed by a bound or an active constraint are in neither.
    """
    basis = open_directions(active, bounded)

    _, singular, rows = np.linalg.svd(triangle_of(jacobian @ basis), full_matrices=True)
    rank = np.sum(singular > DEAD)
    return basis @ rows[:rank].T, basis @ rows[rank:].T


def held_by_bounds(unit: Array, active: Array, bounded: IntArray, releasable: IntArray) -> IntArray:
    """Return the places of the parameters that a bound holds, of those at a bound, `bounded`.

    `unit` (n, p) is the root of the information and `active` (a, p) has the gradients of active
    constraints, both in units of the sizes.
    """
    inside = np.setdiff1d(np.arange(unit.shape[1]), bounded)
    if not releasable.size or not inside.size:
        return bounded

    def errors(held: IntArray) -> Array:
        seen, invisible = determined_directions(unit, active, held)
        errors = np.linalg.norm(root_of_inverse(unit, seen).T, axis=0)
        errors[np.linalg.norm(invisible.T, axis=0) > BLIND] = np.inf
        return errors[inside]

    # Twice the error is that of a parameter with a correlation of 0.87 with the one at its bound.
    limit = 2 * errors(bounded)
    # Each by itself; two may also matter only together.
    singly = [k for k in releasable if np.any(errors(bounded[bounded != k]) > limit)]
    if singly:
        return np.setdiff1d(bounded, singly)
    remaining = np.setdiff1d(bounded, releasable)
    return remaining if np.any(errors(remaining) > limit) else bounded


def names_at_bound(
    nlp: CompiledProblem,
    x: Array,
    shares: Sequence[Share],
    trajectories: Sequence[Trajectory],
) -> tuple[str, ...]:
    """Name the parameters that a bound holds."""
    # How close a solver comes to a bound depends on its tolerances, not on the data. A parameter is
    # held if it is closer than the data can resolve (by the standard error that it would have with
    # all others known) and if its multiplier says that the cost would decrease beyond the bound.
    # Distances are those of the solver: on a logarithmic scale ratios count, and zero is far away.
    z, (low, high) = nlp.scaling.to_solver(x), nlp.bounds
    is_low = np.abs(z - low) <= np.abs(z - high)
    bound = np.where(is_low, nlp.lower, nlp.upper)
    away = np.where(is_low, z - low, high - z)
    distance = np.abs(away / nlp.scaling.slope(x))
    # What is further inside has a value of its own, however little the data tell of it.
    is_near = np.abs(away) <= 0.01 * (high - low)
    # The tolerances of the solvers leave this relative distance.
    held = np.isfinite(bound) & (distance <= 1e-7 * np.maximum(np.abs(x), np.abs(bound)))

    curvature = np.sum(stacked_roots(shares, len(x)) ** 2, axis=0)
    spread = np.sum([(share.meat**2).sum(axis=0) for share in shares], axis=0)
    is_seen = np.isfinite(curvature) & (curvature > 0) & np.isfinite(spread)
    deviation = np.sqrt(np.where(is_seen, spread, 0.0))
    close = (distance * np.where(is_seen, curvature, 1.0) <= 0.01 * deviation) & is_near & ~held
    if close.any() and trajectories:
        # The derivatives of the cost along the best trajectories.
        gradient = sum(
            part.weight * quadratic_model(part, trajectory, part.residual_weight(trajectory))[1]
            for part, trajectory in zip(nlp.parts, trajectories, strict=True)
        )
        outward = np.where(is_low, 1.0, -1.0) * gradient * nlp.scaling.slope(x)
        # The outward gradient must exceed a hundredth of its standard deviation from noise. In a
        # flat valley, a minimum may lie this close to a bound that is not active.
        held |= close & (outward > 0.01 * deviation)
    return tuple(compress(nlp.free, held))


@one_thread_at_a_time
def active_constraints(nlp: CompiledProblem, x: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the gradients (a, p) and the names of the constraints that hold with equality."""
    # Without a constraint, derivatives are not worth their compilation.
    if not nlp.limits:
        return np.empty((0, x.size)), ()
    values = nlp.all_values(x)
    gradient = nlp.constraint.jacobian()(values, 0).full()[:, : x.size]
    slack = nlp.constraint(values).full().ravel()
    active = slack < 1e-6 * (np.abs(gradient) @ np.abs(x) + 1e-12)

    return gradient[active], tuple(compress(nlp.limits, active))
