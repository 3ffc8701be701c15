"""Errors correlated along frequency: how often it is said, of independent errors and of correlated ones."""

import numpy as np
import pytest
from lateral_aircraft import LATERAL, Lateral

import greybox as gb
from greybox.assessment.validation.nested_models import cost_scale, nested_test_at
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.models.tilt import PAPER_G

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Lag(gb.TransferFunction):
    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.1, 50))
    tau = gb.Parameter(0.3, bounds=(0.001, 10), unit="s")
    T = gb.Parameter(0.03, bounds=(0, 0.3), unit="s")

    def response(self, s, p):
        return p.K / (p.tau * s + 1) * gb.exp(-s * p.T)


def fitted(correlation, criterion, seed, n=25):
    """Fit noise of 5 % whose neighbors have a correlation."""
    rng = np.random.default_rng(seed)
    omega = np.geomspace(0.5, 40, n)
    exact = 2 / (0.3j * omega + 1) * np.exp(-0.03j * omega)
    e = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    for k in range(1, n):
        e[k] = correlation * e[k - 1] + np.sqrt(1 - correlation**2) * e[k]
    variance = 2 * (0.05 * np.abs(exact)) ** 2
    data = gb.FrequencyResponse(omega, exact * (1 + 0.05 * e), "u", "y", variance=variance)
    return gb.fit(
        gb.Problem(Lag(), data, criterion),
        starts=[{"K": 2.0, "tau": 0.3, "T": 0.03}],
        progress=False,
    )


def said(fit):
    return any("correlated along frequency" in text for text in fit.warnings)


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MaximumLikelihood()], ids=str)
def test_correlated_errors_are_said_and_independent_ones_not(criterion):
    # With a probability of 3e-4, two of three have one of 1 %.
    assert sum(said(fitted(0.0, criterion, seed)) for seed in range(3)) <= 1
    assert sum(said(fitted(0.8, criterion, seed)) for seed in range(3)) >= 2


def test_few_points_whose_errors_count_as_independent_say_that_they_hardly_show_it():
    """Of 12 points; not where independence is stated, nor of 25."""
    few = fitted(0.0, gb.RelativeError(), 1, n=12)
    assert few.independent is None
    assert "hardly show" in str(few)
    stated = gb.Problem(Lag(), few.parts[0].data.with_independent_errors())
    assert "hardly show" not in str(gb.fit(stated, starts=[few.estimate], progress=False))
    assert "hardly show" not in str(fitted(0.0, gb.RelativeError(), 1))


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MaximumLikelihood()], ids=str)
def test_errors_that_are_stated_to_be_independent_are_taken_as_such(criterion, tmp_path):
    fit = fitted(0.8, criterion, 0)
    data = fit.parts[0].data.with_independent_errors()
    gb.data.write_response(data, tmp_path / "sines.csv")
    read = gb.read_response(tmp_path / "sines.csv")
    assert read.has_independent_errors
    assert not fit.parts[0].data.has_independent_errors
    assert read.checksum == data.checksum == fit.parts[0].data.checksum

    stated = gb.fit(gb.Problem(Lag(), read, criterion), starts=[fit.estimate], progress=False)
    assert stated.independent is None
    np.testing.assert_allclose(stated.covariance, fit.independent[0], rtol=1e-5)
    assert stated.dof == fit.independent[1]
    variances = [(fit.standard_error[n] / stated.standard_error[n]) ** 2 for n in fit.free]
    assert fit.inflation == pytest.approx(np.median(variances), rel=1e-4)
    assert stated.inflation == 1
    # The residuals contradict the statement.
    assert not said(stated)
    assert any("stated to be independent" in text for text in stated.warnings)


def test_points_closer_than_the_resolution_are_said():
    """Bands of three points need some 8 / 30 Hz; these have 0.0125 Hz between them."""
    rng = np.random.default_rng(2)
    time = np.arange(0, 30, 0.02)
    u = rng.standard_normal(time.size)
    y = np.convolve(u, 0.02 * 2 / 0.3 * np.exp(-time[:200] / 0.3))[
        : u.size
    ] + 0.3 * rng.standard_normal(u.size)
    omega = np.linspace(2, 5, 40)
    data = gb.spectral.spectral_response(gb.Record(time, {"u": u, "y": y}), "u", "y", omega=omega)
    problem = gb.Problem(Lag(), data, gb.MaximumLikelihood(), fixed={"T": 0.01})
    assert said(gb.fit(problem, starts=[{"K": 2.0, "tau": 0.3}], progress=False))


