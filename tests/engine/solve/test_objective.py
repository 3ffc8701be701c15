"""`gb.objective`: costs of fits, derivatives against differences and SciPy, other processes and threads."""

import math
import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from declared_models import LagLagDelay
from numpy.testing import assert_allclose
from sampled_lag import SampledLag, lag_problem, lag_record
from scipy.optimize import least_squares, minimize

import greybox as gb
from greybox.problems import pitch_hover

OMEGA = np.geomspace(0.3, 30, 12)
RANDOM = np.random.default_rng(0)
NOISE = 0.05 * (RANDOM.normal(size=12) + 1j * RANDOM.normal(size=12))


class LateLag(gb.StateSpace):
    """T y' = K u(t - D) - y, with an offset: parameters on logarithmic and linear scales."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(1.5, bounds=(0.1, 10), scale="log")
    T = gb.Parameter(0.4, bounds=(0.01, 5), unit="s", scale="log")
    D = gb.Parameter(0.03, bounds=(0.0, 0.1), unit="s")
    b = gb.Parameter(0.1)
    delays = {"u": "D"}

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y + p.b,)


class Hanging(gb.StateSpace):
    """A pendulum held at an angle: its operating point is found by Newton's method."""

    states, inputs, outputs = ("angle", "rate"), ("torque",), ("angle",)
    k = gb.Parameter(9.0, bounds=(1, 40))
    c = gb.Parameter(0.7, bounds=(0.1, 5))

    def derivative(self, x, u, p):
        return (x.rate, u.torque - p.c * x.rate - p.k * gb.sin(x.angle) - 0.3 * x.angle**3)

    def output(self, x, u, p):
        return (x.angle,)


def response(criterion, weight=1.0):
    exact = gb.frequency_response(LagLagDelay(), {}, OMEGA).response
    measured = exact * (1 + NOISE)
    variance = np.abs(0.07 * exact) ** 2
    data = gb.FrequencyResponse(OMEGA, measured, "u", "y", variance=variance)
    return gb.Problem(LagLagDelay(), data, criterion, weight=weight)


def lag_response(criterion):
    exact = 2 / (1 + 0.3j * OMEGA)
    variance = np.abs(0.07 * exact) ** 2
    data = gb.FrequencyResponse(OMEGA, exact * (1 + NOISE), "u", "y", variance=variance)
    return gb.Problem(SampledLag(), data, criterion)


def hanging():
    model = gb.frequency_response(Hanging(), {}, OMEGA, at={"angle": 0.3})
    data = gb.FrequencyResponse(OMEGA, model.response * (1 + NOISE), "torque", "angle")
    return gb.Problem(Hanging(), data, at={"torque": 2.7})


def two_outputs(criterion, gap=10):
    random, time = np.random.default_rng(1), np.arange(80) * 0.05
    u = np.sin(2 * time) + np.sin(5 * time)
    motion = gb.simulate(Pair(), {}, record=gb.Record(time, {"u": u}))
    noisy = {name: motion[name] + 0.03 * random.normal(size=80) for name in ("x", "y")}
    noisy["y"][10 : 10 + gap] = math.nan  # samples without a measurement
    return gb.Problem(Pair(), gb.Record(time, {"u": u, **noisy}), criterion)


class Pair(gb.StateSpace):
    """Two lags, one after the other."""

    states, inputs, outputs = ("x", "y"), ("u",), ("x", "y")
    a = gb.Parameter(2.0, bounds=(0.5, 8))
    b = gb.Parameter(3.0, bounds=(0.5, 8))

    def derivative(self, x, u, p):
        return (u.u - p.a * x.x, x.x - p.b * x.y)

    def output(self, x, u, p):
        return x.x, x.y


def with_outliers():
    record = lag_record(samples=60)
    outputs = record["y"].copy()
    outputs[::17] += 1.5
    record = gb.Record(record.time, {"u": record["u"], "y": outputs})
    return gb.Problem(SampledLag(), record, gb.OutputError(errors="huber"))


