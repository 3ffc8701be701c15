"""What a fixed-step integrator does to an estimate is seen, also where it feigns knowledge."""

import numpy as np

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


def test_a_rate_at_the_limit_of_stability_is_not_believed():
    """The data hold nothing of k; Runge-Kutta steps of 2.78 / k would determine it to 0.2 %, whatever their length."""
    random, n, step = np.random.default_rng(0), 300, 0.05
    u = np.repeat(random.normal(size=n // 10), 10)
    y, decay = np.zeros(n), np.exp(-2.0 * step)
    for i in range(n - 1):
        y[i + 1] = decay * y[i] + 1.5 * (1 - decay) * u[i]
    record = gb.Record(np.arange(n) * step, {"u": u, "y": y + 0.1 * random.normal(size=n)})
    fit = gb.fit(gb.Problem(StiffLag(), record, gb.OutputError(inputs="held")), starts=1)
    believed = fit.standard_error["k"] < 0.05 * fit.estimate["k"]
    assert not believed or any("integration is too coarse" in warning for warning in fit.warnings)
