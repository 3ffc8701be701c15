"""Warnings appear when they should and not otherwise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import (
    TWO_LAGS,
    TWO_LAGS_OMEGA,
    Lag,
    LagLagDelay,
    Oscillator,
    Parabola,
    measured,
)

import greybox as gb
from greybox.assessment.checks.coarse_pade import coarse_pade
from greybox.assessment.checks.no_degrees_of_freedom import no_degrees_of_freedom
from greybox.assessment.pade_error import pade_error
from greybox.models.yaw import YawStates

ORDERED = [lambda p: p.T1 - p.T2]
SMALL = {"K": 5.0, "T1": 1.0, "T2": 0.1, "tau": 0.05}


def warned(model, data, criterion=None, starts=2, **statement):
    problem = gb.Problem(model, data, criterion, **statement)
    return gb.fit(problem, starts=starts, profiles=False).warnings


def lags(noise=0.02, seed=1, **changes):
    return measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS | changes, noise=noise, seed=seed)


@pytest.mark.parametrize(
    "criterion",
    [gb.RelativeError(), gb.SquaredRelativeError(), gb.MagnitudePhase()],
    ids=lambda c: type(c).__name__,
)
def test_a_good_fit_has_no_warnings(criterion):
    assert warned(LagLagDelay(), lags(), criterion, constraints=ORDERED) == ()


def test_lags_that_may_swap_are_told():
    (text,) = warned(LagLagDelay(), lags(), starts=30)
    assert "at least 2 clearly different parameter vectors give this same response" in text


@pytest.mark.parametrize(("side", "truth", "bound"), [("lower", -0.02, "0"), ("upper", 0.7, "0.5")])
def test_a_parameter_at_its_bound_is_named_with_side_and_bound(side, truth, bound):
    fit = gb.fit(
        gb.Problem(LagLagDelay(), lags(tau=truth), constraints=ORDERED), starts=2, profiles=False
    )
    assert any(
        text.startswith(f"tau ended at its {side} bound {bound}; the other standard errors")
        for text in fit.warnings
    )
    assert np.isnan(fit.standard_error["tau"])
    assert {q.name for q in fit.quantities if q.at_bound} == {"tau"}
    assert "AT BOUND" in str(fit)


def test_one_start_and_few_agreeing_starts_are_told():
    (text,) = warned(Lag(), measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.02), starts=1)
    assert "one start only" in text
    bumps = measured(Parabola(), [0.5, 1.0, 2.0, 4.0], {"x": 1.0, "slope": 0.0}, noise=0.01)
    lone = warned(Parabola(), bumps, starts=[{"x": -1.5}] * 11 + [{"x": 1.3}])
    assert any(text.startswith("only 1 of 12 starts reached the best minimum") for text in lone)
    several = warned(Parabola(), bumps, starts=[{"x": -1.5}] * 8 + [{"x": 1.3}] * 4)
    assert not any("reached the best minimum" in text for text in several)


def test_runs_that_failed_are_counted_when_they_are_the_majority():
    data = measured(Oscillator(), [1.0, 2.0, 4.0, 8.0], {"w0": 3.0, "K": 2.0}, noise=0.01)
    starts = [{"w0": 2.0}, {"w0": 4.0}, {"w0": 2.0}, {"w0": 3.2}, {"w0": 3.1}]
    text = warned(Oscillator(), data, starts=starts)[0]
    assert text.startswith(
        "only 2 of 5 runs converged (2 × Invalid_Number_Detected (no finite response at omega = 2 "
    )
    few = warned(Oscillator(), data, starts=[{"w0": 2.0}, {"w0": 3.2}, {"w0": 3.1}])
    assert not any("runs converged" in text for text in few)


@pytest.mark.parametrize(("beta", "share"), [(0.0005, 0.99), (0.01, 0.78), (0.2, None)])
def test_a_rival_minimum_is_told_with_its_likelihood_and_values(beta, share):
    class Twins(gb.TransferFunction):
        """Nearest to 3 at x = 1 and at x = -1, with the responses 3.2 ± 0.1j; `beta` favors the first."""

        x = gb.Parameter(0.5, bounds=(-2, 2))

        def response(self, s, p):
            j = s / abs(s)
            return 3.2 + 2 * (p.x**2 - 1) ** 2 + 0.1 * p.x * j

    data = gb.FrequencyResponse([1.0, 2.0, 3.0], [3 + beta * 1j] * 3)
    fit = gb.fit(gb.Problem(Twins(), data), starts=12)
    assert len(fit.minima) == 2
    texts = [text for text in fit.warnings if "another minimum" in text]
    assert len(texts) == (share is not None)
    assert all(
        text.startswith(
            f"another minimum with a different response has {share} times the likelihood: x = "
        )
        for text in texts
    )


def pade_phase(order, z):
    """Phase error in degrees of exp(-z j) by its diagonal Padé approximant."""
    from math import factorial

    from pade_by_definition import pade

    p, q = pade([(-1) ** k / factorial(k) for k in range(2 * order + 1)], order)
    return np.degrees(np.abs(np.angle(p(1j * z) / q(1j * z) / np.exp(-1j * z)))).max()


@pytest.mark.parametrize(
    ("order", "tau", "expected"),
    [(1, 0.05, True), (2, 0.05, False), (2, 0.1, True)],
)
def test_a_pade_delay_is_told_when_it_errs_by_more_than_a_degree(order, tau, expected):
    delay = f"pade:{order}"
    data = measured(
        LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS | {"tau": tau}, delay=delay, noise=0.001
    )
    fit = gb.fit(
        gb.Problem(LagLagDelay(), data, delay=delay, constraints=ORDERED), starts=2, profiles=False
    )
    error = pade_phase(order, TWO_LAGS_OMEGA * fit.estimate["tau"])
    assert fit.parts[0].pade_error == pytest.approx(error, rel=1e-6)
    assert (error > 1) == expected
    texts = [
        text for text in fit.warnings if f"the phase error of {delay} reaches {error:.2g}°" in text
    ]
    assert len(texts) == expected
    assert f"Padé phase error up to {error:.2g}°" in fit.details


def test_an_exact_delay_has_no_pade_error():
    fit = gb.fit(gb.Problem(LagLagDelay(), lags(), constraints=ORDERED), starts=5)
    assert fit.parts[0].pade_error is None
    assert "Padé" not in fit.details


def test_a_dead_parameter_is_named_and_has_no_standard_error():
    class Dead(Lag):
        mass = gb.Parameter(1.0, bounds=(-5, 5))

        def response(self, s, p):
            return super().response(s, p) + 0 * p.mass

    fit = gb.fit(
        gb.Problem(Dead(), measured(Dead(), TWO_LAGS_OMEGA, {"K": 2.0}, noise=0.02)), starts=2
    )
    (text,) = fit.warnings
    assert text.startswith("mass is not determined: it does not change the response")
    assert np.isnan(fit.standard_error["mass"])
    assert np.isfinite(fit.standard_error["K"])


def test_parameters_seen_only_as_a_product_are_named_together():
    truth = {"a1": 500.0, "a2": 50.0, "a3": 900.0, "a4": 5.0}
    data = measured(
        YawStates(), np.geomspace(1, 60, 30), truth, noise=0.02, seed=2, input="u", output="r"
    )
    fit = gb.fit(gb.Problem(YawStates(), data, free=("K_nu",)), starts=4, profiles=False)
    texts = [text for text in fit.warnings if "depend only on a combination" in text]
    assert len(texts) == 1
    assert set(texts[0].split(" are not determined")[0].split(" and ")) == {"K_nu", "a1"}
    assert np.isnan([fit.standard_error[n] for n in ("K_nu", "a1")]).all()
    # The product is determined as well as with K_nu fixed.
    alone = gb.fit(gb.Problem(YawStates(), data), starts=4, profiles=False)
    assert not any("determined" in text for text in alone.warnings)
    for name in ("a1_tilde", "a2", "a3", "a4"):
        assert fit.standard_error[name] == pytest.approx(alone.standard_error[name], rel=0.05)
    assert fit.derived["a1_tilde"] == pytest.approx(alone.derived["a1_tilde"], rel=1e-3)


def test_poorly_identifiable_combinations_are_told_with_their_collinearity():
    omega = np.geomspace(0.01, 0.1, 12)  # far below both corners the lags act as one delay
    data = measured(LagLagDelay(), omega, SMALL, noise=0.02, seed=3)
    texts = [
        t for t in warned(LagLagDelay(), data, constraints=ORDERED) if "poorly identifiable" in t
    ]
    assert texts
    assert all("collinearity index" in text for text in texts)
    assert any("tau" in text for text in texts)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("points", [1, 2])
def test_too_few_data_are_told_and_give_no_standard_errors(points, noise):
    data = measured(LagLagDelay(), [0.5, 8.0][:points], TWO_LAGS, noise=noise)
    fit = gb.fit(gb.Problem(LagLagDelay(), data), starts=2)
    words = (
        f"{2 * points} real numbers of data for 4 unknowns leave no degrees of freedom, so that no standard error is "
        "known: add data."
    )
    assert words in fit.warnings
    assert np.isnan([fit.standard_error[n] for n in fit.free]).all()


def test_three_points_are_enough_for_four_unknowns():
    data = measured(LagLagDelay(), [0.5, 2.0, 8.0], TWO_LAGS, noise=0.02)
    assert not any("degrees of freedom" in text for text in warned(LagLagDelay(), data))


@pytest.mark.parametrize(
    ("factor", "dof", "words"),
    [
        (1.0, None, None),
        (0.04, None, "variances are too small"),
        (25.0, None, "the variances are too large"),
        # Estimated variances may include systematic errors, which the parameters take up.
        (0.04, 60.0, "variances are too small"),
        (25.0, 60.0, None),
    ],
)
def test_variances_that_do_not_match_the_residuals_are_told(factor, dof, words):
    exact = gb.frequency_response(LagLagDelay(), TWO_LAGS, TWO_LAGS_OMEGA).response
    noisy = lags(noise=0.02)
    variance = factor * 2 * 0.02**2 * np.abs(exact) ** 2
    dof = None if dof is None else np.full(len(noisy), dof)
    data = replace(noisy, variance=variance, dof=dof, name="made")
    texts = [
        t
        for t in warned(LagLagDelay(), data, gb.MaximumLikelihood(), constraints=ORDERED)
        if "variances" in t
    ]
    assert len(texts) == (words is not None)
    assert all(words in text for text in texts)


def test_responses_share_the_unknowns_of_their_sum():
    """Of 12 unknowns in 6 responses, each takes 2 of its 12 numbers."""
    omega = np.geomspace(0.5, 5, 6)
    exact = 2 / (0.5j * omega + 1)
    random = np.random.default_rng(0)
    problems = []
    for k in range(6):
        errors = 0.05 * (random.normal(size=6) + 1j * random.normal(size=6))
        variance = 2 * (0.05 * np.abs(exact)) ** 2
        data = gb.FrequencyResponse(
            omega, exact + np.abs(exact) * errors, variance=variance, name=f"flight {k}"
        )
        names = {name: f"{name}_{k}" for name in ("K", "T")}
        problems.append(gb.Problem(Lag(), data, gb.MaximumLikelihood(), rename=names))
    fit = gb.fit(sum(problems[1:], problems[0]), starts=4)
    assert not [text for text in fit.warnings if "variances" in text]


def test_one_of_a_thing_is_singular():
    record = gb.Record(
        np.arange(6) * 0.1,
        {"u": [1.0, 0.0, 1.0, 1.0, 0.0, 1.0], "y": [0.0, 1.0, 0.5, 1.0, 1.2, 0.8]},
    )
    fit = gb.fit(gb.Problem(Lag(), record, fixed={"T": 0.3}), starts=1, progress=False)
    assert "1 of 1 converged; 1 agrees on the best of 1 distinct minimum" in fit.details
    assert "6 samples in 1 record" in str(fit)
    few = gb.Record(
        record.time, {"u": record["u"], "y": [np.nan, 1.0, np.nan, 1.5, np.nan, np.nan]}
    )
    (said,) = [
        w
        for w in gb.fit(gb.Problem(Lag(), few), starts=1, progress=False).warnings
        if "real numbers" in w
    ]
    assert said.startswith(
        "2 real numbers of data for 2 unknowns and 1 initial state leave no degrees of freedom"
    )
    one = measured(Lag(), [1.0], noise=0.1)
    alone = str(gb.fit(gb.Problem(Lag(), one, fixed={"T": 1.0}), starts=1))
    assert "1 point in 1 frequency response" in alone
    assert "1 degree of freedom" in alone
    assert "1 frequency from 1 to 1 rad/s" in str(one)
    assert "1 sample at" in str(record.rows(np.arange(1)))


@pytest.mark.parametrize("ratio", [0.38, 0.42, 2.4, 2.6])
def test_given_variances_are_doubted_from_a_factor_of_two_and_a_half_on(ratio):
    """Of the residuals' own variance, the fitted parameters counted; a factor of all variances moves no estimate."""
    data = measured(Lag(), TWO_LAGS_OMEGA, {"K": 2.0, "T": 0.3}, noise=0.02, seed=4)

    def with_variance(variance):
        given = gb.FrequencyResponse(data.omega, data.response, variance=variance, name="made")
        return gb.fit(gb.Problem(Lag(), given, gb.MaximumLikelihood()), starts=[{}], progress=False)

    shape = np.abs(data.response) ** 2
    residuals = data.response - with_variance(shape).responses[0].response
    own = np.sum(np.abs(residuals) ** 2 / shape) / (
        len(data) - 1
    )  # two parameters, of two numbers a point
    texts = [t for t in with_variance(shape * own / ratio).warnings if "given variances" in t]
    assert len(texts) == (not 0.4 <= ratio <= 2.5)
    assert all(f"{ratio:.2g} times as large as the given variances" in t for t in texts)
    assert all(("incomplete" in t) == (ratio > 1) for t in texts)


