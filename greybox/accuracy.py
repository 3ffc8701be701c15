"""How well the data determine the estimate: covariance right for the criterion, and combinations left undetermined."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.nlp import Nlp
from greybox.problem import Estimated

DEAD = 1e-7  # singular value of the unit-column Jacobian below which a combination is not determined at all
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
        Degrees of freedom of Student's t for intervals.
    combinations : tuple of Combination
        What the data do not, or hardly, determine.
    at_bound : tuple of str
        Free parameters that ended at a bound.
    noise : (parts,) array
        The standard deviation of one component of the relative error, of every part.
    """

    names: tuple[str, ...]
    covariance: NDArray[np.float64]
    blind: NDArray[np.float64]
    size: NDArray[np.float64]
    dof: float
    combinations: tuple[Combination, ...]
    at_bound: tuple[str, ...]
    noise: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Information:
    """Weighted sums over the parts: bread (p, k) against all values, meat (p, p), and the weighted Jacobian (2N, p)."""

    bread: NDArray[np.float64]
    meat: NDArray[np.float64]
    jacobian: NDArray[np.float64]


def assess(nlp: Nlp, x: NDArray[np.float64]) -> Accuracy:
    """Return the accuracy of the estimate `x` (p,).

    The covariance is that of an M-estimator under the noise condition of each part's criterion; parameters at a bound
    are taken as fixed there, and active constraints hold. Fixed values that come from an earlier fit widen it:
    C + S Σ Sᵀ with S the derivative of the estimate with respect to them.
    """
    p, k = len(nlp.free), len(nlp.names)
    data_size = 2 * sum(len(part.data) for part in nlp.problem.parts)
    information = _information(nlp, x, data_size - p)
    at_bound = _at_bound(nlp, x)
    active = _active_constraints(nlp, x)
    length = np.linalg.norm(information.jacobian, axis=0)
    # In units in which every column of the Jacobian has length one, ranks can be judged.
    size = np.where(np.isfinite(length) & (length > 0), 1 / np.where(length > 0, length, 1.0), 1.0)
    unit = np.nan_to_num(information.jacobian * size)
    seen, blind = _directions(unit, active * size, [nlp.free.index(name) for name in at_bound])
    covariance = np.full((k, k), np.nan)
    if data_size > p and np.all(np.isfinite(information.bread)):
        covariance = _covariance(information, seen * size[:, None], _known_covariance(nlp))
    combinations = tuple(
        c
        for c in _combinations(unit, active * size, nlp.free, at_bound)
        if math.isinf(c.index) or _is_loose(c, nlp, covariance, x)
    )
    known_noise = all(part.criterion.known_noise for part in nlp.problem.parts)
    return Accuracy(
        names=nlp.names,
        covariance=covariance,
        blind=np.vstack([blind, np.zeros((k - p, blind.shape[1]))]),
        size=np.concatenate([size, np.ones(k - p)]),
        dof=math.inf if known_noise else float(max(data_size - p, 0)),
        combinations=combinations,
        at_bound=at_bound,
        noise=_noise(nlp, x),
    )


