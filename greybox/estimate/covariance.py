"""How well the data determine the estimate: covariance right for the criterion, and combinations left undetermined."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.part import ColoredErrors, Information, Trajectory
from greybox.formulation.held_estimate import HeldEstimate

Array = NDArray[np.float64]

DEAD = 1e-7  # singular value of the unit-column Jacobian below which a combination is not determined at all
BLIND = 1e-5  # share of an invisible direction from which a quantity has no standard error
ROUNDING = 1e-12  # what the data see of a change of a parameter as large as itself, below which it is none
COLLINEAR = 20.0  # collinearity index from which a combination is suspect, see `Combination`
LOOSE = 0.5  # relative standard error from which a suspect combination is reported


@dataclass(frozen=True)
class Combination:
    """Parameters that the data determine only together.

    Attributes
    ----------
    names : tuple of str
        The parameters involved, the most affected first.
    index : float
        Collinearity index: 1 / smallest singular value of the Jacobian with columns scaled to unit length; infinite
        when the data do not see the combination at all. Above 10 to 20 parameters compensate one another.
        Source: Brun, Reichert and Künsch (2001), Water Resources Research 37(4).
    """

    names: tuple[str, ...]
    index: float


@dataclass(frozen=True, eq=False)
class Accuracy:
    """The covariance of an estimate and what it leaves open.

    Attributes
    ----------
    names : tuple of str
        Free parameters, then constants.
    covariance : (k, k) array
        In the order of `names`, within the directions that the data determine. Constants have the covariance of the
        earlier fit that they come from, or zero.
    blind : (k, b) array
        Directions, in multiples of `size`, about which the data say nothing: invisible ones, and parameters at a bound.
    size : (k,) array
        The change of each value that the data notice.
    dof : float
        Numbers in the data less the directions they choose; infinite where all have given variances, records never.
    shares : tuple of (k, k) array and float
        What each part, and each earlier fit, contributes to the covariance, and the degrees of freedom it has.
    combinations : tuple of Combination
        What the data do not, or hardly, determine.
    at_bound : tuple of str
        Free parameters that ended at a bound.
    active : tuple of str
        Constraints, and bounds of tied parameters, that hold with equality.
    noise : (parts,) array
        The standard deviation of one component of the relative error, of every part.
    white : (p, p) array or None
        The covariance of the free parameters if the cost were the likelihood of white errors: the inverse bread.
    correlation : (parts,) tuple of ColoredErrors or None
        What correlation in time makes of each record; None for responses, and where errors are taken as white.
    """

    names: tuple[str, ...]
    covariance: Array
    blind: Array
    size: Array
    dof: float
    shares: tuple[tuple[Array, float], ...]
    combinations: tuple[Combination, ...]
    at_bound: tuple[str, ...]
    active: tuple[str, ...]
    noise: Array
    white: Array | None = None
    correlation: tuple[ColoredErrors | None, ...] = ()


@dataclass(frozen=True, eq=False)
class _Share:
    """What one part tells of the unknowns: bread (p, k) against all values, meat (p, p), weighted Jacobian (n, p)."""

    bread: Array
    meat: Array
    jacobian: Array
    dof: float


def assess(nlp: Nlp, x: Array, trajectories: Sequence[Trajectory | None] = ()) -> Accuracy:
    """Return the accuracy of the estimate `x` (p,); parts with nodes need their best `trajectories` there.

    The covariance is that of an M-estimator under the noise condition of each part's criterion; parameters at a bound
    are taken as fixed there, and active constraints hold. Fixed values that come from an earlier fit widen it:
    C + S Σ Sᵀ with S the derivative of the estimate with respect to them.
    """
    p, k = len(nlp.free), len(nlp.names)
    parts = informations(nlp, x, trajectories)
    shares = [_share(part, p=p, correction=1.0, dof=math.inf) for part in parts]
    jacobian = np.vstack([share.jacobian for share in shares])
    at_bound = _at_bound(nlp, x)
    active, holding = _active_constraints(nlp, x)
    length = np.linalg.norm(jacobian, axis=0)
    length[length * np.abs(1 / nlp.scaling.slope(x)) < ROUNDING] = 0
    jacobian = jacobian * (length > 0)
    # In units in which every column of the Jacobian has length one, ranks can be judged.
    size = np.where(np.isfinite(length) & (length > 0), 1 / np.where(length > 0, length, 1.0), 1.0)
    unit = np.nan_to_num(jacobian * size)
    seen, blind = _directions(unit, active * size, [nlp.free.index(name) for name in at_bound])
    dof = sum(part.numbers for part in parts) - seen.shape[1]
    covariance, contributions, inverse = np.full((k, k), np.nan), (), None
    correlation: tuple[ColoredErrors | None, ...] = (None,) * len(parts)
    size = np.concatenate([size, np.ones(k - p)])
    blind = np.vstack([blind, np.zeros((k - p, blind.shape[1]))])
    if dof > 0 and all(np.all(np.isfinite(share.bread)) for share in shares):
        basis = seen * size[:p, None]
        shares, correlation, dof = _corrected(parts, shares, basis)
        inverse, slope = _inverse(shares, basis)
        contributions, unknown = _contributions(nlp, shares, inverse, slope)
        covariance = sum((c for c, _ in contributions), np.zeros((k, k)))
        # What depends on a constant that has no standard error has none either.
        lost = slope[:, unknown] / size[:, None]
        blind = np.hstack([blind, lost / np.maximum(np.linalg.norm(lost, axis=0), 1e-300)])
    combinations = tuple(
        c
        for c in _combinations(unit, active * size[:p], nlp.free, at_bound)
        if math.isinf(c.index) or _is_loose(c, nlp, covariance, x)
    )
    return Accuracy(
        names=nlp.names,
        covariance=covariance,
        blind=blind,
        size=size,
        dof=math.inf if all(part.criterion.known_noise for part in nlp.problem.parts) else float(max(dof, 0)),
        shares=contributions,
        combinations=combinations,
        at_bound=at_bound,
        active=holding,
        noise=np.array([part.relative_noise for part in parts]),
        white=inverse,
        correlation=correlation,
    )


def informations(nlp: Nlp, x: Array, trajectories: Sequence[Trajectory | None] = ()) -> list[Information]:
    """Return what every part says about all values at the unknowns `x` (p,), see `Part.information`."""
    values = nlp.all_values(x)
    uncertain = tuple(
        k for k, name in enumerate(nlp.names) if k >= len(nlp.free) and name in nlp.problem.held_estimates
    )
    slope = nlp.scaling.slope(x)
    each = zip(nlp.parts, trajectories or [None] * len(nlp.parts), strict=True)
    return [part.information(nlp.names, values, uncertain, trajectory, slope) for part, trajectory in each]


def degrees(accuracy: Accuracy, gradient: Array) -> Array:
    """Return the degrees of freedom of quantities from their gradient (m, k): (m,).

    A variance Σ vᵢ whose parts have νᵢ degrees of freedom has (Σ vᵢ)² / Σ (vᵢ²/νᵢ).
    Source: Welch (1947), Biometrika 34; Satterthwaite (1946), Biometrics Bulletin 2.
    """
    if not accuracy.shares:
        return np.full(len(gradient), accuracy.dof)
    v = np.array([np.einsum("ij,jk,ik->i", gradient, c, gradient) for c, _ in accuracy.shares])
    spread = (v**2 / np.array([dof for _, dof in accuracy.shares])[:, None]).sum(axis=0)
    return np.where(spread > 0, v.sum(axis=0) ** 2 / np.where(spread > 0, spread, 1.0), math.inf)


def propagate(accuracy: Accuracy, gradient: Array) -> Array:
    """Return the standard errors of quantities from their gradient (m, k) with respect to all values: (m,).

    NaN for a quantity that depends on a direction about which the data say nothing.
    """
    variance = np.einsum("ij,jk,ik->i", gradient, accuracy.covariance, gradient)
    scaled = gradient * accuracy.size
    unseen = np.abs(scaled @ accuracy.blind) > BLIND * np.linalg.norm(scaled, axis=1)[:, None]
    return np.where(unseen.any(axis=1), np.nan, np.sqrt(np.maximum(variance, 0)))


def _corrected(
    parts: Sequence[Information],
    shares: Sequence[_Share],
    basis: Array,
) -> tuple[list[_Share], tuple[ColoredErrors | None, ...], float]:
    """Scale the noise of every part for the parameters that it pays: pᵢ = tr(B⁻¹ Bᵢ) of the p in all.

    2nᵢ residuals then have 2nᵢ - pᵢ degrees of freedom, as if the part had been fitted alone with pᵢ parameters.
    Records whose errors are correlated in time have their own. Returns these, and the degrees of freedom of all parts,
    too.
    """
    inverse, _ = _inverse(shares, basis)
    p = len(inverse)
    result: list[_Share] = []
    correlation: list[ColoredErrors | None] = []
    degrees = 0.0
    for part, share in zip(parts, shares, strict=True):
        problem = part.part.problem
        left = max(part.numbers - float(np.trace(inverse @ share.bread[:, :p])), 0.5)
        colored = None if part.colored is None else part.colored(problem.weight * inverse)
        correlation.append(colored)
        if colored is not None:
            degrees += colored.dof
            result.append(replace(share, meat=problem.weight**2 * colored.meat[:p, :p], dof=colored.dof))
            continue
        degrees += left
        dof = math.inf if problem.criterion.known_noise else left
        result.append(_share(part, p=p, correction=math.sqrt(max(part.numbers, left) / left), dof=dof))
    return result, tuple(correlation), degrees


def _inverse(shares: Sequence[_Share], basis: Array) -> tuple[Array, Array]:
    """Return B⁻¹ (p, p) within `basis` (p, r), and the derivative (k, k) of all values to the constants."""
    bread = sum((share.bread for share in shares), np.zeros_like(shares[0].bread))
    p, k = bread.shape
    inverse = basis @ np.linalg.inv(basis.T @ bread[:, :p] @ basis) @ basis.T
    slope = np.zeros((k, k))
    slope[:p, p:] = -inverse @ bread[:, p:]
    slope[p:, p:] = np.eye(k - p)
    return inverse, slope


def _contributions(
    nlp: Nlp, shares: Sequence[_Share], inverse: Array, slope: Array
) -> tuple[tuple[tuple[Array, float], ...], NDArray[np.bool_]]:
    """Return B⁻¹ Mᵢ B⁻¹ of every part and S Σ Sᵀ of every earlier fit; and which constants (k,) have no error."""
    p, k = len(nlp.free), len(nlp.names)
    result = []
    for share in shares:
        own = np.zeros((k, k))
        own[:p, :p] = inverse @ share.meat @ inverse
        result.append((own, share.dof))
    unknown = np.zeros(k, dtype=bool)
    for known, dof in _known_covariances(nlp):
        unknown |= np.isnan(np.diag(known))
        result.append((slope @ np.nan_to_num(known) @ slope.T, dof))
    return tuple(result), unknown


def _directions(jacobian: Array, active: Array, bounded: Sequence[int]) -> tuple[Array, Array]:
    """Split the space of the unknowns (p,) into what the data see, and what they do not or a bound closes.

    Directions closed by an active constraint are in neither: the constraint determines them.
    """
    p = jacobian.shape[1]
    closed = np.vstack([active, np.eye(p)[list(bounded)]])
    basis = np.eye(p)
    if len(closed):
        _, singular, rows = np.linalg.svd(closed)
        basis = rows[int(np.sum(singular > 1e-12 * singular[0])) :].T
    _, singular, rows = np.linalg.svd(np.linalg.qr(jacobian @ basis, mode="r"), full_matrices=True)
    rank = int(np.sum(singular > DEAD))
    return basis @ rows[:rank].T, np.hstack([basis @ rows[rank:].T, np.eye(p)[:, list(bounded)]])


def _share(part: Information, *, p: int, correction: float, dof: float) -> _Share:
    """Return what a part tells of the `p` unknowns, its noise scaled by `correction`."""
    scale, meat = part.spread(correction)
    free, weight = part.jacobian[:, :p], part.part.weight
    return _Share(
        bread=weight * scale * free.T @ part.jacobian,
        meat=weight**2 * meat[:p, :p],
        jacobian=math.sqrt(weight * min(scale, 1e12)) * free,
        dof=dof,
    )


def _at_bound(nlp: Nlp, x: Array) -> tuple[str, ...]:
    z, low, high = (nlp.scaling.to_solver(v) for v in (x, nlp.lower, nlp.upper))
    tolerance = 1e-7 * np.maximum(1.0, np.abs(z))  # in units of the start box
    return tuple(n for n, hit in zip(nlp.free, (z - low < tolerance) | (high - z < tolerance), strict=True) if hit)


def _active_constraints(nlp: Nlp, x: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the gradients (a, p) and the names of the constraints that hold with equality."""
    p = len(nlp.free)
    if not nlp.limits:
        return np.zeros((0, p)), ()
    values = nlp.all_values(x)
    symbols = ca.MX.sym("x", len(values))
    slope = ca.Function("slope", [symbols], [ca.jacobian(nlp.constraint(symbols), symbols)])
    gradient = np.asarray(ca.DM(slope(values)))[:, :p]
    slack = np.asarray(nlp.constraint(values)).ravel()
    active = slack < 1e-6 * (np.abs(gradient) @ np.abs(x) + 1e-12)
    return gradient[active], tuple(label for label, holds in zip(nlp.limits, active, strict=True) if holds)


