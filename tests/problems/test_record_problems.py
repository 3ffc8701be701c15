"""Everything a problem may ask of records, held against known truths and against other ways to the same answer."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from declared_models import Lag as StaticLag, measured
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import toeplitz
from scipy.optimize import curve_fit
from scipy.signal import lfilter
from spring_lag_tilt import (
    FINE,
    HELD,
    LAG,
    SPRING,
    Lag,
    Spring,
    assert_true,
    fit,
    fit_finely,
    lag,
    spring,
    steps,
)

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

NAMES = tuple(SPRING)


def estimates(found, names=NAMES):
    return np.array([found.estimate[n] for n in names])


def errors(found, names=NAMES):
    return np.array([found.standard_error[n] for n in names])


def assert_same(a, b, names=NAMES, share=0.01):
    """Two answers differ by less than this share of a standard error, and their errors by less than that."""
    assert np.all(np.abs(estimates(a, names) - estimates(b, names)) < share * errors(a, names))
    assert_allclose(errors(a, names), errors(b, names), rtol=share)


# --- answers that must not depend on the way


def late_spring():
    return gb.Problem(Spring(), spring(values=SPRING | {"d": 0.033}), HELD, free=("d",))


@pytest.fixture(scope="module")
def late_fit():
    return fit(late_spring())


@pytest.mark.parametrize("segment", [1, 500])
def test_the_answer_does_not_depend_on_the_segments(segment, late_fit):
    other = fit(late_spring(), method=gb.MultipleShooting(segment=segment))
    assert_same(late_fit, other, (*NAMES, "d"))


def test_the_answer_does_not_depend_on_the_order_of_the_records():
    parts = [
        gb.Problem(Spring(), spring(seed=k, n=100 + 40 * k, rate=20.0 + 5 * k), HELD)
        for k in range(3)
    ]
    assert_same(fit_finely(sum(parts)), fit_finely(sum(parts[::-1])))


# --- gaps, several records


def test_two_halves_with_a_gap_are_two_records():
    whole = spring(400, seed=4)
    first, second = whole.rows(np.arange(190)), whole.rows(np.arange(210, 400))
    gapped = gb.Record(
        np.concatenate([first.time, second.time]),
        {n: np.concatenate([first[n], second[n]]) for n in whole.signals},
    )
    noise = gb.OutputError(noise={"x": 0.05, "v": 0.15}, inputs="held")
    one = fit_finely(gb.Problem(Spring(), gapped, noise))
    two = fit_finely(gb.Problem(Spring(), first, noise) + gb.Problem(Spring(), second, noise))
    assert_allclose(estimates(one), estimates(two), rtol=1e-6)
    assert_allclose(one.cost, two.cost, rtol=1e-9)
    assert len(one.records[0].initial["x"]) == 2
    assert_allclose(
        errors(one), errors(two), rtol=0.15
    )  # the color of the residuals is estimated apart
    assert_true(one, SPRING)


def test_several_records_weigh_as_their_information():
    """Standard errors of the sum: inverse variances add."""
    parts = [
        gb.Problem(Spring(), spring(seed=k, n=300, rate=rate), HELD)
        for k, rate in enumerate((20.0, 40.0))
    ]
    alone, together = [fit_finely(p) for p in parts], fit_finely(sum(parts))
    assert_true(together, SPRING)
    information = sum(np.linalg.inv(f.covariance_of(NAMES)) for f in alone)
    assert_allclose(errors(together), np.sqrt(np.diag(np.linalg.inv(information))), rtol=0.1)
    assert [len(r.data) for r in together.records] == [300, 300]


def test_a_renamed_parameter_is_one_records_own():
    light, heavy = dict(SPRING), SPRING | {"b": 1.5}
    problem = gb.Problem(Spring(), spring(seed=1, values=light), HELD) + gb.Problem(
        Spring(), spring(seed=2, values=heavy), HELD, rename={"b": "b_heavy"}
    )
    found = fit_finely(problem)
    assert set(found.free) == {"k", "c", "b", "b_heavy"}
    assert_true(found, SPRING | {"b_heavy": 1.5})


def test_degrees_of_freedom_are_those_of_independent_residuals_also_with_noise_given():
    """Errors follow the residuals, so given variances leave them as uncertain as estimated ones.

    That the residuals are white is known from 400 of them alone: fewer degrees of freedom, though
    enough for intervals that are at most 5 % wider.
    """
    given = gb.OutputError(noise={"x": 0.05, "v": 0.15}, inputs="held")
    found, same = (fit(gb.Problem(Spring(), spring(200), criterion)) for criterion in (HELD, given))
    for one in (found, same):
        assert 25 < one.dof < 2 * 200 - 3 - 2
    assert found.dof == pytest.approx(same.dof, rel=0.05)
    colored = fit(gb.Problem(Spring(), noisy(1, rho=0.9), given))
    assert colored.dof < 0.7 * same.dof
    response = measured(StaticLag(), np.geomspace(0.1, 10, 20), noise=0.02, seed=3)
    variances = replace(response, variance=2 * (0.02 * np.abs(response.response)) ** 2)
    exact = gb.fit(
        gb.Problem(StaticLag(), variances, gb.MaximumLikelihood()), starts=1, progress=False
    )
    assert exact.dof == np.inf


# --- ties, constraints, bounds, fixed values


def test_a_tie_is_a_smaller_model():
    data = spring(seed=6)
    tied = fit_finely(gb.Problem(Spring(), data, HELD, tied={"b": lambda p: p.k * 4 / 9}))
    assert "b" not in tied.free
    assert_true(tied, {"k": 9.0, "c": 1.2, "b": 4.0})
    free = fit_finely(gb.Problem(Spring(), data, HELD))
    assert tied.cost >= free.cost - 1e-6
    assert tied.standard_error["b"] < free.standard_error["b"]


def test_constraints_hold_where_they_matter_and_only_there():
    data = spring(seed=6)
    free = fit_finely(gb.Problem(Spring(), data, HELD))
    slack = fit_finely(gb.Problem(Spring(), data, HELD, constraints=[lambda p: 20 - p.k]))
    assert_same(free, slack)
    active = fit_finely(gb.Problem(Spring(), data, HELD, constraints=[lambda p: p.k - 2.5 * p.b]))
    assert active.converged
    assert_allclose(active.estimate["k"], 2.5 * active.estimate["b"], rtol=1e-6)
    assert any("holds with equality" in w for w in active.warnings)
    # The same as a tie.
    tied = fit_finely(gb.Problem(Spring(), data, HELD, tied={"k": lambda p: 2.5 * p.b}))
    assert_allclose(estimates(active), estimates(tied), rtol=1e-5)
    assert_allclose(active.cost, tied.cost, rtol=1e-6)
    assert_allclose(errors(active), errors(tied), rtol=0.02)


def test_a_parameter_at_its_bound_is_the_fixed_one():
    class Narrow(Spring):
        c = gb.Parameter(0.5, bounds=(0, 0.9))

    data = spring(seed=7)
    found = fit_finely(gb.Problem(Narrow(), data, HELD))
    wanted = fit_finely(gb.Problem(Narrow(), data, HELD, fixed={"c": 0.9}))
    assert_allclose(found.estimate["c"], 0.9)
    assert any("ended at its upper bound" in w for w in found.warnings)
    assert_allclose(estimates(found), estimates(wanted), rtol=1e-5)
    assert_allclose(errors(found, ("k", "b")), errors(wanted, ("k", "b")), rtol=0.02)


def test_an_earlier_fit_widens_the_errors():
    first = fit_finely(gb.Problem(Spring(), spring(60, seed=8), HELD))
    data = spring(400, seed=9)
    exact = fit_finely(gb.Problem(Spring(), data, HELD, fixed={"k": first.estimate["k"]}))
    known = fit_finely(gb.Problem(Spring(), data, HELD, fixed={"k": first}))
    assert_allclose(estimates(exact), estimates(known), rtol=1e-9)
    h = 0.01
    moved = [
        estimates(
            fit_finely(gb.Problem(Spring(), data, HELD, fixed={"k": first.estimate["k"] + s * h})),
            ("c", "b"),
        )
        for s in (1, -1)
    ]
    slope = (moved[0] - moved[1]) / (2 * h)
    wanted = np.hypot(errors(exact, ("c", "b")), slope * first.standard_error["k"])
    assert_allclose(
        errors(known, ("c", "b")), wanted, rtol=0.05
    )  # the color of the residuals is judged anew


# --- biases and initial states


def test_biases_of_outputs_and_inputs():
    force = steps(400, 3)
    data = spring(force=force, seed=3)
    data = data.with_signals(v=data["v"] + 0.4, F=data["F"] + 0.7)
    found = fit_finely(gb.Problem(Spring(), data, gb.OutputError(inputs="held", biases=("v", "F"))))
    assert_true(found, SPRING | {"v_bias": 0.4, "F_bias": 0.7})
    without = fit_finely(gb.Problem(Spring(), data, HELD))
    assert without.cost > found.cost + 100


def test_initial_states_known_as_numbers_and_as_functions():
    data = spring(seed=5, initial={"x": 1.0, "v": -2.0}, force=np.zeros(80) + steps(80, 5) * 0.05)
    unknown = fit_finely(gb.Problem(Spring(), data, HELD))
    numbers = fit_finely(
        gb.Problem(Spring(), data, gb.OutputError(inputs="held", initial={"x": 1.0, "v": -2.0}))
    )
    assert_true(unknown, SPRING)
    assert_true(numbers, SPRING)
    assert numbers.standard_error["k"] < unknown.standard_error["k"]
    assert numbers.records[0].initial["x"][0] == 1
    # In a rest of the spring under a known force the state follows from the parameters.
    force = np.concatenate([[2.0], 2 + steps(99, 5)])
    data = spring(seed=5, initial={"x": 2 * 4 / 9, "v": 0.0}, force=force)
    rest = gb.OutputError(inputs="held", initial={"x": lambda p: 2 * p.b / p.k, "v": 0.0})
    found = fit_finely(gb.Problem(Spring(), data, rest))
    assert_true(found, SPRING)
    assert_allclose(
        found.records[0].initial["x"][0], 2 * found.estimate["b"] / found.estimate["k"], rtol=1e-9
    )


def test_known_initial_states_are_those_of_the_record_not_those_after_a_gap():
    data = spring(300, seed=5, initial={"x": 3.0})
    kept = np.r_[0:100, 140:300]
    known = gb.OutputError(inputs="held", initial={"x": 3.0, "v": 0.0})
    found = fit(gb.Problem(Spring(), data.rows(kept), known))
    assert_true(found, SPRING)
    assert found.records[0].initial["x"][0] == 3
    assert abs(found.records[0].initial["x"][1] - 3) > 0.5


def test_a_long_record_with_a_known_initial_state():
    """Long ones are thinned first, into pieces that begin anywhere."""
    data = spring(24000, seed=1, initial={"x": 5.0})
    found = fit(
        gb.Problem(Spring(), data, gb.OutputError(inputs="held", initial={"x": 5.0, "v": 0.0}))
    )
    assert_true(found, SPRING)


# --- kinds of models


class Static(gb.StateSpace):
    """A saturating amplifier: no states."""

    states = ()
    K = gb.Parameter(1.0, bounds=(-10, 10))
    w = gb.Parameter(1.0, bounds=(0.01, 10))

    def output(self, x, u, p):
        return (p.K * gb.tanh(p.w * u.u),)


def test_a_static_model_is_a_curve_fit():
    random = np.random.default_rng(0)
    u = random.normal(size=300)
    y = 2 * np.tanh(0.7 * u) + 0.05 * random.normal(size=300)
    found = fit(gb.Problem(Static(), gb.Record(0.1 * np.arange(300), {"u": u, "y": y})))
    values, covariance = curve_fit(lambda u, K, w: K * np.tanh(w * u), u, y, (1, 1))
    assert_allclose(estimates(found, ("K", "w")), values, rtol=1e-5)
    assert_allclose(errors(found, ("K", "w")), np.sqrt(np.diag(covariance)), rtol=0.05)


class Decay(gb.StateSpace):
    """Without inputs."""

    states = ("x",)
    inputs = ()
    rate = gb.Parameter(1.0, bounds=(0, 100), unit="1/s")
    power = gb.Parameter(1.0, bounds=(0.5, 3), fixed=True)

    def derivative(self, x, u, p):
        return (-p.rate * x.x,)

    def output(self, x, u, p):
        return (x.x,)


def test_a_model_without_inputs():
    class Named(Decay):
        outputs = ("x",)

    time = np.arange(100) / 50
    ratios = []
    for seed in range(5):
        y = 3 * np.exp(-2.5 * time) + 0.02 * np.random.default_rng(seed).normal(size=100)
        found = fit(gb.Problem(Named(), gb.Record(time, {"x": y})))
        values, covariance = curve_fit(lambda t, r, a: a * np.exp(-r * t), time, y, (1, 1))
        assert_allclose(
            [found.estimate["rate"], found.records[0].initial["x"][0]], values, rtol=1e-5
        )
        ratios.append(found.standard_error["rate"] / np.sqrt(covariance[0, 0]))
    # scipy is told that the errors are white; here that is estimated from 100 of them, record by
    # record.
    assert np.median(ratios) == pytest.approx(1.0, abs=0.1)
    assert max(ratios) < 1.4
    assert min(ratios) > 0.7


def test_a_transfer_function_and_the_same_ode():
    class Ode(gb.StateSpace):
        states = outputs = ("y",)
        delays = {"u": "d"}
        K, T, d = Lag.K, Lag.T, Lag.d

        def derivative(self, x, u, p):
            return ((p.K * u.u - x.y) / p.T,)

        def output(self, x, u, p):
            return (x.y,)

    data = lag(0.06, False, noise=0.05)
    both = [fit(gb.Problem(model, data, free=("d",)), method=FINE) for model in (Lag(), Ode())]
    assert_same(*both, ("K", "T", "d"))
    assert_true(both[0], LAG | {"d": 0.06})


class Cart(gb.StateSpace):
    """A saturated motor against smooth dry friction."""

    states = ("x", "v")
    outputs = ("x", "v")
    F = gb.Parameter(1.0, bounds=(0, 50), unit="m/s²")
    mu = gb.Parameter(0.1, bounds=(0, 10), unit="m/s²")
    limit = gb.Parameter(1.0, bounds=(0.1, 5))

    def derivative(self, x, u, p):
        drive = gb.where(u.u > 0, gb.minimum(u.u, p.limit), gb.maximum(u.u, -p.limit))
        return (x.v, p.F * drive - p.mu * gb.tanh(x.v / 0.05) - 0.3 * x.v)

    def output(self, x, u, p):
        return (x.x, x.v)


def test_saturation_and_friction():
    truth = {"F": 4.0, "mu": 0.8, "limit": 0.6}
    data = gb.virtual_flight(
        Cart(),
        truth,
        excitation={"u": steps(1000, 2, hold=20)},
        rate=50.0,
        noise={"x": 0.01, "v": 0.02},
        seed=1,
    )
    found = fit(
        gb.Problem(Cart(), data, HELD), [{}, {"F": 10.0, "limit": 0.3}, {"mu": 3.0, "limit": 0.9}]
    )
    assert_true(found, truth)
    assert found.agreeing == 3


class Reaction(gb.StateSpace):
    """Two time scales: the fast one 500 times faster than the sampling."""

    states = outputs = ("fast", "slow")
    k = gb.Parameter(1.0, bounds=(0.1, 10), unit="1/s")
    K = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (5000 * (p.K * u.u - x.fast * (1 + x.slow**2)), p.k * (x.fast - x.slow))

    def output(self, x, u, p):
        return (x.fast, x.slow)


def test_a_stiff_model():
    u, truth = 1 + 0.5 * steps(120, 4, hold=10), (2.0, 1.5)

    def slope(t, x):
        return (
            5000 * (truth[1] * u[min(int(t / 0.1 + 1e-9), 119)] - x[0] * (1 + x[1] ** 2)),
            truth[0] * (x[0] - x[1]),
        )

    found = solve_ivp(
        slope, (0, 11.9), (0, 0), "Radau", np.arange(120) * 0.1, rtol=1e-5, atol=1e-7, max_step=0.1
    )
    noisy = found.y + 0.02 * np.random.default_rng(0).normal(size=found.y.shape)
    # A fast state has its own value right after a step of the input, before which it is sampled.
    data = gb.Record(
        found.t, {"u": u, "fast": np.where(np.arange(120) % 10, noisy[0], np.nan), "slow": noisy[1]}
    )
    assert_true(fit(gb.Problem(Reaction(), data, HELD)), {"k": 2.0, "K": 1.5})


class Hydraulic(gb.StateSpace):
    """Pressure in Pa, position in m, angle in mrad: sizes from 1e-3 to 1e6."""

    states = outputs = ("pressure", "position", "angle")
    stiffness = gb.Parameter(5e6, bounds=(1e4, 1e8), unit="Pa/s", scale="log")
    leak = gb.Parameter(3.0, bounds=(0.1, 100), unit="1/s")
    area = gb.Parameter(1e-6, bounds=(1e-8, 1e-4), unit="m/(s·Pa)", scale="log")
    gear = gb.Parameter(0.02, bounds=(0, 1), unit="rad/m")

    def derivative(self, x, u, p):
        return (
            p.stiffness * u.u - p.leak * x.pressure,
            p.area * x.pressure - 0.5 * x.position,
            p.gear * x.position - 2 * x.angle,
        )

    def output(self, x, u, p):
        return (x.pressure, x.position, x.angle)


def test_states_and_parameters_of_very_different_size():
    truth = {"stiffness": 8e6, "leak": 4.0, "area": 3e-7, "gear": 0.01}
    data = gb.virtual_flight(
        Hydraulic(),
        truth,
        excitation={"u": steps(600, 3, hold=15)},
        rate=50.0,
        noise={"pressure": 2e4, "position": 5e-3, "angle": 2e-5},
    )
    found = fit(gb.Problem(Hydraulic(), data, HELD), 6)
    assert_true(found, truth)
    assert found.agreeing == 6


def test_units_do_not_change_the_answer():
    class Milli(Spring):
        def derivative(self, x, u, p):
            return (x.v, -p.k * x.x - p.c * x.v + 1e3 * p.b * u.F)

    data = spring(seed=2)
    scaled = data.with_signals(x=1e3 * data["x"], v=1e3 * data["v"])
    for noise in ("diagonal", "full"):
        rule = gb.OutputError(noise=noise, inputs="held")
        assert_same(
            fit_finely(gb.Problem(Spring(), data, rule)),
            fit_finely(gb.Problem(Milli(), scaled, rule)),
        )


def test_a_quantized_measurement():
    data = spring(600, seed=3, noise=0.0)
    data = data.with_signals(x=np.round(data["x"], 1), v=np.round(data["v"], 1))
    assert_true(fit(gb.Problem(Spring(), data, HELD)), SPRING, 4.0)


def test_without_noise_the_truth_is_found():
    found = fit(gb.Problem(Spring(), spring(noise=0.0), HELD), method=FINE)
    assert_allclose(estimates(found), [*SPRING.values()], rtol=1e-4)


# --- together with frequency responses


class StepLag(StaticLag):
    """The lag of the frequency responses."""


def joint(weights=(1.0, 1.0), seed=0):
    truth = {"K": 2.0, "T": 0.4}
    u = steps(400, seed, hold=6)
    data = gb.virtual_flight(
        StepLag(), truth, excitation={"u": u}, rate=20.0, noise={"y": 0.1}, seed=seed
    )
    response = measured(StepLag(), np.geomspace(0.3, 20, 20), truth, noise=0.02, seed=seed)
    return [
        gb.Problem(StepLag(), data, HELD, weight=weights[0]),
        gb.Problem(StepLag(), response, gb.RelativeLikelihood(), weight=weights[1]),
    ]


def test_a_joint_fit_tends_to_each_alone():
    names = ("K", "T")
    alone = [fit(part) for part in joint()]
    for k, weights in enumerate([(1.0, 1e-9), (1e-9, 1.0)]):
        together = fit(sum(joint(weights)))
        assert_allclose(estimates(together, names), estimates(alone[k], names), rtol=1e-3)
        assert_allclose(errors(together, names), errors(alone[k], names), rtol=0.02)


def test_a_joint_fit_adds_information():
    names = ("K", "T")
    time, frequency = joint()
    alone = [fit(part) for part in (time, frequency)]
    together = fit(time + frequency)
    information = sum(np.linalg.inv(f.covariance_of(names)) for f in alone)
    assert_allclose(
        errors(together, names), np.sqrt(np.diag(np.linalg.inv(information))), rtol=0.15
    )
    assert_true(together, {"K": 2.0, "T": 0.4})


# --- process noise


def windy(n=2000, seed=0):
    return gb.virtual_flight(
        Spring(),
        SPRING,
        excitation={"F": steps(n, seed)},
        rate=20.0,
        noise={"x": 0.02, "v": 0.06},
        process_noise={"v": 1.0},
        seed=seed,
    )


def color(values):
    values = values[np.isfinite(values)]
    return values[1:] @ values[:-1] / (values @ values)


def test_prediction_error_where_the_wind_blows():
    data = windy(800)
    output = fit(gb.Problem(Spring(), data, HELD))
    prediction = fit(gb.Problem(Spring(), data, gb.PredictionError(inputs="held")))
    assert_true(prediction, SPRING)
    assert_true(output, SPRING)
    assert color(output.records[0].residual("x")) > 0.8
    assert abs(color(prediction.records[0].residual("x"))) < 0.1
    assert prediction.cost < output.cost - 400
    assert np.all(errors(prediction) < 0.9 * errors(output))


def test_the_gain_is_that_of_the_kalman_filter():
    from scipy.linalg import expm, solve_discrete_are

    found = fit_finely(
        gb.Problem(Spring(), windy(3000, 1), gb.PredictionError(noise="full", inputs="held"))
    )
    A, step = np.array([[0, 1], [-9, -1.2]]), 0.05
    F = expm(A * step)
    # The force is held over a step: white with a variance of 1 / step.
    drive = np.linalg.solve(A, (F - np.eye(2)) @ [0, 1])
    R = np.diag([0.02**2, 0.06**2])
    P = solve_discrete_are(F.T, np.eye(2), np.outer(drive, drive) / step, R)
    K = P @ np.linalg.inv(P + R)  # corrects before the step
    gain = np.array([[found.estimate[f"K_{s}_{o}"] for o in "xv"] for s in "xv"])
    error = np.array([[found.standard_error[f"K_{s}_{o}"] for o in "xv"] for s in "xv"])
    assert np.all(np.abs(gain - K) < 4 * error)
    assert_allclose(found.records[0].noise, P + R, rtol=0.1, atol=2e-4)


def test_only_some_states_are_corrected():
    rule = gb.PredictionError(corrected=("v",), inputs="held")
    found = fit_finely(gb.Problem(Spring(), windy(1000), rule))
    assert {n for n in found.free if n.startswith("K_")} == {"K_v_x", "K_v_v"}
    assert_true(found, SPRING, 6.0)  # the held force of the wind moves the position a little too
    assert abs(color(found.records[0].residual("v"))) < 0.3


# --- coverage


def noisy(seed, *, n=200, rho=0.0, bias=0.0, **options):
    # The same forces for all seeds, which have the same errors in theory.
    data = spring(n, noise=0.0, **options)
    white = np.random.default_rng([seed, 9]).normal(size=(2, n + 200))
    error = np.array([[0.05], [0.15]]) * lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)[:, 200:]
    return data.with_signals(x=data["x"] + error[0] + bias, v=data["v"] + error[1])


COVERAGE = {
    "colored": ({"rho": 0.8, "n": 400}, HELD),
    "white, with bias and initial states": (
        {"bias": 0.2, "initial": {"x": 0.5, "v": 1.0}},
        gb.OutputError(inputs="held", biases=("x",)),
    ),
}


def expected_errors(data, values, *, rho=0.0, bias=0.0, initial=MappingProxyType({}), **_):
    """Standard errors of least squares with the true weights and the true correlation of the errors."""
    initial = {"x": 0.0, "v": 0.0, **initial}
    at = np.array([*values.values(), *initial.values()])

    def simulated(point):
        spring = dict(zip(values, point, strict=False))
        states = dict(zip(initial, point[len(values) :], strict=True))
        moved = gb.simulate(Spring(), spring, data, initial=states)
        return np.array([moved["x"] / 0.05, moved["v"] / 0.15])

    h = 1e-4 * np.eye(len(at))
    J = [(simulated(at + step) - simulated(at - step)) / 2e-4 for step in h]
    if bias:
        J.append(np.outer([1 / 0.05, 0], np.ones(len(data))))
    J = np.array(J)
    bread = np.linalg.inv(np.einsum("ikn,jkn->ij", J, J))
    meat = np.einsum("ikn,nm,jkm->ij", J, toeplitz(rho ** np.arange(len(data))), J)
    errors = np.sqrt(np.diag(bread @ meat @ bread))
    return np.r_[errors[: len(values)], errors[len(at) :]]


@pytest.mark.parametrize("case", COVERAGE)
def test_errors_are_those_of_theory(case):
    """A reduced form of `benchmarks/coverage_time.py`."""
    options, rule = COVERAGE[case]
    truth = SPRING | ({"x_bias": 0.2} if "bias" in options else {})
    printed = []
    for seed in range(3):
        data = noisy(seed, **options)
        found = fit_finely(gb.Problem(Spring(), data, rule), [SPRING])
        assert_true(found, truth, 5.0)
        printed.append(errors(found, truth))
    # The size and color of the residuals are estimated: a ratio differs from 1 by 0.1.
    expected = expected_errors(data, SPRING, **options)
    assert_allclose(np.mean(printed / expected, 0), 1.0, atol=0.25)
