"""Fits of records, held against known truths, brute-force likelihoods, and fits that must give the same."""

import re

import numpy as np
import pytest
from hard_models import Direct, direct
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import minimize
from spring_lag_tilt import (
    FINE,
    HELD,
    LAG,
    SPRING,
    TILT,
    FullTilt,
    Lag,
    Spring,
    assert_true,
    fit,
    lag,
    spring,
    tilt_flight,
)

import greybox as gb
from greybox.modeling.formulation.signal_bias import bias_parameter

pytestmark = pytest.mark.usefixtures("unjudged_file")


@pytest.fixture(scope="module")
def flight():
    return tilt_flight()


@pytest.fixture(scope="module")
def short_flight():
    return tilt_flight(15)


# --- the tilt plant in closed loop


def test_every_parameter_of_a_flight_is_found(flight):
    problem = gb.Problem(FullTilt(), flight, HELD, free=("T_rotor", "T_delay"))
    near = [{"T_rotor": 0.03, "T_delay": 0.03, "a1": 10.0, "a2": 1.0, "a4": 300.0, "C_x": 0.5}]
    found = fit(problem, near)
    assert_true(found, TILT, 3.0)
    assert all(
        found.standard_error[name] < 0.05 * max(abs(value), 0.1) for name, value in TILT.items()
    )
    assert found.records[0].fit_percent("theta") > 90
    assert_allclose(np.sqrt(np.diag(found.records[0].noise)), [0.05, 0.02, 0.005], rtol=0.05)


def test_a_start_beside_the_true_lag_beats_one_where_it_changes_places_with_another(short_flight):
    """The rotor's lag and the slow pole of the tilt may swap, and nearly all wide starts end there."""
    problem = gb.Problem(FullTilt(), short_flight, HELD, free=("T_rotor", "T_delay"))
    found = fit(problem, [{"T_rotor": 0.3}, {"T_rotor": 0.03}])
    swapped = found.runs[0]
    assert swapped.estimate[found.free.index("T_rotor")] > 3 * TILT["T_rotor"]
    assert found.cost < swapped.cost - 10
    assert_true(found, TILT, 3.0)
    assert any("only 1 of 2 starts reached the best minimum" in text for text in found.warnings)


def test_random_starts_in_wide_boxes_agree(short_flight):
    problem = gb.Problem(
        FullTilt(), short_flight, HELD, fixed={"T_rotor": TILT["T_rotor"]}, free=("T_delay",)
    )
    found = fit(problem, 3, method=FINE)
    assert_true(found, {k: v for k, v in TILT.items() if k != "T_rotor"}, 3.0)
    assert found.agreeing >= 2


# --- delays


@pytest.mark.parametrize(
    ("samples", "held"), [(0.0, True), (0.13, False), (1.5, True), (3.0, False), (3.0, True)]
)
def test_a_free_delay_is_found_to_a_tenth_of_a_sample(samples, held):
    data = lag(samples * 0.05, held, noise=0.01)
    problem = gb.Problem(
        Lag(), data, gb.OutputError(inputs="held" if held else "linear"), free=("d",)
    )
    found = fit(problem, [{"d": 0.18}, {"d": 0.02}, {"d": 0.1}], method=FINE)
    assert found.converged
    assert abs(found.estimate["d"] / 0.05 - samples) < 0.1
    assert_allclose([found.estimate["K"], found.estimate["T"]], [3, 0.2], rtol=0.02)
    # A held input has a kink in the delay at whole samples, on both sides of which there may be a
    # minimum.
    assert found.agreeing >= (1 if held and samples % 1 == 0 else 3)


