"""Fit of a rational function to a measured response by linear least squares, (3.17).

Multiplied by its denominator, the equation (2.13) = P is linear in the unknown coefficients at
every frequency: b(jω) - P [a(jω) - (jω)ⁿ] = P (jω)ⁿ. Its solution needs no start. The method
minimizes |a(jω)| times the error, not the error itself, and so favors high frequencies.

Sources: Levy, Complex-curve fitting, IRE Trans. Automatic Control 4 (1959) 37-43 (who sets a0 = 1
where (2.13) sets the highest coefficient to 1). Sanathanan and Koerner, Transfer function synthesis
as a ratio of two complex polynomials, IEEE Trans. Automatic Control 8 (1963) 56-58.
"""

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.argument_checks import require_whole
from greybox.data.files.arrays import Array, ComplexArray, positive_or_one, real_and_imaginary
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.regression.poles_and_zeros import NearPair, near_pairs, root_text
from greybox.modeling.factored_form import factored, upper_half
from greybox.modeling.formulation.frequency_criteria import RelativeError, evaluate

# Singular values below this share of the largest one are rounding errors, which are 1e-16 in the
# columns; there is a margin for sums.
RANK = 1e-12


@frozen
class RationalFit(Printed):
    """A rational function (2.13) fitted by `levy`.

    Attributes
    ----------
    numerator, denominator : (m + 1,), (n + 1,) arrays
        Coefficients, highest power of s first. That of the denominator's highest power is one.
    integrators : int
        Number of poles at zero: as many last coefficients of the denominator are 0.
    data : FrequencyResponse
    iterations : int
        Number of reweightings.
    cost : float
        Sum of relative errors (4.26), which is not what was minimized; NaN if the data contain a
        zero.
    condition : float
        Condition number of the equations with normalized columns; infinite if the columns are
        linearly dependent.
    """

    numerator: Array
    denominator: Array
    integrators: int
    data: FrequencyResponse
    iterations: int
    cost: float
    condition: float

    @property
    def n(self) -> int:
        """Order of the denominator, the integrator included."""
        return len(self.denominator) - 1

    @property
    def m(self) -> int:
        """Order of the numerator."""
        return len(self.numerator) - 1

    @property
    def zeros(self) -> ComplexArray:
        """Zeros, (m,) or fewer when leading coefficients vanish, rad/s."""
        return np.roots(self.numerator).astype(complex)

    @property
    def poles(self) -> ComplexArray:
        """Poles, (n,), rad/s."""
        return np.roots(self.denominator).astype(complex)

    @property
    def factored(self) -> str:
        """Gain, zeros, time constants and quadratics as (3.18) prints them."""
        return factored(self.numerator, self.denominator)

    @property
    def near_pairs(self) -> tuple[NearPair, ...]:
        """Poles and zeros closer than a tenth of their magnitude, stable or not, closest first."""
        return near_pairs(self.zeros, self.poles)

    @property
    def determined(self) -> bool:
        """Whether the data determine the coefficients; if not, the orders are too high."""
        return self.condition < 1 / RANK

    @property
    def coefficients(self) -> Values:
        """Coefficients by the names of `Polynomial(n, m, integrator)`, as a start for its fit."""
        return coefficients(self.numerator, self.denominator, self.integrators)

    def response(self, omega: ArrayLike) -> FrequencyResponse:
        """Evaluate P(jω) at `omega` (k,) in rad/s."""
        omega = np.array(omega, dtype=float, ndmin=1)
        values = ratio(self.numerator, self.denominator, omega)
        name = f"least squares ({self.n}, {self.m})"
        return FrequencyResponse(
            omega, values, input=self.data.input, output=self.data.output, name=name, source="model"
        )

    def __str__(self) -> str:
        how = "not reweighted"
        if self.iterations:
            how = f"reweighted {counted(self.iterations, 'time')}"
        rows = []
        for kind, roots in (("zero", self.zeros), ("pole", self.poles)):
            for root in upper_half(roots):
                damping = number(-root.real / abs(root), 3) if root else "-"
                rows.append((kind, root_text(root), number(abs(root), 4), damping))
        with_integrator = ", with integrator" if self.integrators else ""
        lines = [
            f"linear least squares (3.17), n = {self.n}, m = {self.m}{with_integrator}, "
            f"{len(self.data)} frequencies, {how}",
            f"P(s) = {self.factored}",
            text_table(("", "rad/s", "size", "damping"), rows),
            f"sum of relative errors {number(self.cost)}",
            *(f"nearly cancel: {pair}" for pair in self.near_pairs),
        ]
        if not self.determined:
            lines.append("the data do not determine the coefficients: lower n and m.")
        return "\n".join(lines)


