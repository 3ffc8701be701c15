"""Models that leave their domain, ignite, hide their states or reach limits: found from the starts that `fit` draws."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb


def simulated(derivative, first, time, held, **options):
    """Integrate derivative(x, *inputs) with inputs (m, n) held from sample to sample, to ten digits."""
    states = [np.array(first, dtype=float)]
    for k in range(time.size - 1):
        inputs = [values[k] for values in held]
        step = solve_ivp(
            lambda _, x, inputs=inputs: derivative(x, *inputs),
            (time[k], time[k + 1]),
            states[-1],
            method="LSODA",
            rtol=1e-9,
            atol=1e-10,
            **options,
        )
        states.append(step.y[:, -1])
    return np.array(states).T


def levels(random, n, hold, low, high):
    return np.repeat(random.uniform(low, high, size=-(-n // hold)), hold)[:n]


def fit(problem, starts=12):
    return gb.fit(problem, starts=starts, progress=False)


def near(found, truth, errors=4.0):
    for name, value in truth.items():
        assert abs(found.estimate[name] - value) < errors * found.standard_error[name], name


# --- roots of levels that a start drains ------------------------------------------------------------------------------


class Tanks(gb.StateSpace):
    """Two tanks, the lower one measured; a start with wide drains empties them."""

    states, inputs, outputs = ("h1", "h2"), ("V",), ("h2",)
    k = gb.Parameter(0.005, bounds=(1e-4, 0.1), scale="log")
    a1 = gb.Parameter(0.02, bounds=(1e-3, 0.2), scale="log")
    a2 = gb.Parameter(0.02, bounds=(1e-3, 0.2), scale="log")

    def root(self, level):
        return gb.sqrt(19.62 * level)

    def derivative(self, x, u, p):
        through = p.a1 * self.root(x.h1)
        return ((p.k * u.V - through) / 0.5, (through - p.a2 * self.root(x.h2)) / 0.25)

    def output(self, x, u, p):
        return (x.h2,)


class GuardedTanks(Tanks):
    """The slope of a guarded root is 0 · inf where the tank is empty."""

    def root(self, level):
        return gb.sqrt(19.62 * gb.maximum(level, 0))


@pytest.mark.parametrize("model", [Tanks, GuardedTanks])
def test_tanks_are_found_from_starts_that_would_drain_them(model):
    random, n, truth = np.random.default_rng(0), 400, {"k": 0.0035, "a1": 0.019, "a2": 0.0136}
    time, V = 2.0 * np.arange(n), levels(random, n, 50, 3, 10)

    def derivative(x, V):
        through = 0.019 * np.sqrt(19.62 * max(x[0], 0))
        return [(0.0035 * V - through) / 0.5, (through - 0.0136 * np.sqrt(19.62 * max(x[1], 0))) / 0.25]

    x = simulated(derivative, [0.2, 0.3], time, [V])
    record = gb.Record(time, {"V": V, "h2": x[1] + 0.003 * random.normal(size=n)})
    found = fit(gb.Problem(model(), record, gb.OutputError(inputs="held")))
    assert sum(run.converged for run in found.runs) >= 8
    near(found, truth)


# --- a reactor that ignites -------------------------------------------------------------------------------------------


class Reactor(gb.StateSpace):
    """A stirred tank with Arrhenius kinetics: its rate changes a thousandfold along the record."""

    states, inputs, outputs = ("C", "T"), ("Tc",), ("C", "T")
    k350 = gb.Parameter(0.5, bounds=(0.01, 20), unit="1/min", scale="log")
    E = gb.Parameter(9000.0, bounds=(2000, 20000), unit="K")
    H = gb.Parameter(100.0, bounds=(-500, 1000), unit="K·L/mol")
    UA = gb.Parameter(1.0, bounds=(0.1, 20), scale="log")

    def derivative(self, x, u, p):
        rate = p.k350 * gb.exp(-p.E * (1 / x.T - 1 / 350)) * x.C
        return (1 - x.C - rate, 350 - x.T + p.H * rate + p.UA * (u.Tc - x.T))

    def output(self, x, u, p):
        return (x.C, x.T)


def test_a_reactor_that_ignites_is_found_in_a_wide_box():
    random, n = np.random.default_rng(0), 150
    time, Tc = 0.1 * np.arange(n), levels(random, n, 25, 290, 310)

    def derivative(x, Tc):
        rate = np.exp(-8750 * (1 / x[1] - 1 / 350)) * x[0]
        return [1 - x[0] - rate, 350 - x[1] + 209 * rate + 2.09 * (Tc - x[1])]

    C, T = simulated(derivative, [0.8, 330.0], time, [Tc])
    assert np.ptp(T) > 100
    signals = {"Tc": Tc, "C": C + 0.005 * random.normal(size=n), "T": T + 0.3 * random.normal(size=n)}
    found = fit(gb.Problem(Reactor(), gb.Record(time, signals), gb.OutputError(inputs="held")), 10)
    assert found.agreeing >= 6
    near(found, {"k350": 1.0, "E": 8750.0, "H": 209.0, "UA": 2.09})


# --- states that no output shows --------------------------------------------------------------------------------------


class Chain(gb.StateSpace):
    """Six lags with a cubic loss; the third and the last are measured."""

    states, inputs, outputs = tuple(f"x{k}" for k in range(6)), ("u",), ("middle", "end")
    k = gb.Parameter(5.0, bounds=(0.5, 50), unit="1/s", scale="log")
    b = gb.Parameter(1.0, bounds=(-10, 10))
    d = gb.Parameter(1.0, bounds=(0, 10))

    def derivative(self, x, u, p):
        v = [getattr(x, name) for name in self.states]
        return (p.b * u.u - p.k * v[0] - p.d * v[0] ** 3, *(p.k * (v[i - 1] - v[i]) for i in range(1, 6)))

    def output(self, x, u, p):
        return (x.x2, x.x5)


def test_hidden_states_do_not_explain_what_parameters_should():
    random, n = np.random.default_rng(3), 1000
    u = 3 * np.repeat(random.normal(size=n // 10), 10)
    record = gb.Record(0.02 * np.arange(n), {"u": u})
    truth = {"k": 8.0, "b": 2.0, "d": 1.5}
    clean = gb.simulate(Chain(), truth, record, inputs="held")
    noisy = {name: clean[name] + 0.005 * random.normal(size=n) for name in ("middle", "end")}
    found = fit(gb.Problem(Chain(), record.with_signals(**noisy), gb.OutputError(inputs="held")))
    assert found.agreeing >= 6
    near(found, truth)


class Unseen(gb.StateSpace):
    """Nothing measured depends on the second state."""

    states, inputs, outputs = ("x", "h"), ("u",), ("x", "h")
    a = gb.Parameter(2.0, bounds=(0.1, 20))
    b = gb.Parameter(1.0, bounds=(-10, 10))
    c = gb.Parameter(1.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.a * x.x, x.x - p.c * x.h)

    def output(self, x, u, p):
        return (x.x, x.h)


def test_a_state_that_nothing_shows_hinders_nothing_and_its_parameter_is_named():
    random, n = np.random.default_rng(0), 400
    record = gb.Record(0.05 * np.arange(n), {"u": np.repeat(random.normal(size=n // 10), 10)})
    x = gb.simulate(Unseen(), {"a": 3.0, "b": 2.0, "c": 1.0}, record, inputs="held")["x"]
    record = record.with_signals(x=x + 0.05 * random.normal(size=n))
    found = fit(gb.Problem(Unseen(), record, gb.OutputError(inputs="held")), 6)
    assert found.agreeing == 6
    near(found, {"a": 3.0, "b": 2.0})
    assert np.isnan(found.standard_error["c"])
    assert any(text.startswith("c is not determined") for text in found.warnings)


# --- a limit that the level reaches at times --------------------------------------------------------------------------


class Overflow(gb.StateSpace):
    """The level stops at one; only that tells the size of the inflow, since the sensor's gain is unknown."""

    states, inputs, outputs = ("h",), ("u",), ("y",)
    k = gb.Parameter(0.1, bounds=(0.01, 5), scale="log")
    c = gb.Parameter(0.5, bounds=(0.05, 5), scale="log")
    g = gb.Parameter(1.0, bounds=(0.05, 20), scale="log")

    def derivative(self, x, u, p):
        rate = p.k * u.u - p.c * x.h
        return (gb.where(x.h >= 1, gb.minimum(rate, 0), rate),)

    def output(self, x, u, p):
        return (p.g * x.h,)