@pytest.mark.parametrize("samples", [0.3, 2.0])
def test_a_held_input_that_reaches_the_output_directly_has_the_value_before_its_late_change(
    samples,
):
    """The delay is then found within its sample; a mean of both values would draw it to the next whole one."""
    exact = direct(samples, 0)
    starts = [{"d": d} for d in (0.0, 0.02, 0.07, 0.12)]
    found = fit(gb.Problem(Direct(), exact, HELD, free=("d",)), starts, method=FINE)
    assert found.estimate["d"] / 0.05 == pytest.approx(samples, abs=0.06)
    assert_allclose([found.estimate["K"], found.estimate["T"]], [3, 0.2], rtol=0.03)
    assert np.nanmean(found.records[0].residual("y") ** 2) < 1.2 * 0.01**2
    assert any(
        "the cost is discontinuous where d is a whole number of samples" in text
        for text in found.warnings
    )
    lone = fit(gb.Problem(Lag(), lag(0.015, True, noise=0.01), HELD, free=("d",)), 1)
    assert not any("the cost is discontinuous" in text for text in lone.warnings)
    simulated = gb.simulate(Direct(), {**LAG, "d": samples * 0.05}, exact, inputs="held")
    assert_allclose(
        simulated["y"][5:], exact["y"][5:], atol=0.05
    )  # five standard deviations of the noise


def test_a_delay_by_pade_states_is_nearly_the_same():
    data = lag(0.115, False, noise=0.005)
    exact, pade = (
        fit(gb.Problem(Lag(), data, free=("d",), delay=delay), [{"d": 0.1}], method=FINE)
        for delay in ("exact", "pade:2")
    )
    assert_allclose(pade.estimate["d"], 0.115, atol=0.01)
    assert_allclose(pade.estimate["K"], exact.estimate["K"], rtol=0.02)
    assert_allclose(exact.estimate["d"], 0.115, atol=0.001)


@pytest.mark.parametrize("delay", ["pade:1", "pade:3"])
def test_a_short_delay_by_pade_states_costs_what_the_exact_one_costs(delay):
    """Both compare the same samples, and take the input for constant before the first one."""
    data = lag(0.01, False, noise=0.005)
    exact, pade = (
        fit(gb.Problem(Lag(), data, free=("d",), delay=name), [{"d": 0.02}], method=FINE)
        for name in ("exact", delay)
    )
    # A sample more would change the cost by four.
    assert_allclose(pade.cost, exact.cost, atol=0.3)
    assert_allclose(list(pade.estimate.values()), list(exact.estimate.values()), rtol=2e-3)
    assert pade.converged == 1


# --- the likelihood


def simulated(record, k, c, b, x0, v0):
    """The spring with held forces, sample by sample with the matrix exponential: (2, n)."""
    step = record.step
    big = expm(step * np.array([[0, 1, 0], [-k, -c, b], [0, 0, 0]]))
    rows = np.empty((len(record), 2))
    x = rows[0] = np.array([x0, v0])
    A, B = big[:2, :2], big[:2, 2]
    for i, force in enumerate(record["F"][:-1]):
        rows[i + 1] = x = A @ x + B * force
    return rows.T


def brute_force(record, likelihood):
    """Minimize a likelihood of residuals (2, n) over parameters and initial states, by scipy alone."""
    y = np.array([record["x"], record["v"]])

    def cost(z):
        return likelihood(y - simulated(record, *z))

    return minimize(
        cost,
        [8.9, 1.2, 4.0, *(record[name][0] for name in "xv")],
        method="BFGS",
        options={"gtol": 1e-4},
    )


def gaussian(residual, sigma):
    there = np.isfinite(residual)
    z = residual[there] / np.broadcast_to(np.array(sigma)[:, None], residual.shape)[there]
    return 0.5 * (z @ z) + (there * np.log(np.sqrt(2 * np.pi) * np.array(sigma))[:, None]).sum()


def diagonal(residual):
    sigma = np.sqrt(np.nanmean(residual**2, axis=1))
    return gaussian(residual, sigma)


def full(residual):
    n = residual.shape[1]
    return n / 2 * np.linalg.slogdet(residual @ residual.T / n)[1] + n * (np.log(2 * np.pi) + 1)


