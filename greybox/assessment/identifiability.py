"""How well the data determine each parameter, and which combinations of poorly determined ones."""

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

# Guidelines as shares of the value. Source: Tischler and Remple (2012), Aircraft and Rotorcraft
# System Identification, ch. 12.
ERROR_GUIDELINE = 0.2
INSENSITIVITY_GUIDELINE = 0.1

# Factor by which the error of a reported combination is smaller than those of its members.
GAIN = 5.0

# Squared condition number above which a direction counts as not determined. In double precision,
# rounding alone gives a singular matrix the condition number 1e16.
LARGEST_SQUARED_CONDITION = 1e14

SUPERSCRIPTS = {2: "²", 3: "³"}


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
        # NaN is within no guideline.
        within = (self.error <= ERROR_GUIDELINE) & (self.insensitivity <= INSENSITIVITY_GUIDELINE)
        names = [name for name, is_within in zip(self.names, within, strict=True) if not is_within]
        return tuple(name for name in names if name not in self.at_bound)

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
    unknown = directions.of(places)
    unknown_names = [names[k] for k in places]
    unknown_units = [units[k] for k in places]
    errors = unknown.errors(np.eye(len(places)))
    matrix = unknown.matrix
    diagonal = np.diag(matrix)
    is_seen = diagonal > BLIND**2 * diagonal.max(initial=0.0)

    error = np.full(len(names), np.nan)
    insensitivity = np.full(len(names), np.nan)
    with np.errstate(all="ignore"):
        error_alone = unknown.size / np.sqrt(np.where(is_seen, diagonal, 0.0))
        error[places] = errors / np.abs(unknown.at)
        insensitivity[places] = error_alone / np.abs(unknown.at)
    # A bound determines the value, so errors relative to it mean nothing. It is often zero.
    is_at_bound = np.isin(names, at_bound)
    error[is_at_bound] = math.nan
    insensitivity[is_at_bound] = math.nan

    r = unknown.correlation
    # At a correlation of 0.9, each error is 2.3 times the error with the other parameter known.
    pairs = [pair for pair in combinations(range(len(places)), 2) if abs(r[pair]) > 0.9]
    pairs.sort(key=lambda pair: -abs(r[pair]))
    correlated = [(unknown_names[i], unknown_names[j], float(r[i, j])) for i, j in pairs]

    return Identifiability(
        names=tuple(names),
        error=error,
        insensitivity=insensitivity,
        at_bound=tuple(at_bound),
        correlated=tuple(correlated),
        condition=_condition(matrix),
        combinations=tuple(_combinations(unknown_names, unknown_units, unknown, errors)),
    )


def _condition(matrix: Array) -> float:
    """Return the condition number of the Jacobian J with unit columns; `matrix` (m, m) is JᵀJ."""
    length = np.sqrt(np.diag(matrix))
    if not len(matrix):
        return math.nan
    if not np.all(length > 0):
        return math.inf
    squared = float(np.linalg.cond(matrix / np.outer(length, length)))
    return math.sqrt(squared) if squared < LARGEST_SQUARED_CONDITION else math.inf


