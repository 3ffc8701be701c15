"""A term that a model with many states lacks is found in its equation, among terms of its kind."""

import numpy as np

import greybox as gb

CELLS = 11
TIME = 0.2 * np.arange(150)  # s


class Chain(gb.StateSpace):
    """A heated chain of cells that lose heat to their surroundings."""

    states = tuple(f"T{i}" for i in range(CELLS))
    inputs, outputs = ("u",), ("T0", "T3", "T10")
    a = gb.Parameter(1.0, bounds=(0.1, 10), unit="1/s")
    h = gb.Parameter(0.5, bounds=(0.01, 5), unit="1/s")
    b = gb.Parameter(5.0, bounds=(0.1, 50), unit="1/s")
    radiation = 0.0

    def derivative(self, x, u, p):
        T = [getattr(x, name) for name in self.states]
        flows = [p.b * u.u, *(p.a * (T[i] - T[i + 1]) for i in range(CELLS - 1)), 0.0]
        rates = [flows[i] - flows[i + 1] - p.h * T[i] for i in range(CELLS)]
        rates[0] = rates[0] - self.radiation * T[0] ** 3
        return tuple(rates)

    def output(self, x, u, p):
        return (x.T0, x.T3, x.T10)


class Radiating(Chain):
    radiation = 0.3


def test_the_missing_term_is_named_with_its_equation():
    u = np.sign(np.sin(0.7 * TIME) + 0.3 * np.sin(2.1 * TIME)) + 0.3
    still = dict.fromkeys(Chain.states, 0.0)
    driven = gb.Record(TIME, {"u": u}, hold={"u": np.inf})
    truth = {"a": 2.0, "h": 0.3, "b": 4.0}
    motion = gb.simulate(Radiating(), truth, driven, initial=still)
    noise = 0.01 * np.random.default_rng(0).normal(size=(3, TIME.size))
    measured = {name: motion[name] + e for name, e in zip(Chain.outputs, noise, strict=True)}
    record = gb.Record(TIME, {"u": u, **measured}, hold={"u": np.inf})
    fit = gb.fit(gb.Problem(Chain(), record, gb.OutputError(initial=still)), starts=1)
    assert not fit.misfit.explains
    named = [cause.text for cause in fit.misfit.causes[:2]]
    assert any("T0**3 in the equation of T0" in text for text in named)