def correlated(seed=3, n=150):
    data = spring(n, noise=0.0, seed=seed, initial={"x": 0.4, "v": -0.5})
    error = np.array([[0.05, 0.0], [0.12, 0.05]]) @ np.random.default_rng(seed).normal(size=(2, n))
    return data.with_signals(x=data["x"] + error[0], v=data["v"] + error[1])


KNOWN = {"x": 0.05, "v": 0.13}


@pytest.mark.parametrize(
    ("noise", "likelihood"),
    [(KNOWN, lambda r: gaussian(r, [*KNOWN.values()])), ("diagonal", diagonal), ("full", full)],
    ids=["known", "diagonal", "full"],
)
def test_the_estimate_is_the_most_likely_one(noise, likelihood):
    data = correlated()
    wanted = brute_force(data, likelihood)
    found = fit(gb.Problem(Spring(), data, gb.OutputError(noise=noise, inputs="held")), method=FINE)
    assert_allclose([found.estimate[n] for n in SPRING], wanted.x[:3], rtol=2e-4)
    assert_allclose([found.records[0].initial[n][0] for n in "xv"], wanted.x[3:], atol=2e-3)
    assert_allclose(found.cost, wanted.fun, rtol=1e-6)


def test_missing_samples_are_left_out_of_the_likelihood():
    data = correlated()
    holes = {
        n: np.where(np.random.default_rng(k).random(150) < 0.3, np.nan, data[n])
        for k, n in enumerate("xv")
    }
    data = data.with_signals(**holes)
    wanted = brute_force(data, diagonal)
    found = fit(gb.Problem(Spring(), data, HELD), method=FINE)
    assert_allclose([found.estimate[n] for n in SPRING], wanted.x[:3], rtol=2e-4)
    assert_allclose(found.cost, wanted.fun, rtol=1e-6)
    assert np.isnan(found.records[0].residual("x")[np.isnan(data["x"])]).all()


def test_standard_errors_are_those_of_the_brute_force_likelihood():
    data = spring(400, seed=2)
    wanted = brute_force(data, diagonal)
    found, h = fit(gb.Problem(Spring(), data, HELD)), 1e-4
    y = np.array([data["x"], data["v"]])
    columns = [
        (simulated(data, *(wanted.x + h * e)) - simulated(data, *(wanted.x - h * e))) / (2 * h)
        for e in np.eye(5)
    ]
    sigma = np.sqrt(np.mean((y - simulated(data, *wanted.x)) ** 2, axis=1))
    J = np.array([(c / sigma[:, None]).ravel() for c in columns]).T
    errors = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))[:3]
    assert_allclose(
        [found.standard_error[n] for n in SPRING], errors, rtol=0.1
    )  # residuals nearly white
    assert_allclose(np.sqrt(np.diag(found.white)), errors, rtol=0.01)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_a_bias_begins_as_near_to_zero_in_every_unit(unit):
    time = np.arange(50.0)
    parameter = bias_parameter("y", gb.Record(time, {"y": unit * np.sin(time)}))
    known = bias_parameter("y", gb.Record(time, {"y": np.sin(time)}))
    assert_allclose(
        [*parameter.starts, *parameter.bounds], unit * np.array([*known.starts, *known.bounds])
    )
    assert parameter.bounds[0] <= parameter.starts[0] == -parameter.starts[1] < 0


def test_what_a_record_cannot_be_compared_with_is_said():
    record = gb.Record(0.1 * np.arange(50), {"F": np.ones(50), "other": np.zeros(50)})
    with pytest.raises(
        ValueError, match=r"none of the outputs of Spring \(x, v\); it has F, other"
    ):
        gb.Problem(Spring(), record, HELD)
    with pytest.raises(TypeError, match=r"initial is \[1\.0\]: give \{state: value or function"):
        gb.OutputError(initial=[1.0])
    for value in (np.nan, np.inf, "rest"):
        with pytest.raises(ValueError, match="initial gives 'x' the value"):
            gb.OutputError(initial={"x": value})