def _combinations(
    unit: Array, active: Array, names: tuple[str, ...], at_bound: Sequence[str]
) -> tuple[Combination, ...]:
    """Return the suspect combinations of a Jacobian with unit columns (2N, p)."""
    dead = [k for k in range(len(names)) if not (unit[:, k].any() or active[:, k].any())]
    inside = [k for k, name in enumerate(names) if name not in at_bound and k not in dead]
    found = [Combination((names[k],), math.inf) for k in dead]
    limits = active[:, inside]
    unit = np.vstack([unit[:, inside], limits / np.maximum(np.linalg.norm(limits, axis=1, keepdims=True), 1e-300)])
    _, singular, rows = np.linalg.svd(np.linalg.qr(unit, mode="r"), full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(rows) - len(singular))])
    for value, row in zip(singular, np.abs(rows), strict=True):
        if value <= 1 / COLLINEAR:
            # What is invisible takes the error from everything that it involves, however little.
            least = BLIND if value < DEAD else 0.2 * row.max()
            group = tuple(names[inside[i]] for i in np.argsort(-row) if row[i] > least)
            found.append(Combination(group, math.inf if value < DEAD else float(1 / value)))
    return tuple(found)


def _is_loose(combination: Combination, nlp: Nlp, covariance: Array, x: Array) -> bool:
    places = [nlp.free.index(name) for name in combination.names]
    error = np.sqrt(np.maximum(np.diag(covariance)[places], 0))
    return bool(np.any(~(error < LOOSE * np.abs(x[places]))))


def _known_covariances(nlp: Nlp) -> list[tuple[Array, float]]:
    """Return the covariance of the constants that come from each earlier fit, embedded in that of all values."""
    names = nlp.names
    sources: dict[int, tuple[HeldEstimate, list[str]]] = {}
    for name, source in nlp.problem.held_estimates.items():
        if name in names:
            sources.setdefault(id(source), (source, []))[1].append(name)
    result = []
    for source, group in sources.values():
        places = [names.index(name) for name in group]
        embedded = np.zeros((len(names), len(names)))
        embedded[np.ix_(places, places)] = source.covariance_of(group)
        result.append((embedded, source.dof))
    return result
