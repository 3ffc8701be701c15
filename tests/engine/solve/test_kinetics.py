"""Chemical kinetics: fast and slow rates, samples over decades, any unit of concentration."""

import numpy as np
import pytest
from scipy.linalg import expm

import greybox as gb

RATES = {"forward": 30.0, "back": 3.0, "onward": 0.2}
TIME = np.r_[0, np.geomspace(1e-3, 1e2, 60)]


class Reaction(gb.StateSpace):
    """A turns into B and back, and B into C."""

    states = outputs = ("A", "B", "C")
    inputs = ()
    forward = gb.Parameter(1.0, bounds=(1e-3, 1e3), unit="1/s")
    back = gb.Parameter(0.1, bounds=(1e-4, 1e2), unit="1/s")
    onward = gb.Parameter(1.0, bounds=(1e-3, 1e3), unit="1/s")

    def derivative(self, x, u, p):
        net, made = p.forward * x.A - p.back * x.B, p.onward * x.B
        return (-net, net - made, made)

    def output(self, x, u, p):
        return (x.A, x.B, x.C)


class Enzyme(gb.StateSpace):
    """Substrate, its complex with an enzyme, and the product; c is the unit of concentrations."""

    states, inputs, outputs = ("S", "C", "P"), (), ("S", "P")
    c = gb.Parameter(1.0, fixed=True)
    binding = gb.Parameter(5e3, bounds=(1.0, 1e5))
    release = gb.Parameter(200.0, bounds=(1.0, 1e5), unit="1/s")
    turnover = gb.Parameter(30.0, bounds=(0.01, 1e3), unit="1/s")

    def derivative(self, x, u, p):
        net = p.binding * x.S * (0.01 - x.C / p.c) - p.release * x.C
        return (-net, net - p.turnover * x.C, p.turnover * x.C)

    def output(self, x, u, p):
        return (x.S, x.P)


class Flame(gb.StateSpace):
    """The radius of a flame, small for long before it grows (Shampine, Gladwell, Thompson 2003)."""

    states = outputs = ("r",)
    inputs = ()
    a = gb.Parameter(1.0, bounds=(0.01, 100))
    b = gb.Parameter(1.0, bounds=(0.01, 100))

    def derivative(self, x, u, p):
        return (p.a * x.r**2 - p.b * x.r**3,)

    def output(self, x, u, p):
        return (x.r,)


class Oregonator(gb.StateSpace):
    """Oscillating bromate, stiff far from rest (Hairer and Wanner, Solving ODEs II, IV.10)."""

    states = outputs = ("x", "y", "z")
    inputs = ()
    s = gb.Parameter(77.27, bounds=(1, 200))

    def derivative(self, x, u, p):
        return (
            p.s * (x.y - x.x * x.y + x.x - 8.375e-6 * x.x**2),
            (-x.y - x.x * x.y + x.z) / p.s,
            0.161 * (x.x - x.z),
        )

    def output(self, x, u, p):
        return (x.x, x.y, x.z)


def fit(model, record, initial, starts):
    problem = gb.Problem(model, record, gb.OutputError(initial=initial))
    return gb.fit(problem, starts=starts, progress=False, profiles=False)


def test_samples_over_decades_are_fitted_from_every_start():
    # Half of the box is too fast for explicit steps of 18 s, the declared values are not.
    forward, back, onward = RATES.values()
    matrix = np.array([[-forward, back, 0], [forward, -back - onward, 0], [0, onward, 0]])
    exact = np.array([expm(matrix * t) @ [1, 0, 0] for t in TIME]).T
    noisy = exact + 0.01 * np.random.default_rng(3).normal(size=exact.shape)
    record = gb.Record(TIME, dict(zip("ABC", noisy, strict=True)))
    found = fit(Reaction(), record, {"A": 1.0, "B": 0.0, "C": 0.0}, 3)
    assert found.agreeing == 3
    for name, value in RATES.items():
        assert abs(found.estimate[name] - value) < 3 * found.standard_error[name]
    # The initial states alone determine a linear model without inputs; its outputs still vary.
    problem = gb.Problem(Reaction(), record)
    free = gb.fit(problem, starts=1, progress=False, profiles=False)
    assert free.misfit.left < 0.01


def test_a_run_that_noisy_nodes_mislead_begins_again_from_a_simulation():
    """Radii that are noise alone ignite at once, or never."""
    time, initial = np.linspace(0, 2000, 101), {"r": 1e-3}
    exact = gb.simulate(Flame(), {}, gb.Record(time, {"any": time}), initial=initial)
    noise = 0.02 * np.random.default_rng(0).normal(size=time.size)
    found = fit(Flame(), gb.Record(time, {"r": exact["r"] + noise}), initial, 1)
    assert found.converged
    for name in ("a", "b"):
        assert abs(found.estimate[name] - 1) < 4 * found.standard_error[name]


@pytest.mark.parametrize("unit", [1e12, 1e-13])
def test_the_unit_of_concentrations_changes_no_answer(unit):
    time = np.linspace(0, 2, 21)

    def moved(c):
        initial = {"S": c, "C": 0.0, "P": 0.0}
        drive = gb.Record(time, {"any": time})
        return gb.simulate(Enzyme(), {"c": c}, drive, initial=initial, integrator=gb.Radau())

    one, other = moved(1.0), moved(unit)
    for name in ("S", "C", "P"):
        np.testing.assert_allclose(other[name] / unit, one[name], rtol=1e-9, atol=1e-12)


def test_slow_directions_of_fast_rates_stall_no_run():
    # Steps of Newton's method below its tolerance left residuals that counted as failures.
    time = np.linspace(0, 10, 101)
    initial = {"S": 1.0, "C": 0.0, "P": 0.0}
    exact = gb.simulate(Enzyme(), {}, gb.Record(time, {"any": time}), initial=initial)
    noise = 0.01 * np.random.default_rng(0).normal(size=(2, time.size))
    record = gb.Record(time, {"S": exact["S"] + noise[0], "P": exact["P"] + noise[1]})
    found = fit(Enzyme(), record, initial, 2)
    assert np.all(found.runs.converged)
    assert abs(found.estimate["turnover"] - 30) < 4 * found.standard_error["turnover"]


def test_what_becomes_stiff_is_simulated_by_implicit_steps():
    time = np.linspace(0, 60, 41)
    initial = {"x": 1.0, "y": 2.0, "z": 3.0}
    motion = gb.simulate(Oregonator(), {}, gb.Record(time, {"any": time}), initial=initial)
    reference = gb.simulate(
        Oregonator(),
        {},
        gb.Record(time, {"any": time}),
        initial=initial,
        integrator=gb.Radau(substeps=80),
    )
    for name in ("x", "y", "z"):
        np.testing.assert_allclose(motion[name], reference[name], rtol=1e-4)
