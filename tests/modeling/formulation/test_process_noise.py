"""Process noise of estimated variance, held against a Kalman filter written here, a truth, and output error."""

from dataclasses import replace

import numpy as np
import pytest
from lateral_aircraft import LATERAL, Lateral, discretized, disturbed, doublets
from numpy.testing import assert_allclose
from sampled_lag import SampledLag, lag_record
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize
from scipy.signal import lfilter
from spring_lag_tilt import SPRING, Spring, assert_true, fit_finely as fit

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem

pytestmark = pytest.mark.usefixtures("unjudged_file")

WIND = gb.PredictionError(process_noise=("v",), inputs="held")
TRUTH = {name: SPRING[name] for name in ("k", "c", "b")}
SENSORS = {"x": 0.05, "v": 0.15}
STEP = 0.05


def flown(wind, seed=1, n=200):
    return disturbed(Spring(), TRUTH, doublets(1, n, 1.0, seed), STEP, {"v": wind}, SENSORS, seed)


@pytest.fixture(scope="module")
def windy():
    record = flown(0.3)
    return record, fit(gb.Problem(Spring(), record, WIND))


def steady_filter(k, c, b, w, v_x, v_v):
    A, B = np.array([[0.0, 1.0], [-k, -c]]), np.array([[0.0], [b]])
    F, G, Q = discretized(A, B, [0.0, w], STEP)
    P = solve_discrete_are(F.T, np.eye(2), Q, np.diag([v_x**2, v_v**2]))
    S = P + np.diag([v_x**2, v_v**2])
    return F, G[:, 0], P @ np.linalg.inv(S), S


def negative_log_likelihood(values, record):
    """Of the innovations of the steady filter from a free first state, the last two of the values."""
    F, G, K, S = steady_filter(*values[:6])
    y, force = np.array([record["x"], record["v"]]).T, record["F"]
    x, errors = values[6:], []
    for k in range(len(force)):
        errors.append(y[k] - x)
        x = F @ (x + K @ errors[-1]) + G * force[k]
    squares = np.einsum("ki,ij,kj->", errors, np.linalg.inv(S), errors)
    return 0.5 * (len(force) * np.linalg.slogdet(2 * np.pi * S)[1] + squares)


def test_gain_and_covariance_follow_the_parameters_as_the_equation_of_riccati_says():
    problem = gb.Problem(Spring(), flown(0.3, n=50), WIND)
    nlp = compile_problem(problem)
    (part,) = nlp.parts
    values = TRUTH | {"w_v": 0.3, "v_x": 0.05, "v_v": 0.15}
    at = np.array([values[name] for name in nlp.free])
    found = part.place(nlp.scaling.to_solver(at)).filter
    _, _, K, S = steady_filter(*at)
    assert_allclose(found.gain, K, rtol=1e-5, atol=1e-7)
    assert_allclose(found.covariance, S, rtol=1e-5)
    for i in range(len(at)):
        step = 1e-4 * at[i] * np.eye(len(at))[i]
        (_, _, K1, S1), (_, _, K0, S0) = steady_filter(*(at + step)), steady_filter(*(at - step))
        assert_allclose(found.gain_slope[:, :, i], (K1 - K0) / (2 * step[i]), rtol=1e-3, atol=1e-6)
        assert_allclose(
            found.covariance_slope[:, :, i], (S1 - S0) / (2 * step[i]), rtol=1e-3, atol=1e-8
        )


