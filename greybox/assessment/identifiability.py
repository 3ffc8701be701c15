"""How well each parameter is determined, and which combinations are although no member is."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from greybox.data.files.arrays import Array, unit_length
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import number, with_error
from greybox.data.files.printed import Printed, one_line
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted
from greybox.engine.covariance.known_directions import BLIND, KnownDirections

# Guidelines, of the value. Source: Tischler and Remple (2012), Aircraft and Rotorcraft System
# Identification, ch. 12.
ERROR_GUIDELINE = 0.2
INSENSITIVITY_GUIDELINE = 0.1


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
    # A parameter that is fixed by its bound must not appear as a direction without information.
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
    # A bound determines the value, so errors relative to it mean nothing. It is often zero.
    error[np.isin(names, at_bound)] = insensitivity[np.isin(names, at_bound)] = math.nan

    r = inside.correlation
    # At a correlation of 0.9, each error is 2.3 times the error with the other parameter known.
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
    # The contribution of each member alone to the error. A member that is not determined has the
    # error NaN, which counts as infinite.
    single = np.nan_to_num(np.abs(gradients) * errors, nan=np.inf)
    smallest = np.where(rows != 0, single, np.inf).min(axis=1, initial=np.inf)
    # A sum of values of opposite sign may be nearly zero. Its error is then compared with the
    # larger member.
    largest = np.abs(rows * value).max(axis=1, initial=0.0)
    size = np.where(is_product, 1.0, np.maximum(np.abs(rows @ value), largest))
    # A combination is reported if its error is five times smaller than those of its members.
    good = (error * 5.0 < smallest) & (error < ERROR_GUIDELINE * size)
    if beside := directions.elsewhere:  # they must be determined there too
        good &= ~np.isnan(beside.errors(beside.gradients(rows, is_product)))

    # The simplest combinations come first: fewest factors, products before sums, fewest divisors,
    # smallest error.
    factors, divisors = np.abs(rows).sum(axis=1), (rows < 0).sum(axis=1)
    order = np.lexsort((error / smallest, divisors, ~is_product, factors))
    spanned = np.zeros((0, len(value)))
    for k in order[good[order]]:
        scaled = gradients[k] * directions.size
        extended = np.vstack([spanned, unit_length(scaled, 0)])
        # A combination that follows from the previous ones is left out.
        if np.linalg.matrix_rank(extended, tol=1e-6) == len(extended):
            spanned = extended
            yield _named(names, value, rows[k], float(error[k]), bool(is_product[k]))


def _products(members: Sequence[int]) -> Iterator[dict[int, int]]:
    """Yield the powers of candidate products, by the members' places.

    Products of two members have powers up to the third; longer products have first powers only.
    """
    # The powers have no common divisor and the first is positive: all other products are powers of
    # these. With eight parameters, products of up to four are a few thousand candidates.
    for count in range(2, 5 if len(members) <= 8 else 3):
        # A length may be squared or cubed. Longer products with higher powers are hard to read.
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
    """Return a combination with its formula, written with few divisors or a value above one."""
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
    """Yield the lines of the table, the condition number, the correlations and combinations."""
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