def _combinations(
    names: Sequence[str],
    units: Sequence[str],
    directions: KnownDirections,
    errors: Array,
) -> Iterator[DeterminedCombination]:
    """Yield the simplest independent combinations that are determined."""
    value = directions.at
    # Also true where an error is not known, NaN.
    poorly_determined = np.flatnonzero(~(errors <= ERROR_GUIDELINE * np.abs(value))).tolist()
    products = [*_products([k for k in poorly_determined if value[k] != 0])]
    candidates = [*products, *_sums(poorly_determined, units)]
    is_product = np.arange(len(candidates)) < len(products)
    # A row has the powers of the parameters in a product, or their signs in a sum.
    rows = np.zeros((len(candidates), len(value)))
    for row, powers in zip(rows, candidates, strict=True):
        for place, power in powers.items():
            row[place] = power

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
    is_determined = (error * GAIN < smallest) & (error < ERROR_GUIDELINE * size)
    # A second point, if there is one, must determine the combination too.
    beside = directions.elsewhere
    if beside is not None:
        is_determined &= ~np.isnan(beside.errors(beside.gradients(rows, is_product)))

    # The simplest combinations come first: fewest factors, products before sums, fewest divisors,
    # smallest error. The last key of `lexsort` counts first.
    factors = np.abs(rows).sum(axis=1)
    divisors = (rows < 0).sum(axis=1)
    order = np.lexsort((error / smallest, divisors, ~is_product, factors))
    spanned = np.zeros((0, len(value)))
    for k in order[is_determined[order]]:
        scaled = gradients[k] * directions.size
        extended = np.vstack([spanned, unit_length(scaled, 0)])
        # A combination that follows from the previous ones is left out.
        if np.linalg.matrix_rank(extended, tol=1e-6) == len(extended):
            spanned = extended
            combined = _product if is_product[k] else _sum
            yield combined(names, value, rows[k], float(error[k]))


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


def _product(
    names: Sequence[str], value: Array, powers: Array, relative_error: float
) -> DeterminedCombination:
    """Return the product of values (p,) to these powers (p,), or its inverse.

    The formula has the fewest divisors; of two with equally many, the one with a value above one.
    """
    surplus_divisors = (powers < 0).sum() - (powers > 0).sum()
    logarithm = powers @ np.log(np.abs(np.where(powers == 0, 1.0, value)))
    if surplus_divisors > 0 or (surplus_divisors == 0 and logarithm < 0):
        powers = -powers

    places = np.flatnonzero(powers).tolist()
    factors = []
    divisors = []
    for k in places:
        factor = names[k] + SUPERSCRIPTS.get(abs(int(powers[k])), "")
        if powers[k] > 0:
            factors.append(factor)
        else:
            divisors.append(factor)
    formula = " ".join(factors)
    if len(divisors) == 1:
        formula += f"/{divisors[0]}"
    elif divisors:
        formula += f"/({' '.join(divisors)})"

    result = float(np.prod(value[places] ** powers[places]))
    return DeterminedCombination(
        formula,
        names=tuple(names[k] for k in places),
        powers=tuple(int(powers[k]) for k in places),
        value=result,
        standard_error=relative_error * abs(result),
    )


def _sum(names: Sequence[str], value: Array, signs: Array, error: float) -> DeterminedCombination:
    """Return the sum or difference of two of the values (p,), by their signs (p,)."""
    first, second = np.flatnonzero(signs).tolist()
    sign = "+" if signs[second] > 0 else "-"
    return DeterminedCombination(
        f"{names[first]} {sign} {names[second]}",
        names=(names[first], names[second]),
        powers=(int(signs[first]), int(signs[second])),
        value=float(signs @ value),
        standard_error=error,
    )


def _text(judgment: Identifiability) -> Iterator[str]:
    """Yield the lines of the table, the condition number, the correlations and combinations."""
    rows = []
    for k, name in enumerate(judgment.names):
        remark = ""
        if name in judgment.at_bound:
            remark = "at its bound"
        elif name in judgment.beyond:
            remark = "beyond the guideline"
        rows.append(
            [name, _percent(judgment.error[k]), _percent(judgment.insensitivity[k]), remark]
        )

    yield text_table(["parameter", "error, %", "insensitivity, %", ""], rows, left=(0, 3))
    yield ""
    yield (
        f"guidelines: {100 * ERROR_GUIDELINE:.0f} % error (Cramér-Rao bound), "
        f"{100 * INSENSITIVITY_GUIDELINE:.0f} % insensitivity (the error if all others were known)"
    )
    yield f"condition number of the scaled Jacobian: {number(judgment.condition, 3)}"

    for first, second, r in judgment.correlated:
        yield f"correlation of {first} and {second}: {r:.4f}"
    for combination in judgment.combinations:
        yield f"determined together: {combination}"


def _percent(share: float) -> str:
    return "no effect" if math.isinf(share) else number(100 * share, 3)
