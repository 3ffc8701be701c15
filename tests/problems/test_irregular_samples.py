"""Records whose samples are not uniform in time, against closed forms and scipy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

RANDOM = np.random.default_rng(0)
TIMES = np.sort(RANDOM.uniform(0, 10, 60))


class Decay(gb.StateSpace):
    """x' = -k x + u, with x(0) = 1 where the record begins."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    k = gb.Parameter(0.3, bounds=(0.01, 10), unit="1/s")
    b = gb.Parameter(1.0, bounds=(0.01, 10), unit="1/s")

    def derivative(self, x, u, p):
        return (-p.k * x.x + p.b * u.u,)

    def output(self, x, u, p):
        return (x.x,)


def ramp(k, b):
    """Return the exact x(t) for u = t - t0, from x(t0) = 1."""
    t = TIMES - TIMES[0]
    return (1 + b / k**2) * np.exp(-k * t) + b * (t / k - 1 / k**2)


def ramped():
    noise = 0.05 * np.random.default_rng(1).normal(size=TIMES.size)
    return gb.Record(TIMES, {"u": TIMES - TIMES[0], "x": ramp(0.8, 2.0) + noise}, hold={"u": 0.0})


def test_estimates_and_errors_are_those_of_least_squares_with_the_exact_solution():
    record = ramped()
    white = gb.OutputError(initial={"x": 1.0})
    fit = gb.fit(gb.Problem(Decay(), record, white), starts=3, seed=0)
    other = least_squares(lambda p: record["x"] - ramp(*p), [0.5, 1.0], xtol=1e-12, ftol=1e-12)
    assert_allclose([fit.estimate[name] for name in "kb"], other.x, rtol=1e-5)
    variance = 2 * other.cost / (TIMES.size - 2)
    expected = np.sqrt(variance * np.diag(np.linalg.inv(other.jac.T @ other.jac)))
    errors = [fit.standard_error[name] for name in "kb"]
    assert np.all(np.abs(np.log(errors / expected)) < 0.4)  # they allow for correlated errors


def test_a_simulation_passes_through_the_exact_solution():
    motion = gb.simulate(Decay(), {"k": 0.8, "b": 2.0}, ramped(), initial={"x": 1.0})
    assert_allclose(motion["x"], ramp(0.8, 2.0), rtol=1e-6)


def test_what_needs_uniform_samples_says_so():
    class Late(Decay):
        T = gb.Parameter(0.1, bounds=(0, 0.5), unit="s")
        delays = {"u": "T"}

    with pytest.raises(ValueError, match=r"not uniform .* a delay needs uniform sampling"):
        gb.fit(gb.Problem(Late(), ramped()))
    with pytest.raises(ValueError, match=r"not uniform .* a delay needs uniform sampling"):
        gb.simulate(Late(), {"k": 0.8, "b": 2.0}, ramped())
    with pytest.raises(ValueError, match="corrects its states by a constant gain"):
        gb.fit(gb.Problem(Decay(), ramped(), gb.PredictionError()))
    with pytest.raises(ValueError, match="uniform"):
        gb.regression.equation_error(Decay(), ramped())


class Robertson(gb.StateSpace):
    """Rate constants over nine decades (Robertson 1966), the classical stiff problem."""

    states, inputs, outputs = ("a", "b", "c"), (), ("a", "many_b", "c")
    slow = gb.Parameter(0.1, bounds=(1e-3, 1), starts=(0.0126, 0.126))
    fast = gb.Parameter(1e7, bounds=(1e5, 1e9), starts=(0.95e7, 9.5e7))
    back = gb.Parameter(1e5, bounds=(1e2, 1e6), starts=(3.16e3, 3.16e4))

    def derivative(self, x, u, p):
        made, used, turned = p.slow * x.a, p.back * x.b * x.c, p.fast * x.b**2
        return (-made + used, made - used - turned, turned)

    def output(self, x, u, p):
        return (x.a, 1e4 * x.b, x.c)


def test_stiff_kinetics_with_times_over_eight_decades():
    truth = {"slow": 0.04, "fast": 3e7, "back": 1e4}
    times = np.concatenate([[0.0], np.logspace(-3, 5, 80)])

    def slope(t, x):
        made, used, turned = 0.04 * x[0], 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
        return (-made + used, made - used - turned, turned)

    exact = solve_ivp(slope, (0, 1e5), (1, 0, 0), "LSODA", times, rtol=1e-9, atol=1e-14).y
    exact[1] *= 1e4
    noise = np.array([[0.01], [0.003], [0.01]])
    measured = exact + noise * np.random.default_rng(0).normal(size=exact.shape)
    record = gb.Record(times, dict(zip(Robertson.outputs, measured, strict=True)))
    begin = gb.OutputError(initial={"a": 1.0, "b": 0.0, "c": 0.0})
    fit = gb.fit(gb.Problem(Robertson(), record, begin), starts=3, seed=0)
    assert len(fit.minima[0].runs) == 3
    for name, value in truth.items():
        assert abs(fit.estimate[name] - value) < 3.5 * fit.standard_error[name]


class E5(gb.StateSpace):
    """Stiff kinetics whose concentrations fall by thirty decades (Hairer and Wanner, IV.10)."""

    states, inputs, outputs = ("a", "b", "c", "d"), (), ("a", "b")
    A = gb.Parameter(7e-10, bounds=(8e-11, 8e-9), unit="1/s", scale="log")
    B = gb.Parameter(2.3e4, bounds=(2e3, 2e5), unit="1/s", scale="log")
    a_0 = gb.Parameter(1.0, bounds=(0.5, 2), fixed=True)

    def derivative(self, x, u, p):
        begun, fed, ended, returned = p.A * x.a, p.B * x.a * x.c, 2e6 * x.b * x.c, 1130 * x.d
        return (-begun - fed, begun - ended, begun - fed - ended + returned, fed - returned)

    def output(self, x, u, p):
        return (x.a, x.b)


def test_an_initial_state_is_estimated_like_a_parameter_where_transitions_change_by_decades():
    time = np.append(0, np.geomspace(1e2, 1e11, 40))  # s
    sigma = {"a": 0.01, "b": 1e-9}
    empty = gb.Record(time, dict.fromkeys("ab", 0 * time))
    exact = gb.simulate(E5(), {"A": 7.9e-10, "B": 1.9e4}, empty, initial={"a": 1.0})
    noise = np.random.default_rng(0).normal(size=(2, time.size))
    measured = {n: exact[n] + sigma[n] * e for n, e in zip("ab", noise, strict=True)}
    zero = dict.fromkeys("bcd", 0.0)
    state, parameter = (
        gb.fit(
            gb.Problem(
                E5(), gb.Record(time, measured), gb.OutputError(sigma, initial=initial), free=free
            ),
            starts=1,
        )
        for initial, free in ((zero, ()), (zero | {"a": lambda p: p.a_0}, ("a_0",)))
    )
    assert_allclose(state.cost, parameter.cost, atol=1e-6)
    assert_allclose(state.records[0].initial["a"], parameter.estimate["a_0"], rtol=1e-5)
    for name in "AB":
        assert_allclose(state.estimate[name], parameter.estimate[name], rtol=1e-4)