def test_the_estimate_is_the_minimum_of_the_likelihood_of_a_kalman_filter(windy):
    record, found = windy
    names = ("k", "c", "b", "w_v", "v_x", "v_v")
    first = [found.records[0].initial[state][0] for state in ("x", "v")]
    at = np.array([*(found.estimate[name] for name in names), *first])
    cost = negative_log_likelihood(at, record)
    assert found.cost == pytest.approx(cost, abs=1e-3)
    lower = minimize(negative_log_likelihood, at, (record,), "BFGS", options={"maxiter": 3})
    assert lower.fun > cost - 1e-3
    error = np.array([found.standard_error[name] for name in names])
    assert_allclose(lower.x[:6], at[:6], atol=0.02 * error.min(), rtol=0.02)
    # BFGS's approximation is far off: the curvature by differences.
    size = 0.1 * np.array([*error, 0.02, 0.05])
    H = np.zeros((8, 8))
    for i, j in zip(*np.triu_indices(8), strict=True):
        e, f = size * np.eye(8)[i], size * np.eye(8)[j]
        corners = [(e + f, 1), (e - f, -1), (f - e, -1), (-e - f, 1)]
        H[i, j] = H[j, i] = sum(s * negative_log_likelihood(at + d, record) for d, s in corners) / (
            4 * size[i] * size[j]
        )
    curvature = np.sqrt(np.diag(np.linalg.inv(H)))[:6]
    white = dict(zip(found.free, np.sqrt(np.diag(found.white)), strict=True))
    assert_allclose([white[name] for name in names], curvature, rtol=0.1)
    # The size of the process noise is estimated, too, and from few numbers.
    assert np.all((curvature < error) & (error < 1.3 * curvature))


def test_a_size_that_the_data_hardly_show_has_no_smaller_error_than_the_curvature_says():
    found = fit(gb.Problem(Spring(), flown(0.02), WIND))
    curvature = np.sqrt(found.white[found.free.index("w_v"), found.free.index("w_v")])
    assert found.standard_error["w_v"] > curvature > found.estimate["w_v"]
    low, high = found.interval()["w_v"]
    assert high - low < 10 * curvature


def test_gains_have_the_errors_of_what_they_follow_from(windy):
    _, found = windy
    names = ("k", "c", "b", "w_v", "v_x", "v_v")
    at = np.array([found.estimate[name] for name in names])
    slopes = []
    for step in np.diag(1e-4 * at):
        (_, _, high, _), (_, _, low, _) = steady_filter(*(at + step)), steady_filter(*(at - step))
        slopes.append((high - low).ravel() / (2 * step.max()))
    expected = np.transpose(slopes) @ found.covariance_of(names) @ slopes
    kept = found.at_estimate()
    places = [
        kept.names.index(f"K_{state}_{output}") for state in ("x", "v") for output in ("x", "v")
    ]
    assert_allclose(
        kept.covariance[np.ix_(places, places)],
        expected,
        rtol=1e-2,
        atol=1e-2 * np.abs(expected).min(),
    )
    own = [kept.names.index(name) for name in ("k", "c", "b")]
    assert_allclose(
        kept.covariance[np.ix_(own, own)], found.covariance_of(("k", "c", "b")), rtol=1e-9
    )


def test_a_test_against_output_error_tells_whether_there_is_process_noise(windy):
    record, found = windy
    calm = flown(0.0, seed=2)
    rule = gb.OutputError(inputs="held")
    simulated = fit(gb.Problem(Spring(), record, rule))
    assert any("look like gusts" in text for text in simulated.notes)
    without = fit(gb.Problem(Spring(), record, WIND, fixed={"w_v": 0.0}))
    assert any("start process noise above zero" in text for text in without.warnings)
    needed = gb.validation.nested_test(simulated, found)
    assert needed.terms == ("w_v",)
    assert needed.p_value < 1e-6
    small, large = fit(gb.Problem(Spring(), calm, rule)), fit(gb.Problem(Spring(), calm, WIND))
    assert large.cost <= small.cost + 1e-2
    assert large.estimate["w_v"] == 0
    # The two are then the same model, and which one costs less is rounding.
    for rounding in (-1e-9, 1e-9):
        same = replace(large, cost=small.cost + rounding)
        assert gb.validation.nested_test(small, same).p_value == 1.0
    assert any("show no process noise: w_v" in text for text in large.warnings)
    assert not any("look like gusts" in text for text in small.notes)
    assert not any("not determined" in text for text in large.warnings)