def test_the_order_of_the_points_does_not_matter():
    data = fitted(0.8, gb.RelativeError(), 0).responses[0].data
    order = np.random.default_rng(0).permutation(len(data))
    mixed = gb.FrequencyResponse(data.omega[order], data.response[order], "u", "y")
    problem = gb.Problem(Lag(), mixed, gb.RelativeError())
    fit = gb.fit(problem, starts=[{}], progress=False)
    assert said(fit)


def test_the_answer_says_how_far_the_standard_errors_account_for_it():
    (told,) = [
        t for t in fitted(0.6, gb.RelativeError(), 1, n=60).warnings if "along frequency" in t
    ]
    assert "independent errors have a probability of" in told
    assert told.endswith("account for what 60 points show of the first, but not for the second.")


def test_what_follows_from_the_covariance_is_as_wide():
    """Profiles and replicates, of errors that are correlated: as intervals by the standard errors, or nearly."""
    fit = fitted(0.6, gb.SquaredRelativeError(), 1, n=60)
    covariance, dof = fit.independent
    assert "; correlated along frequency like the residuals" in str(fit)
    widened = np.sqrt(np.diag(fit.covariance) / np.diag(covariance))
    assert np.all(widened > 1.4)
    low, high = gb.profile(fit, ["K"]).intervals["K"]
    wald = fit.interval()["K"]
    assert high - low == pytest.approx(wald[1] - wald[0], rel=0.1)
    drawn = gb.bootstrap(fit, 200, progress=False)
    assert "with their correlation along frequency" in drawn.about
    assert drawn.standard_error["K"] == pytest.approx(fit.standard_error["K"], rel=0.15)
    tau = {"tau": fit.estimate["tau"] * 1.02}
    held = gb.Problem(Lag(), fit.responses[0].data, gb.SquaredRelativeError(), fixed=tau)
    small = gb.fit(held, starts=[{"K": 2.0, "T": 0.03}], progress=False)
    widened_test, alone = (
        nested_test_at(tau, small, fit, ("small", "large"), independent=independent)
        for independent in (False, True)
    )
    assert widened_test.scale / alone.scale == pytest.approx(widened[1] ** 2, rel=1e-6)
    assert widened_test.scale > widened.min() ** 2 * cost_scale(fit)
    assert fit.dof < dof == alone.dof[1] == 2 * 60 - 3


def test_common_errors_are_not_counted_as_correlation():
    """Errors that all points share are known: the residuals are judged without them."""
    rng = np.random.default_rng(3)
    n = 40
    omega = np.geomspace(0.5, 40, n)
    exact = 2 / (0.3j * omega + 1) * np.exp(-0.03j * omega)
    common = 0.2 * exact * np.exp(1j * np.linspace(0, 6, n))
    errors = 0.02 * exact * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    variance = 2 * (0.02 * np.abs(exact)) ** 2 + np.abs(common) ** 2
    found = {}
    for name, told in (("told", {"common_errors": common[None]}), ("not told", {})):
        data = gb.FrequencyResponse(
            omega, exact + common + errors, "u", "y", variance=variance, **told
        )
        nlp = compile_problem(gb.Problem(Lag(), data, gb.MaximumLikelihood()))
        found[name] = nlp.parts[0].neighbors(np.array([2.0, 0.3, 0.03]), np.eye(3), 1.0)
    assert found["told"].independent > 0.6
    assert found["not told"].mean > 0.8


class Pair(gb.StateSpace):
    """Roll and yaw rates that are coupled, from two controls."""

    states = outputs = ("p", "r")
    inputs = ("lat", "ped")
    Lp = gb.Parameter(-3.0, bounds=(-12, 0))
    Lr = gb.Parameter(0.8, bounds=(-4, 4))
    Np = gb.Parameter(-0.5, bounds=(-4, 4))
    Nr = gb.Parameter(-1.0, bounds=(-5, 0))
    Llat = gb.Parameter(30.0, bounds=(0, 100))
    Nped = gb.Parameter(10.0, bounds=(0, 50))
    Nlat = gb.Parameter(-3.0, bounds=(-20, 20))

    def derivative(self, x, u, p):
        return p.Lp * x.p + p.Lr * x.r + p.Llat * u.lat, p.Np * x.p + p.Nr * x.r + (
            p.Nped * u.ped + p.Nlat * u.lat
        )

    def output(self, x, u, p):
        return x.p, x.r


