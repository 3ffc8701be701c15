"""The compiled problem: scaling, costs, weights, and an operating point that Newton's method
finds.
"""

import math

import casadi as ca
import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem, scaling_of
from greybox.engine.compiled.response_programs import solver_unit
from greybox.models.tilt import PAPER_G, NonlinearTilt

NOISY = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.05)
LAG = measured(Lag(), TWO_LAGS_OMEGA, {"K": 3.0, "T": 0.2}, noise=0.05)


def relative(problem_model, data, values):
    response = gb.frequency_response(problem_model, values, data.omega).response
    return np.sum(np.abs(response - data.response) / np.abs(data.response))


def test_scaling_goes_there_and_back():
    both = compile_problem(
        gb.Problem(LagLagDelay(), NOISY, rename={"K": "K2"}) + gb.Problem(Lag(), LAG)
    )
    assert both.scaling.logarithmic.any()
    assert not both.scaling.logarithmic.all()
    random = np.random.default_rng(0)
    x = random.uniform(np.maximum(both.lower, 1e-4), both.upper, (20, len(both.free)))
    z = both.scaling.to_solver(x)
    assert_allclose(both.scaling.to_parameters(z), x, rtol=1e-14)
    symbol = ca.SX.sym("z", len(both.free))
    expressions = ca.Function("x", [symbol], [ca.vertcat(*both.scaling.expressions(symbol))])
    assert_allclose(np.asarray(expressions(z[0])).ravel(), x[0], rtol=1e-14)


def test_a_linear_variable_is_of_order_one_and_a_logarithmic_one_is_the_logarithm():
    linear, log = (
        compile_problem(gb.Problem(LagLagDelay(), NOISY)),
        compile_problem(gb.Problem(Lag(), LAG)),
    )
    assert_allclose(linear.scaling.to_solver(linear.upper), 1)
    assert_allclose(log.scaling.to_solver(np.array([np.e, np.e**2])), [1, 2])


def test_cost_is_the_naive_sum_with_weights():
    a, b = (
        gb.Problem(LagLagDelay(), NOISY),
        gb.Problem(Lag(), LAG, rename={"K": "gain"}, weight=2.5),
    )
    values = {"K": 4.0, "T1": 0.5, "T2": 0.2, "tau": 0.1, "gain": 2.0, "T": 0.3}
    first = relative(LagLagDelay(), NOISY, {k: values[k] for k in TWO_LAGS})
    second = relative(Lag(), LAG, {"K": 2.0, "T": 0.3})
    assert gb.cost(a, {k: values[k] for k in TWO_LAGS}) == pytest.approx(first, rel=1e-12)
    assert gb.cost(a + b, values) == pytest.approx(first + 2.5 * second, rel=1e-12)


def test_cost_takes_declared_starts_and_fixed_values_for_what_is_not_given():
    problem = gb.Problem(LagLagDelay(), NOISY, fixed={"tau": 0.07})
    assert gb.cost(problem, {"K": 2.0}) == pytest.approx(
        relative(LagLagDelay(), NOISY, {"K": 2.0, "tau": 0.07}), rel=1e-12
    )


def test_cost_refuses_an_unknown_name():
    with pytest.raises(ValueError, match="has no parameter 'gain'; it has K, T1, T2, tau"):
        gb.cost(gb.Problem(LagLagDelay(), NOISY), {"gain": 1.0})


def test_a_problem_without_unknowns_is_refused():
    with pytest.raises(
        ValueError, match=r"no parameter of 'made' is free: free one, e\.g\. free=\('K',\)"
    ):
        gb.fit(gb.Problem(LagLagDelay(), NOISY, fixed=TWO_LAGS))


def test_what_the_solver_minimizes_is_the_smoothed_cost_of_the_scaled_variables():
    nlp = compile_problem(gb.Problem(Lag(), LAG, weight=3.0))
    response = gb.frequency_response(Lag(), {"K": 2.0, "T": 5.0}, LAG.omega).response
    e = np.abs(response / LAG.response - 1)
    cost, _ = nlp.programs[-1].function(np.log([2.0, 5.0]), 0.04, nlp.data)
    assert float(cost) == pytest.approx(3 * np.sum(np.sqrt(e**2 + 0.04)), rel=1e-12)


@pytest.mark.parametrize("T", [1e-3, 1e-1, 10.0, 1e3])
@pytest.mark.parametrize("K", [2e-3, 500.0])
def test_logarithmic_parameters_recover_the_truth_over_decades(T, K):
    fit = gb.fit(
        gb.Problem(Lag(), measured(Lag(), np.geomspace(1e-4, 1e4, 15), {"K": K, "T": T})), starts=12
    )
    assert fit.agreeing >= 10
    assert fit.estimate["K"] == pytest.approx(K, rel=1e-6)
    assert fit.estimate["T"] == pytest.approx(T, rel=1e-6)