def test_only_a_model_with_named_states_is_predicted():
    record = gb.Record(0.1 * np.arange(50), {"u": np.ones(50), "y": np.zeros(50)})
    with pytest.raises(ValueError, match="Lag declares no states, which PredictionError corrects"):
        gb.PredictionError().gains(Lag(), ("y",))
    constant = bias_parameter("u", record)
    known = bias_parameter("u", record.with_signals(u=np.linspace(3.0, 4.0, 50)))
    assert (constant.starts, constant.bounds) == (
        known.starts,
        known.bounds,
    )  # a constant counts as a range of one


def test_unknowns_of_the_criterion_have_sizes_of_the_measured_signals():
    """Ranges for biases, deviations for noise; a constant signal has neither."""
    record = gb.Record(
        np.arange(4.0),
        {"F": [1.0, 3.0, np.nan, 7.0], "x": [2.0, 2.0, 2.0, 2.0], "v": [-1.0, 1.0, 3.0, np.nan]},
        units={"F": "N", "v": "m/s"},
    )
    found = gb.OutputError(biases=("F", "x")).parameters(Spring(), record)
    assert list(found) == ["F_bias", "x_bias"]
    assert (found["F_bias"].start, found["F_bias"].bounds) == (0, (-60, 60))
    assert found["F_bias"].starts == pytest.approx((-0.3, 0.3))
    assert (found["F_bias"].unit, found["x_bias"].unit) == ("N", "1")
    assert (found["x_bias"].bounds, found["x_bias"].starts) == ((-10, 10), (-0.05, 0.05))

    found = gb.PredictionError(process_noise=("v",), biases=("x",)).parameters(Spring(), record)
    assert list(found) == ["x_bias", "w_v", "v_x", "v_v"]
    driven, deviation = found["w_v"], found["v_v"]
    assert (driven.start, driven.bounds, driven.starts, driven.unit) == (
        0,
        (0, np.inf),
        (0, 0),
        "[v]/√s",
    )
    spread = np.sqrt(8 / 3)
    assert deviation.start == pytest.approx(0.1 * spread)
    assert deviation.starts == pytest.approx((1e-5 * spread, spread))
    assert deviation.bounds == pytest.approx((1e-5 * spread, np.inf))
    assert deviation.unit == "m/s"
    assert found["v_x"].start == pytest.approx(0.1)

    gains = gb.PredictionError(corrected=("v",)).parameters(Spring(), record)
    assert list(gains) == ["K_v_x", "K_v_v"]
    assert (gains["K_v_x"].start, gains["K_v_x"].starts, gains["K_v_x"].unit) == (
        0,
        (0, 0),
        "[v/x]",
    )


@pytest.mark.parametrize(
    ("criterion", "words"),
    [
        (
            lambda: gb.OutputError(noise={"x": 0.0}),
            "noise gives 'x' the value 0.0: give a standard deviation above 0.",
        ),
        (
            lambda: gb.OutputError(noise={"x": np.inf}),
            "noise gives 'x' the value inf: give a standard deviation",
        ),
        (
            lambda: gb.OutputError(noise={"x": "1"}),
            "noise gives 'x' the value '1': give a standard deviation",
        ),
        (
            lambda: gb.OutputError(noise="ful"),
            "noise 'ful' is not known: use 'diagonal', 'full', {output: standard",
        ),
        (
            lambda: gb.OutputError(initial={"x": np.nan}),
            "initial gives 'x' the value nan: give a finite number or",
        ),
        (
            lambda: gb.OutputError(initial={"x": "0"}),
            "initial gives 'x' the value '0': give a finite number or a",
        ),
        (
            lambda: gb.PredictionError(process_noise="v", corrected=("v",)),
            "process_noise and disturbance say which states are corrected: leave out corrected.",
        ),
        (
            lambda: gb.PredictionError(process_noise="v", noise="full"),
            "with process_noise or disturbance, sensors have the parameters v_<output>: leave out noise='full', and",
        ),
    ],
)
def test_options_that_are_none_are_refused(criterion, words):
    with pytest.raises(ValueError, match=f"^{re.escape(words)}"):
        criterion()
    with pytest.raises(
        TypeError,
        match=r"^initial is \(\('x', 1\.0\),\): give \{state: value or function of the par",
    ):
        gb.OutputError(initial=(("x", 1.0),))


