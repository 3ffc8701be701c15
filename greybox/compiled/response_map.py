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
import numpy as np

from greybox.files.arrays import Array
from greybox.modeling.complex_arithmetic import Complex

# Product of instructions of the formula, frequencies and parameters above which responses are
# mapped. Below, one expression is built in half a second at most, and is evaluated faster. The
# switch is silent: both forms have the same values and derivatives.
LARGE = 300_000


class Mapped(NamedTuple):
    """One response: (p, omega) -> (real, imaginary part), and the frequencies (n,) in rad/s."""

    formula: ca.Function
    omega: Array

    @property
    def work(self) -> float:
        """The approximate number of instructions of a Hessian."""
        return self.formula.n_instructions() * self.omega.size * (self.formula.numel_in(0) + 1)

    def function(self) -> ca.Function:
        """Return parameters -> real and imaginary part (n,)."""
        p, _ = self.formula.mx_in()
        rows: Any = _over(self.formula, self.omega)(p, self.omega[None])
        return ca.Function("response", [p], [ca.densify(row.T) for row in rows])


def lagrangian_hessian(
    parts: Sequence[tuple[Mapped, ca.SX, Callable[[Complex, Any], Any], float]],
    z: ca.SX,
    data: ca.SX,
    limits: ca.SX,
) -> ca.Function:
    """Return the Hessian of weighted costs and constraints, as option `hess_lag` of `nlpsol`.

    Parameters
    ----------
    parts : sequence of (response, local, cost, weight)
        `local` are its parameters as functions of z and data; `cost` takes response and smoothing.
    z, data : (p,), (g,) symbols
        The `data` also occur in the costs.
    limits : (c,) expressions of z and data
        The constraints.

    Returns
    -------
    casadi.Function
        (z, smoothing and data, weight of the cost, multipliers) -> upper triangle.
    """
    point, p = ca.MX.sym("z", z.numel()), ca.MX.sym("p", 1 + data.numel())
    smoothing, given = p[0], p[1:]
    total: Any = ca.MX(z.numel(), z.numel())
    omega, factors = ca.SX.sym("omega"), ca.SX.sym("factors", 2)
    for mapped, local, cost, weight in parts:
        count, frequencies = mapped.omega.size, mapped.omega[None]
        slope = _criterion_slope(cost, count, data)

        # At one frequency: the expressions do not grow with the number of frequencies. Data that
        # the parameters do not need are left out, since CasADi's map repeats its inputs.
        used = np.flatnonzero(ca.which_depends(local, data, 1, False)).tolist()
        constants, values = data[used], given[used]
        r = ca.densify(ca.vertcat(*mapped.formula(local, omega)))
        jacobian = ca.densify(ca.jacobian(r, z).T)
        rows = ca.Function("rows", [z, constants, omega], [r, jacobian])
        summed, _ = ca.hessian(ca.dot(factors, r), z)
        curvature = ca.Function("curvature", [z, constants, omega, factors], [summed])

        # At all of them.
        outputs: Any = _over(rows, mapped.omega)(point, values, frequencies)
        r, jacobian = ca.vec(outputs[0]), outputs[1]
        along = slope.forward(1).map("along", "serial", z.numel(), [0, 1, 2, 3, 5, 6], [])
        pull: Any = slope(r, smoothing, given)
        curved: Any = along(r, smoothing, given, pull, jacobian.T, 0, 0)
        total += weight * ca.mtimes(jacobian, curved)
        if summed.nnz():  # a formula that is linear in the parameters has none
            mapped_sum = curvature.map("curvatures", "serial", count, [0, 1], [0])
            total += weight * mapped_sum(point, values, frequencies, ca.reshape(pull, 2, count))

    multipliers = ca.SX.sym("multipliers", limits.numel())
    of_limits = ca.Function(
        "limits", [z, data, multipliers], [ca.hessian(ca.dot(multipliers, limits), z)[0]]
    )
    factor, symbols = ca.MX.sym("factor"), ca.MX.sym("multipliers", limits.numel())
    return ca.Function(
        "nlp_hess_l",
        [point, p, factor, symbols],
        [ca.triu(ca.densify(factor * total + of_limits(point, given, symbols)))],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )


def _over(function: ca.Function, omega: Array) -> ca.Function:
    """Return the function mapped over all frequencies, its results side by side."""
    # All inputs but the last, the frequency, are shared.
    return function.map(function.name(), "serial", omega.size, [*range(function.n_in() - 1)], [])


def _criterion_slope(cost: Callable[[Complex, Any], Any], size: int, data: ca.SX) -> ca.Function:
    """Return (r, smoothing, data) -> φ'; real and imaginary parts alternate in r (2 size,)."""
    r, smoothing = ca.SX.sym("r", 2 * size), ca.SX.sym("smoothing")
    value = ca.SX(cost(Complex(r[0::2], r[1::2]), smoothing))
    return ca.Function("slope", [r, smoothing, data], [ca.densify(ca.gradient(value, r))])
