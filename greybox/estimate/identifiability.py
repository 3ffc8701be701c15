"""How well each parameter, and each combination of parameters, is determined.

Combinations of parameters that the data do not determine, or determine poorly.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from greybox.files.arrays import Array, BoolArray, real_root, sum_of_squares, unit_length
from greybox.files.frozen_values import frozen
from greybox.files.grouping import unique
from greybox.files.numbers_in_text import number, with_error
from greybox.files.printed import Printed, one_line
from greybox.files.text_table import text_table
from greybox.files.wording import counted
from greybox.statistics.column_space import triangle_of

# Guidelines, of the value. Source: Tischler and Remple (2012), Aircraft and Rotorcraft System
# Identification, ch. 12.
ERROR_GUIDELINE = 0.2
INSENSITIVITY_GUIDELINE = 0.1


@frozen
class KnownDirections:
    """The information of the data on parameters, also where they leave directions open.

    Attributes
    ----------
    covariance : (p, p) array
        Covariance of the estimate within the directions that the data determine, without NaN.
    unseen : (p, b) array
        Directions, in multiples of `size`, on which the data contain no information.
    size : (p,) array
        The change of each parameter that the data notice.
    at : (p,) array
        The estimate.
    elsewhere : KnownDirections or None
        The same of the free parameters at a point near the estimate, if a direction is unseen. It
        distinguishes a product from a sum, whose derivatives agree where both factors are equal.
    """

    covariance: Array
    unseen: Array
    size: Array
    at: Array
    elsewhere: "KnownDirections | None" = None

    def of(self, places: Sequence[int]) -> "KnownDirections":
        """Return the directions of the parameters at these places alone.

        `elsewhere` is None if one of them is fixed or tied: it has the free parameters only, which
        come first.
        """
        beside = self.elsewhere
        if beside is not None:
            are_free = max(places, default=0) < len(beside.at)
            beside = beside.of(places) if are_free else None
        return KnownDirections(
            self.covariance[np.ix_(places, places)],
            self.unseen[places],
            self.size[places],
            self.at[places],
            beside,
        )

    @property
    def is_known(self) -> BoolArray:
        """Whether each value counts as exact (p,): constants, and parameters that a bound holds."""
        return (np.diag(self.covariance) == 0) & ~self.unseen.any(axis=1)

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p); NaN for a parameter without a standard error."""
        errors = self.errors(np.eye(len(self.at)))
        errors = np.where(errors > 0, errors, np.nan)
        return self.covariance / np.outer(errors, errors)

    @property
    def matrix(self) -> Array:
        """The inverse covariance in multiples of size; zero along unseen directions."""
        scaled = self.covariance / np.outer(self.size, self.size)
        values, vectors = np.linalg.eigh(scaled)
        lost = np.linalg.matrix_rank(self.unseen) if self.unseen.size else 0
        # Directions without information have the smallest eigenvalues: zero except for rounding.
        seen = vectors[:, lost:]
        return (seen / np.maximum(values[lost:], 1e-300)) @ seen.T

    def errors(self, gradients: Array) -> Array:
        """Return the standard errors (m,) of quantities by their gradients (m, p); NaN if open."""
        variance = np.einsum("ij,jk,ik->i", gradients, self.covariance, gradients)
        scaled = gradients * self.size
        lost = np.abs(scaled @ self.unseen) > BLIND * np.linalg.norm(scaled, axis=1)[:, None]
        return np.where(lost.any(axis=1), np.nan, real_root(variance))

    def gradients(self, rows: Array, is_product: BoolArray) -> Array:
        """Return gradients (m, p) of logarithms of products of powers `rows` (m, p), or of sums."""
        return rows / np.where(is_product[:, None] & (self.at != 0), self.at, 1.0)


@dataclass(frozen=True)
class DeterminedCombination:
    """A product of powers, or a sum, that is determined although none of its members is.

    Attributes
    ----------
    formula : str
        Such as ``a3/a2``.
    names, powers : tuple of str, tuple of int
        Its members, with their powers in a product and their signs in a sum.
    value, standard_error : float
    """

    formula: str
    names: tuple[str, ...]
    powers: tuple[int, ...]
    value: float
    standard_error: float

    def __str__(self) -> str:
        value, error = with_error(self.value, self.standard_error)
        return f"{self.formula} = {value} ± {error}"


