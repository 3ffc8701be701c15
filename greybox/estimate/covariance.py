"""The accuracy of an estimate: its covariance, and the combinations that the data leave open."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.information import ColoredErrors, CorrelatedPoints, Information
from greybox.compiled.part import Trajectory
from greybox.estimate.identifiability import (
    BLIND,
    Combination,
    KnownDirections,
    collinear_groups,
    invisible_groups,
)
from greybox.files.arrays import (
    Array,
    IntArray,
    all_finite,
    positive_or_one,
    real_root,
    sum_of_squares,
    unit_length,
)
from greybox.files.frozen_values import frozen
from greybox.files.named_values import Values
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.discretization_error import quadratic_model
from greybox.statistics.column_space import open_directions, triangle_of
from greybox.statistics.neighbor_correlation import NeighborCorrelation, judged_together
from greybox.statistics.shared_errors import shared_covariance

# Singular value of the Jacobian below which a combination is not determined at all, with columns of
# unit length before the initial states were fitted too.
DEAD = 1e-7
# Relative change of what the data see, for a change of a parameter by its own size, that is
# rounding.
ROUNDING = 1e-12


@frozen
class Accuracy:
    """The covariance of an estimate and what it leaves open.

    Attributes
    ----------
    nlp : CompiledProblem
    x : (p,) array
        The estimate.
    trajectories : (parts,) sequence of Trajectory
        Those of the parts at the estimate; None without an estimate.
    covariance : (k, k) array
        Covariance of the free parameters, then the constants, in the directions that the data
        determine. Constants have the covariance of the earlier fit that they come from, or zero.
    blind : (k, b) array
        Directions, in multiples of `size`, on which the data contain no information: invisible
        ones, and parameters that a bound holds.
    size : (k,) array
        The change of each value that the data notice.
    dof : float
        Numbers in the data less the directions that they determine, and fewer if errors are
        correlated. Infinite if all data have given variances, which records never have.
    shares : tuple of (k, k) array and float
        Contribution of each part and of each earlier fit to the covariance, with its degrees of
        freedom.
    combinations : tuple of Combination
        Combinations that the data do not determine, or determine poorly.
    at_bound : tuple of str
        Free parameters that ended at a bound.
    active : tuple of str
        Constraints, and bounds of tied parameters, that hold with equality.
    bias : (k,) array
        Bias of the estimate from the magnitude by which a criterion divides, see
        `AnyCriterion.gain_bias`; without the bias of an earlier fit.
    white : (p, p) array or None
        The covariance of the free parameters if the cost were the likelihood of white errors: the
        inverse bread.
    independent : (p, p) array and float, or None
        Covariance of the free parameters, and degrees of freedom, if the errors of responses were
        independent along frequency; None where they are.
    informations : (parts,) tuple of Information
        Information of every part.
    parts : (parts,) tuple of PartAccuracy
        Errors of every part; empty where no degrees of freedom are left.
    """

    nlp: CompiledProblem
    x: Array
    trajectories: Sequence[Any]
    covariance: Array
    blind: Array
    size: Array
    dof: float
    bias: Array
    shares: tuple[tuple[Array, float], ...] = ()
    combinations: tuple[Combination, ...] = ()
    at_bound: tuple[str, ...] = ()
    active: tuple[str, ...] = ()
    white: Array | None = None
    independent: tuple[Array, float] | None = None
    informations: tuple[Information, ...] = ()
    parts: tuple["PartAccuracy", ...] = ()

    @classmethod
    def unknown(cls, nlp: CompiledProblem) -> "Accuracy":
        """Return the accuracy of a fit without an estimate: NaN everywhere."""
        k = len(nlp.names)
        return cls(
            nlp,
            np.full(len(nlp.free), np.nan),
            [None] * len(nlp.parts),
            covariance=np.full((k, k), np.nan),
            blind=np.zeros((k, 0)),
            size=np.ones(k),
            dof=0.0,
            bias=np.zeros(k),
        )


@frozen
class _Share:
    """The information of one part: roots of its bread (n, k) by all values and of its meat (m, p).

    `reach` (p,) has the lengths of the root's columns before the initial states were fitted too.
    `limit` is a factor on both that limits the weight of a part relative to others. `pull` (p,) is
    the mean gradient of the cost at the true values, over the noise. `correction` is the factor on
    the noise for the degrees of freedom that the parameters took, or for what all responses show.
    """

    root: Array
    meat: Array
    reach: Array
    limit: float
    pull: Array
    correction: float


@frozen
class PartAccuracy:
    """The information of a part, with its noise enlarged for its share of the parameters.

    Attributes
    ----------
    share : _Share
    meat, independent : (r, r) arrays
        In the directions of the root of the inverse bread before the correction; the second for
        errors that are independent along frequency.
    dof : float
        Degrees of freedom of `meat`.
    numbers : float
        Degrees of freedom of the residuals, at least 0.5.
    bread : (r, r) array
        In the same directions; those of all parts add up to the identity.
    colored : ColoredErrors or None
        Effect of correlation in time on a record or a spectrum; None for responses, and where
        errors are taken as white.
    neighbors : NeighborCorrelation or None
        Correlation along frequency of the errors of a response; None for others, and where errors
        count as independent.
    points : CorrelatedPoints or None
        What the residuals of a response, judged alone, show of that correlation.
    noise : float or None
        Squared residuals of all responses over their given variances, at least one; None where they
        differ from one response to the next.
    """

    share: _Share
    meat: Array
    dof: float
    independent: Array
    numbers: float
    bread: Array
    colored: ColoredErrors | None = None
    neighbors: NeighborCorrelation | None = None
    points: CorrelatedPoints | None = None
    noise: float | None = None


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
    shares = [_share(part, p, paid) for part in parts]
    jacobian = np.vstack([share.limit * share.root[:, :p] for share in shares])
    at_bound = _at_bound(nlp, x, shares, trajectories)
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
    held = _held(unit, active * size, bounded, np.setdiff1d(bounded, [*idle, *sizes]))
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
    shares: Sequence[_Share],
    basis: Array,
    known_noise: bool,
) -> Accuracy:
    """Return the accuracy with a covariance within a basis (p, r) of the determined directions."""
    nlp = accuracy.nlp
    p, k = len(nlp.free), len(nlp.names)
    stacked = _stacked(shares, p)
    first = _root_of_inverse(stacked, basis)
    pairs = [*zip(accuracy.informations, shares, strict=True)]
    noise = _common_noise(pairs, first)
    parts = tuple(_with_neighbors([_corrected(*pair, first, noise) for pair in pairs]))
    root = _root_of_inverse(_stacked([part.share for part in parts], p), basis)
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
    # A quantity that depends on a constant without a standard error has no standard error either.
    unknown = np.isnan(sum((np.diag(covariance) for covariance, _ in earlier), np.zeros(k)))
    lost = unit_length(slope[:, unknown] / accuracy.size[:, None], 0)

    return replace(
        accuracy,
        covariance=covariance,
        blind=np.hstack([accuracy.blind, lost]),
        dof=float(dof),
        bias=bias,
        white=inverse,
        independent=independent,
        parts=parts,
    )


def prior_shares(accuracy: Accuracy) -> Values:
    """Return the share of priors in the information on each free parameter, by name.

    The other parameters are estimated too, and errors are taken as independent. NaN for a parameter
    without a standard error; empty without a prior.
    """
    nlp = accuracy.nlp
    p = len(nlp.free)
    is_prior = [part.problem.criterion.is_prior for part in nlp.parts]
    if not any(is_prior):
        return {}
    if accuracy.white is None:
        return dict.fromkeys(nlp.free, math.nan)

    information = np.array(
        [
            np.linalg.norm(_share(part, p).root[:, :p] @ accuracy.white, axis=0) ** 2
            for part in accuracy.informations
        ]
    )
    share = information[is_prior].sum(0) / np.maximum(information.sum(0), 1e-300)
    share[np.isnan(propagate(accuracy, np.eye(p, len(nlp.names))))] = math.nan
    return dict(zip(nlp.free, share.tolist(), strict=True))


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


def degrees(accuracy: Accuracy, gradient: Array) -> Array:
    """Return the degrees of freedom of quantities from their gradient (m, k): (m,).

    A variance Σ vᵢ whose parts have νᵢ degrees of freedom has (Σ vᵢ)² / Σ (vᵢ²/νᵢ).
    Source: Welch (1947), Biometrika 34; Satterthwaite (1946), Biometrics Bulletin 2.
    """
    if not accuracy.shares:
        return np.full(len(gradient), accuracy.dof)
    v = np.array([np.einsum("ij,jk,ik->i", gradient, c, gradient) for c, _ in accuracy.shares])
    spread = 1 / np.array([dof for _, dof in accuracy.shares]) @ v**2
    return np.where(spread > 0, v.sum(axis=0) ** 2 / positive_or_one(spread), math.inf)


def propagate(accuracy: Accuracy, gradient: Array) -> Array:
    """Return the standard errors (m,) of quantities from their gradients (m, k) by all values.

    NaN for a quantity that depends on a direction on which the data contain no information.
    """
    return KnownDirections(
        accuracy.covariance, accuracy.blind, accuracy.size, accuracy.size
    ).errors(gradient)


def _common_noise(pairs: Sequence[tuple[Information, _Share]], root: Array) -> float | None:
    """Return the squared residuals of all responses over their given variances, at least one.

    None if responses differ: then each has its own. Forty residuals show a ratio to 20 %, and those
    below one count as one. If each response had its own, standard errors of ten responses would be
    4 % too large in the mean. `root` (p, r) is one of B⁻¹.
    """
    given = [
        (part.numbers, part.noise_ratio, sum_of_squares(share.root[:, : len(root)] @ root))
        for part, share in pairs
        if part.noise_ratio
    ]
    if len(given) < 2:
        return None
    from scipy.special import chdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    count, ratio, paid = np.transpose(given)
    numbers, squares = np.maximum(count - paid, 0.5), count * ratio
    common = squares.sum() / numbers.sum()
    # Source: Bartlett (1937), Proceedings of the Royal Society A 160.
    difference = numbers @ np.log(common * numbers / squares)
    return max(common, 1.0) if chdtrc(len(given) - 1, difference) > 0.05 else None


def _corrected(part: Information, share: _Share, root: Array, noise: float | None) -> PartAccuracy:
    """Scale the noise of a part for its share of the parameters, or to that of all responses.

    `root` (p, r) is one of B⁻¹.
    """
    # The share is pᵢ = tr(B⁻¹ Bᵢ): 2nᵢ residuals then have 2nᵢ - pᵢ degrees of freedom, as if the
    # part had been fitted alone with pᵢ parameters. Correlated errors have their own.
    p = len(root)
    problem = part.part.problem
    rows = share.root[:, :p] @ root
    bread = rows.T @ rows
    # A whole number for a single part.
    paid = round(float(np.trace(bread)), 9)
    numbers = max(part.numbers - paid, 0.5)
    colored = part.colored(math.sqrt(problem.weight) * root)
    if colored:
        meat = problem.weight * colored.meat
        return PartAccuracy(share, meat, colored.dof, meat, colored.dof, bread, colored)

    dof = math.inf if problem.criterion.known_noise else numbers
    share = _share(part, p, paid, noise)
    turned = share.meat @ root
    meat = turned.T @ turned
    points = part.correlated(share.correction, root, dof)
    return PartAccuracy(share, meat, dof, meat, numbers, bread, points=points, noise=noise)


def _with_neighbors(parts: Sequence[PartAccuracy]) -> Iterator[PartAccuracy]:
    """Yield the parts with the correlation along frequency that all responses together show."""
    judged = iter(judged_together([part.points.neighbors for part in parts if part.points]))
    for part in parts:
        if part.points and (errors := next(judged)):
            meat, dof = part.points.averaged(errors)
            yield replace(part, meat=meat, dof=dof, neighbors=errors)
        else:
            yield part


def _stacked(shares: Iterable[_Share], p: int) -> Array:
    """Return the root (n, p) of the information of all parts on the parameters."""
    return np.vstack([share.root[:, :p] for share in shares])


def _root_of_inverse(jacobian: Array, basis: Array) -> Array:
    """Return a square root (p, r) of B⁻¹ within `basis` (p, r), for a root (n, p) of B."""
    # B itself has the squares of the singular values: it loses the digits that a root keeps.
    return basis @ np.linalg.inv(triangle_of(jacobian @ basis))


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
        shares = [_share(part, p) for part in informations(nlp, larger, moved)]
        other = _root_of_inverse(_stacked(shares, p), basis)
        # A size may be known better where it is larger, which is no reason for a smaller error.
        directions, sizes, _ = np.linalg.svd(np.linalg.pinv(root) @ other)
        # 0.0201 is the growth of the variance, 1.01² - 1.
        added = root @ directions * real_root((sizes**2 - 1) / 0.0201)
        # Few numbers are no reason for a variance of more than twice the size.
        share = p / (numbers + p)
        yield np.pad(share * added @ added.T, (0, len(nlp.constants))), numbers * share**2


def determined_directions(jacobian: Array, active: Array, bounded: IntArray) -> tuple[Array, Array]:
    """Split the space of the unknowns (p,) into seen and unseen directions.

    Directions closed by a bound or an active constraint are in neither.
    """
    basis = open_directions(active, bounded)

    _, singular, rows = np.linalg.svd(triangle_of(jacobian @ basis), full_matrices=True)
    rank = np.sum(singular > DEAD)
    return basis @ rows[:rank].T, basis @ rows[rank:].T


def _held(unit: Array, active: Array, bounded: IntArray, releasable: IntArray) -> IntArray:
    """Return the places of the parameters that a bound holds, of those at a bound, `bounded`.

    `unit` (n, p) is the root of the information and `active` (a, p) has the gradients of active
    constraints, both in units of the sizes.
    """
    inside = np.setdiff1d(np.arange(unit.shape[1]), bounded)
    if not releasable.size or not inside.size:
        return bounded

    def errors(held: IntArray) -> Array:
        seen, invisible = determined_directions(unit, active, held)
        errors = np.linalg.norm(_root_of_inverse(unit, seen).T, axis=0)
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


def _share(part: Information, p: int, paid: float = 0.0, noise: float | None = None) -> _Share:
    """Return the information of a part on `p` unknowns, its residuals having `paid` for them.

    `noise` is that of all responses over their given variances.
    """
    numbers = max(part.numbers - paid, 0.5)
    correction = math.sqrt(max(part.numbers, numbers) / numbers)
    if noise and part.noise_ratio:
        correction = math.sqrt(noise / part.noise_ratio)
    scale, meat = part.spread(correction)
    weight = part.part.weight
    size = math.sqrt(weight * scale)
    root = size * part.jacobian
    # Exact data would have infinite weight, and rounding in them would hide all other parts.
    limit = math.sqrt(min(scale, 1e12) / scale)
    offset = part.offset(correction)
    pull = np.zeros(p) if offset is None else size * root[:, :p].T @ offset
    return _Share(root, weight * meat[:, :p], size * part.reach[:p], limit, pull, correction)


def _at_bound(
    nlp: CompiledProblem,
    x: Array,
    shares: Sequence[_Share],
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

    curvature = np.sum(_stacked(shares, len(x)) ** 2, axis=0)
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
        # By more than a hundredth of the standard deviation that noise gives the gradient. In a
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


def known_covariances(nlp: CompiledProblem) -> Iterator[tuple[Array, float]]:
    """Yield the covariance (k, k) of the constants from each earlier fit, zero elsewhere."""
    held = nlp.problem.held_estimates
    sources = {id(source): source for name, source in held.items() if name in nlp.names}
    for source in sources.values():
        is_from = [held.get(name) is source for name in nlp.names]
        embedded = np.zeros((len(is_from),) * 2)
        embedded[np.ix_(is_from, is_from)] = source.covariance_of([*compress(nlp.names, is_from)])
        yield embedded, source.dof