@pytest.mark.parametrize("time", [0.5, 3.0])
def test_gusts_that_last_are_named_in_a_long_record_and_slow_sensors_are_not(time):
    calm, rule = flown(0.0, n=20), gb.PredictionError(disturbance={"v": "colored"}, inputs="held")
    gusty = gb.Problem(Spring(), calm, rule).model
    truth, inputs = TRUTH | {"T_gust_v": time}, doublets(1, 800, 1.0, 5)
    random = np.random.default_rng(5)
    named = []
    for size in (1.0, 0.0):
        record = disturbed(gusty, truth, inputs, STEP, {"gust_v": size}, SENSORS, 5)
        slow = {
            name: record[name]
            + (size == 0) * lfilter([deviation], [1, -0.95], random.normal(size=800))
            for name, deviation in SENSORS.items()
        }
        simulated = fit(
            gb.Problem(Spring(), record.with_signals(**slow), gb.OutputError(inputs="held"))
        )
        named.append(any("look like gusts" in text for text in simulated.notes))
    assert named == [True, False]


def test_five_outputs_need_a_few_numbers():
    wind = {"beta": 0.01, "p": 0.15}
    sensors = {"beta": 0.005, "p": 0.01, "r": 0.005, "phi": 0.004, "a_y": 0.02}
    record = disturbed(Lateral(), LATERAL, doublets(2, 200, 0.1, 3), 0.04, wind, sensors, 3)
    found = fit(
        gb.Problem(
            Lateral(), record, gb.PredictionError(process_noise=("beta", "p"), inputs="held")
        )
    )
    assert len(found.free) == len(LATERAL) + 7
    truth = LATERAL | {f"w_{name}": size for name, size in wind.items()}
    truth |= {f"v_{name}": size for name, size in sensors.items()}
    assert_true(found, truth, 4.0)


