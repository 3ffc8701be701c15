"""Programs of responses at operating points that Newton's method finds, with these roots as inputs.

A root finder is not an SX function, and CasADi's second derivatives through one take twenty times
as long as the cost. With the roots as inputs, cost and constraints are an SX function whose
derivatives hold the roots, see `modeling.trim.Trimmed`. It is evaluated for many points at once,
and IPOPT's derivatives call it after the root finder.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca

from greybox.formulation.problem import Problem
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.trim import Trimmed


def roots_of(
    parts: Sequence[Problem], formulas: Sequence[Trimmed], named: Mapping[str, Any]
) -> ca.MX:
    """Return the roots of all responses, stacked, as expressions of the `named` values."""
    roots = [
        ca.MX(0, 1)
        if formula.root is None
        else formula.root(ca.vertcat(*part.local_values(named).values()))
        for part, formula in zip(parts, formulas, strict=True)
    ]
    return ca.vertcat(*roots)


def explicit_program(
    parts: Sequence[Problem],
    formulas: Sequence[Trimmed],
    named: Mapping[str, Any],
    z: ca.SX,
    cost: Callable[[list[Complex], Any], Any],
    limits: ca.SX,
) -> ca.Function:
    """Return (z, smoothing, w) -> cost and limits, for the stacked roots w of all parts.

    The `named` values and the `limits` (c,) are expressions of z (p,), the `cost` is one of the
    responses of all parts and of the smoothing.
    """
    roots = [ca.SX.sym("w", formula.function.numel_in(1)) for formula in formulas]
    responses = []
    for part, formula, root in zip(parts, formulas, roots, strict=True):
        outputs: Any = formula.function(ca.vertcat(*part.local_values(named).values()), root)
        responses.append(Complex(*outputs))

    smoothing = ca.SX.sym("smoothing")
    return ca.Function(
        "explicit", [z, smoothing, ca.vertcat(*roots)], [ca.SX(cost(responses, smoothing)), limits]
    )


def derivatives_at(roots: ca.Function, explicit: ca.Function) -> dict[str, ca.Function]:
    """Return gradient and Hessian of an explicit program as options of `nlpsol`.

    The program is (z, smoothing, w) -> cost, limits.
    """
    z, smoothing, w = (ca.SX.sym("v", explicit.numel_in(k)) for k in range(3))
    cost, limits = explicit(z, smoothing, w)
    factor, multipliers = ca.SX.sym("factor"), ca.SX.sym("multipliers", limits.numel())
    hessian, _ = ca.hessian(factor * cost + ca.dot(multipliers, limits), z)
    # IPOPT takes the upper triangle alone.
    upper = [ca.triu(ca.densify(hessian))]
    # Cost and gradient share most of their operations, which cse computes once.
    slope = ca.Function(
        "slope", [z, smoothing, w], [cost, ca.densify(ca.gradient(cost, z))], {"cse": True}
    )
    curvature = ca.Function(
        "curvature", [z, smoothing, factor, multipliers, w], upper, {"cse": True}
    )
    x, p, f, m = (ca.MX.sym("v", count) for count in (z.numel(), 1, 1, limits.numel()))
    hessian_at_root: Any = curvature(x, p, f, m, roots(x))
    slope_at_root: Any = slope(x, p, roots(x))

    return {
        "grad_f": ca.Function("nlp_grad_f", [x, p], slope_at_root, ["x", "p"], ["f", "grad_f_x"]),
        "hess_lag": ca.Function(
            "nlp_hess_l",
            [x, p, f, m],
            [hessian_at_root],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
    }
