"""A stiff model."""

import greybox as gb


class StiffLag(gb.StateSpace):
    """A lag behind one that is much too fast to be seen."""

    states, inputs, outputs = ("x", "f"), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(0.01, 50), unit="1/s", about="pole")
    b = gb.Parameter(1.0, bounds=(-50, 50), unit="1/s", about="gain")
    k = gb.Parameter(1000.0, bounds=(10, 1e6), scale="log", unit="1/s", about="fast pole")

    def derivative(self, x, u, p):
        return (-p.a * x.x + p.b * x.f, p.k * (u.u - x.f))

    def output(self, x, u, p):
        return (x.x,)