@pytest.mark.parametrize(
    ("numbers", "initial", "said"),
    [
        (1, 0, "1 real number of data for 3 unknowns leaves no degrees"),
        (3, 0, "3 real numbers of data for 3 unknowns leave no degrees"),
        (4, 0, ""),
        (4, 1, "4 real numbers of data for 3 unknowns and 1 initial state leave no degrees"),
        (5, 2, "5 real numbers of data for 3 unknowns and 2 initial states leave no degrees"),
        (5, 1, ""),
    ],
)
def test_there_must_be_more_numbers_than_unknowns(numbers, initial, said):
    parts = [
        SimpleNamespace(numbers=numbers - 1, unknown_initial_states=0),
        SimpleNamespace(numbers=1, unknown_initial_states=initial),
    ]
    nlp = SimpleNamespace(parts=parts, free=("a", "b", "c"), numbers=numbers)
    found = [f.text for f in no_degrees_of_freedom(SimpleNamespace(nlp=nlp))]
    assert found == (
        [f"{said} of freedom, so that no standard error is known: add data."] if said else []
    )


def test_an_approximate_delay_is_told_beyond_a_degree():
    parts = [
        SimpleNamespace(delay="pade:2", name=name, pade_error=error)
        for name, error in (("near", 1.0), ("far", 1.01), ("exact", None))
    ]
    evidence = SimpleNamespace(fit=SimpleNamespace(responses=parts))
    found = [f.text for f in coarse_pade(evidence)]
    assert found == [
        "the phase error of pade:2 reaches 1° in the band of 'far': use a higher order or delay='exact'."
    ]


