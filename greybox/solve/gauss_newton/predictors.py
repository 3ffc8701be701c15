"""Predictors within an iteration: the gains it begins with, and steps that keep the poles stable."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.kalman_gain import Predictor
from greybox.solve.gauss_newton.iterate import Point

Array = NDArray[np.float64]
PROCESS_NOISE = 10.0 ** np.arange(-12, 1)  # variance a sample, as shares of that of the states
DIFFERENCE = 1e-6  # of the point, by which slopes of poles are found
HELD = 0.9  # of the way to the limit of stability


def best_gains(
    predictors: Sequence[Predictor | None],
    weights: Sequence[float],
    point: Point,
    variances: Sequence[Array],
    clipped: Callable[[Array], Array],
) -> Array:
    """Return z (p,) of the point with the best gains among its own and those of steady Kalman filters.

    For some sizes of the process noise; `variances` (n,) say for every record how much each state moves at all.
    """
    ways = zip(predictors, point.paths, point.places, weights, variances, strict=True)
    used = [(p, path, place, weight, size) for p, path, place, weight, size in ways if p is not None]
    filters = [p.steady(path, place, [share * size for share in PROCESS_NOISE]) for p, path, place, _, size in used]
    candidates = [point.z] if are_stable(predictors, point) else []
    for entries in zip(*filters, strict=True):
        trial = point.z
        for (p, _, place, _, _), values in zip(used, entries, strict=True):
            trial = trial if values is None else p.placed(trial, place, values)
        if all(values is not None for values in entries):
            candidates.append(clipped(trial))

    def cost(z: Array) -> float:
        return sum(weight * p.cost(path.nodes, p.part.place(z)) for p, path, _, weight, _ in used)

    return min(candidates, key=cost, default=point.z)


def are_stable(predictors: Sequence[Predictor | None], point: Point, *, followed: bool = False) -> bool:
    """Tell whether all predictors are stable at a point; with `followed`, those alone that are followed there."""
    ways = zip(predictors, point.paths, point.places, strict=True)
    return all(p.is_stable(path, place) for p, path, place in ways if p is not None and (path.followed or not followed))


def within(predictors: Sequence[Predictor | None], point: Point, dz: Array) -> tuple[Array, Array]:
    """Return normals (n, p) and limits (n,) of steps that keep poles where predictors are stable, if dz (p,) does not.

    normals · step >= limits; at most a share HELD of the way to the limit is gone at once.
    """
    normals, limits = [np.zeros((0, len(dz)))], [np.zeros(0)]
    for p, path, place in zip(predictors, point.paths, point.places, strict=True):
        if p is None or not path.followed or p.is_stable(path, p.part.place(point.z + dz)):
            continue
        steps = DIFFERENCE * np.maximum(np.abs(point.z), 1.0)
        slopes, left = p.outward(path, place, [p.part.place(point.z + row) for row in np.diag(steps)], steps)
        there = np.isfinite(slopes).all(axis=1)
        normals.append(-slopes[there])
        limits.append(-HELD * left[there])
    return np.vstack(normals), np.concatenate(limits)


def followed(predictors: Sequence[Predictor | None], point: Point) -> Point:
    """Return the point with stable predictors followed to the end of their stretches, where they stay finite."""
    paths = []
    for p, path, place in zip(predictors, point.paths, point.places, strict=True):
        if p is not None and not path.followed and p.is_stable(path, place):
            along = p.part.followed(path.nodes, place)
            paths.append(along if along.finite else path)
        else:
            paths.append(path)
    return Point(point.z, point.places, tuple(paths))