def propagate(accuracy: Accuracy, gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard errors of quantities from their gradient (m, k) with respect to all values: (m,).

    NaN for a quantity that depends on a direction about which the data say nothing.
    """
    variance = np.einsum("ij,jk,ik->i", gradient, accuracy.covariance, gradient)
    scaled = gradient * accuracy.size
    unseen = np.abs(scaled @ accuracy.blind) > 1e-5 * np.linalg.norm(scaled, axis=1)[:, None]
    return np.where(unseen.any(axis=1), np.nan, np.sqrt(np.maximum(variance, 0)))


def _covariance(
    information: _Information, basis: NDArray[np.float64], known: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return B⁻¹ M B⁻¹ within `basis` (p, r), and what the constants' covariance (k, k) adds to it."""
    p, k = information.bread.shape
    inverse = basis @ np.linalg.inv(basis.T @ information.bread[:, :p] @ basis) @ basis.T
    shift = np.zeros((k, k))
    shift[:p, p:] = -inverse @ information.bread[:, p:]
    shift[p:, p:] = np.eye(k - p)
    covariance = known.copy()
    covariance[:p, :p] = np.nan
    if np.all(np.isfinite(known)):
        covariance = shift @ known @ shift.T
        covariance[:p, :p] += inverse @ information.meat @ inverse
    return covariance


def _directions(
    jacobian: NDArray[np.float64], active: NDArray[np.float64], bounded: Sequence[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Split the space of the unknowns (p,) into what the data see, and what they do not or a bound closes.

    Directions closed by an active constraint are in neither: the constraint determines them.
    """
    p = jacobian.shape[1]
    closed = np.vstack([active, np.eye(p)[list(bounded)]])
    basis = np.eye(p)
    if len(closed):
        _, singular, rows = np.linalg.svd(closed)
        basis = rows[int(np.sum(singular > 1e-12 * singular[0])) :].T
    _, singular, rows = np.linalg.svd(jacobian @ basis, full_matrices=True)
    rank = int(np.sum(singular > DEAD))
    return basis @ rows[:rank].T, np.hstack([basis @ rows[rank:].T, np.eye(p)[:, list(bounded)]])


def _information(nlp: Nlp, x: NDArray[np.float64], dof: int) -> _Information:
    p = len(nlp.free)
    values = nlp.all_values(x)
    symbols: Any = ca.SX.sym("x", len(values)) if nlp.responses.is_a("SXFunction") else ca.MX.sym("x", len(values))
    derivative = ca.Function("derivative", [symbols], [ca.jacobian(nlp.responses(symbols), symbols)])
    stacked = np.asarray(ca.DM(derivative(values)))
    half = len(stacked) // 2
    responses = nlp.split(nlp.response_rows(x[None])[0])
    sensitivities = nlp.split(stacked[:half] + 1j * stacked[half:])
    correction = math.sqrt(2 * half / dof) if dof > 0 else math.nan
    bread, meat, rows = np.zeros((p, len(values))), np.zeros((p, p)), []
    for part, response, sensitivity in zip(nlp.problem.parts, responses, sensitivities, strict=True):
        jacobian = part.criterion.jacobian(response, sensitivity, part.data)
        scale, spread = part.criterion.spread(response, part.data, correction) if dof > 0 else (1.0, np.zeros(half * 2))
        spread = spread[: len(jacobian)]
        own = jacobian[:, :p]
        bread += part.weight * scale * own.T @ jacobian
        meat += part.weight**2 * own.T @ (spread[:, None] * own)
        rows.append(math.sqrt(part.weight * min(scale, 1e12)) * own)
    return _Information(bread, meat, np.vstack(rows))


def _noise(nlp: Nlp, x: NDArray[np.float64]) -> NDArray[np.float64]:
    responses = nlp.split(nlp.response_rows(x[None])[0])
    errors = [np.abs(r / part.data.response - 1) for r, part in zip(responses, nlp.problem.parts, strict=True)]
    return np.array([e.mean() * math.sqrt(2 / math.pi) for e in errors])


def _at_bound(nlp: Nlp, x: NDArray[np.float64]) -> tuple[str, ...]:
    z, low, high = (nlp.scaling.to_solver(v) for v in (x, nlp.lower, nlp.upper))
    tolerance = 1e-6 * np.maximum(1.0, np.abs(z))
    return tuple(n for n, hit in zip(nlp.free, (z - low < tolerance) | (high - z < tolerance), strict=True) if hit)


def _active_constraints(nlp: Nlp, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the gradients (a, p) of the constraints that hold with equality."""
    p, size = len(nlp.free), nlp.constraint.numel_out()
    if not size:
        return np.zeros((0, p))
    values = nlp.all_values(x)
    symbols = ca.MX.sym("x", len(values))
    slope = ca.Function("slope", [symbols], [ca.jacobian(nlp.constraint(symbols), symbols)])
    gradient = np.asarray(ca.DM(slope(values)))[:, :p]
    slack = np.asarray(nlp.constraint(values)).ravel()
    return gradient[slack < 1e-6 * (np.abs(gradient) @ np.abs(x) + 1e-12)]


def _combinations(
    unit: NDArray[np.float64], active: NDArray[np.float64], names: tuple[str, ...], at_bound: Sequence[str]
) -> tuple[Combination, ...]:
    """Return the suspect combinations of a Jacobian with unit columns (2N, p)."""
    inside = [k for k, name in enumerate(names) if name not in at_bound]
    if not inside:
        return ()
    limits = active[:, inside]
    unit = np.vstack([unit[:, inside], limits / np.maximum(np.linalg.norm(limits, axis=1, keepdims=True), 1e-300)])
    _, singular, rows = np.linalg.svd(unit, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(rows) - len(singular))])
    found = []
    for value, row in zip(singular, np.abs(rows), strict=True):
        if value <= 1 / COLLINEAR:
            group = tuple(names[inside[i]] for i in np.argsort(-row) if row[i] > 0.2 * row.max())
            found.append(Combination(group, math.inf if value < DEAD else float(1 / value)))
    return tuple(found)


def _is_loose(combination: Combination, nlp: Nlp, covariance: NDArray[np.float64], x: NDArray[np.float64]) -> bool:
    places = [nlp.free.index(name) for name in combination.names]
    error = np.sqrt(np.maximum(np.diag(covariance)[places], 0))
    return bool(np.any(~(error < LOOSE * np.abs(x[places]))))


def _known_covariance(nlp: Nlp) -> NDArray[np.float64]:
    """Return the covariance of the constants that come from earlier fits, embedded in that of all values."""
    names = nlp.names
    result = np.zeros((len(names), len(names)))
    sources: dict[int, tuple[Estimated, list[str]]] = {}
    for name, source in nlp.problem.known.items():
        if name in names:
            sources.setdefault(id(source), (source, []))[1].append(name)
    for source, group in sources.values():
        places = [names.index(name) for name in group]
        result[np.ix_(places, places)] = source.covariance_of(group)
    return result
