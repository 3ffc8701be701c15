"""The answer: errors of derived quantities, intervals, earlier fits, and what it prints."""

import pydoc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import (
    ROTOR,
    ROTOR_OMEGA,
    TILT,
    TILT_OMEGA,
    TWO_LAGS,
    TWO_LAGS_OMEGA,
    Lag,
    LagLagDelay,
    measured,
)
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import greybox as gb
from greybox.assessment.checks.coarse_integration import coarse_integration
from greybox.engine.solve.interruption import limited
from greybox.engine.solve.runs import SEARCH_OVER
from greybox.engine.solve.search import Search
from greybox.models.rotor import Rotor
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt

ORDERED = [lambda p: p.T1 - p.T2]
LAG = gb.fit(
    gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0, "T": 0.3}, noise=0.05, seed=3)),
    starts=2,
)
LAGS = gb.fit(
    gb.Problem(
        LagLagDelay(),
        measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2),
        constraints=ORDERED,
    ),
    starts=4,
)


def test_derived_quantities_and_their_errors_by_the_delta_method():
    def derived(x):
        K, T = x
        return np.array([1 / T, K * T**2])

    x = [LAG.estimate["K"], LAG.estimate["T"]]
    slope = numeric_jacobian(derived, x)
    expected = np.sqrt(np.diag(slope @ LAG.covariance_of(["K", "T"]) @ slope.T))
    assert_allclose(list(LAG.derived.values()), derived(x), rtol=1e-12)
    assert_allclose([LAG.standard_error[n] for n in LAG.derived], expected, rtol=1e-6)
    assert list(LAG.derived) == ["bandwidth", "area"]


@pytest.mark.parametrize("level", [0.5, 0.68, 0.95, 0.999])
def test_intervals_are_those_of_students_t(level):
    assert LAG.dof == 2 * len(TWO_LAGS_OMEGA) - 2
    for name, (low, high) in LAG.interval(level).items():
        value = {q.name: q.value - q.bias for q in LAG.quantities}[name]
        expected = stats.t.interval(level, LAG.dof, loc=value, scale=LAG.standard_error[name])
        assert (low, high) == pytest.approx(expected, rel=1e-9)


def test_intervals_of_known_noise_are_normal():
    exact = gb.frequency_response(Lag(), {"K": 2.0}, TWO_LAGS_OMEGA).response
    noisy = measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.05, seed=3)
    data = gb.FrequencyResponse(
        noisy.omega, noisy.response, variance=2 * 0.05**2 * np.abs(exact) ** 2
    )
    fit = gb.fit(gb.Problem(Lag(), data, gb.MaximumLikelihood()), starts=4)
    low, high = fit.interval(0.95)["T"]
    assert (high - low) / 2 / fit.standard_error["T"] == pytest.approx(1.959964, rel=1e-5)


@pytest.mark.parametrize("level", [0.0, 1.0, 95, -0.1, float("nan")])
def test_a_level_that_is_no_probability_is_refused(level):
    with pytest.raises(ValueError, match=f"level {level} must lie between 0 and 1"):
        LAG.interval(level)


def test_a_name_in_the_place_of_the_level_is_named():
    with pytest.raises(ValueError, match="level 'T' must lie between 0 and 1"):
        LAG.interval("T")


def test_covariance_of_picks_names_in_their_order():
    full = LAGS.covariance_of(["K", "T1", "T2", "tau"])
    assert_array_equal(LAGS.covariance_of(["tau", "K"]), full[np.ix_([3, 0], [3, 0])])
    assert_allclose(
        np.sqrt(np.diag(full)), [LAGS.standard_error[n] for n in ("K", "T1", "T2", "tau")]
    )
    assert np.linalg.eigvalsh(full).min() > 0
    with pytest.raises(ValueError, match="no parameter 'gain'; it has K, T1, T2, tau"):
        LAGS.covariance_of(["gain"])


