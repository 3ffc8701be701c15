"""Kalman gains within an iteration: good ones to begin with, and predictors that must be stable."""

from collections.abc import Sequence

import numpy as np

from greybox.files.arrays import Array
from greybox.solve.gauss_newton.all_parts import AllParts
from greybox.solve.gauss_newton.iterate import Iterate

# Decades of process noise for which steady Kalman filters are tried, as shares of the first
# variance of the gaps: 1e-12 of a variance is a state without noise.
DECADES = 10.0 ** np.arange(-12, 1)


def best_gains(parts: AllParts, iterate: Iterate, variances: Sequence[Array]) -> Array:
    """Return z (p,) with the best gains: those of the iterate, or of a steady Kalman filter.

    `variances` (n,) for every part are those by which each state moves at all; the filters' process
    noise is a share of them.
    """
    predictors = [
        (gain, trajectory, size)
        for gain, trajectory, size in zip(parts.gains, iterate.trajectories, variances, strict=True)
        if gain is not None
    ]
    filters = [
        gain.steady_state(trajectory, [share * size for share in DECADES])
        for gain, trajectory, size in predictors
    ]
    candidates = [iterate.z] if are_stable(parts, iterate) else []

    # The same share for all records at a time: all combinations would be too many.
    for entries in zip(*filters, strict=True):
        trial = iterate.z
        for (gain, trajectory, _), values in zip(predictors, entries, strict=True):
            trial = trial if values is None else gain.placed(trajectory, trial, values)
        if all(values is not None for values in entries):
            candidates.append(parts.limits.clipped(trial))

    def cost(z: Array) -> float:
        return sum(
            gain.part.weight * gain.simulated_cost(z, trajectory.nodes)
            for gain, trajectory, _ in predictors
        )

    return min(candidates, key=cost, default=iterate.z)


def are_stable(parts: AllParts, iterate: Iterate, *, simulated: bool = False) -> bool:
    """Return whether all predictors, or all `simulated` ones, are stable at an iterate."""
    return all(
        gain.is_stable(trajectory)
        for gain, trajectory in zip(parts.gains, iterate.trajectories, strict=True)
        if gain is not None and (trajectory.simulated or not simulated)
    )


def stability_constraints(parts: AllParts, iterate: Iterate, dz: Array) -> tuple[Array, Array]:
    """Return normals (n, p) and limits (n,) of steps, normals · step >= limits.

    They keep those simulated predictors stable that dz would make unstable, and follow from the
    derivatives of the poles' magnitudes. Without them runs crawl where the likelihood grows toward
    the stability limit (`tests/compiled/test_kalman_gain.py`).
    """
    normals: list[Array] = [np.zeros((0, len(dz)))]
    limits: list[Array] = [np.zeros(0)]
    for gain, trajectory in zip(parts.gains, iterate.trajectories, strict=True):
        # In segments, nodes keep an unstable predictor near the data.
        if gain is None or not trajectory.simulated:
            continue
        if gain.is_stable(trajectory, gain.part.place(iterate.z + dz)):
            continue
        slopes, distances = gain.pole_derivatives(trajectory, iterate.z)
        # Poles that coincide have no derivative; the line search still keeps them inside.
        finite = np.isfinite(slopes).all(axis=1)
        normals.append(-slopes[finite])
        limits.append(-0.9 * distances[finite])  # one step goes only part of the way to the limit
    return np.vstack(normals), np.concatenate(limits)


def simulate_stable(parts: AllParts, iterate: Iterate) -> Iterate:
    """Return the iterate with stable predictors simulated over whole stretches, where finite."""
    trajectories = []
    for gain, trajectory in zip(parts.gains, iterate.trajectories, strict=True):
        if gain is not None and not trajectory.simulated and gain.is_stable(trajectory):
            simulated = gain.part.trajectory(iterate.z, trajectory.nodes, simulated=True)
            trajectory = simulated if simulated.finite else trajectory  # noqa: PLW2901
        trajectories.append(trajectory)
    return Iterate(iterate.z, tuple(trajectories))
