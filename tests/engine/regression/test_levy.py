"""Linear least squares (3.17): the paper's transfer functions, exact recovery, what is refused."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given
from numpy.testing import assert_allclose
from rational_functions import (
    PITCH,
    ROLL,
    ROOTS,
    YAW,
    evaluated,
    numbers,
    polynomial,
    simulated,
    table,
)

import greybox as gb
from greybox.engine.regression.levy import levy, order_path
from greybox.modeling.formulation.frequency_criteria import evaluate
from greybox.models.polynomial import Polynomial


def naive(data, n, m):
    """Equations written out one by one: unknowns b_m..b_0, a_{n-1}..a_0."""
    rows, right = [], []
    for omega, P in zip(data.omega, data.response, strict=True):
        s = 1j * omega
        row = [s**k for k in range(m, -1, -1)] + [-P * s**k for k in range(n - 1, -1, -1)]
        rows += [np.real(row), np.imag(row)]
        right += [(P * s**n).real, (P * s**n).imag]
    x = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    return x[: m + 1], np.concatenate([[1], x[m + 1 :]])


@pytest.mark.parametrize(("name", "published"), [("roll", ROLL), ("pitch", PITCH)])
def test_roll_and_pitch_of_the_paper(name, published):
    fit = levy(table(name), 4, 1)
    assert_allclose(numbers(fit.factored), numbers(published), rtol=0.02)


def test_yaw_of_the_paper_does_not_follow_from_the_printed_table():
    form = levy(table("yaw"), 4, 1, integrator=True).factored
    assert " / [s (" in form
    assert_allclose(numbers(form), [1138, 11.70, 0.8145, 25.66, 996.6], rtol=1e-3)
    assert np.all(np.abs(numbers(form) / numbers(YAW) - 1) > 0.02)


def test_yaw_of_the_paper_follows_from_a_table_that_rounds_to_the_printed_one():
    """At 30.28 rad/s, which the equations weigh most, α = -0.0444 is printed as -0.044."""
    data = table("yaw")
    response = data.response.copy()
    assert response[0].real == -0.044 == round(-0.0444, 3)
    response[0] = -0.0444 + 1j * response[0].imag
    form = levy(gb.FrequencyResponse(data.omega, response), 4, 1, integrator=True).factored
    assert_allclose(numbers(form), numbers(YAW), rtol=0.005)


@pytest.mark.parametrize(
    ("name", "published", "cost"),
    [("roll", ROLL, 0.6288), ("pitch", PITCH, 0.6771), ("yaw", YAW, 1.9701)],
)
def test_costs_of_the_published_functions(name, published, cost):
    data = table(name)
    model = evaluated(published, 1j * data.omega)
    assert evaluate(gb.RelativeError(), model, data) == pytest.approx(cost, abs=5e-5)


def test_costs_of_the_least_squares():
    costs = [levy(table(name), 4, 1, name == "yaw").cost for name in ("roll", "pitch", "yaw")]
    assert_allclose(costs, [0.6336, 0.6720, 2.1065], atol=5e-5)


@pytest.mark.parametrize("name", ["roll", "pitch", "yaw"])
@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (3, 2), (4, 1), (5, 3)])
def test_same_as_the_equations_written_out(name, n, m):
    fit = levy(table(name), n, m)
    numerator, denominator = naive(table(name), n, m)
    assert_allclose(fit.numerator, numerator, rtol=1e-7)
    assert_allclose(fit.denominator, denominator, rtol=1e-7)


@given(
    st.permutations(ROOTS), st.integers(1, 3), st.integers(0, 3), st.floats(0.1, 10), st.booleans()
)
def test_exact_data_give_back_the_function(roots, below, above, gain, integrator):
    denominator = polynomial(roots[:below])
    numerator = gain * polynomial(roots[below : below + above])
    denominator = np.append(denominator, 0.0) if integrator else denominator
    n, m = len(denominator) - 1, len(numerator) - 1
    assume(m < n)
    fit = levy(simulated(numerator, denominator), n, m, integrator)
    assert fit.determined
    assert_allclose(fit.numerator, numerator, rtol=1e-6, atol=1e-7 * np.abs(numerator).max())
    assert_allclose(fit.denominator, denominator, rtol=1e-6, atol=1e-7 * np.abs(denominator).max())
    assert fit.cost < 1e-6
    if integrator:
        assert fit.denominator[-1] == 0
        assert 0 in fit.poles


def test_equivariance():
    data = table("roll")
    fit = levy(data, 4, 1)
    faster = levy(gb.FrequencyResponse(10 * data.omega, data.response), 4, 1)
    assert_allclose(np.sort_complex(faster.poles), np.sort_complex(10 * fit.poles), rtol=1e-9)
    larger = levy(gb.FrequencyResponse(data.omega[::-1], 3 * data.response[::-1]), 4, 1)
    assert_allclose(larger.numerator, 3 * fit.numerator, rtol=1e-9)
    assert larger.cost == pytest.approx(fit.cost)


def test_weights():
    data = table("roll")
    fit = levy(data, 4, 1)
    assert_allclose(
        levy(data, 4, 1, weight=np.full(10, 7.0)).denominator, fit.denominator, rtol=1e-9
    )
    # a weight of two counts as four equal points: normal equations of the written-out system
    weight = np.geomspace(1, 2, 10)
    s, P = 1j * data.omega, data.response
    A = np.column_stack([s, s**0, -P * s**3, -P * s**2, -P * s, -P]) * weight[:, None]
    y = weight * P * s**4
    x = np.linalg.lstsq(np.vstack([A.real, A.imag]), np.concatenate([y.real, y.imag]), rcond=None)[
        0
    ]
    weighted = levy(data, 4, 1, weight=weight)
    assert_allclose(np.concatenate([weighted.numerator, weighted.denominator[1:]]), x, rtol=1e-7)


def test_reweighting_leads_towards_the_error_of_the_response():
    numerator, denominator = [20.0, 40.0], np.polymul([1, 2, 25], [1, 12])
    plain, reweighted = [], []
    for seed in range(20):
        data = simulated(numerator, denominator, noise=0.05, seed=seed)
        weight = 1 / np.abs(data.response)
        plain.append(levy(data, 3, 1).cost)
        reweighted.append(levy(data, 3, 1, weight=weight, iterations=10).cost)
    assert np.mean(reweighted) < 0.95 * np.mean(plain)
    exact = levy(simulated(numerator, denominator), 3, 1, iterations=5)
    assert_allclose(exact.denominator, denominator, rtol=1e-9)
    assert exact.iterations == 5


def test_reweighting_is_at_a_fixed_point():
    data = simulated([20.0, 40.0], np.polymul([1, 2, 25], [1, 12]), noise=0.05)
    fit = levy(data, 3, 1, iterations=60)
    again = levy(data, 3, 1, weight=1 / np.abs(np.polyval(fit.denominator, 1j * data.omega)))
    assert_allclose(again.denominator, fit.denominator, rtol=1e-6)


def test_a_response_of_zero_has_no_relative_error():
    fit = levy(gb.FrequencyResponse([1.0, 2.0, 3.0], [0.0, 1.0, -1j]), 2, 0)
    assert np.isnan(fit.cost)
    nothing = levy(gb.FrequencyResponse([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]), 2, 1)
    assert not nothing.determined
    assert numbers(nothing.factored)[0] == 0


@pytest.mark.parametrize(("name", "integrator"), [("roll", False), ("yaw", True)])
def test_coefficients_are_a_start_of_polynomial(name, integrator):
    data, model = table(name), Polynomial(4, 1, integrator=integrator)
    linear = levy(data, 4, 1, integrator)
    assert list(linear.coefficients) == list(model.parameters)
    response = gb.frequency_response(model, linear.coefficients, data.omega).response
    assert_allclose(response, linear.response(data.omega).response, rtol=1e-12)
    fit = gb.fit(gb.Problem(model, data), starts=[linear.coefficients])
    assert fit.cost < linear.cost


def test_levy_finds_a_near_pair():
    numerator, denominator = np.polymul([3.0], [1, 4.04]), polynomial([-4, -1.5 + 2j])
    (pair,) = levy(simulated(numerator, denominator), 3, 1).near_pairs
    assert_allclose([pair.zero, pair.pole], [-4.04, -4], rtol=1e-6)
    assert pair.distance == pytest.approx(0.04 / 4.04, rel=1e-4)
    assert str(pair) == "stable zero -4.04 and pole -4, 0.99 % apart"


def test_orders_one_too_high_leave_a_pair_open():
    fit = levy(simulated([3.0, 6.0], polynomial([-4, -1.5 + 2j])), 4, 2)
    assert not fit.determined
    assert fit.near_pairs[0].distance < 1e-6
    assert "lower n and m" in str(fit)


def test_a_fit_prints_itself():
    lines = str(levy(table("yaw"), 4, 1, integrator=True)).splitlines()
    assert (
        lines[0]
        == "linear least squares (3.17), n = 4, m = 1, with integrator, 10 frequencies, not reweighted"
    )
    assert lines[1] == "P(s) = 1138 (s + 11.7) / [s (0.8145 s + 1) (s² + 25.66 s + 996.6)]"
    assert [line.split()[:2] for line in lines[4:8]] == [
        ["zero", "-11.7"],
        ["pole", "0"],
        ["pole", "-1.228"],
        ["pole", "-12.83"],
    ]
    # Damping ratios: the real part over the size, negative on the right; none of a pole at zero.
    assert [line.split()[-2:] for line in lines[4:7]] == [["11.7", "1"], ["0", "-"], ["1.228", "1"]]
    assert lines[7].split()[-2:] == ["31.57", f"{25.66 / 2 / np.sqrt(996.6):.3g}"]
    assert lines[8] == "sum of relative errors 2.1065"
    assert "reweighted 2 times" in str(levy(table("roll"), 4, 1, iterations=2))
    assert "nearly cancel: unstable zero" in str(levy(table("roll"), 6, 3))


def test_fits_are_frozen():
    fit = levy(table("roll"), 4, 1)
    with pytest.raises(AttributeError):
        fit.cost = 0.0
    with pytest.raises(ValueError, match="read-only"):
        fit.numerator[0] = 0.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"n": 4, "m": 4}, r"m = 4 is not below n = 4: \(2.13\) needs m < n, lower m or raise n\."),
        ({"n": 0, "m": 0}, r"n is 0: give a whole number of at least 1\."),
        ({"n": 4.0, "m": 1}, r"n is 4\.0: give a whole number of at least 1\."),
        ({"n": True, "m": 0}, r"n is True: give a whole number"),
        ({"n": 4, "m": -1}, r"m is -1: give a whole number of at least 0\."),
        (
            {"n": 10, "m": 9},
            r"10 frequencies give 20 equations for the 20 unknowns of n = 10, m = 9: .* lower n and m",
        ),
        (
            {"n": 11, "m": 9, "integrator": True},
            r"20 equations for the 20 unknowns of n = 11, m = 9",
        ),
        (
            {"n": 4, "m": 1, "iterations": -1},
            r"iterations is -1: give a whole number of at least 0\.",
        ),
        (
            {"n": 4, "m": 1, "weight": [1.0]},
            r"weight has the shape \(1,\)",
        ),
        (
            {"n": 4, "m": 1, "weight": [0] + [1] * 9},
            "one finite number above 0",
        ),
    ],
)
def test_bad_arguments(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        levy(table("roll"), **arguments)


def test_the_last_orders_that_the_data_allow():
    assert levy(table("roll"), 10, 8).n == 10
    assert levy(table("roll"), 10, 9, integrator=True).n == 10


def test_the_condition_is_that_of_normalized_columns():
    data = table("roll")
    s, P = 1j * data.omega, data.response
    columns = np.column_stack([s, s**0, -P * s**3, -P * s**2, -P * s, -P])
    real = np.vstack([columns.real, columns.imag])
    singular = np.linalg.svd(real / np.linalg.norm(real, axis=0), compute_uv=False)
    assert levy(data, 4, 1).condition == pytest.approx(singular[0] / singular[-1], rel=1e-6)


# --- the choice of orders


def orders(path):
    return [(step.n, step.m) for step in path]


@given(st.permutations(ROOTS), st.integers(1, 2), st.integers(1, 2), st.booleans())
def test_path_from_too_high_ends_at_the_true_orders(roots, above, excess, integrator):
    numerator, denominator = polynomial(roots[:1]), polynomial(roots[1 : 2 + above])
    denominator = np.append(denominator, 0.0) if integrator else denominator
    n, m = len(denominator) - 1, len(numerator) - 1
    assume(m < n)
    path = order_path(simulated(numerator, denominator), n + excess, m + excess, integrator)
    assert orders(path) == [(n + k, m + k) for k in range(excess, -1, -1)]
    size = np.abs(denominator).max()
    assert_allclose(path[-1].denominator, denominator, rtol=1e-6, atol=1e-7 * size)
    assert not path[0].determined


def test_path_drops_a_stable_pair_and_keeps_an_unstable_one():
    stable = simulated([1, 4.04], polynomial([-4, -1.5 + 2j]))
    assert orders(order_path(stable, 3, 1)) == [(3, 1), (2, 0)]
    unstable = simulated([1, -4.04], polynomial([4, -1.5 + 2j]))
    assert orders(order_path(unstable, 3, 1)) == [(3, 1)]


def test_path_ends_at_a_constant_numerator():
    silent = gb.FrequencyResponse([1.0, 2.0, 3.0], [0.0, 0.0, 0.0])
    assert orders(order_path(silent, 2, 1)) == [(2, 1), (1, 0)]


@pytest.mark.parametrize(
    ("name", "start", "end"),
    [
        ("roll", (4, 1), (4, 1)),
        ("roll", (7, 4), (6, 3)),
        ("roll", (10, 7), (6, 3)),
        ("pitch", (4, 1), (4, 1)),
        ("pitch", (7, 4), (7, 4)),
        ("pitch", (9, 6), (7, 4)),
        ("yaw", (4, 1), (4, 1)),
        ("yaw", (7, 4), (7, 4)),
        ("yaw", (10, 7), (9, 6)),
    ],
)
def test_path_on_the_tables_of_the_paper(name, start, end):
    """The paper's (4, 1) is where the rule ends only when it begins there."""
    options = {"integrator": name == "yaw"}
    assert orders(order_path(table(name), *start, **options))[-1] == end