def test_standard_errors_of_least_squares_are_those_of_the_textbook():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=1e-4, seed=4)
    fit = gb.fit(
        gb.Problem(LagLagDelay(), data, gb.SquaredRelativeError(), constraints=ORDERED), starts=8
    )

    def residuals(x):
        P = gb.frequency_response(
            LagLagDelay(), dict(zip(TWO_LAGS, x, strict=True)), data.omega
        ).response
        e = (P - data.response) / np.abs(data.response)
        return np.concatenate([e.real, e.imag])

    x = [fit.estimate[n] for n in TWO_LAGS]
    J = numeric_jacobian(residuals, x, 1e-4)
    s2 = np.sum(residuals(x) ** 2) / (2 * len(data) - 4)
    assert_allclose(
        fit.covariance_of(list(TWO_LAGS)), s2 * np.linalg.inv(J.T @ J), rtol=2e-3, atol=1e-14
    )


SQUARES = gb.SquaredRelativeError()
SHARED = {n: ROTOR[n] for n in ("T_rotor", "T_delay")}
ROTOR_FIT = gb.fit(
    gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR, noise=0.02, seed=3), SQUARES),
    starts=2,
)
TILT_DATA = measured(Tilt(), TILT_OMEGA, TILT | SHARED, noise=0.02, seed=4)


def refit(T_rotor, T_delay):
    fixed = {"T_rotor": T_rotor, "T_delay": T_delay}
    return gb.fit(
        gb.Problem(Tilt(), TILT_DATA, SQUARES, fixed=fixed),
        starts=[TILT],
        solver_options={"tol": 1e-12},
    )


def test_an_earlier_fit_widens_the_standard_errors_by_how_the_estimate_moves_with_its_values():
    """C + S Σ Sᵀ, with S from refits at shifted values."""
    names, given = list(TILT), list(SHARED)
    widened = gb.fit(gb.Problem(Tilt(), TILT_DATA, SQUARES, fixed=ROTOR_FIT), starts=[TILT])
    centre = np.array([ROTOR_FIT.estimate[n] for n in given])
    narrow = refit(*centre)
    assert_allclose(
        [widened.estimate[n] for n in names], [narrow.estimate[n] for n in names], rtol=1e-6
    )
    columns = []
    for k in range(2):
        shift = np.zeros(2)
        shift[k] = 1e-3 * centre[k]
        up, down = refit(*(centre + shift)), refit(*(centre - shift))
        columns.append([(up.estimate[n] - down.estimate[n]) / (2 * shift[k]) for n in names])
    S, sigma = np.array(columns).T, ROTOR_FIT.covariance_of(given)
    expected = narrow.covariance_of(names) + S @ sigma @ S.T
    # The refits see the residuals' curvature, which Gauss-Newton neglects: a few percent at 2 %
    # noise.
    assert_allclose(
        [widened.standard_error[n] for n in names], np.sqrt(np.diag(expected)), rtol=0.05
    )
    assert_allclose(widened.covariance_of(given), sigma, rtol=1e-12)
    assert all(widened.standard_error[n] > 1.03 * narrow.standard_error[n] for n in names)
    assert widened.standard_error["a3_tilde"] == pytest.approx(
        PAPER_G * widened.standard_error["a3"], rel=1e-9
    )


def test_fixed_numbers_have_no_error_and_those_of_a_fit_keep_theirs():
    plain = gb.fit(gb.Problem(Tilt(), TILT_DATA, SQUARES, fixed=SHARED), starts=8)
    assert {plain.standard_error[n] for n in SHARED} == {0.0}
    assert not set(SHARED) & set(plain.interval())
    widened = gb.fit(gb.Problem(Tilt(), TILT_DATA, SQUARES, fixed=ROTOR_FIT), starts=8)
    assert set(SHARED) < set(widened.interval())


