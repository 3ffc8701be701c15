"""A lag with a gain, in wide bounds, for records that are short beside it."""

import greybox as gb


class SlowLag(gb.StateSpace):
    """tau y' = K u - y."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    tau = gb.Parameter(2.0, bounds=(0.1, 50))

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.x) / p.tau,)

    def output(self, x, u, p):
        return (x.x,)