def forward_flight(omega, p, theta):
    """Pitch angle from control about a steady pitch `theta`: (4.23) linearized by hand, drag
    slope 2 C_x |v0|.
    """
    v0 = np.sqrt(PAPER_G * np.tan(theta) / p["C_x"])
    A = np.array(
        [
            [-2 * p["C_x"] * v0, 0, PAPER_G / np.cos(theta) ** 2, 0],
            [-p["a3"], -p["a2"], -p["a1"], p["a4"]],
            [0, 1, 0, 0],
            [0, 0, 0, -1 / p["T_rotor"]],
        ]
    )
    b = np.array([0, 0, 0, 1 / p["T_rotor"]])
    return np.array(
        [
            np.linalg.solve(1j * w * np.eye(4) - A, b)[2] * np.exp(-1j * w * p["T_delay"])
            for w in omega
        ]
    )


def test_a_trim_by_newton_compiles_to_mx_and_agrees_with_the_model_linearized_by_hand():
    omega, theta = np.geomspace(0.5, 20, 12), np.radians(5)
    truth = {
        "a1": -10.0,
        "a2": 3.0,
        "a3": 4.0,
        "a4": 250.0,
        "T_rotor": 0.048,
        "T_delay": 0.0042,
        "C_x": 0.08,
    }
    data = gb.FrequencyResponse(
        omega, forward_flight(omega, truth, theta), input="u", output="theta", name="5 deg"
    )
    problem = gb.Problem(NonlinearTilt(), data, at={"theta": theta})
    assert compile_problem(problem).programs[-1].function.is_a("MXFunction")
    assert gb.cost(problem, truth) == pytest.approx(0, abs=1e-9)
    other = truth | {"C_x": 0.3, "a3": 2.0}
    by_hand = np.sum(np.abs(forward_flight(omega, other, theta) / data.response - 1))
    assert gb.cost(problem, other) == pytest.approx(by_hand, rel=1e-9)


def test_a_problem_without_newton_stays_sx():
    assert (
        compile_problem(gb.Problem(LagLagDelay(), NOISY)).programs[-1].function.is_a("SXFunction")
    )