def spectrum(criterion):
    data = gb.spectral.transient_spectrum(lag_record(), "u", "y", (2.0, 30.0))
    return gb.Problem(SampledLag(), data, criterion)


RESPONSES = {
    "relative errors": pitch_hover.problem,
    "given variances": lambda: response(gb.MaximumLikelihood()),
    "one unknown variance": lambda: response(gb.RelativeLikelihood(), weight=0.5),
    "magnitude and phase": lambda: response(gb.MagnitudePhase()),
    "over the model": lambda: response(gb.SquaredRelativeError("model")),
    "two responses": lambda: (
        response(gb.MaximumLikelihood()) + lag_response(gb.MaximumLikelihood())
    ),
    "an operating point": hanging,
}
RECORDS = {
    "output errors": lambda: lag_problem(samples=40),
    "given errors": lambda: lag_problem(samples=40, noise={"y": 0.02}),
    "a prior": lambda: gb.Problem(SampledLag(), lag_record(samples=40), prior={"K": (1.9, 0.05)}),
    "a delay": lambda: gb.Problem(LateLag(), lag_record(samples=60), fixed={"b": 0.02}),
    "missing samples": lambda: two_outputs(gb.OutputError()),
    "a full covariance": lambda: two_outputs(gb.OutputError(noise="full"), gap=0),
    "process noise": lambda: two_outputs(gb.PredictionError(process_noise=("x",)), gap=0),
    "a gain": lambda: gb.Problem(SampledLag(), lag_record(samples=40), gb.PredictionError()),
    "bounded errors": with_outliers,
    "two records": lambda: lag_problem(0, 40) + lag_problem(1, 40),
    "a response beside": lambda: (
        gb.Problem(SampledLag(), lag_record(samples=40)) + lag_response(gb.RelativeLikelihood())
    ),
    "a manoeuvre": lambda: spectrum(gb.OutputError()),
    "a manoeuvre by equation error": lambda: spectrum(gb.EquationError()),
}


def beside_start(objective):
    """Return a point inside all bounds, at which no derivative vanishes."""
    shares = np.linspace(0.04, 0.09, len(objective.names))
    step = np.where(objective.start == 0, 0.3, objective.start * shares)
    inside = objective.start + step
    return np.clip(inside, objective.lower, objective.upper)


def differences(function, point):
    """Return the derivatives of a function of a vector by central differences, last axis by it."""
    columns = []
    for k, value in enumerate(point):
        step = np.zeros(len(point))
        step[k] = 1e-5 * max(abs(value), 1e-2)
        change = np.asarray(function(point + step)) - np.asarray(function(point - step))
        columns.append(change / (2 * step[k]))
    return np.stack(columns, axis=-1)


def require_close(values, expected, rtol):
    assert_allclose(values, expected, rtol=0, atol=rtol * np.abs(expected).max())


def require_derivatives(objective, *, is_exact):
    point = beside_start(objective)
    gradient = objective.gradient(point)
    require_close(gradient, differences(objective.value, point), 1e-6)
    residuals, jacobian = objective.residuals(point), objective.jacobian(point)
    require_close(jacobian.T @ residuals, gradient, 1e-7)
    hessian = objective.hessian(point)
    if is_exact and objective.is_least_squares:
        # The residuals are functions, of which the Jacobian has the derivatives.
        require_close(jacobian, differences(objective.residuals, point), 1e-6)
    if is_exact:
        require_close(hessian, differences(objective.gradient, point), 1e-5)
    if objective.is_least_squares:
        squares = [0.5 * np.sum(objective.residuals(x) ** 2) for x in (point, objective.start)]
        costs = [objective.value(x) for x in (point, objective.start)]
        assert squares[0] - squares[1] == pytest.approx(costs[0] - costs[1], rel=1e-9)


