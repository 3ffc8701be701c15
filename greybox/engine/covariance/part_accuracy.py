"""The information of one part, with its noise enlarged for its share of the parameters."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array, sum_of_squares
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.information import ColoredErrors, CorrelatedPoints, Information
from greybox.statistics.column_space import triangle_of
from greybox.statistics.neighbor_correlation import NeighborCorrelation, judged_together


@frozen
class Share:
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
    share : Share
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

    share: Share
    meat: Array
    dof: float
    independent: Array
    numbers: float
    bread: Array
    colored: ColoredErrors | None = None
    neighbors: NeighborCorrelation | None = None
    points: CorrelatedPoints | None = None
    noise: float | None = None


def common_noise(pairs: Sequence[tuple[Information, Share]], root: Array) -> float | None:
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


def corrected(part: Information, share: Share, root: Array, noise: float | None) -> PartAccuracy:
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
    share = share_of(part, p, paid, noise)
    turned = share.meat @ root
    meat = turned.T @ turned
    points = part.correlated(share.correction, root, dof)
    return PartAccuracy(share, meat, dof, meat, numbers, bread, points=points, noise=noise)


def with_neighbors(parts: Sequence[PartAccuracy]) -> Iterator[PartAccuracy]:
    """Yield the parts with the correlation along frequency that all responses together show."""
    judged = iter(judged_together([part.points.neighbors for part in parts if part.points]))
    for part in parts:
        if part.points and (errors := next(judged)):
            meat, dof = part.points.averaged(errors)
            yield replace(part, meat=meat, dof=dof, neighbors=errors)
        else:
            yield part


def stacked_roots(shares: Iterable[Share], p: int) -> Array:
    """Return the root (n, p) of the information of all parts on the parameters."""
    return np.vstack([share.root[:, :p] for share in shares])


def root_of_inverse(jacobian: Array, basis: Array) -> Array:
    """Return a square root (p, r) of B⁻¹ within `basis` (p, r), for a root (n, p) of B."""
    # B itself has the squares of the singular values: it loses the digits that a root keeps.
    return basis @ np.linalg.inv(triangle_of(jacobian @ basis))


def share_of(part: Information, p: int, paid: float = 0.0, noise: float | None = None) -> Share:
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
    return Share(root, weight * meat[:, :p], size * part.reach[:p], limit, pull, correction)