def test_rows_of_unknowns_are_evaluated_like_single_ones():
    nlp = compile_problem(gb.Problem(LagLagDelay(), NOISY, fixed={"K": 4.0}))
    rows = np.random.default_rng(1).uniform(0.01, 0.4, (5, 3))
    for row, cost, signature in zip(rows, nlp.costs(rows), nlp.judged(rows)[1], strict=True):
        values = dict(zip(nlp.free, row, strict=True)) | {"K": 4.0}
        assert cost == pytest.approx(relative(LagLagDelay(), NOISY, values), rel=1e-12)
        alone = nlp.parts[0].signature(nlp.parts[0].trajectory(nlp.scaling.to_solver(row)))
        assert_allclose(signature, alone, rtol=1e-12)
    assert nlp.costs(np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize("noise", [0.1, 1e-5])
def test_costs_of_precise_data_are_weighed_down_to_what_rounding_allows(noise):
    """A hundred rounding errors of Σ (M/σ)² are at most the tolerance of 1e-8, and at least half of
    it; a criterion without sizes has none.
    """
    sigma = noise * np.abs(NOISY.response) * np.geomspace(0.5, 2, len(NOISY))
    precise = gb.FrequencyResponse(NOISY.omega, NOISY.response, "u", "y", variance=sigma**2)
    parts = [
        gb.Problem(LagLagDelay(), precise, gb.MaximumLikelihood(), weight=3.0),
        gb.Problem(Lag(), LAG, rename={"K": "gain"}, weight=0.5),
    ]
    precision = 3.0 * np.sum((np.abs(NOISY.response) / sigma) ** 2)
    unit = max(1.0, 100 * np.finfo(float).eps / 1e-8 * precision)
    assert (unit > 1) == (noise < 1e-3)
    assert unit <= solver_unit(parts) < 2 * unit


@pytest.mark.parametrize(
    ("criterion", "is_located"),
    [(gb.RelativeError(), False), (gb.MagnitudePhase(), True), (gb.RelativeLikelihood(), True)],
    ids=repr,
)
def test_a_criterion_with_local_minima_of_its_own_is_located_by_squares(criterion, is_located):
    nlp = compile_problem(gb.Problem(Lag(), LAG, criterion, weight=2.0))
    assert len(nlp.programs) == 1 + is_located
    if is_located:
        z = nlp.scaling.to_solver(np.array([2.0, 5.0]))
        e = np.abs(
            gb.frequency_response(Lag(), {"K": 2.0, "T": 5.0}, LAG.omega).response / LAG.response
            - 1
        )
        assert float(nlp.programs[0].function(z, 0.0, nlp.data)[0]) == pytest.approx(
            2 * np.sum(e**2), rel=1e-9
        )


PARAMETERS = [
    gb.Parameter(0.3, bounds=(-7, 5)),
    gb.Parameter(2.0, bounds=(0.1, 50), scale="log"),
    gb.Parameter(0.3, bounds=(-80, 90), starts=(-4, 3)),
]
X = np.array([[-3.5, 20.0, 6.0], [1.4, 0.5, -1.0]])
Z = np.array([[-0.5, np.log(20), 1.5], [0.2, np.log(0.5), -0.25]])  # in 7, the logarithm, and 4


def test_variables_are_in_units_of_the_start_box_or_logarithms():
    scaling = scaling_of(PARAMETERS)
    assert_allclose(scaling.to_solver(X), Z)
    assert_allclose(scaling.to_parameters(Z), X)
    assert scaling.to_solver(np.array([1.0, 0.0, 1.0]))[1] == -np.inf
    for x, z in zip(X, Z, strict=True):
        assert_allclose(scaling.slope(x), [1 / 7, 1 / x[1], 1 / 4])
        symbols = ca.SX.sym("z", 3)
        assert_allclose(
            ca.Function("x", [symbols], [ca.vertcat(*scaling.expressions(symbols))])(z)
            .full()
            .ravel(),
            x,
        )


@pytest.mark.parametrize(
    ("parameter", "unit"),
    [
        (gb.Parameter(-0.3, bounds=(-7, 5), starts=(-2, 1)), 2.0),
        (gb.Parameter(0.3, bounds=(0, 5)), 5.0),  # an end at zero says nothing of the size
        (gb.Parameter(0.3, bounds=(-7, 5), starts=(0, 0)), 7.0),
        (gb.Parameter(-0.3, bounds=(-math.inf, 0)), 0.3),
        (gb.Parameter(0.0), 1.0),
    ],
)
def test_the_unit_is_the_larger_end_in_magnitude_of_what_starts_are_drawn_from(parameter, unit):
    assert scaling_of([parameter]).factor.tolist() == [unit]


SEVERAL_LAGS = [
    measured(Lag(), TWO_LAGS_OMEGA, {"K": 3.0, "T": T}, noise=0.05, seed=k)
    for k, T in enumerate((0.2, 0.4))
]


def part(k, *constraints, **options):
    """One of two problems of one name."""
    return gb.Problem(Lag(), SEVERAL_LAGS[k], constraints=constraints, name="flight", **options)


def test_constraints_of_parts_of_one_name_all_count():
    """Each holds its own time constant away from the truth."""
    both = part(0, lambda p: 0.1 - p.T) + part(1, lambda p: p.T - 0.8, rename={"T": "T2"})
    nlp = compile_problem(both)
    values = dict(zip(nlp.names, nlp.all_values(np.arange(1.0, 1 + len(nlp.free))), strict=True))
    missed = np.asarray(nlp.constraint(np.array([*values.values()]))).ravel()
    assert_allclose(missed, [0.1 - values["T"], values["T2"] - 0.8])
    fit = gb.fit(both, starts=[{}], progress=False)
    assert_allclose([fit.estimate["T"], fit.estimate["T2"]], [0.1, 0.8], rtol=1e-6)


def test_a_constraint_that_parts_of_one_name_share_counts_once():
    both = part(0, lambda p: p.K - 2 * p.T) + part(1, lambda p: p.K - 2 * p.T)
    assert compile_problem(both).limits == ("constraints[0] of 'flight 1'",)


def test_a_constraint_that_parts_of_two_names_share_counts_once():
    runs = [part(k, lambda p: p.K - 2 * p.T).with_(name=f"run {k}") for k in range(2)]
    assert compile_problem(runs[0] + runs[1]).limits == ("constraints[0] of 'run 0'",)


def test_bounds_of_what_is_tied_alike_count_once():
    options = {"tied": {"T": lambda p: p.K / 10}, "bounds": {"T": (0.1, 0.5)}}
    limits = compile_problem(part(0, **options) + part(1, **options)).limits
    assert limits == ("the lower bound 0.1 of the tied T", "the upper bound 0.5 of the tied T")