def test_the_error_of_an_approximate_delay_is_that_of_its_phase():
    """Of first order -2 atan(ωT/2) for -ωT, which differ most at the upper end of the band."""

    class Delay(gb.TransferFunction):
        T = gb.Parameter(0.4, bounds=(0, 1))

        def response(self, s, p):
            return 2 * gb.exp(-s * p.T)

    omega = np.array([5.0, 1.0, 2.0])
    problem = gb.Problem(Delay(), gb.FrequencyResponse(omega, np.ones(3)), delay="pade:1")
    assert pade_error(problem, {"T": 0.4}) == pytest.approx(np.degrees(2.0 - 2 * np.arctan(1.0)))
    assert pade_error(problem.with_(delay="exact"), {"T": 0.4}) is None


# Frequencies of nearly equal magnitude, where equal variances agree with errors of equal relative size.
FLAT = np.geomspace(0.1, 1, 20)


@pytest.mark.parametrize(
    ("criterion", "columns", "said"),
    [
        (
            gb.RelativeError(),
            {"variance": np.full(20, 0.1)},
            "the variances of 'sines' are not used: MaximumLikelihood()",
        ),
        (
            None,
            {"coherence": np.full(20, 0.9)},
            "the coherence of 'sines' is not used: MagnitudePhase()",
        ),
        (gb.MagnitudePhase(), {"coherence": np.full(20, 0.9), "variance": np.full(20, 0.1)}, ""),
        (None, {"variance": np.full(20, 0.1)}, ""),
        (gb.RelativeLikelihood(), {"coherence": np.full(20, 0.9)}, ""),
        (None, {}, ""),
    ],
)
def test_what_the_criterion_does_not_use_is_mentioned(criterion, columns, said, tmp_path):
    data = measured(Lag(), FLAT, noise=0.05, columns=columns, name="sines")
    fit = gb.fit(gb.Problem(Lag(), data, criterion), starts=1)
    found = [text for text in fit.notes if "not used" in text]
    assert [text[: len(said)] for text in found] == ([said] if said else [])
    gb.save(fit, tmp_path / "fit.h5")
    assert gb.load(tmp_path / "fit.h5").notes == fit.notes


