"""A lag with one rate, for tests of solvers that need no more."""

import greybox as gb


class Lag(gb.StateSpace):
    """x' = a (u - x)."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(1.0, bounds=(0.01, 50))

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.x),)

    def output(self, x, u, p):
        return (x.x,)