def test_a_saved_fit_predicts_by_its_filter(windy, tmp_path):
    record, found = windy
    gb.save(found, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5")
    assert loaded.records[0].driven == ("v",)
    assert loaded.records[0].added == ("w_v", "v_x", "v_v")
    assert_allclose(loaded.records[0].gain, found.records[0].gain)
    _, _, K, S = steady_filter(
        *(found.estimate[name] for name in ("k", "c", "b", "w_v", "v_x", "v_v"))
    )
    assert_allclose(np.reshape(found.records[0].gain, (2, 2)), K, rtol=1e-4, atol=1e-6)
    assert_allclose(found.records[0].noise, S, rtol=1e-4)
    ahead = gb.predict(found, record=record, lead=2.0, horizon=0.5)
    assert abs(np.nanstd(ahead.one_step) - 1) < 0.1  # with the covariance of the filter


def test_what_process_noise_does_not_go_with_is_refused():
    record = flown(0.3, n=50)
    for options, reason in (
        ({"corrected": ("x",)}, "leave out corrected"),
        ({"noise": "full"}, "leave out noise='full'"),
        ({"noise": {"x": 0.1, "v": 0.1}}, "fixed="),
    ):
        with pytest.raises(ValueError, match=reason):
            gb.PredictionError(process_noise="v", **options)
    with pytest.raises(ValueError, match="state 'y'"):
        gb.Problem(Spring(), record, gb.PredictionError(process_noise="y"))
    slow = record.with_signals(x=np.where(np.arange(50) % 5, np.nan, record["x"]))
    with pytest.raises(ValueError, match="at too few samples for process_noise"):
        compile_problem(gb.Problem(Spring(), slow, WIND)).parts[0].place(np.ones(6))
    with pytest.raises(ValueError, match="use method=MultipleShooting"):
        gb.fit(
            gb.Problem(Spring(), record, WIND), starts=1, method=gb.Collocation(), progress=False
        )


def test_manoeuvres_of_unlike_sizes_share_the_noise_of_their_sensors():
    large, small = flown(0.3), flown(0.3, seed=2)
    small = small.with_signals(x=0.01 * small["x"], v=0.01 * small["v"], F=0.01 * small["F"])
    assert gb.several(Spring(), [large, small], criterion=WIND).parameters["v_x"].bounds[0] > 0


GUSTY = gb.PredictionError(disturbance={"v": "colored"}, inputs="held")


def gusty(seed=1, n=400, rms=1.0, time=0.5):
    """A record of the spring in gusts of first order; they are an Ornstein-Uhlenbeck process."""
    model = gb.Problem(Spring(), flown(0.0, n=20), GUSTY).model
    truth, noise = TRUTH | {"T_gust_v": time}, {"gust_v": rms * np.sqrt(2 / time)}
    return disturbed(model, truth, doublets(1, n, 1.0, seed), STEP, noise, SENSORS, seed)


def test_gusts_are_estimated_with_their_time_constant(tmp_path):
    record = gusty()
    problem = gb.Problem(Spring(), record, GUSTY)
    assert problem.model.states == ("x", "v", "gust_v")
    assert problem.with_(criterion=gb.OutputError()).model.states == ("x", "v")
    truth = TRUTH | {"w_gust_v": 2.0, "v_x": 0.05, "v_v": 0.15}
    found = fit(problem, starts=[TRUTH])
    assert_true(found, truth, 3.0)
    # The errors of a time constant are nearly normal in its logarithm.
    relative = found.standard_error["T_gust_v"] / found.estimate["T_gust_v"]
    assert abs(np.log(found.estimate["T_gust_v"] / 0.5)) < 3 * relative

    gb.save(found, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5", models=[Spring])
    assert loaded.model_of(0).states == ("x", "v", "gust_v")
    assert np.isfinite(gb.simulate(loaded, record=record)["x"]).all()


def test_gusts_that_do_not_blow_have_no_time_constant():
    found = fit(gb.Problem(Spring(), flown(0.0, seed=2), GUSTY))
    assert found.estimate["w_gust_v"] == 0
    assert not any("not determined" in text for text in found.warnings)


def test_a_time_constant_of_a_sample_is_that_of_white_noise():
    found = fit(gb.Problem(Spring(), flown(1.0, n=100), GUSTY))
    assert found.by_name["T_gust_v"].at_bound
    assert any("white noise, process_noise=('v',)" in text for text in found.warnings)


def test_steps_that_overshoot_settle():
    """Damping that fell after each of them let runs go to and fro beside this minimum to their end."""
    gusty = gb.PredictionError(disturbance={"y": "colored"}, inputs="held")
    found = fit(gb.Problem(SampledLag(), lag_record(5, 200), gusty), starts=2)
    assert found.runs.converged.all()
    assert max(found.runs.iterations) < 300


class WithAcceleration(Spring):
    outputs = ("x", "v", "a")

    def output(self, x, u, p):
        return (x.x, x.v, self.derivative(x, u, p)[1])


class Pushed(WithAcceleration):
    """The spring with a further force per mass."""

    inputs = ("F", "push")

    def derivative(self, x, u, p):
        v, a = super().derivative(x, u, p)
        return (v, a + u.push)


def test_a_gust_is_in_the_measured_acceleration_too():
    random, step, n = np.random.default_rng(3), 0.02, 600
    (force,) = doublets(1, n, 1.0, 1)
    change = np.exp(-step / 0.5)
    push = lfilter([np.sqrt(1 - change**2)], [1, -change], random.normal(size=n))
    forces = gb.Record(
        step * np.arange(n), {"F": force, "push": push}, hold=dict.fromkeys(("F", "push"), np.inf)
    )
    clean = gb.simulate(Pushed(), TRUTH, forces, initial={"x": 0.0, "v": 0.0})
    size = {"x": 0.02, "v": 0.05, "a": 0.1}
    noisy = {name: clean[name] + s * random.normal(size=n) for name, s in size.items()}
    record = forces.with_signals(**noisy)
    found = fit(gb.Problem(WithAcceleration(), record, GUSTY), starts=[TRUTH])
    noise = {f"v_{name}": s for name, s in size.items()}
    assert_true(found, TRUTH | noise | {"w_gust_v": 2.0}, 3.5)
    # Without the gust in its model, the acceleration would look ten times as noisy.
    assert found.standard_error["w_gust_v"] < 0.2


def test_accelerations_without_noise_leave_errors_of_the_size_of_the_spread():
    """Almost all information is in the difference of outputs that the states and inputs give."""
    sensors, deviations = dict.fromkeys("xva", 1e-4), []
    rule = gb.PredictionError(process_noise=("v",), inputs="held")
    for seed in range(4):
        force = doublets(1, 200, 1.0, seed)
        record = disturbed(WithAcceleration(), TRUTH, force, STEP, {"v": 0.3}, sensors, seed)
        answer = fit(gb.Problem(WithAcceleration(), record, rule))
        deviations += [
            (answer.estimate[name] - value) / answer.standard_error[name]
            for name, value in TRUTH.items()
        ]
    # The rms of 12 normal deviations, less and more two and a half of its standard deviations.
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.5


def test_disturbances_are_named_by_state_and_color():
    with pytest.raises(ValueError, match="'colored'"):
        gb.PredictionError(disturbance={"v": "pink"})
    with pytest.raises(ValueError, match="state 'y'"):
        gb.Problem(Spring(), flown(0.3, n=50), gb.PredictionError(disturbance={"y": "colored"}))


def drive(pressure):
    """Return the class of a hydraulic drive with the pressure in this unit, Pa."""

    class Drive(gb.StateSpace):
        states = outputs = ("v", "p")
        inputs = ("u",)
        a = gb.Parameter(3e-6 * pressure, bounds=(1e-7 * pressure, 1e-4 * pressure))
        b = gb.Parameter(5.0, bounds=(0, 100))
        c = gb.Parameter(3e8 / pressure, bounds=(1e7 / pressure, 1e10 / pressure))
        q = gb.Parameter(4e7 / pressure, bounds=(1e6 / pressure, 1e9 / pressure))

        def derivative(self, x, u, p):
            return (p.a * x.p - p.b * x.v, p.q * u.u - p.c * x.v - 20 * x.p)

        def output(self, x, u, p):
            return (x.v, x.p)

    return Drive()


def test_gusts_are_estimated_alike_in_pascal_and_in_bar():
    random, n = np.random.default_rng(0), 100
    u = 2 * np.repeat(random.choice([-1.0, 1.0], 10), 10)
    gust = lfilter([0.3], [1, -0.95], random.normal(size=n))
    flown = gb.virtual_flight(
        drive(1.0),
        {"a": 5e-6, "b": 8.0, "c": 4e8, "q": 6e7},
        {"u": u + gust},
        noise={"v": 0.004, "p": 2e4},
        rate=1000,
        seed=1,
    ).with_signals(u=u)
    in_pascal, in_bar = (
        fit(gb.Problem(drive(unit), flown.with_signals(p=flown["p"] / unit), gb.PredictionError()))
        for unit in (1.0, 1e5)
    )
    assert_allclose(in_pascal.cost, in_bar.cost + n * np.log(1e5), atol=1e-5)
    assert_allclose(in_pascal.standard_error["b"], in_bar.standard_error["b"], rtol=1e-3)


def test_process_noise_ends_at_zero_where_the_model_itself_settles_slowly():
    """Errors of the states last for ten seconds, the record for six."""
    u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 8), 15)
    values = {"k": 20.0, "c": 0.2, "b": 10.0}
    noise = {"x": 0.03, "v": 0.15}
    calm = gb.virtual_flight(Spring(), values, {"F": u}, noise=noise, rate=20, seed=3)
    rules = gb.OutputError(), gb.PredictionError(process_noise=("v",))
    small, large = (fit(gb.Problem(Spring(), calm, rule)) for rule in rules)
    assert large.estimate["w_v"] == 0
    assert large.cost == pytest.approx(small.cost, abs=1e-4)
    assert any("show no process noise: w_v" in text for text in large.warnings)
    with pytest.raises(ValueError, match="these data show no process noise, or its fit"):
        gb.validation.nested_test(small, replace(large, cost=small.cost + 1))