@frozen
class Identifiability(Printed):
    """How well the data determine each parameter; printed, it is CIFER's table.

    Attributes
    ----------
    names : tuple of str
        Free parameters.
    error : (p,) array
        Cramér-Rao bound, the standard error of the fit, as a share of the absolute value; NaN where
        it is not known. Guideline: at most 0.2.
    insensitivity : (p,) array
        The standard error that the parameter would have if all others were known, as a share of the
        absolute value; infinite without any effect. Guideline: at most 0.1. A large error with a
        small insensitivity means correlation. A large insensitivity means that the data contain
        little information on the parameter.
    at_bound : tuple of str
        Parameters that ended at a bound. They are taken as known, unless an error of another
        parameter would more than double without the bound.
    correlated : tuple of (str, str, float)
        Pairs with a correlation above 0.9, largest first.
    condition : float
        Condition number of the Jacobian with columns of unit length; infinite where a direction is
        not determined.
    combinations : tuple of DeterminedCombination
        Combinations that are determined although their members are not: the simplest ones.

    Source: Tischler and Remple (2012), Aircraft and Rotorcraft System Identification, 2nd ed.,
    chapter 12.
    """

    names: tuple[str, ...]
    error: Array
    insensitivity: Array
    at_bound: tuple[str, ...]
    correlated: tuple[tuple[str, str, float], ...]
    condition: float
    combinations: tuple[DeterminedCombination, ...]

    @property
    def beyond(self) -> tuple[str, ...]:
        """The parameters beyond a guideline, which the data do not determine well."""
        well = (self.error <= ERROR_GUIDELINE) & (self.insensitivity <= INSENSITIVITY_GUIDELINE)
        return tuple(
            n
            for n, good in zip(self.names, well, strict=True)
            if not good and n not in self.at_bound
        )

    def __repr__(self) -> str:
        return one_line(
            self, counted(len(self.names), "parameter"), f"{len(self.beyond)} beyond a guideline"
        )

    def __str__(self) -> str:
        return "\n".join(_text(self))


def identifiability(
    names: Sequence[str],
    units: Sequence[str],
    directions: KnownDirections,
    at_bound: Sequence[str],
) -> Identifiability:
    """Judge every free parameter at the estimate, and find the combinations that are determined."""
    # A parameter that its bound holds must not appear as an unseen direction.
    is_known = directions.is_known
    places = [k for k, name in enumerate(names) if not (name in at_bound and is_known[k])]
    inside = directions.of(places)
    inside_names = [names[k] for k in places]
    errors = inside.errors(np.eye(len(places)))
    matrix = inside.matrix
    diagonal = np.diag(matrix)
    is_seen = diagonal > BLIND**2 * diagonal.max(initial=0.0)

    error = np.full(len(names), np.nan)
    insensitivity = np.full(len(names), np.nan)
    with np.errstate(all="ignore"):
        alone = inside.size / np.sqrt(np.where(is_seen, diagonal, 0.0))
        error[places] = errors / np.abs(inside.at)
        insensitivity[places] = alone / np.abs(inside.at)
    # A bound chose the value: no share of it means anything, and it is often zero.
    error[np.isin(names, at_bound)] = insensitivity[np.isin(names, at_bound)] = math.nan

    r = inside.correlation
    # From a correlation of 0.9 on, each error is 2.3 times that with the other parameter known.
    pairs = [pair for pair in combinations(range(len(places)), 2) if abs(r[pair]) > 0.9]
    correlated = tuple(
        (inside_names[i], inside_names[j], float(r[i, j]))
        for i, j in sorted(pairs, key=lambda pair: -abs(r[pair]))
    )

    return Identifiability(
        names=tuple(names),
        error=error,
        insensitivity=insensitivity,
        at_bound=tuple(at_bound),
        correlated=correlated,
        condition=_condition(matrix),
        combinations=tuple(_combinations(inside_names, [units[k] for k in places], inside, errors)),
    )


def _condition(matrix: Array) -> float:
    """Return the condition number of the Jacobian J with unit columns; `matrix` (m, m) is JᵀJ."""
    length = np.sqrt(np.diag(matrix))
    if not len(matrix):
        return math.nan
    if not np.all(length > 0):
        return math.inf
    squared = float(np.linalg.cond(matrix / np.outer(length, length)))
    return math.sqrt(squared) if squared < 1e14 else math.inf


