"""Large frequency responses: one small function of the frequency, mapped over all frequencies.

The expressions of a response at all frequencies at once grow with their number, and those of the
Hessian of a cost with that times the number of parameters: 300 frequencies and 200 parameters took
3.3 GB and 70 s before the first iteration. Here the formula is one function of parameters and
frequency. With r the real and imaginary parts at all frequencies, J their Jacobian and φ the
criterion, the Hessian of φ(r(z)) is composed as

    Jᵀ φ'' J + Σ φ'_k r_k'',

where J and the sum come from functions of one frequency, mapped.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca

from greybox.files.arrays import Array
from greybox.modeling.complex_arithmetic import Complex

# Instructions of the formula, times frequencies, times parameters, from which responses are mapped.
# Below, one expression is built in half a second at most, and is evaluated faster. The switch is
# silent: both forms have the same values and derivatives.
LARGE = 300_000


class Mapped(NamedTuple):
    """One response: (p, omega) -> (real, imaginary part), and the frequencies (n,) in rad/s."""

    formula: ca.Function
    omega: Array

    @property
    def work(self) -> float:
        """The approximate number of instructions of a Hessian."""
        return (
            float(self.formula.n_instructions()) * self.omega.size * (self.formula.numel_in(0) + 1)
        )

    def function(self) -> ca.Function:
        """Return parameters -> real and imaginary part (n,)."""
        p = ca.MX.sym("p", self.formula.numel_in(0))
        rows: Any = _over(_rows(self.formula), self.omega)(p, self.omega[None])
        return ca.Function("response", [p], [rows[0, :].T, rows[1, :].T])


def lagrangian_hessian(
    parts: Sequence[tuple[Mapped, ca.SX, Callable[[Complex, Any], Any], float]],
    z: ca.SX,
    limits: ca.SX,
) -> ca.Function:
    """Return the Hessian of weighted costs and constraints, as option `hess_lag` of `nlpsol`.

    Parameters
    ----------
    parts : sequence of (response, local, cost, weight)
        `local` are its parameters as functions of z; `cost` takes response and smoothing.
    z : (p,) symbols
    limits : (c,) expressions of z
        The constraints.

    Returns
    -------
    casadi.Function
        (z, smoothing, weight of the cost, multipliers) -> upper triangle.
    """
    point, smoothing = ca.MX.sym("z", z.numel()), ca.MX.sym("smoothing")
    total: Any = ca.MX(z.numel(), z.numel())
    for mapped, local, cost, weight in parts:
        slope, curvature_times = _criterion_derivatives(cost, mapped.omega.size, z.numel())
        omega = ca.SX.sym("omega")
        rows = ca.Function("rows", [z, omega], [ca.vertcat(*mapped.formula(local, omega))])
        r = ca.vec(_over(rows, mapped.omega)(point, mapped.omega[None]))
        jacobian = _over(_transposed_jacobian(rows), mapped.omega)(point, mapped.omega[None])
        pull = slope(r, smoothing)
        total += weight * ca.mtimes(jacobian, curvature_times(r, smoothing, jacobian.T))
        curvature = _curvature(rows)
        if curvature.nnz_out(0):
            summed = curvature.map("curvatures", "serial", mapped.omega.size, [0], [0])
            total += weight * summed(
                point, mapped.omega[None], ca.reshape(pull, 2, mapped.omega.size)
            )

    multipliers = ca.SX.sym("multipliers", limits.numel())
    of_limits = ca.Function(
        "limits", [z, multipliers], [ca.hessian(ca.dot(multipliers, limits), z)[0]]
    )
    factor, symbols = ca.MX.sym("factor"), ca.MX.sym("multipliers", limits.numel())
    return ca.Function(
        "nlp_hess_l",
        [point, smoothing, factor, symbols],
        [ca.triu(ca.densify(factor * total + of_limits(point, symbols)))],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )


def _rows(formula: ca.Function) -> ca.Function:
    """Return (p, omega) -> real and imaginary part as one column."""
    p, omega = ca.SX.sym("p", formula.numel_in(0)), ca.SX.sym("omega")
    return ca.Function("rows", [p, omega], [ca.densify(ca.vertcat(*formula(p, omega)))])


def _transposed_jacobian(rows: ca.Function) -> ca.Function:
    p, omega = ca.SX.sym("p", rows.numel_in(0)), ca.SX.sym("omega")
    return ca.Function("jacobian", [p, omega], [ca.densify(ca.jacobian(rows(p, omega), p).T)])


def _curvature(rows: ca.Function) -> ca.Function:
    """Return (p, omega, factors of both rows) -> the sum of their Hessians."""
    p, omega, factors = (
        ca.SX.sym("p", rows.numel_in(0)),
        ca.SX.sym("omega"),
        ca.SX.sym("factors", 2),
    )
    return ca.Function(
        "curvature", [p, omega, factors], [ca.hessian(ca.dot(factors, rows(p, omega)), p)[0]]
    )


def _over(function: ca.Function, omega: Array) -> ca.Function:
    """Return the function mapped over all frequencies, its results side by side."""
    return function.map(function.name(), "serial", omega.size, [0], [])


def _criterion_derivatives(
    cost: Callable[[Complex, Any], Any], size: int, columns: int
) -> tuple[ca.Function, Callable[[Any, Any, Any], Any]]:
    """Return (r, smoothing) -> φ' and (r, smoothing, X) -> φ'' X.

    Real and imaginary parts alternate in r (2 size,).
    """
    r, smoothing = ca.SX.sym("r", 2 * size), ca.SX.sym("smoothing")
    value = ca.SX(cost(Complex(r[0::2], r[1::2]), smoothing))
    gradient = ca.densify(ca.gradient(value, r))
    slope = ca.Function("slope", [r, smoothing], [gradient])
    # A cost that is a sum over the frequencies has two rows of φ'' in each column, for real and
    # imaginary part; a function of such sums, as a logarithm, has all rows.
    if ca.jacobian(gradient, r[0]).nnz() <= 4:
        second = ca.Function("second", [r, smoothing], [ca.jacobian(gradient, r)])
        return slope, lambda r, smoothing, x: ca.mtimes(second(r, smoothing), x)

    along = slope.forward(1).map("along", "serial", columns, [0, 1, 2, 4], [])
    return slope, lambda r, smoothing, x: along(r, smoothing, slope(r, smoothing), x, 0)
