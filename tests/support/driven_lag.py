"""A lag with a gain, for records of which one may have another gain."""

import greybox as gb


class Lag(gb.StateSpace):
    """tau y' = g u - y."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    g = gb.Parameter(3.0, bounds=(0.1, 30))
    tau = gb.Parameter(0.4, bounds=(0.02, 5), unit="s")

    def derivative(self, x, u, p):
        return ((p.g * u.u - x.y) / p.tau,)

    def output(self, x, u, p):
        return (x.y,)