def _combinations(
    names: Sequence[str],
    units: Sequence[str],
    directions: KnownDirections,
    errors: Array,
) -> Iterator[DeterminedCombination]:
    """Yield the simplest independent combinations that are determined."""
    value = directions.at
    loose = np.flatnonzero(~(errors <= ERROR_GUIDELINE * np.abs(value))).tolist()
    products = [*_products([k for k in loose if value[k] != 0])]
    members = [*products, *_sums(loose, units)]
    is_product = np.arange(len(members)) < len(products)
    rows = np.zeros((len(members), len(value)))
    for row, powers in zip(rows, members, strict=True):
        row[[*powers]] = [*powers.values()]

    gradients = directions.gradients(rows, is_product)
    error = directions.errors(gradients)
    # The contribution of each member alone. One that is not determined at all, NaN, is infinite.
    single = np.nan_to_num(np.abs(gradients) * errors, nan=np.inf)
    smallest = np.where(rows != 0, single, np.inf).min(axis=1, initial=np.inf)
    # A sum of values of opposite sign may be nearly zero: measure its error by the larger of the
    # members then.
    largest = np.abs(rows * value).max(axis=1, initial=0.0)
    size = np.where(is_product, 1.0, np.maximum(np.abs(rows @ value), largest))
    # A combination is reported if its error is five times smaller than those of its members.
    good = (error * 5.0 < smallest) & (error < ERROR_GUIDELINE * size)
    if beside := directions.elsewhere:  # they must be determined there too
        good &= ~np.isnan(beside.errors(beside.gradients(rows, is_product)))

    # The simplest first: fewest factors, products before sums, few divisors, smallest error. Others
    # follow from the chosen ones.
    factors, divisors = np.abs(rows).sum(axis=1), (rows < 0).sum(axis=1)
    order = np.lexsort((error / smallest, divisors, ~is_product, factors))
    spanned = np.zeros((0, len(value)))
    for k in order[good[order]]:
        scaled = gradients[k] * directions.size
        extended = np.vstack([spanned, unit_length(scaled, 0)])
        # Their number is limited by the directions that remain for the members.
        if np.linalg.matrix_rank(extended, tol=1e-6) == len(extended):
            spanned = extended
            yield _named(names, value, rows[k], float(error[k]), bool(is_product[k]))


def _products(members: Sequence[int]) -> Iterator[dict[int, int]]:
    """Yield candidate powers by place: up to the third for two members, the first for more."""
    # Powers without a common divisor and with a positive first one: others are powers of these.
    # Among eight parameters, products of up to four are a few thousand candidates.
    for count in range(2, 5 if len(members) <= 8 else 3):
        # A length squared or cubed; of products of more than two, nobody reads longer ones.
        highest = 3 if count == 2 else 1
        powers = [n for n in range(-highest, highest + 1) if n]
        for chosen in product(powers, repeat=count):
            if chosen[0] > 0 and math.gcd(*chosen) == 1:
                for group in combinations(members, count):
                    yield dict(zip(group, chosen, strict=True))


def _sums(members: Sequence[int], units: Sequence[str]) -> Iterator[dict[int, int]]:
    """Yield sums and differences of two members of one unit, as signs by place."""
    # A sum of a length and a time has no meaning, whatever the data determine.
    for i, j in combinations(members, 2):
        if units[i] == units[j]:
            yield {i: 1, j: 1}
            yield {i: 1, j: -1}


def _named(
    names: Sequence[str], value: Array, row: Array, error: float, is_product: bool
) -> DeterminedCombination:
    """Write a combination as people do: few divisors, and the larger value over the smaller one."""
    if is_product:
        turned = (row < 0).sum() - (row > 0).sum()
        smaller = row @ np.log(np.abs(np.where(row == 0, 1.0, value))) < 0
        if turned > 0 or (turned == 0 and smaller):
            row = -row

    places = np.flatnonzero(row).tolist()
    members = tuple(names[k] for k in places)
    powers = tuple(int(row[k]) for k in places)
    if is_product:
        above = [_power(n, k) for n, k in zip(members, powers, strict=True) if k > 0]
        below = [_power(n, -k) for n, k in zip(members, powers, strict=True) if k < 0]
        divisor = below[0] if len(below) == 1 else f"({' '.join(below)})"
        formula = " ".join(above) + (f"/{divisor}" if below else "")
        result = float(np.prod(value[places] ** row[places]))
        error *= abs(result)
    else:
        formula = f" {'+' if powers[1] > 0 else '-'} ".join(members)
        result = float(row @ value)
    return DeterminedCombination(formula, members, powers, result, error)


def _power(name: str, power: int) -> str:
    return name if power == 1 else f"{name}{'  ²³'[power]}"


