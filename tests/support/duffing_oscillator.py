"""A hardening spring in dimensionless form, of which sines of finite amplitude show harmonics."""

import greybox as gb


class Spring(gb.StateSpace):
    """A hardening spring."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    b = gb.Parameter(1.0, bounds=(0, 10))
    d = gb.Parameter(0.4, bounds=(0, 10))

    def derivative(self, x, u, p):
        return (x.v, -x.x - p.b * x.x**3 - p.d * x.v + u.u)

    def output(self, x, u, p):
        return (x.x,)