def test_each_of_many_responses_has_a_share_of_the_parameters_only():
    """Given variances and white errors: intervals are nearly normal, as printed and in every quantity."""
    random, responses = np.random.default_rng(0), []
    omega = np.geomspace(0.5, 20, 20)
    for u, y in [(u, y) for u in Pair.inputs for y in Pair.outputs] * 3:
        exact = gb.frequency_response(Pair(), None, omega, input=u, output=y).response
        error = random.standard_normal((omega.size, 2)) @ [1, 1j] * 0.05 / np.sqrt(2)
        variance = (0.05 * np.abs(exact)) ** 2
        data = gb.FrequencyResponse(omega, exact * (1 + error), u, y, variance=variance)
        responses.append(gb.Problem(Pair(), data, gb.MaximumLikelihood()))
    fit = gb.fit(sum(responses[1:], responses[0]), starts=[{}], progress=False)
    assert not said(fit)
    # With the directions of all parameters taken from each response, 5.6 and 8.9.
    assert fit.dof == min(q.dof for q in fit.quantities) > 30


def lateral_responses(values, omega):
    """Return the ten responses (10, n) of `Lateral`, by input and output."""
    Yb, Lb, Lp, Lr, Nb, Np, Nr, La, Nd, Yd = values
    A = np.array([[Yb, 0, -1, 0.25], [Lb, Lp, Lr, 0], [Nb, Np, Nr, 0], [0, 1, 0, 0]])
    B = np.array([[0, Yd], [La, 0], [0, Nd], [0, 0]])
    C = np.vstack([np.eye(4), [40 / PAPER_G * Yb, 0, 0, 0]])
    D = np.zeros((5, 2))
    D[4, 1] = 40 / PAPER_G * Yd
    G = [C @ np.linalg.solve(1j * w * np.eye(4) - A, B) + D for w in omega]
    return np.reshape(np.transpose(G), (10, -1))


def test_standard_errors_of_many_responses_with_white_errors_are_those_of_the_information():
    """Given variances: beside the inverse information by differences."""
    names, omega = [*LATERAL], np.geomspace(0.5, 20, 16)
    truth = np.array([*LATERAL.values()])
    exact = lateral_responses(truth, omega)
    deviation = 0.05 * np.abs(exact)
    moved = [
        (lateral_responses(truth + h, omega) - lateral_responses(truth - h, omega)) / (2 * h.sum())
        for h in np.diag(1e-6 * np.abs(truth))
    ]
    J = np.array([(slope / deviation).ravel() for slope in moved])
    wanted = np.sqrt(np.diag(np.linalg.inv(2 * (J @ J.conj().T).real)))
    pairs = [(u, y) for u in Lateral.inputs for y in Lateral.outputs]
    ratios = []
    for seed in range(4):
        errors = np.random.default_rng(seed).normal(size=(*exact.shape, 2)) @ [1, 1j] / np.sqrt(2)
        data = [
            gb.FrequencyResponse(omega, G, u, y, variance=size**2)
            for (u, y), G, size in zip(pairs, exact + deviation * errors, deviation, strict=True)
        ]
        problem = gb.several(Lateral(), data, criterion=gb.MaximumLikelihood())
        fit = gb.fit(problem, starts=[LATERAL], profiles=False, progress=False)
        ratios.append([fit.standard_error[name] for name in names] / wanted)
    # Residuals that exceed the given variances of a response by chance widen them by 1.04 in the
    # mean. Where each response is judged by itself, the mean is 1.25.
    assert 0.98 < np.mean(ratios) < 1.1


class Product(gb.TransferFunction):
    """A lag whose gain is a product, of which the data determine no factor."""

    input, output = "u", "y"
    a = gb.Parameter(1.0, bounds=(0, 10))
    b = gb.Parameter(1.0, bounds=(0, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5))

    def response(self, s, p):
        return p.a * p.b / (p.T * s + 1)


def test_the_widening_is_that_of_the_parameters_with_a_standard_error():
    random, s = np.random.default_rng(0), 1j * np.geomspace(0.3, 30, 25)
    errors = np.convolve(random.normal(size=(40, 2)) @ [1, 1j], np.ones(8) / 3, "valid")[:25]
    data = gb.FrequencyResponse(s.imag, 2 / (0.4 * s + 1) * (1 + 0.05 * errors), "u", "y")
    fit = gb.fit(gb.Problem(Product(), data), starts=3, progress=False, profiles=False)
    errors_of = fit.standard_error
    assert np.isnan(errors_of["a"])
    place = fit.free.index("T")
    alone = np.sqrt(fit.independent[0][place, place])
    assert fit.inflation == pytest.approx((errors_of["T"] / alone) ** 2)
    assert "nan" not in str(fit)