def test_a_limit_that_no_start_reaches_is_found_along_what_the_data_do_not_determine():
    random, n, truth = np.random.default_rng(0), 600, {"k": 0.8, "c": 0.6, "g": 3.0}
    u = levels(random, n, 20, 0, 1.3)
    x, y = 0.3, []
    for k in range(n):
        y.append(3.0 * x + 0.01 * random.normal())
        for _ in range(50):
            rate = 0.8 * u[k] - 0.6 * x
            x += 0.1 / 50 * (min(rate, 0) if x >= 1 else rate)
    assert 0.03 < np.mean(np.array(y) > 2.97) < 0.5
    problem = gb.Problem(Overflow(), gb.Record(0.1 * np.arange(n), {"u": u, "y": y}), gb.OutputError(inputs="held"))
    found = fit(problem)
    assert found.cost <= gb.cost(problem, truth) + 5
    for name, value in truth.items():
        assert found.estimate[name] == pytest.approx(value, rel=0.05)


# --- residuals that are far from noise --------------------------------------------------------------------------------


class TooSimple(gb.StateSpace):
    """One lag for two outputs that follow different ones."""

    states, inputs, outputs = ("x", "y"), ("u",), ("x", "y")
    a = gb.Parameter(1.0, bounds=(0.05, 20), scale="log")
    b = gb.Parameter(1.0, bounds=(-10, 10))
    c = gb.Parameter(0.5, bounds=(-10, 10))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.a * x.x, p.c * x.x - p.a * x.y)

    def output(self, x, u, p):
        return (x.x, x.y)


@pytest.mark.parametrize("noise", ["diagonal", "full"])
def test_an_estimated_covariance_that_follows_the_parameters_does_not_slow_the_end(noise):
    """Of a wrong model; the minimum is one in all directions by finite differences of the cost."""
    random, n = np.random.default_rng(0), 300
    time, u = 0.1 * np.arange(n), levels(random, n, 15, -1, 1)
    x = simulated(lambda x, u: [u - 0.4 * x[0], 2.0 * x[0] - 3.0 * x[1] + x[1] ** 2], [0, 0], time, [u])
    record = gb.Record(time, {"u": u, "x": x[0] + 0.01 * random.normal(size=n), "y": x[1]})
    problem = gb.Problem(TooSimple(), record, gb.OutputError(inputs="held", noise=noise))
    found = fit(problem, 4)
    assert sum(run.converged for run in found.runs) == len(found.runs)
    assert max(run.iterations for run in found.runs) <= 40
    for name in found.free:
        for sign in (-1, 1):
            moved = found.estimate | {name: found.estimate[name] + sign * 0.3 * found.standard_error[name]}
            assert gb.cost(problem, moved) >= found.cost - 1e-6
