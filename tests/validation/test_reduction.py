"""What a fit leaves open goes to its end, and nothing else does."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from drag_flights import Drag, fitted, flight

import greybox as gb
from greybox.modeling.limit import Limit
from greybox.models.yaw import YawAngle
from greybox.problems import pitch_hover, yaw_hover
from greybox.validation.reduction import Candidate, directions


@pytest.fixture(scope="module")
def yaw():
    return gb.reduce(gb.fit(yaw_hover.problem(), starts=8), starts=4)


def test_the_yaw_of_the_paper_has_three_parameters(yaw):
    """The limit by hand: (a3/a2)(s + a4)/(s + a4 + a1/a2) behind integrator, rotor and delay."""
    assert str(yaw).startswith(
        "yaw hover: 3 parameters instead of 4, cost 0.8083 against 0.8045: a2 → ∞"
    )
    assert yaw.test.p_value > 0.5
    data = yaw_hover.data()
    s = 1j * data.omega
    e = yaw.fit.estimate
    zero = s + e["a4"]
    by_hand = (
        e["a3_tilde_per_a2"]
        * zero
        / (zero + e["a1_tilde_per_a2"])
        / s
        / (0.048 * s + 1)
        * np.exp(-0.0042 * s)
    )
    np.testing.assert_allclose(yaw.fit.responses[0].response, by_hand, rtol=2e-8)
    assert np.sum(np.abs(by_hand / data.response - 1)) == pytest.approx(yaw.fit.cost, rel=1e-6)
    # The ratios are those that the full fit determines, with its errors.
    ratios = {c.formula: c for c in yaw.large.identifiability.combinations}
    for formula, name in (("a3_tilde/a2", "a3_tilde_per_a2"), ("a1_tilde/a2", "a1_tilde_per_a2")):
        assert e[name] == pytest.approx(ratios[formula].value, abs=ratios[formula].standard_error)
        assert yaw.fit.standard_error[name] == pytest.approx(
            ratios[formula].standard_error, rel=0.3
        )
    units = {q.name: q.unit for q in yaw.fit.quantities}
    assert units["a3_tilde_per_a2"] == "1/s"


def test_a_reduced_fit_is_saved_and_loaded(yaw, tmp_path):
    gb.save(yaw.fit, tmp_path / "yaw.h5")
    loaded = gb.load(tmp_path / "yaw.h5")
    assert loaded.estimate == yaw.fit.estimate
    omega = np.array([0.5, 5.0])
    np.testing.assert_array_equal(loaded.response(omega).response, yaw.fit.response(omega).response)


def test_a_lag_that_is_too_fast_to_be_seen_is_left_out_in_all_parts():
    omega = np.geomspace(0.1, 10, 15)
    truth = {"T1": 0.5, "T2": 0.0012, "tau": 0.0}
    parts = [
        gb.Problem(
            LagLagDelay(),
            measured(LagLagDelay(), omega, {"K": gain, **truth}, noise=0.05, seed=seed),
            fixed={"tau": 0.0},
            rename={"K": f"K_{seed}", "T2": "T_fast"},
        )
        for gain, seed in ((2.0, 1), (3.0, 2))
    ]
    fit = gb.fit(sum(parts), starts=[{"K_1": 2.0, "K_2": 3.0, "T1": 0.5, "T_fast": 0.0012}])
    found = gb.reduce(fit, starts=1)
    assert [str(candidate) for candidate in found.taken] == ["T_fast = 0"]
    assert set(found.fit.free) == {"K_1", "K_2", "T1"}
    alone = gb.fit(
        sum(gb.Problem(Lag(), p.response, rename={"K": p.rename["K"], "T": "T1"}) for p in parts),
        starts=[{"K_1": 2.0, "K_2": 3.0, "T1": 0.5}],
    )
    assert found.fit.cost == pytest.approx(alone.cost, rel=1e-6)


def test_what_is_determined_is_left_alone():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)
    fit = gb.fit(gb.Problem(LagLagDelay(), data), starts=4)
    found = gb.reduce(fit)
    assert found.fit is fit
    assert found.taken == ()
    assert "not reduced" in str(found)


def test_a_needed_parameter_with_a_large_error_stays():
    """Noise of 40 % leaves errors of both lags above the guideline, and the absence of either is rejected."""
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, {**TWO_LAGS, "tau": 0.0}, noise=0.4, seed=3)
    fit = gb.fit(gb.Problem(LagLagDelay(), data, fixed={"tau": 0.0}), starts=4)
    assert fit.identifiability.beyond
    found = gb.reduce(fit, starts=2)
    assert found.tried
    assert found.taken == ()
    assert "the data reject every limit" in str(found)


def test_directions_leave_products_as_they_are():
    products = [{"a": 2, "b": -1}, {"b": 1, "c": -1}]  # a²/b and b/c: b and c go as the square of a
    assert list(directions(products)) == [{"a": 1, "b": 2, "c": 2}]
    assert list(directions([{"a": 1, "b": 1}])) in ([{"a": 1, "b": -1}], [{"b": 1, "a": -1}])
    assert list(directions([])) == []


def test_limits_by_powers_and_to_zero():
    """K/(T s + 1) with K and T to infinity together integrates; with K T kept and T to infinity it vanishes."""
    omega = np.array([0.5, 2.0])
    model = Limit(Lag(), "T", 2.0, "infinity", (("K", 1, 6.0),))
    assert list(model.parameters) == ["K_per_T"]
    assert gb.frequency_response(model, {}, omega).response == pytest.approx(3.0 / (1j * omega))
    model = Limit(Lag(), "T", 2.0, "zero")
    assert gb.frequency_response(model, {"K": 4.0}, omega).response == pytest.approx(4.0)
    with pytest.raises(ValueError, match="Lag has no parameter 'T9'; it has K, T"):
        Limit(Lag(), "T9", 2.0, "zero")


def test_what_cannot_be_reduced_is_told(yaw):
    with pytest.raises(ValueError, match="has other unknowns than the fit"):
        gb.reduce(yaw.large, problem=pitch_hover.problem())
    tied = gb.fit(
        gb.Problem(YawAngle(), yaw_hover.data(), tied={"a4": lambda p: 0.01 * p.a2}), starts=2
    )
    with pytest.raises(ValueError, match="has ties"):
        gb.reduce(tied)
    record = flight({"a5": 0.2, "C_x": 0.05}, 8, duration=6.0)
    with pytest.raises(ValueError, match="transfer functions fitted to frequency responses"):
        gb.reduce(fitted(Drag(), record))
    known = gb.fit(gb.Problem(YawAngle(), yaw_hover.data(), prior={"a4": (5.6, 0.2)}), starts=2)
    with pytest.raises(ValueError, match="prior"):
        gb.reduce(known)


class Grown(gb.TransferFunction):
    """A gain that grows without end, and one that is finite nowhere but at finite values."""

    K = gb.Parameter(1.0, bounds=(0.1, 10))
    a = gb.Parameter(1.0, bounds=(0, 5))

    def response(self, s, p):
        return p.K * gb.exp(p.a) / (s + 1)


def test_only_ends_at_which_the_response_has_a_limit_are_tried():
    """K and exp(a) determine one product: K cannot go anywhere, and a only to zero."""
    omega = np.geomspace(0.1, 10, 15)
    data = measured(Grown(), omega, {"K": 1.0, "a": 1.0}, noise=0.05)
    found = gb.reduce(gb.fit(gb.Problem(Grown(), data), starts=4, progress=False), starts=1)
    assert [str(trial.candidate) for trial in found.tried] == ["a = 0"]


def test_a_candidate_says_where_its_parameters_go():
    powers = {"a": 1, "b": 2, "c": -3}
    assert str(Candidate(powers, "infinity")) == "a → ∞, b/a^2 and c·a^3 kept"
    assert str(Candidate({"a": 1, "b": -1}, "zero")) == "a → 0, b·a kept"
    assert [str(Candidate({"a": 1}, end)) for end in ("infinity", "zero")] == ["a → ∞", "a = 0"]