@pytest.mark.parametrize("name", RESPONSES)
def test_derivatives_of_responses(name):
    objective = gb.objective(RESPONSES[name]())
    assert objective.is_least_squares == (name in ("given variances", "two responses"))
    require_derivatives(objective, is_exact=True)
    require_derivatives(objective.scaled, is_exact=True)


@pytest.mark.parametrize("states", ["profiled", "simulated"])
@pytest.mark.parametrize("name", RECORDS)
def test_derivatives_of_records(name, states):
    problem = RECORDS[name]()
    objective = gb.objective(problem, states=states)
    assert objective.is_least_squares == (name == "given errors")
    for each in (objective, objective.scaled):
        require_derivatives(each, is_exact=False)
        # The residuals' squares are the Hessian; beside records, a response has its curvature.
        if name != "a response beside":
            point = beside_start(each)
            jacobian = each.jacobian(point)
            require_close(jacobian.T @ jacobian, each.hessian(point), 1e-6)


@pytest.mark.parametrize("name", [*RESPONSES, *RECORDS])
def test_its_value_is_the_cost_of_a_fit(name):
    problem = (RESPONSES | RECORDS)[name]()
    fit = gb.fit(problem, starts=3, profiles=False, checks=(), progress=False)
    objective = gb.objective(problem, fit.estimate)
    value = objective.value(fit.estimate)
    # Steps of integration are halved further in a fit, as long as they move an estimate.
    assert value == pytest.approx(fit.cost, rel=1e-6, abs=1e-3)
    assert value == gb.cost(problem, fit.estimate)
    scaled = objective.scaled
    at = np.array([fit.estimate[name] for name in objective.names])
    assert scaled.value(scaled.to_scaled(at)) == pytest.approx(value, rel=1e-12)
    # A step of Gauss and Newton promises next to nothing.
    free = (at > objective.lower + 1e-6) & (at < objective.upper - 1e-6)
    step = np.linalg.lstsq(objective.jacobian(at)[:, free], objective.residuals(at))[0]
    promised = objective.gradient(at)[free] @ step / 2
    assert promised == pytest.approx(0, abs=1e-3 * max(abs(value) / 20, 1.0))


def test_many_points_have_the_values_of_each():
    for problem in (pitch_hover.problem(), lag_problem(samples=20)):
        objective = gb.objective(problem)
        points = objective.start * np.linspace(0.9, 1.1, 4)[:, None]
        for function in (
            objective.value,
            objective.gradient,
            objective.hessian,
            objective.residuals,
            objective.jacobian,
        ):
            alone = [function(point) for point in points]
            assert_allclose(function(points), alone, rtol=1e-9, atol=1e-9)


def test_values_by_name():
    objective = gb.objective(pitch_hover.problem())
    values = objective.start.copy()
    values[1] = 20.0
    assert objective.value({objective.names[1]: 20.0}) == objective.value(values)
    assert objective.scaled.value({objective.names[1]: 20.0}) == objective.value(values)
    assert objective.by_name(values)[objective.names[1]] == 20.0
    with pytest.raises(ValueError, match="has no parameter 'a9'"):
        objective.value({"a9": 1.0})
    with pytest.raises(ValueError, match=r"T_delay is fixed at 0.0042 .* gb.objective"):
        objective.value({"T_delay": 0.005})
    other = gb.objective(pitch_hover.problem(), {"T_delay": 0.005})
    cost = gb.cost(pitch_hover.problem(), {"T_delay": 0.005})
    assert other.value(other.start) == cost != objective.value(objective.start)


def test_bounds_and_starts_are_those_of_the_parameters():
    objective = gb.objective(gb.Problem(LateLag(), lag_record(), fixed={"b": 0.0}))
    assert objective.names == ("K", "T", "D")
    assert_allclose(objective.start, [1.5, 0.4, 0.03])
    assert_allclose(objective.lower, [0.1, 0.01, 0])
    assert_allclose(objective.upper, [10, 5, 0.1])
    scaled = objective.scaled
    assert_allclose(scaled.lower[:2], np.log([0.1, 0.01]))
    assert_allclose(scaled.to_parameters(scaled.start), objective.start, rtol=1e-15)