@pytest.mark.parametrize(
    ("model", "delay"), [(Tilt(), "exact"), (Tilt(), "pade:2"), (LinearTilt(), "exact")], ids=repr
)
def test_response_is_the_models_at_the_estimate(model, delay):
    problem = gb.Problem(model, TILT_DATA, fixed=SHARED, delay=delay)
    fit = gb.fit(problem, starts=2, profiles=False)
    omega = [0.5, 3.0, 40.0]
    expected = gb.frequency_response(
        model, fit.estimate, omega, input="u", output="theta", delay=delay
    )
    assert_array_equal(fit.response(omega).response, expected.response)
    assert_allclose(fit.parts[0].response, fit.response(TILT_OMEGA).response, rtol=1e-10)
    assert fit.cost == pytest.approx(
        np.sum(np.abs(fit.parts[0].response / TILT_DATA.response - 1)), rel=1e-9
    )


def test_response_of_a_part_uses_its_renamed_and_tied_values_and_operating_point():
    theta = np.radians(5)
    truth = TILT | SHARED | {"a1": -10.0, "C_x": 0.08}
    forward = measured(
        NonlinearTilt(), TILT_OMEGA, truth, output="theta", at={"theta": theta}, noise=0.01
    )
    parts = [
        gb.Problem(Tilt(), TILT_DATA, tied={"a2": lambda p: p.a4 / 50}),
        gb.Problem(
            NonlinearTilt(), forward, at={"theta": theta}, rename={n: f"{n}_5" for n in TILT}
        ),
    ]
    fit = gb.fit(sum(parts), starts=2, profiles=False)
    values = {n: fit.estimate[f"{n}_5"] for n in TILT} | {
        n: fit.estimate[n] for n in ("T_rotor", "T_delay", "C_x")
    }
    expected = gb.frequency_response(
        NonlinearTilt(), values, TILT_OMEGA, output="theta", at={"theta": theta}
    )
    assert_array_equal(fit.response(TILT_OMEGA, part=1).response, expected.response)
    first = {n: fit.estimate[n] for n in Tilt().parameters}
    assert first["a2"] == pytest.approx(first["a4"] / 50, rel=1e-12)
    assert_array_equal(
        fit.response(TILT_OMEGA).response, gb.frequency_response(Tilt(), first, TILT_OMEGA).response
    )


def test_derived_quantities_of_renamed_parts_are_all_reported():
    # Two flights of one log name: each has its own a3, so there are two a3_tilde.
    parts = [gb.Problem(Tilt(), TILT_DATA, rename={"a3": name}) for name in ("a3_up", "a3_down")]
    fit = gb.fit(sum(parts), starts=2, profiles=False)
    assert len(fit.derived) == 2


def test_a_mistake_in_a_derived_quantity_is_a_sentence():
    class Typo(Lag):
        derived = {"bandwidth": lambda p: 1 / p.Tau}

    with pytest.raises(ValueError, match=r"'bandwidth'.*'Tau'"):
        gb.fit(gb.Problem(Typo(), LAG.parts[0].data), starts=2)


def test_the_print_answers_in_order():
    text = str(LAG)
    value, error = LAG.estimate["T"], LAG.standard_error["T"]
    (line,) = (line for line in text.splitlines() if line.strip().startswith("T "))
    words = line.split()
    assert float(words[1]) == pytest.approx(value, abs=0.6 * float(words[2]))
    assert float(words[2]) == pytest.approx(error, rel=0.05)
    assert words[3] == "s"
    assert line.endswith("time constant")


def test_other_criteria_are_the_costs_of_their_own_problems():
    by_name = {
        c.name: c for c in (gb.MagnitudePhase(), SQUARES, gb.RelativeError(normalized="model"))
    }
    for name, criterion in by_name.items():
        expected = gb.cost(
            gb.Problem(Lag(), LAG.parts[0].data, criterion), {n: LAG.estimate[n] for n in LAG.free}
        )
        assert LAG.costs[name] == pytest.approx(expected, rel=1e-10)
    assert np.isnan(LAG.costs["maximum-likelihood"])