def _text(of: Identifiability) -> Iterator[str]:
    """Yield the table, then correlations, condition number and combinations, a line for each."""
    rows = []
    for name, error, alone in zip(of.names, of.error, of.insensitivity, strict=True):
        remark = (
            "at its bound"
            if name in of.at_bound
            else "beyond the guideline"
            if name in of.beyond
            else ""
        )
        rows.append([name, _percent(error), _percent(alone), remark])

    yield text_table(["parameter", "error, %", "insensitivity, %", ""], rows, left=(0, 3))
    yield ""
    yield (
        f"guidelines: {100 * ERROR_GUIDELINE:.0f} % error (Cramér-Rao bound), "
        f"{100 * INSENSITIVITY_GUIDELINE:.0f} % insensitivity (the error if all others were known)"
    )
    yield f"condition number of the scaled Jacobian: {number(of.condition, 3)}"

    for first, second, r in of.correlated:
        yield f"correlation of {first} and {second}: {r:.4f}"
    for combination in of.combinations:
        yield f"determined together: {combination}"


def _percent(share: float) -> str:
    return "no effect" if math.isinf(share) else number(100 * share, 3)


BLIND = 1e-5  # share of an invisible direction above which a quantity has no standard error


@dataclass(frozen=True)
class Combination:
    """Parameters that the data determine only together.

    Attributes
    ----------
    names : tuple of str
        The parameters involved, the most affected first.
    index : float
        Collinearity index: 1 / smallest singular value of the Jacobian with columns scaled to unit
        length; infinite when the data do not see the combination at all. Above 10 to 20 parameters
        compensate one another. Source: Brun, Reichert and Künsch (2001), Water Resources Research
        37(4).
    directions : int
        In how many directions the parameters move without effect.
    states : tuple of str
        States whose unknown initial values take part.
    """

    names: tuple[str, ...]
    index: float
    directions: int = 1
    states: tuple[str, ...] = ()

    @property
    def members(self) -> tuple[str, ...]:
        """The parameters and the initial states, in words."""
        return (*self.names, *(f"the initial state of {name}" for name in self.states))


def invisible_groups(
    invisible: Array, size: Array, names: tuple[str, ...], initial: Sequence[Mapping[str, Array]]
) -> tuple[Combination, ...]:
    """Return the groups of parameters that move without effect in `invisible` directions (p, b).

    Directions without a common parameter are different groups, however the directions are mixed.
    """
    if not invisible.any():
        return ()  # as of most fits, without the import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (imports slowly)

    # The projector does not depend on how the singular vectors mix equal singular values.
    projector = invisible @ invisible.T
    # No parameter that takes part has an error, however small its part is.
    places = np.flatnonzero(np.diag(projector) > BLIND**2)
    linked = np.abs(projector[np.ix_(places, places)]) > BLIND
    count, labels = connected_components(linked)
    groups = []

    for label in range(count):
        group = places[labels == label].tolist()
        members = sorted(group, key=lambda k: (-round(float(projector[k, k]), 6), k))
        block = projector[np.ix_(members, members)]
        moves = np.zeros((len(names), len(members)))
        moves[members] = block * size[members, None]
        states = unique(
            state
            for of_part in initial
            for state, follow in of_part.items()
            # Initial states that change by less than this share take no part.
            if np.any(np.abs(follow[:, : len(names)] @ moves) > 1e-3)
        )
        directions = max(round(float(np.trace(block))), 1)
        members_by_name = tuple(names[k] for k in members)
        groups.append(Combination(members_by_name, math.inf, directions, states))

    return tuple(sorted(groups, key=lambda group: names.index(group.names[0])))


def collinear_groups(
    jacobian: Array,
    active: Array,
    names: tuple[str, ...],
    at_bound: Sequence[str],
    invisible: Array,
) -> tuple[Combination, ...]:
    """Return combinations whose effects nearly cancel, apart from `invisible` ones (p, b).

    Singular vectors of the same parameters are one combination, with the largest index. `active`
    (a, p) has the gradients of active constraints.
    """
    rows = np.vstack([jacobian, active])
    inside = [k for k, name in enumerate(names) if name not in at_bound and rows[:, k].any()]
    # Columns of unit length: the index measures how parallel effects are, not how large.
    unit = np.vstack([unit_length(jacobian[:, inside], 0), unit_length(active[:, inside], 1)])
    _, singular, rows = np.linalg.svd(triangle_of(unit), full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(rows) - len(singular))])
    # The smallest singular values belong to the invisible directions, which have groups already.
    seen = len(rows) - round(sum_of_squares(invisible[inside]))
    groups: dict[frozenset[str], Combination] = {}

    for value, row in zip(singular[:seen][::-1], np.abs(rows[:seen][::-1]), strict=True):
        if value > 1 / 20:  # above an index of 20 parameters hardly compensate one another
            break
        # Rounding must not order what takes part alike.
        order = np.argsort(-row.round(3), kind="stable")
        group = tuple(names[inside[i]] for i in order if row[i] > 0.2 * row.max())
        groups.setdefault(frozenset(group), Combination(group, float(1 / max(value, 1e-300))))

    return tuple(groups.values())