def test_constraints_with_their_derivatives():
    limits = [lambda p: p.K * p.T - 0.2, lambda p: 3 - p.K]
    problem = gb.Problem(LateLag(), lag_record(), fixed={"b": 0.0}, constraints=limits)
    for objective in (gb.objective(problem), gb.objective(problem).scaled):
        assert len(objective.limits) == 2
        point = beside_start(objective)
        K, T, _ = objective.by_name(point).values()
        assert_allclose(objective.constraints(point), [K * T - 0.2, 3 - K])
        slopes = differences(objective.constraints, point)
        assert_allclose(objective.constraint_jacobian(point), slopes, atol=1e-8)


def test_scipy_finds_the_minimum_of_a_fit():
    problem = lag_problem(samples=60, noise={"y": 0.02})
    fit = gb.fit(problem, starts=3, progress=False)
    objective = gb.objective(problem)
    bounds = objective.lower, objective.upper
    end = least_squares(objective.residuals, objective.start, objective.jacobian, bounds=bounds)
    assert_allclose(end.x, [fit.estimate[name] for name in objective.names], rtol=1e-5)

    scaled = gb.objective(pitch_hover.problem()).scaled
    pitch = gb.fit(pitch_hover.problem(), starts=20, progress=False)
    end = minimize(
        scaled.value_and_gradient,
        scaled.to_scaled([pitch.estimate[name] * 1.05 for name in scaled.names]),
        jac=True,
        method="L-BFGS-B",
        bounds=[*zip(scaled.lower, scaled.upper, strict=True)],
    )
    assert end.fun == pytest.approx(pitch.cost, rel=1e-4)


def test_a_model_that_diverges_has_no_cost():
    class Growing(SampledLag):
        """y' = y² / T."""

        def derivative(self, x, u, p):
            return (p.K * x.y**2 / p.T,)

    objective = gb.objective(gb.Problem(Growing(), lag_record()), states="simulated")
    values = {"K": 10.0, "T": 0.01}
    assert objective.value(values) == math.inf
    assert np.isnan(objective.gradient(values)).all()
    with pytest.raises(ValueError, match="diverges"):
        objective.residuals(values)


def value_at_start(objective):
    return objective.value(objective.start), objective.gradient(objective.start)


def test_it_travels_to_other_processes_and_threads():
    local = lambda p: 20 - p.K  # noqa: E731  (cannot be pickled)
    problems = [
        pitch_hover.problem(),
        gb.Problem(SampledLag(), lag_record(samples=30), constraints=[local]),
    ]
    with ProcessPoolExecutor(1, get_context("spawn")) as pool, ThreadPoolExecutor(4) as threads:
        for problem in problems:
            objective = gb.objective(problem)
            here = value_at_start(objective)
            futures = [pool.submit(value_at_start, objective)]
            futures += [threads.submit(value_at_start, objective) for _ in range(8)]
            for value, gradient in [future.result() for future in futures]:
                assert value == here[0]
                assert_allclose(gradient, here[1], rtol=1e-12)
            again = pickle.loads(pickle.dumps(objective))
            assert again.names == objective.names


def test_what_it_refuses():
    with pytest.raises(ValueError, match="'profiled' or 'simulated'"):
        gb.objective(lag_problem(), states="measured")
    with pytest.raises(ValueError, match="has no parameter 'T_delay'"):
        gb.objective(lag_problem(), {"T_delay": 1.0})
    with pytest.raises(ValueError, match=r"a point has 2 values.*shape \(3,\)"):
        gb.objective(lag_problem()).value(np.ones(3))
    record = gb.Problem(LateLag(), lag_record(), fixed={"b": 0.0})
    with pytest.raises(ValueError, match=r"b is fixed at 0 here.*fixed={'b': ...}"):
        gb.objective(record, {"b": 1.0})