@public
def levy(
    data: FrequencyResponse,
    n: int,
    m: int,
    integrator: int = False,
    *,
    weight: ArrayLike | None = None,
    iterations: int = 0,
) -> RationalFit:
    """Fit (2.13) of chosen orders to `data` by linear least squares, (3.17), as the paper does.

    The real and imaginary parts of b(jω) - P [a(jω) - (jω)ⁿ] = P (jω)ⁿ at n_ω frequencies are 2 n_ω
    equations. Their columns are normalized, which changes rounding errors but not the solution. If
    the equations are rank deficient, the result is the solution with the least norm of the
    normalized unknowns; see `determined`. It is a start for the model:
    ``gb.fit(problem, starts=[levy(data, 4, 1).coefficients, gb.solve.Sobol(100)])``.

    Parameters
    ----------
    data : FrequencyResponse
        The measured response P = α + jβ.
    n, m : int
        Orders of denominator and numerator, 0 <= m < n. `n` counts the integrator: (3.20) is n=4,
        m=1 with integrator.
    integrator : bool or int
        Number of factors s of the denominator; a0 and so on are then zero.
    weight : (n_ω,) array, optional
        Factors of the equations, above 0, such as ``1 / abs(data.response)``. By default all are
        one, as in the paper.
    iterations : int
        How often the equations are divided by |a(jω)| of the previous solution and solved again
        (Sanathanan and Koerner 1963). The equation error then approaches the error of the response.

    Raises
    ------
    ValueError
        If the orders are not whole numbers with 0 <= m < n, if there are not more equations than
        unknowns (2 n_ω > n + m + 1 in the paper; one unknown less with an integrator), or if
        weights or iterations are out of range.
    """
    _check_orders(data, n, m, integrator)
    weights = np.ones(len(data)) if weight is None else np.asarray(weight, dtype=float)
    if weights.shape != (len(data),) or not np.all((weights > 0) & np.isfinite(weights)):
        raise ValueError(
            f"weight has the shape {weights.shape}: give one finite number above 0 for each of the "
            f"{len(data)} frequencies."
        )
    require_whole("iterations", iterations, 0)

    numerator, denominator, matrix = reweighted(
        data.omega, data.response, (n, m, int(integrator)), weights, iterations
    )
    # A frozen value has frozen arrays.
    numerator.flags.writeable = False
    denominator.flags.writeable = False

    return RationalFit(
        numerator,
        denominator,
        integrators=int(integrator),
        data=data,
        iterations=iterations,
        cost=evaluate(RelativeError(), ratio(numerator, denominator, data.omega), data),
        condition=float(np.abs(np.linalg.cond(matrix))),  # LAPACK's zero may be negative
    )


def ratio(
    numerator: Array | list[float], denominator: Array | list[float], omega: Array
) -> ComplexArray:
    """Return the quotient of two polynomials in s, highest power first, at s = jω."""
    return np.polyval(numerator, 1j * omega) / np.polyval(denominator, 1j * omega)


