"""Profiles of the likelihood, against brute force, an F-test written out, and planted truths."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose
from scipy.optimize import brentq, least_squares
from scipy.stats import t as student
from unfolded import unfolded

import greybox as gb
from greybox.assessment.profile import likelihood_factor
from greybox.assessment.profile_result import ProfileOf, Profiles
from greybox.data.files.numbers_in_text import number
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.models.tilt import PAPER_G
from greybox.problems import pitch_hover, yaw_hover

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(0.3, 30, 15)


class OneSided(gb.TransferFunction):
    """A gain over a pole far above the band: the data bound the pole from below alone, and know their ratio."""

    input, output = "u", "y"
    b = gb.Parameter(100.0, bounds=(1, 1e9), starts=(10, 1000))
    a = gb.Parameter(100.0, bounds=(1, 1e6), starts=(10, 1000))
    derived = {"ratio": lambda p: p.b / p.a}

    def response(self, s, p):
        return p.b / (s + p.a)


class Ladder(gb.TransferFunction):
    """Two stages of a resistor and a capacitor of one farad.

    The values R2/2 and 2 R1 have the response of R1 and R2; at R2 = 2 R1 both are the same.
    """

    input, output = "u", "y"
    R1 = gb.Parameter(1.0, bounds=(0.01, 100), starts=(0.3, 5), unit="Ω")
    R2 = gb.Parameter(1.0, bounds=(0.01, 100), starts=(0.3, 5), unit="Ω")

    def response(self, s, p):
        return 1 / (p.R1 * p.R2 * s**2 + (2 * p.R1 + p.R2) * s + 1)


def noisy(model, values, sigma, seed, omega=OMEGA):
    return measured(model, omega, values, noise=sigma, seed=seed)


def fitted(model, data, criterion=None, **options):
    return gb.fit(gb.Problem(model, data, criterion, **options), starts=2, progress=False)


def brute_force(fit, model, name, edge, level=0.95):
    """The end of the interval of squared relative errors, by scipy on the residuals, with the F-like threshold."""
    data, start = fit.parts[0].data, fit.estimate[name]
    others = {other: fit.estimate[other] for other in fit.free if other != name}
    names = [*others]

    def lowest(value):
        def residual(x):
            values = SimpleNamespace(**{name: value}, **dict(zip(names, x, strict=True)))
            error = model.response(1j * data.omega, values) / data.response - 1
            return np.concatenate([error.real, error.imag])

        return (
            2
            * least_squares(
                residual, list(others.values()), x_scale="jac", xtol=1e-12, ftol=1e-12
            ).cost
        )

    dof = 2 * len(data) - len(names) - 1
    bias = {q.name: q.bias for q in fit.quantities}[name] / fit.standard_error[name]
    root = student.ppf(0.5 + level / 2, dof) + (bias if edge < start else -bias)
    place = fit.free.index(name)
    limit = fit.cost + root**2 / 2 * fit.covariance_of([name])[0, 0] / fit.white[place, place]
    return brentq(lambda value: lowest(value) - limit, start, edge, rtol=1e-8)


def test_both_ends_are_those_of_brute_force():
    data = noisy(LagLagDelay(), TWO_LAGS, 0.1, 3, TWO_LAGS_OMEGA[::3])
    fit = fitted(LagLagDelay(), data, gb.SquaredRelativeError())
    low, high = gb.profile(fit, "K")["K"].interval
    best = fit.estimate["K"]
    for end, edge in ((low, 0.5 * best), (high, 1.7 * best)):
        expected = brute_force(fit, LagLagDelay(), "K", edge)
        assert_allclose(end, expected, atol=2e-3 * fit.standard_error["K"])


def test_with_little_noise_profiles_are_the_intervals_of_the_standard_errors():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.002, 1, TWO_LAGS_OMEGA)
    for criterion in (gb.RelativeError(), gb.SquaredRelativeError()):
        fit = fitted(Lag(), data, criterion)
        profiles = gb.profile(fit)
        for name, wald in fit.interval().items():
            # The sum of magnitudes of few points is not quadratic: its roots follow the standard
            # error to a tenth.
            width = 0.12 if isinstance(criterion, gb.RelativeError) else 0.02
            assert_allclose(
                profiles[name].interval,
                wald,
                atol=width * (wald[1] - wald[0]),
                err_msg=str(criterion),
            )


def test_an_open_end_is_said_and_the_ratio_is_known(monkeypatch):
    monkeypatch.setattr(
        ResponsePart, "neighbors", lambda *_: None
    )  # the brute force is that of independent errors
    data = noisy(OneSided(), {"b": 10000.0, "a": 5000.0}, 0.05, 1)
    fit = fitted(OneSided(), data, gb.SquaredRelativeError())
    profiles = gb.profile(fit)
    low, high = profiles["a"].interval
    assert high == np.inf
    # Steps at most triple, so that the curve is shown up to where it ends.
    steps = np.diff(profiles["a"].values[profiles["a"].roots >= 0])
    assert np.all(steps[1:] < 3.01 * steps[:-1])
    assert_allclose(low, brute_force(fit, OneSided(), "a", 20.0), rtol=0.01)
    assert "no upper limit up to the bound 1e+06" in str(profiles["a"])
    assert profiles["a"].unit == "1"  # which is not written
    assert str(profiles["a"]).startswith(f"above {number(low, 4)}, ")
    assert_allclose(profiles["ratio"].interval, 2.0, rtol=0.1)


@pytest.fixture(scope="module")
def yaw():
    return gb.fit(yaw_hover.problem(), starts=5, progress=False)


def test_the_yaw_damping_is_positive_and_has_no_upper_limit(yaw):
    profiles = gb.profile(yaw, ["a2", "a3_tilde"])
    low, high = profiles["a2"].interval
    # Errors are independent, of sines flown one after another; if their residuals decided, the
    # limit would lie below 100.
    assert 100 < low < 170
    assert high == np.inf
    assert profiles["a2"].ends == ("crossed", "bound")
    # a3 / a2 is determined, so that the upper end of a3 is made by the bound of a2.
    assert profiles["a3_tilde"].at_bound == ((), ("a2",))
    assert "the upper limit with a2 at its bound" in str(profiles)


def test_derived_quantities_follow_their_parameter():
    profiles = gb.profile(
        gb.fit(pitch_hover.problem(), starts=5, progress=False), ["a3", "a3_tilde"]
    )
    assert_allclose(
        profiles["a3_tilde"].interval, PAPER_G * np.array(profiles["a3"].interval), rtol=1e-3
    )


def test_intervals_hold_the_truth_as_often_as_they_say():
    # The one-sided model, whose standard error says nothing: of 5 intervals of 95 % at least 2
    # (all but 3e-5 of the time).
    held = 0
    for seed in range(5):
        data = noisy(OneSided(), {"b": 800.0, "a": 400.0}, 0.05, seed)
        fit = gb.fit(gb.Problem(OneSided(), data), [{"b": 800.0, "a": 400.0}], profiles=False)
        low, high = gb.profile(fit, "a")["a"].interval
        held += low <= 400.0 <= high
    assert held >= 2


def test_a_saved_fit_is_profiled_too(tmp_path):
    fit = gb.fit(pitch_hover.problem(), starts=5, progress=False)
    gb.save(fit, tmp_path / "pitch.h5")
    again = gb.load(tmp_path / "pitch.h5")
    assert gb.profile(again, "a1")["a1"].interval == gb.profile(fit, "a1")["a1"].interval


def test_a_fit_profiles_what_its_standard_error_misleads_about(yaw, tmp_path):
    fit = yaw
    assert [profile.name for profile in fit.profiles.profiles] == [
        "a1_tilde",
        "a2",
        "a3_tilde",
    ]  # a4: 5.6 ± 0.3
    asked = gb.profile(fit, "a2")["a2"]
    assert fit.profiles["a2"].interval == pytest.approx(asked.interval)
    said = str(fit)
    assert (
        f"a2        above {asked.interval[0]:.4g} 1/s, no upper limit up to the bound 2000" in said
    )
    gb.save(fit, tmp_path / "yaw.h5")
    again = gb.load(tmp_path / "yaw.h5")
    assert str(again) == said
    assert again.profiles.summary() == fit.profiles.summary()
    assert again.to_dict()["profiles"]["a2"]["high"] is None


def test_nothing_is_profiled_where_standard_errors_serve_or_it_is_not_asked_for():
    assert gb.fit(pitch_hover.problem(), starts=2, progress=False).profiles is None
    assert gb.fit(yaw_hover.problem(), starts=2, profiles=False, progress=False).profiles is None
    data = noisy(OneSided(), {"b": 10000.0, "a": 5000.0}, 0.05, 1)
    assert fitted(OneSided(), data, gb.MagnitudePhase()).profiles is None


def test_near_a_fold_an_interval_reaches_the_values_beyond_it():
    omega = np.geomspace(0.05, 5, 20)
    near = noisy(Ladder(), {"R1": 1.0, "R2": 2.6}, 0.05, 0, omega)
    fit = fitted(Ladder(), near, gb.RelativeLikelihood())
    low, high = fit.interval()["R1"]
    low_twin, high_twin = (end / 2 for end in fit.interval()["R2"])
    assert high < low_twin or high_twin < low  # as if the estimate were the only minimum
    # Both minima have one cost, so each resistor has the interval of the other one.
    twin = np.array(fit.profiles["R2"].interval) / 2
    assert_allclose(fit.profiles["R1"].interval, twin, rtol=0.005)
    # With a prior, the cost is no likelihood.
    wide = gb.Problem(Ladder(), near, gb.RelativeLikelihood(), prior={"R1": (1.0, 50.0)})
    assert gb.fit(wide, starts=3, progress=False).profiles is None
    apart = noisy(Ladder(), {"R1": 1.0, "R2": 20.0}, 0.05, 0, omega)
    assert fitted(Ladder(), apart, gb.RelativeLikelihood()).profiles is None


def test_problems_with_constraints_are_profiled_up_to_them():
    data = noisy(Ladder(), {"R1": 1.0, "R2": 2.05}, 0.05, 2, np.geomspace(0.05, 5, 20))
    problem = gb.Problem(
        Ladder(), data, gb.RelativeLikelihood(), constraints=[lambda p: p.R2 - 2 * p.R1]
    )
    fit = gb.fit(problem, starts=3, progress=False)
    assert fit.interval()["R1"][0] < 0  # the errors of both are several hundred times the values
    low, high = fit.profiles["R1"].interval
    assert 0.7 < low < 1.0 < high < 1.1
    # Near its upper end R1 takes R2 with it.
    assert_allclose(fit.profiles["R1"].others[-1] @ [2, -1], 0, atol=1e-5)


def test_a_parameter_at_its_bound_has_an_interval():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.05, 0)
    for bound in (0.35, 0.35 * (1 + 1e-15)):  # a solver may stop short of it by rounding
        problem = gb.Problem(Lag(), data, gb.RelativeLikelihood(), bounds={"T": (bound, 5)})
        profile = gb.fit(problem, starts=3, progress=False).profiles["T"]
        assert profile.ends == ("bound", "crossed")
        assert bound < profile.interval[1] < 0.5


def test_what_has_no_likelihood_ratio_is_refused():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.02, 0)
    with pytest.raises(ValueError, match="MagnitudePhase does not weigh"):
        gb.profile(fitted(Lag(), data, gb.MagnitudePhase()))
    tied = gb.Problem(
        LagLagDelay(), noisy(LagLagDelay(), TWO_LAGS, 0.02, 0), tied={"T1": lambda p: 3 * p.T2}
    )
    fit = gb.fit(tied, starts=5, progress=False)
    with pytest.raises(ValueError, match="give its problem="):
        gb.profile(fit)
    assert np.isfinite(gb.profile(fit, "T1", problem=tied)["T1"].interval).all()
    with pytest.raises(ValueError, match="has no quantity to profile 'T'"):
        gb.profile(fit, "T", problem=tied)


def test_what_follows_from_constants_alone_has_no_profile():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.02, 0)
    fit = fitted(Lag(), data, fixed={"T": 0.3})
    found = gb.profile(fit)
    assert [profile.name for profile in found.profiles] == ["K", "area"]
    assert_allclose(found["area"].interval, 0.09 * np.array(found["K"].interval), rtol=1e-3)
    with pytest.raises(ValueError, match="has no quantity to profile 'bandwidth'"):
        gb.profile(fit, "bandwidth")
    for names in (3, ["K", 3]):
        with pytest.raises(TypeError, match="a name is 3: give names of parameters"):
            gb.profile(fit, names)


def test_the_figure_has_a_panel_for_each(yaw):
    axes = gb.plotting.profiles(yaw.profiles)
    assert [ax.get_xlabel()[:2] for ax in axes] == ["a1", "a2", "a3"]


def test_a_level_is_a_share():
    fit = fitted(OneSided(), noisy(OneSided(), {"b": 100.0, "a": 100.0}, 0.02, 0))
    for level in (0.0, 1.0, 95.0):
        with pytest.raises(ValueError, match=f"level {level} must lie between 0 and 1"):
            gb.profile(fit, level=level)


def test_profiles_by_newtons_method_are_those_by_gauss_newton_steps(monkeypatch):
    fit = fitted(
        LagLagDelay(),
        noisy(LagLagDelay(), TWO_LAGS, 0.03, 2, TWO_LAGS_OMEGA),
        gb.SquaredRelativeError(),
    )
    found = gb.profile(fit, list(fit.free)[:1])
    monkeypatch.setattr("greybox.assessment.profile.ResponseSolver.serves", lambda nlp: False)
    wanted = gb.profile(fit, list(fit.free)[:1])
    for one, other in zip(found.profiles, wanted.profiles, strict=True):
        assert one.interval == pytest.approx(other.interval, rel=1e-3)


@pytest.mark.parametrize(
    ("interval", "ends", "at_bound", "connected", "said"),
    [
        ((1.0, 2.5), ("crossed", "crossed"), ((), ()), True, "1 to 2.5 s"),
        ((1.0, 2.5), ("crossed", "crossed"), ((), ()), False, "1 to 2.5 s, in separate pieces"),
        (
            (1.0, np.inf),
            ("crossed", "bound"),
            ((), ()),
            True,
            "above 1 s, no upper limit up to the bound 9",
        ),
        (
            (-np.inf, 2.5),
            ("bound", "crossed"),
            ((), ()),
            True,
            "below 2.5 s, no lower limit down to the bound -3",
        ),
        (
            (-np.inf, 2.5),
            ("failed", "crossed"),
            ((), ()),
            True,
            "below 2.5 s, no lower limit that could be found: solves failed beyond",
        ),
        ((1.0, np.inf), ("crossed", "flat"), ((), ()), True, "above 1 s, no upper limit"),
        (
            (-np.inf, np.inf),
            ("flat", "bound"),
            ((), ()),
            True,
            "not limited by the data on either side",
        ),
        (
            (1.0, 2.5),
            ("crossed", "crossed"),
            (("k",), ("k", "c")),
            True,
            "1 to 2.5 s, the lower limit with k at its bound, the upper limit with k, c at their bounds",
        ),
    ],
)
def test_an_interval_in_words(interval, ends, at_bound, connected, said):
    one = ProfileOf(
        "T", "s", 1.5, 0.2, *np.zeros((3, 1)), np.zeros((1, 1)), interval, ends, (-3.0, 9.0)
    )
    one = replace(one, at_bound=at_bound, connected=connected)
    assert str(one) == said
    found = Profiles("step", 0.9, {"T": 1.7}, ("T",), (one,), ("a profile found more",))
    assert unfolded(found) == (
        f"step: 90 % intervals by profile likelihood T 1.5 {said} warning: a profile found more"
    )
    low, high = (None if np.isinf(value) else value for value in interval)
    assert found.intervals_in_words() == {"T": {"low": low, "high": high, "text": said}}
    summary = found.summary()
    assert (summary["problem"], summary["level"], summary["limit"]) == ("step", 0.9, {"T": 1.7})
    assert summary["profiles"]["T"] == {
        "estimate": 1.5,
        "standard_error": 0.2,
        "low": low,
        "high": high,
        "ends": [*ends],
        "at_bound": [list(names) for names in at_bound],
        "connected": connected,
        "text": said,
        "values": [0.0],
        "costs": [0.0],
        "roots": [0.0],
        "others": {"T": [0.0]},
    }
    with pytest.raises(KeyError, match="'k' was not profiled"):
        found["k"]


def test_the_factor_of_the_cost_is_that_of_both_variances_along_the_gradient():
    known = SimpleNamespace(
        covariance=np.array([[2.0, -0.5], [-0.5, 3.0]]), size=np.array([1.0, 10.0])
    )
    fit = SimpleNamespace(
        free=("a", "b"),
        white=np.array([[4.0, 1.0], [1.0, 9.0]]),
        known_directions={("a", "b"): known}.get,
    )
    gradient = np.array([2.0, -1.0])
    assert likelihood_factor(fit, gradient) == pytest.approx((16 - 4 + 9) / (8 + 2 + 3))
    # Along what has no variance, what holds on average, in multiples of the sizes.
    known.covariance = np.diag([2.0, 0.0])
    assert likelihood_factor(fit, np.array([0.0, 3.0])) == pytest.approx((4 + 0.09) / 2)
    assert likelihood_factor(fit, np.array([3.0, 0.0])) == pytest.approx(2)


@pytest.fixture(scope="module")
def lag():
    return fitted(Lag(), noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.02, 0), gb.SquaredRelativeError())


def test_a_fit_without_an_estimate_and_one_with_a_prior_have_no_profile(lag):
    with pytest.raises(ValueError, match="no start converged"):
        gb.profile(replace(lag, name="run", minima=()))
    with pytest.raises(
        ValueError,
        match="has priors",
    ):
        gb.profile(replace(lag, name="run", priors={"K": (2.0, 0.1)}))


def test_a_lower_cost_than_the_fits_is_told(lag):
    assert gb.profile(lag, "K").warnings == ()
    off = tuple(replace(q, value=1.2 * q.value) if q.name == "T" else q for q in lag.quantities)
    found = gb.profile(replace(lag, quantities=off), "K")
    (said,) = found.warnings
    p = {q.name: q.value for q in off}
    data = lag.parts[0].data
    cost = np.sum(np.abs(p["K"] / (1j * data.omega * p["T"] + 1) / data.response - 1) ** 2)
    lowest = number(float(found["K"].costs.min()))
    assert (
        said
        == f"a profile found the cost {lowest} below the fit's {number(cost)}: fit from more starts."
    )


class Unbounded(gb.TransferFunction):
    """A lead whose numbers have no bounds."""

    input, output = "u", "y"
    a = gb.Parameter(1.0)
    b = gb.Parameter(0.1)
    T = gb.Parameter(0.5, bounds=(0.01, 5))

    def response(self, s, p):
        return p.a * (1 + p.b * s) / (p.T * s + 1)


def test_a_fit_profiles_parameters_without_bounds():
    random, s = np.random.default_rng(0), 1j * np.geomspace(0.3, 3, 12)
    noise = 0.05 * random.normal(size=(12, 2)) @ [1, 1j]
    data = gb.FrequencyResponse(s.imag, 2 / (0.4 * s + 1) * (1 + noise), "u", "y")
    fit = gb.fit(gb.Problem(Unbounded(), data), starts=1, progress=False)
    low, high = fit.profiles["b"].interval
    assert low < 0 < high


class Pair(gb.StateSpace):
    """Sideslip and roll rate from two controls."""

    states, inputs, outputs = ("v", "p", "phi"), ("lat", "ped"), ("v", "p")
    delays = {"lat": "tau"}
    Lp = gb.Parameter(-3.0, bounds=(-12, 0))
    Lv = gb.Parameter(-0.5, bounds=(-2, 2))
    Yv = gb.Parameter(-0.2, bounds=(-1, 1))
    Llat = gb.Parameter(12.0, bounds=(1, 50))
    Lped = gb.Parameter(2.0, bounds=(-8, 8))
    tau = gb.Parameter(0.05, bounds=(0, 0.2))

    def derivative(self, x, u, p):
        roll = p.Lv * x.v + p.Lp * x.p + p.Llat * u.lat + p.Lped * u.ped
        return p.Yv * x.v + gb.g * x.phi + u.ped, roll, x.p

    def output(self, x, u, p):
        return x.v, x.p


def test_many_responses_are_profiled_by_the_search_of_their_fit(monkeypatch):
    """Runs from one point after the other would take fifty times as long as the fit."""

    def run(self, start):
        raise AssertionError("a run from one start")

    monkeypatch.setattr(GaussNewton, "run", run)
    omega, random = np.geomspace(0.5, 20, 60), np.random.default_rng(0)
    responses = []
    for y in Pair.outputs:
        for u in Pair.inputs:
            exact = gb.frequency_response(Pair(), None, omega, input=u, output=y).response
            noise = 0.05 * random.standard_normal((2, omega.size))
            measured = exact * (1 + noise[0] + 1j * noise[1])
            responses.append(gb.FrequencyResponse(omega, measured, input=u, output=y))
    problem = gb.several(Pair(), responses, criterion=gb.SquaredRelativeError())
    fit = gb.fit(problem, starts=2, progress=False)
    low, high = gb.profile(fit, "Lv")["Lv"].interval
    assert_allclose((low, high), fit.interval()["Lv"], atol=0.05 * (high - low))


def test_what_is_no_fit_is_named():
    with pytest.raises(
        TypeError, match=r"^fit is 'lag\.h5': give what gb\.fit or gb\.load returns"
    ):
        gb.profile("lag.h5")
