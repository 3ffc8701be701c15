"""Programs whose operating points Newton's method finds: their explicit form and its
derivatives, by differences.
"""

import casadi as ca
import numpy as np
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem


class Drag(gb.StateSpace):
    """A mass with quadratic drag in a steady wind: the force that holds its speed follows from
    both.
    """

    states, inputs, outputs = ("v",), ("F",), ("v",)
    c = gb.Parameter(0.4, bounds=(0.1, 5))
    m = gb.Parameter(2.0, bounds=(0.5, 9))
    w = gb.Parameter(0.3, bounds=(-3, 3))

    def derivative(self, x, u, p):
        v = x.v - p.w
        return ((u.F - p.c * v * gb.sqrt(v**2 + 1)) / p.m,)

    def output(self, x, u, p):
        return (x.v,)


def response(force, seed):
    omega, random = np.array([0.3, 1.0, 4.0]), np.random.default_rng(seed)
    values = (0.5 + 0.1 * random.normal(size=3)) / (1 + 1j * omega)
    return gb.Problem(
        Drag(),
        gb.FrequencyResponse(omega, values, "F", "v"),
        gb.SquaredRelativeError(),
        at={"F": force},
    )


def test_an_explicit_program_at_its_roots_is_the_program_and_has_its_derivatives():
    """Two operating points, one of them of a parameter of its own and of another weight; two
    constraints.
    """
    second = response(5.0, 2).with_(
        rename={"w": "w2"}, weight=0.4, constraints=[lambda p: p.c * p.m**2 - p.w]
    )
    problem = response(2.0, 1).with_(constraints=[lambda p: p.m - p.c**2]) + second
    nlp = compile_problem(problem)
    [program] = nlp.programs
    assert program.explicit is not None
    assert program.roots is not None
    z = nlp.scaling.to_solver(np.array([0.7, 1.6, 0.4, -0.2]))
    assert nlp.free == ("c", "m", "w", "w2")

    def whole(v):
        return np.concatenate([value.full().ravel() for value in nlp.program(v, 0.0)])

    assert_allclose(
        np.concatenate([v.full().ravel() for v in program.explicit(z, 0.0, program.roots(z))]),
        whole(z),
    )
    x = nlp.scaling.to_parameters(z)
    assert_allclose(whole(z)[1:], [1.6 - 0.7**2, 0.7 * 1.6**2 + 0.2], rtol=1e-9)
    assert whole(z)[0] == sum(
        nlp.parts[k].weight * nlp.response_cost(x).full()[k, 0] for k in (0, 1)
    )

    slopes = numeric_jacobian(whole, z)
    multipliers = np.array([1.7, 0.6, -0.9])
    wanted = numeric_jacobian(lambda v: multipliers @ numeric_jacobian(whole, v, 1e-3), z, 1e-3)
    x = ca.MX.sym("x", z.size)
    stacked = ca.vertcat(*nlp.program(x, 0.0))
    hessian, _ = ca.hessian(ca.dot(multipliers, stacked), x)
    found, curvature = ca.Function("d", [x], [ca.jacobian(stacked, x), hessian])(z)
    assert_allclose(found.full(), slopes, rtol=1e-6, atol=1e-8)
    assert_allclose(curvature.full(), wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