@pytest.mark.parametrize(("low", "high", "contradict"), [(0.05, 0.05, 0), (0.01, 0.17, 1)])
def test_variances_that_contradict_the_criterion_leave_a_fit_in_doubt(low, high, contradict):
    omega = np.geomspace(0.5, 20, 7)
    data = measured(Lag(), omega, noise=0.01, name="sines")
    variance = (np.geomspace(low, high, 7) * np.abs(data.response)) ** 2
    stated = replace(data, variance=variance)
    fit = gb.fit(gb.Problem(Lag(), stated, gb.RelativeError()), starts=2)
    assert sum("contradict" in text for text in fit.warnings) == contradict


def test_what_many_responses_do_not_use_is_mentioned_once():
    columns = {"variance": np.full(20, 0.1)}
    parts = [
        gb.Problem(
            Lag(),
            measured(
                Lag(),
                FLAT,
                noise=0.05,
                columns=columns,
                seed=k,
                name=f"sweep {k}",
            ),
            gb.RelativeError(),
        )
        for k in range(5)
    ]
    fit = gb.fit(sum(parts[1:], start=parts[0]), starts=1)
    [note] = [text for text in fit.notes if "not used" in text]
    assert "the variances of 'sweep 0' are not used" in note
    assert "the same applies to 4 more ('sweep 1', 'sweep 2'" in note


