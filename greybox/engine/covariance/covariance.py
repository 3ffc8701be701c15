"""The accuracy of an estimate: its covariance, and the combinations that the data leave open."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from greybox.data.files.arrays import (
    Array,
    all_finite,
    real_root,
    unit_length,
)
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.information import Information
from greybox.engine.compiled.part import Trajectory
from greybox.engine.covariance.accuracy import Accuracy, degrees
from greybox.engine.covariance.active_limits import (
    DEAD,
    active_constraints,
    determined_directions,
    held_by_bounds,
    names_at_bound,
)
from greybox.engine.covariance.combinations import collinear_groups, invisible_groups
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.engine.covariance.part_accuracy import (
    Share,
    common_noise,
    corrected,
    root_of_inverse,
    share_of,
    stacked_roots,
    with_neighbors,
)
from greybox.statistics.shared_errors import shared_covariance

# Relative change of what the data see, for a change of a parameter by its own size, that is
# rounding.
ROUNDING = 1e-12


def accuracy_at(
    nlp: CompiledProblem, x: Array, trajectories: Sequence[Trajectory] = ()
) -> Accuracy:
    """Return the accuracy of the estimate `x` (p,).

    Parts with nodes need their best `trajectories` there.

    It is the covariance of an M-estimator under the noise condition of each part's criterion;
    active constraints hold. A parameter at a bound is taken as fixed there, unless the error of
    another one would more than double without the bound: noise may have chosen between the bound
    and a place inside, and the other parameter would have followed. Then the bound is released.
    Fixed values that come from an earlier fit widen the covariance: C + S Σ Sᵀ with S the
    derivative of the estimate with respect to them.
    """
    p, k = len(nlp.free), len(nlp.names)
    parts = informations(nlp, x, trajectories)
    # A single part loses the degrees of freedom of all parameters: its errors are computed once.
    paid = p if len(parts) == 1 else 0
    shares = [share_of(part, p, paid) for part in parts]
    jacobian = np.vstack([share.limit * share.root[:, :p] for share in shares])
    at_bound = names_at_bound(nlp, x, shares, trajectories)
    active, holding = active_constraints(nlp, x)

    # A column may be mere rounding, relative to the parameter or after the initial states have
    # compensated for it. It must not count as information.
    length = np.linalg.norm(jacobian, axis=0)
    reach = np.linalg.norm([share.limit * share.reach for share in shares], axis=0)
    rounding = ROUNDING * np.abs(nlp.scaling.slope(x))
    reach[reach < rounding] = 0
    jacobian = jacobian * ((length >= rounding) & (length >= DEAD * reach))

    # Ranks can only be judged in units in which all columns have length one. Take the length before
    # the initial states are fitted: where these compensate for a parameter, only rounding remains.
    size = 1 / np.where(np.isfinite(reach) & (reach > 0), reach, 1.0)
    unit = np.nan_to_num(jacobian * size)
    bounded = np.flatnonzero(np.isin(nlp.free, at_bound))

    # A parameter at a bound counts as known, unless the data contain nothing about it: then the
    # bound held it only by chance.
    idle = [k for k in bounded if not (unit[:, k].any() or active[:, k].any())]
    # The size of noise that ends at zero is that of no noise.
    sizes = np.flatnonzero(np.isin(nlp.free, [*nlp.noise_sizes]))
    held = held_by_bounds(unit, active * size, bounded, np.setdiff1d(bounded, [*idle, *sizes]))
    seen, invisible = determined_directions(unit, active * size, held)
    # Not even rounding may give a value that is held an error.
    seen[held] = invisible[held] = 0
    combinations = invisible_groups(
        np.hstack([invisible, np.eye(p)[:, idle]]),
        size,
        nlp.free,
        [part.initial for part in parts],
    )

    known_noise = all(part.criterion.known_noise for part in nlp.problem.parts)
    blind = np.eye(k, p) @ np.hstack([invisible, np.eye(p)[:, held]])
    fixed = tuple(nlp.free[k] for k in held)
    suspect = collinear_groups(jacobian, active, nlp.free, fixed, invisible)
    accuracy = replace(
        Accuracy.unknown(nlp),
        x=x,
        trajectories=trajectories,
        blind=blind,
        size=np.concatenate([size, np.ones(k - p)]),
        dof=math.inf
        if known_noise
        else float(max(sum(part.numbers for part in parts) - seen.shape[1], 0)),
        at_bound=at_bound,
        active=holding,
        informations=tuple(parts),
    )

    if accuracy.dof > 0 and all_finite(*(share.root for share in shares)):
        accuracy = _with_covariance(accuracy, shares, seen * size[:, None], known_noise)

    # Collinearity matters where an error exceeds half of a value, which a bound has not chosen.
    error = real_root(np.diag(accuracy.covariance)[:p])
    loose = ~(error < 0.5 * np.abs(x)) & ~np.isin(nlp.free, at_bound)
    reported = (c for c in suspect if np.any(loose & np.isin(nlp.free, c.names)))
    return replace(accuracy, combinations=(*combinations, *reported))


def _with_covariance(
    accuracy: Accuracy,
    shares: Sequence[Share],
    basis: Array,
    known_noise: bool,
) -> Accuracy:
    """Return the accuracy with a covariance within a basis (p, r) of the determined directions."""
    nlp = accuracy.nlp
    p, k = len(nlp.free), len(nlp.names)
    stacked = stacked_roots(shares, p)
    first = root_of_inverse(stacked, basis)
    pairs = [*zip(accuracy.informations, shares, strict=True)]
    noise = common_noise(pairs, first)
    parts = tuple(with_neighbors([corrected(*pair, first, noise) for pair in pairs]))
    root = root_of_inverse(stacked_roots([part.share for part in parts], p), basis)
    inverse = root @ root.T

    # How the estimate follows the constants, from the optimality condition: -B⁻¹ Bᵪ.
    slope = np.eye(k)
    slope[:p] = 0
    for part in parts:
        slope[:p, p:] -= root @ (root.T @ part.share.root[:, :p].T) @ part.share.root[:, p:]

    turned = np.eye(k, p) @ (root @ ((stacked @ root).T @ (stacked @ first)))
    earlier = [*known_covariances(nlp)]
    terms: list[tuple[Array, float]] = [(turned @ part.meat @ turned.T, part.dof) for part in parts]
    # Errors that responses share, such as those of wind, add up.
    shared, bins = shared_covariance(
        [
            (*part.errors, part.jacobian[:, :p] @ first, np.trace(known.independent))
            for part, known in zip(accuracy.informations, parts, strict=True)
            if part.errors
        ],
        first.shape[1],
    )
    terms.append((turned @ shared @ turned.T, bins))
    terms += [(slope @ np.nan_to_num(covariance) @ slope.T, dof) for covariance, dof in earlier]
    terms += _by_process_noise(accuracy, first, basis)
    covariance = np.sum([term for term, _ in terms], axis=0)
    accuracy = replace(accuracy, shares=tuple(terms))

    # A manoeuvre of one line, which its end terms take up, has no information.
    dof = sum(min(part.numbers, part.dof) for part in parts if np.trace(part.bread) > 1e-9)
    if known_noise:
        # Variances that were given have no uncertainty; the estimated correlation has, of every
        # part by itself.
        dof = degrees(accuracy, np.eye(p, k)).min()
    independent = None
    if shared.any() or any(part.neighbors for part in parts):
        # Tests of terms need errors that are taken as independent: a term that is missing looks
        # like a correlation.
        change = sum(part.independent - part.meat for part in parts) - shared
        alone = (covariance + turned @ change @ turned.T)[:p, :p]
        independent = alone, math.inf if known_noise else sum(part.numbers for part in parts)

    # The bias is the least-squares response to what noise adds to the residuals on average.
    bias = np.eye(k, p) @ inverse @ sum(part.share.pull for part in parts)
    common = [
        part.share.meat[len(part.share.meat) - known.common_errors :]
        for known, part in zip(accuracy.informations, parts, strict=True)
    ]
    systematic = np.eye(k, p) @ inverse @ np.vstack(common).T
    # A quantity that depends on a constant without a standard error has no standard error either.
    unknown = np.isnan(sum((np.diag(covariance) for covariance, _ in earlier), np.zeros(k)))
    lost = unit_length(slope[:, unknown] / accuracy.size[:, None], 0)

    return replace(
        accuracy,
        covariance=covariance,
        blind=np.hstack([accuracy.blind, lost]),
        dof=float(dof),
        bias=bias,
        systematic=systematic,
        white=inverse,
        independent=independent,
        parts=parts,
    )


def known_directions(accuracy: Accuracy, values: Array, slopes: Array) -> KnownDirections | None:
    """Return what the data determine of values (m,) with derivatives (m, k) in all values.

    None without a covariance. A parameter that its bound holds counts as known, as in all errors of
    a fit.
    """
    if not all_finite(accuracy.covariance):
        return None
    # Directions of single parameters at their bounds are among the blind ones only because these
    # are held.
    scaled = slopes * accuracy.size
    inside = ~np.isin(accuracy.nlp.names, accuracy.at_bound)
    unseen = accuracy.blind[:, np.any(np.abs(accuracy.blind[inside]) > 0, axis=0)]
    size = np.maximum(np.linalg.norm(scaled, axis=1), 1e-300)
    covariance = slopes @ accuracy.covariance @ slopes.T
    return KnownDirections(covariance, scaled @ unseen / size[:, None], size, values)


def directions_beside(
    nlp: CompiledProblem,
    x: Array,
    at_bound: Sequence[str],
    trajectories_at: Callable[[Array], Sequence[Trajectory]],
) -> KnownDirections | None:
    """Return the directions of the free parameters at a point near the estimate `x` (p,).

    `trajectories_at` returns the best trajectories there.
    """
    # Each parameter moves by a different share, so that equal ones become different.
    share = 0.1 * (1 + np.arange(len(x)) / len(x))
    span = nlp.upper - nlp.lower
    step = share * np.where(x == 0, np.where(np.isfinite(span), 0.1 * span, 1.0), np.abs(x))
    moved = np.where(nlp.upper - x > x - nlp.lower, x + step, x - step)
    beside = np.where(np.isin(nlp.free, at_bound), x, np.clip(moved, nlp.lower, nlp.upper))

    try:
        accuracy = accuracy_at(nlp, beside, trajectories_at(beside))
    except np.linalg.LinAlgError:  # the model may diverge there
        return None
    return known_directions(accuracy, beside, np.eye(len(x), len(nlp.names)))


def informations(
    nlp: CompiledProblem, x: Array, trajectories: Sequence[Trajectory | None] = ()
) -> list[Information]:
    """Return the information of every part on all values, at the unknowns `x` (p,)."""
    values = nlp.all_values(x)
    constants = enumerate(nlp.constants, len(nlp.free))
    held = nlp.problem.held_estimates
    uncertain = tuple(k for k, name in constants if name in held)
    slope = nlp.scaling.slope(x)
    return [
        part.information(nlp.names, values, uncertain, trajectory, slope)
        for part, trajectory in zip(nlp.parts, trajectories or [None] * len(nlp.parts), strict=True)
    ]


def _by_process_noise(
    accuracy: Accuracy, root: Array, basis: Array
) -> Iterator[tuple[Array, float]]:
    """Yield what the uncertain sizes of process noise add to the covariance, with their degrees.

    If n numbers show a size, its variance is estimated like that of n residuals: too small by the
    share of the p parameters, and with n degrees of freedom. Both concern what larger noise adds to
    the covariance. Without them, intervals of 95 % of four plants in gusts that 19 to 29 numbers
    show covered 90 to 95 %. `root` (p, r) is one of B⁻¹.
    """
    nlp, x = accuracy.nlp, accuracy.x
    p = len(x)
    # A bound may hold some.
    for k in np.flatnonzero(np.isin(nlp.free, [*nlp.noise_sizes]) & root.any(axis=1)):
        # Twice these are the information on its logarithm.
        numbers = x[k] ** 2 / (root[k] @ root[k]) / 2
        larger = x.copy()
        larger[k] *= 1.01
        z = nlp.scaling.to_solver(larger)
        moved = [
            part.trajectory(z, along.nodes, simulated=along.simulated)
            for part, along in zip(nlp.parts, accuracy.trajectories, strict=True)
        ]
        shares = [share_of(part, p) for part in informations(nlp, larger, moved)]
        other = root_of_inverse(stacked_roots(shares, p), basis)
        # A size may be known better where it is larger, which is no reason for a smaller error.
        directions, sizes, _ = np.linalg.svd(np.linalg.pinv(root) @ other)
        # 0.0201 is the growth of the variance, 1.01² - 1.
        added = root @ directions * real_root((sizes**2 - 1) / 0.0201)
        # Few numbers are no reason for a variance of more than twice the size.
        share = p / (numbers + p)
        yield np.pad(share * added @ added.T, (0, len(nlp.constants))), numbers * share**2


def known_covariances(nlp: CompiledProblem) -> Iterator[tuple[Array, float]]:
    """Yield the covariance (k, k) of the constants from each earlier fit, zero elsewhere."""
    held = nlp.problem.held_estimates
    sources = {id(source): source for name, source in held.items() if name in nlp.names}
    for source in sources.values():
        is_from = [held.get(name) is source for name in nlp.names]
        embedded = np.zeros((len(is_from),) * 2)
        embedded[np.ix_(is_from, is_from)] = source.covariance_of([*compress(nlp.names, is_from)])
        yield embedded, source.dof
