"""Kalman gains within an iteration: good ones to begin with, and predictors that must be stable."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, all_finite
from greybox.engine.compiled.kalman_gain import KalmanGain
from greybox.engine.compiled.part import Trajectory
from greybox.engine.solve.gauss_newton.all_parts import AllParts
from greybox.engine.solve.gauss_newton.iterate import Iterate

# Decades of process noise for which steady Kalman filters are tried, as shares of the first
# variance of the gaps: 1e-12 of a variance is a state without noise.
DECADES = 10.0 ** np.arange(-12, 1)


def best_gains(parts: AllParts, iterate: Iterate, variances: Sequence[Array]) -> Array:
    """Return z (p,) with the best gains: those of the iterate, or of a steady Kalman filter.

    `variances` (n,) for every part are the variances of the gaps; the process noise of the filters
    is a share of them.
    """
    rows: Any = zip(parts.gains, iterate.trajectories, variances, strict=True)
    corrected = [row for row in rows if row[0]]
    if not corrected:
        return iterate.z
    candidates = [iterate.z] if are_stable(parts, iterate) else []
    for share in DECADES:
        # The same share for all records at a time: all combinations would be too many.
        z = iterate.z
        for gain, trajectory, size in corrected:
            z = gain.filtered(trajectory, z, share * size)
        if all_finite(z):
            candidates.append(parts.limits.clipped(z))

    def cost(z: Array) -> float:
        return sum(
            gain.part.weight * gain.simulated_cost(z, trajectory.nodes)
            for gain, trajectory, _ in corrected
        )

    return min(candidates, key=cost, default=iterate.z)


def predictors(
    parts: AllParts, iterate: Iterate, *, simulated: bool = False
) -> list[tuple[KalmanGain, Trajectory]]:
    """Return the gains with their trajectories, or those of the `simulated` ones."""
    pairs = zip(parts.gains, iterate.trajectories, strict=True)
    return [(gain, t) for gain, t in pairs if gain and (t.simulated or not simulated)]


def are_stable(parts: AllParts, iterate: Iterate, *, simulated: bool = False) -> bool:
    """Return whether all predictors, or all `simulated` ones, are stable at an iterate."""
    return all(gain.is_stable(t) for gain, t in predictors(parts, iterate, simulated=simulated))


def stable_step(
    parts: AllParts,
    iterate: Iterate,
    constraints: tuple[Array, Array],
    solve: Callable[[Array, Array], Array],
) -> tuple[Array, Array, Array]:
    """Return a step that keeps simulated predictors stable, and its constraints.

    These are normals (n, p) and limits (n,) with normals · step >= limits, and `solve` gives the
    best step within them. Where that makes predictors unstable, the room of their poles is added.
    The limit is curved: what a step still violates, the next one allows for. Otherwise runs crawl
    where the likelihood grows toward the limit (`tests/engine/compiled/test_kalman_gain.py`).
    """
    dz = solve(*constraints)
    # In segments, nodes keep an unstable predictor near the data.
    unstable = [
        (gain, trajectory)
        for gain, trajectory in predictors(parts, iterate, simulated=True)
        if not gain.is_stable(gain.moved(trajectory, iterate.z + dz))
    ]
    # Most steps keep predictors stable, and derivatives of poles take long.
    if not unstable:
        return dz, *constraints

    def room(z: Array) -> Array:
        return np.concatenate([gain.room(gain.moved(t, z)) for gain, t in unstable])

    rooms = room(iterate.z)
    steps = 1e-6 * np.maximum(np.abs(iterate.z), 1.0)
    slopes = [room(z) - rooms for z in iterate.z + np.diag(steps)]
    normals = np.vstack([constraints[0], np.transpose(slopes) / steps])
    # One step goes only part of the way to the limit.
    limits = np.append(constraints[1], -0.9 * rooms)
    left = -np.inf
    for _ in range(6):
        last = left
        trial = solve(normals, limits)
        left = room(iterate.z + trial).min()
        # Steps that are longer than the limit is curved are left to the line search.
        if not left > last:
            break
        dz = trial
        limits[-len(rooms) :] -= 1.5 * min(left, 0.0)
    return dz, normals, limits


def simulate_stable(parts: AllParts, iterate: Iterate) -> Iterate:
    """Return the iterate with stable predictors simulated over whole stretches, where finite."""
    trajectories = []
    for gain, trajectory in zip(parts.gains, iterate.trajectories, strict=True):
        if gain and not trajectory.simulated and gain.is_stable(trajectory):
            simulated = gain.part.trajectory(iterate.z, trajectory.nodes, simulated=True)
            trajectory = simulated if simulated.finite else trajectory  # noqa: PLW2901
        trajectories.append(trajectory)
    return Iterate(iterate.z, tuple(trajectories))