class Flexible(gb.StateSpace):
    """A lag with a flexible mode."""

    states, inputs, outputs = ("p", "x", "v"), ("u",), ("p",)
    L = gb.Parameter(2.0, bounds=(0.5, 10))
    omega = gb.Parameter(9.0, bounds=(5, 20))
    zeta = gb.Parameter(0.02, bounds=(0.001, 0.2))

    def derivative(self, x, u, p):
        mode = p.omega**2 * (0.02 * u.u - x.x) - 2 * p.zeta * p.omega * x.v
        return p.L * (u.u - x.p), x.v, mode

    def output(self, x, u, p):
        return (x.p + x.v,)


# The mode is 2 ζ ω = 0.36 rad/s wide; at 15.5 rad/s it lies outside the band.
@pytest.mark.parametrize(
    ("seconds", "omega", "is_named"), [(60, 9.0, True), (100, 9.0, False), (60, 15.5, False)]
)
def test_a_mode_that_is_too_narrow_for_the_spectra_is_named(seconds, omega, is_named):
    truth = {"L": 3.0, "omega": omega, "zeta": 0.18 / omega}
    exact = gb.frequency_response(Flexible(), truth, np.geomspace(1, 15, 40))
    noise = np.random.default_rng(0).standard_normal((2, 40)).T @ (0.01, 0.01j)
    spacing = {"spacing of the spectral lines, rad/s": f"{2 * np.pi / seconds}"}
    measured = gb.FrequencyResponse(exact.omega, exact.response * (1 + noise), about=spacing)
    fit = gb.fit(gb.Problem(Flexible(), measured), starts=5, progress=False, profiles=False)
    named = [text for text in fit.warnings if "spectral lines wide" in text]
    assert len(named) == is_named
    assert not named or f"the mode at {fit.estimate['omega']:.3g} rad/s is 3." in named[0]