def test_the_answer_names_the_seed_that_was_used():
    fit = gb.fit(gb.Problem(Lag(), LAG.parts[0].data), starts=gb.solve.Sobol(4, seed=7))
    assert "seed=7" in fit.starts or fit.seed == 7
    assert "seed 0" not in fit.details


def test_criteria_agree_within_their_errors():
    data = LAGS.parts[0].data
    fits = [
        gb.fit(gb.Problem(LagLagDelay(), data, c, constraints=ORDERED), starts=3, profiles=False)
        for c in (SQUARES, gb.MagnitudePhase())
    ]
    for name, truth in TWO_LAGS.items():
        for fit in (LAGS, *fits):
            assert abs(fit.estimate[name] - truth) < 4 * fit.standard_error[name]
        # Absolute values of normal errors have 4/π times the variance that squares have.
        for fit in fits:
            expected = LAGS.standard_error[name] * np.sqrt(np.pi / 4)
            assert fit.standard_error[name] == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("options", [[1], "tol"])
def test_solver_options_of_another_kind_are_refused(options):
    with pytest.raises(TypeError, match="give IPOPT's options as"):
        gb.fit(gb.Problem(Lag(), LAGS.parts[0].data), starts=2, solver_options=options)


@pytest.mark.parametrize("method", [gb.MultipleShooting, "shooting"])
def test_a_method_is_an_instance(method):
    with pytest.raises(TypeError, match="give an instance such as MultipleShooting"):
        gb.fit(gb.Problem(Lag(), LAGS.parts[0].data), method=method)


def test_what_ctrl_c_and_time_limits_left_out_is_said():
    def said(statuses, count, interrupted=False):
        found = SimpleNamespace(brought=statuses, runs=SimpleNamespace(status=np.array(statuses)))
        return [*Search(found, None, None, None, "", count, interrupted).cut_short()]

    assert said(["done"] * 3, 5) == []
    assert said(["done"] * 5, 5, interrupted=True) == []
    assert said(["done"] * 3, 5, interrupted=True) == [
        "interrupted after 3 of 5 starts: another start may end at a lower cost."
    ]
    assert said(["done", SEARCH_OVER], 2) == [
        "interrupted after 2 of 2 starts: another start may end at a lower cost."
    ]
    with limited(0.0):
        assert said(["done", SEARCH_OVER], 9) == [
            "the time limit ended the search after 2 of 9 starts: another start may end at a lower cost, and a faster "
            "machine may answer otherwise."
        ]


@pytest.mark.parametrize(
    ("matters", "largest", "by"),
    [
        (False, 0.5, None),
        (True, 0.123, "by 0.12 standard errors"),
        (True, np.inf, "by without limit, since"),
    ],
)
def test_steps_that_are_too_coarse_are_told_with_what_they_move_most(matters, largest, by):
    nlp = SimpleNamespace(substeps=3, free=("a", "b", "c"), method=gb.MultipleShooting())
    error = SimpleNamespace(
        matters=matters, shift=np.array([0.1, -0.9, 0.3]), largest=largest, growth=2
    )
    search = SimpleNamespace(error=error)
    found = [f.text for f in coarse_integration(SimpleNamespace(nlp=nlp, search=search))]
    assert len(found) == matters
    if matters:
        said = "the integration is too coarse: twice the steps per sample (6 instead of 3) would change b or its standard"
        assert found[0].startswith(
            f"{said} error {by.removeprefix('by ') if np.isinf(largest) else by}"
        )
        assert str(nlp.method.finer(6)) in found[0]
    static = SimpleNamespace(substeps=0)
    assert not [*coarse_integration(SimpleNamespace(nlp=static, search=search))]


def test_help_begins_with_what_a_fit_is():
    assert "The answer to a problem" in pydoc.render_doc(gb.Fit, renderer=pydoc.plaintext)[:200]
    assert replace(LAG, name="renamed").name == "renamed"