@pytest.mark.parametrize(
    ("criterion", "signals", "words"),
    [
        (
            gb.OutputError(),
            ("x", "v"),
            "Spring needs the input 'F', which the record does not have: rename one of its signals, x, v.",
        ),
        (
            gb.OutputError(),
            ("F", "y"),
            "the record has none of the outputs of Spring (x, v); it has F, y.",
        ),
        (
            gb.OutputError(noise={"x": 0.1}),
            ("F", "x", "v"),
            "noise gives no standard deviation for 'v': add it, or use noise='diagonal'.",
        ),
        (gb.OutputError(noise={"a": 0.1, "x": 1.0}), ("F", "x"), "Spring has no output 'a'"),
        (gb.OutputError(biases=("v",)), ("F", "x"), "Spring has no measured output or input 'v'"),
        (gb.OutputError(initial={"a": 0.1}), ("F", "x"), "Spring has no state 'a'"),
    ],
)
def test_a_record_that_does_not_meet_the_criterion_is_refused(criterion, signals, words):
    record = gb.Record(np.arange(5.0), dict.fromkeys(signals, np.array([0.0, 1.0, 0.5, 2.0, 1.0])))
    with pytest.raises(ValueError, match=f"^{re.escape(words)}"):
        criterion.compared(Spring(), record)


MORE_NOISE = gb.PredictionError(process_noise=("v", "q"))


@pytest.mark.parametrize(
    ("large", "small", "contains"),
    [
        (gb.OutputError(), gb.OutputError(), True),
        (gb.OutputError(biases=("a", "b")), gb.OutputError(biases=["b"]), True),
        (gb.OutputError(biases=("a",)), gb.OutputError(biases=("b",)), False),
        (gb.OutputError(noise="full"), gb.OutputError(), False),
        (gb.OutputError(errors="huber"), gb.OutputError(), False),
        (gb.OutputError(initial={"v": 0.0}), gb.OutputError(), False),
        (gb.PredictionError(), gb.OutputError(), True),
        (gb.PredictionError(), gb.OutputError(errors="huber"), False),
        (gb.PredictionError(inputs="held"), gb.OutputError(), False),
        (gb.OutputError(), gb.PredictionError(), False),
        (gb.PredictionError(), gb.PredictionError(corrected=("v",)), True),
        (gb.PredictionError(corrected=("v", "q")), gb.PredictionError(corrected=("v",)), True),
        (gb.PredictionError(corrected=("v",)), gb.PredictionError(), False),
        (MORE_NOISE, gb.OutputError(), True),
        (MORE_NOISE, gb.PredictionError(process_noise=("v",)), True),
        (gb.PredictionError(process_noise=("v",)), MORE_NOISE, False),
        (MORE_NOISE, gb.PredictionError(), False),
        (gb.PredictionError(), MORE_NOISE, False),
        (gb.RelativeError(), gb.RelativeError(), True),
        (gb.RelativeError(), gb.SquaredRelativeError(), False),
        (gb.OutputError(), gb.RelativeError(), False),
    ],
    ids=str,
)
def test_a_criterion_contains_those_without_some_of_its_parameters(large, small, contains):
    """Klein and Morelli, chapter 6: without gains or process noise, filter error is output error."""
    assert large.contains(small) == contains