@public
def order_path(
    data: FrequencyResponse, n: int, m: int, integrator: bool = False
) -> tuple[RationalFit, ...]:
    """Lower the orders from `n` and `m` until no stable pole and zero obviously cancel (section 3).

    While a stable zero is close to a stable pole (`near_pairs`), or the equations are rank
    deficient, both orders are lowered by one, down to m = 0, and the function is fitted again. The
    paper has no number for "obviously". On its tables this rule does not lead to its orders (4, 1):
    begin with several orders, or use `gb.identification.select_orders`.

    Parameters
    ----------
    data, n, m, integrator
        As for `levy`; the orders are the highest ones.

    Returns
    -------
    tuple of RationalFit
        All steps; the last one is the result.

    Raises
    ------
    ValueError
        As `levy`.
    """
    steps = [levy(data, n, m, integrator)]
    while steps[-1].m > 0:
        if steps[-1].determined and not any(pair.stable for pair in steps[-1].near_pairs):
            break
        steps.append(levy(data, steps[-1].n - 1, steps[-1].m - 1, integrator))
    return tuple(steps)


def coefficients(numerator: Array, denominator: Array, integrators: int) -> Values:
    """Return coefficients by the names of `Polynomial(n, m, integrators)`."""
    b = {f"b{k}": float(value) for k, value in enumerate(numerator[::-1])}
    a = {f"a{k}": float(value) for k, value in enumerate(denominator[:0:-1]) if k >= integrators}
    return b | a


def reweighted(
    omega: Array,
    response: ComplexArray,
    orders: tuple[int, int, int],
    weight: Array,
    iterations: int,
) -> tuple[Array, Array, Array]:
    """Return numerators (..., m + 1), denominators (..., n + 1) and normalized equations.

    The equations are those of the last iteration. `response` and `weight` (..., n_ω) belong to one
    problem, or to several that are solved together; `orders` are n, m and the number of
    integrators. See `levy` for the other arguments.
    """
    n, m, integrators = orders
    powers = (1j * omega[:, None]) ** np.arange(n, -1, -1)
    measured = response[..., None] * powers
    shared = np.broadcast_to(powers[:, n - m :], (*response.shape, m + 1))
    equations = np.concatenate([shared, -measured[..., 1 : n + 1 - integrators]], axis=-1)
    highest = np.ones((*response.shape[:-1], 1))
    zeros = np.zeros((*response.shape[:-1], integrators))

    def solved(weight: Array) -> tuple[Array, Array, Array]:
        """Return numerators, denominators and normalized equations for weights (..., n_ω)."""
        factor = weight[..., None]
        matrix = real_and_imaginary(factor * equations, -2)
        # Powers of ω differ by decades. Without scaling, the rank would depend on the unit of ω.
        scale = positive_or_one(np.linalg.norm(matrix, axis=-2, keepdims=True))
        normalized = matrix / scale
        inverse = np.linalg.pinv(normalized, RANK) / scale.mT
        solution = inverse @ real_and_imaginary(factor * measured[..., :1], -2)
        numerator, lower = np.split(solution[..., 0], [m + 1], axis=-1)
        return numerator, np.concatenate([highest, lower, zeros], axis=-1), normalized

    numerator, denominator, normalized = solved(weight)
    # Once the denominator no longer changes, the equation error divided by |a| is the error of the
    # response.
    for _ in range(iterations):
        size = np.abs(denominator @ powers.T)
        numerator, denominator, normalized = solved(weight / size)
    return numerator, denominator, normalized


def _check_orders(data: FrequencyResponse, n: int, m: int, integrator: int) -> None:
    """Raise ValueError for orders that do not suit the equations or the data."""
    require_whole("n", n, 1)
    require_whole("m", m, 0)
    if m >= n:
        raise ValueError(f"m = {m} is not below n = {n}: (2.13) needs m < n, lower m or raise n.")
    unknowns = n + m + 1 - int(integrator)
    if 2 * len(data) <= unknowns:
        raise ValueError(
            f"{len(data)} frequencies give {2 * len(data)} equations for the {unknowns} unknowns "
            f"of n = {n}, m = {m}: (3.17) needs more equations than unknowns, lower n and m or add "
            "frequencies."
        )
