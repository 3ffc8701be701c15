"""Standard errors against numpy by hand, against scipy, against an equivalent problem, and by Monte Carlo."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from benchmark_module import benchmark
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose
from scipy.optimize import curve_fit
from scipy.stats import binom, t

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.covariance.accuracy import Accuracy, degrees, propagate
from greybox.engine.covariance.active_limits import determined_directions
from greybox.engine.covariance.combinations import collinear_groups, invisible_groups
from greybox.engine.covariance.covariance import accuracy_at, directions_beside, known_directions
from greybox.models.rotor import Rotor
from greybox.models.tilt import PAPER_G, Tilt

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(1, 60, 20)
ROTOR_OMEGA = np.array([30.28, 20.11, 16.01, 12.03, 8.00, 5.34, 4.00, 3.50, 3.00])
ROTOR = {"K_Omega": 1033.0, "T_rotor": 0.048, "T_delay": 0.0042}
TILT = {"a1": -14.61, "a2": 2.97, "a3": 83.06 / PAPER_G, "a4": 295.5}
LAGS = {"K": 2.0, "T1": 0.4, "T2": 0.05, "T": 0.02}


@pytest.fixture(autouse=True)
def independent_errors(monkeypatch):
    """Take errors as independent, whatever the few residuals of a draw show: so do the formulas here."""
    monkeypatch.setattr(ResponsePart, "neighbors", lambda *_: None)


class Lags(gb.TransferFunction):
    r"""Two lags and a delay, $K e^{-s T} / ((T_1 s + 1)(T_2 s + 1))$."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.01, 100))
    T1 = gb.Parameter(0.4, bounds=(0.001, 10), unit="s")
    T2 = gb.Parameter(0.05, bounds=(0.001, 10), unit="s")
    T = gb.Parameter(0.02, bounds=(0, 0.2), unit="s")
    derived = {"ratio": lambda p: p.T1 / p.T2}

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) * gb.exp(-s * p.T)


class LagsInMilliseconds(gb.TransferFunction):
    """The same, the delay in another unit."""

    input, output = "u", "y"
    K, T1, T2 = Lags.K, Lags.T1, Lags.T2
    T = gb.Parameter(20.0, bounds=(0, 200), unit="ms")

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) * gb.exp(-s * p.T / 1000)


class Product(gb.TransferFunction):
    """Two gains of which only the product is seen, and a parameter that does nothing."""

    input, output = "u", "y"
    K1 = gb.Parameter(1.0, bounds=(0.01, 100))
    K2 = gb.Parameter(2.0, bounds=(0.01, 100))
    idle = gb.Parameter(0.5, bounds=(0, 1))
    T1, T2, T = Lags.T1, Lags.T2, Lags.T
    derived = {"K": lambda p: p.K1 * p.K2, "quotient": lambda p: p.K1 / p.K2}

    def response(self, s, p):
        return p.K1 * p.K2 / ((p.T1 * s + 1) * (p.T2 * s + 1)) * gb.exp(-s * p.T)


def measured(model, omega, truth, noise, seed=0, variance=False, coherence=None):
    """Noisy data with the exact relative variances, where they are asked for."""
    random = np.random.default_rng(seed)
    exact = gb.frequency_response(model, truth, omega).response
    size = noise * (np.geomspace(0.5, 2, omega.size) if variance else np.ones(omega.size))
    response = exact * (
        1 + size * (random.normal(size=omega.size) + 1j * random.normal(size=omega.size))
    )
    return gb.FrequencyResponse(
        omega,
        response,
        input="u",
        output=model.output_names[0],
        variance=2 * (size * np.abs(exact)) ** 2 if variance else None,
        coherence=coherence,
    )


def fitted(problem, truth=None):
    start = {
        name: (truth or {}).get(name, p.start)
        for name, p in problem.parameters.items()
        if not p.fixed
    }
    return gb.fit(problem, starts=[start], progress=False, profiles=False)


def response_of(model, omega, names, others=None):
    """The response as a function of a parameter vector, by numpy."""
    return lambda x: (
        gb.frequency_response(
            model, {**(others or {}), **dict(zip(names, x, strict=True))}, omega
        ).response
    )


def stacked(values):
    return np.concatenate([values.real, values.imag])


def vector(fit, names):
    return np.array([fit.estimate[name] for name in names])


def relative_jacobian(fit, model, data, names=None):
    """Jacobian of the relative residuals by finite differences, (2n, p)."""
    names = names or fit.free
    function = response_of(
        model, data.omega, names, {n: v for n, v in fit.estimate.items() if n not in names}
    )
    return numeric_jacobian(
        lambda x: stacked(function(x) / np.abs(data.response)), vector(fit, names)
    )


def same_covariance(actual, desired, rtol=1e-5):
    """Equal, each element relative to the two standard errors: covariances may vanish."""
    errors = np.sqrt(np.diag(desired))
    assert_allclose(
        actual / np.outer(errors, errors), desired / np.outer(errors, errors), rtol=0, atol=rtol
    )


def same_errors(fit, other, names, rtol=1e-6):
    assert_allclose(
        [fit.standard_error[n] for n in names],
        [other.standard_error[n] for n in names],
        rtol=rtol,
        err_msg=str(names),
    )


SMALL = 1e-4  # noise of which relative criteria make what the linear theory says

# --- each criterion, computed by other means


@pytest.mark.parametrize(
    ("model", "truth", "omega"),
    [(Lags(), LAGS, OMEGA), (Tilt(), TILT, OMEGA), (Rotor(), ROTOR, ROTOR_OMEGA)],
)
def test_relative_error_has_four_over_pi_s_squared(model, truth, omega):
    data = measured(model, omega, truth, SMALL)
    fit = fitted(gb.Problem(model, data), truth)
    n, p = len(data), len(fit.free)
    error = np.abs(fit.parts[0].response - data.response) / np.abs(data.response)
    s = error.mean() * math.sqrt(2 / math.pi) / (1 - p / (math.pi * n))
    j = relative_jacobian(fit, model, data)
    same_covariance(
        fit.covariance_of(fit.free), 4 / math.pi * s**2 * np.linalg.inv(j.T @ j), rtol=1e-3
    )
    assert fit.dof == 2 * n - p


def test_relative_error_over_the_model_magnitude():
    data = measured(Lags(), OMEGA, LAGS, SMALL)
    fit = fitted(gb.Problem(Lags(), data, criterion=gb.RelativeError(normalized="model")))
    magnitude = np.abs(fit.parts[0].response)
    error = np.abs(fit.parts[0].response - data.response) / magnitude
    j = (
        relative_jacobian(fit, Lags(), data)
        * np.tile(np.abs(data.response) / magnitude, 2)[:, None]
    )
    s = error.mean() * math.sqrt(2 / math.pi) / (1 - 4 / (math.pi * len(error)))
    same_covariance(
        fit.covariance_of(fit.free), 4 / math.pi * s**2 * np.linalg.inv(j.T @ j), rtol=1e-3
    )


def test_intervals_of_relative_criteria_are_about_what_the_likelihood_finds():
    data = measured(Lags(), np.geomspace(1, 60, 60), LAGS, 0.2)
    unbiased = fitted(gb.Problem(Lags(), data, criterion=gb.RelativeLikelihood()), LAGS)
    unbiased_profile = gb.profile(unbiased, "K")["K"]
    center, error = np.mean(unbiased.interval()["K"]), unbiased.standard_error["K"]
    assert center == pytest.approx(unbiased.estimate["K"])
    for normalized, side in (("measured", -1), ("model", 1)):
        fit = fitted(
            gb.Problem(Lags(), data, criterion=gb.SquaredRelativeError(normalized=normalized)), LAGS
        )
        assert side * (fit.estimate["K"] - center) > error
        assert np.mean(fit.interval()["K"]) == pytest.approx(center, abs=0.5 * error)
        if side < 0:
            profile = gb.profile(fit, "K")["K"]
            assert_allclose(profile.interval, unbiased_profile.interval, atol=0.8 * error)
        assert f"bias by the noise (K {'+' if side < 0 else '-'}0." in str(fit)
        band = fit.response_band(np.array([1.0]))
        truth = gb.frequency_response(Lags(), unbiased.estimate, [1.0]).response
        assert np.sqrt(band.magnitude[0] * band.magnitude[1]) == pytest.approx(
            np.abs(truth), rel=0.5 * error / center
        )


@pytest.mark.parametrize("criterion", [gb.SquaredRelativeError(), gb.MaximumLikelihood()])
def test_least_squares_agree_with_scipy(criterion):
    data = measured(Lags(), OMEGA, LAGS, SMALL, variance=True)
    fit = fitted(gb.Problem(Lags(), data, criterion=criterion))
    known = isinstance(criterion, gb.MaximumLikelihood)
    sigma = np.sqrt(data.variance / 2) if known else np.abs(data.response)
    function = response_of(Lags(), OMEGA, fit.free)
    estimate, covariance = curve_fit(
        lambda _, *x: stacked(function(x)),
        np.arange(2 * OMEGA.size),
        stacked(data.response),
        p0=list(LAGS.values()),
        sigma=np.tile(sigma, 2),
        absolute_sigma=known,
        method="trf",
        jac="3-point",
        x_scale=list(LAGS.values()),
        xtol=1e-13,
        ftol=1e-13,
        gtol=1e-13,
    )
    errors = np.sqrt(np.diag(covariance))
    assert_allclose(vector(fit, fit.free), estimate, atol=1e-3 * errors.min(), rtol=0)
    same_covariance(fit.covariance_of(fit.free), covariance, rtol=1e-3)
    assert fit.dof == (math.inf if known else 2 * OMEGA.size - 4)


@pytest.mark.parametrize("given", [False, True])
def test_magnitude_phase_sandwich_by_hand(given):
    coherence = np.linspace(0.99, 0.6, OMEGA.size)
    data = measured(Lags(), OMEGA, LAGS, 0.03, variance=given, coherence=coherence)
    fit = fitted(gb.Problem(Lags(), data, criterion=gb.MagnitudePhase()))
    function = response_of(Lags(), OMEGA, fit.free)

    def logarithm(x):  # magnitude in dB, phase error in degrees
        ratio = function(x) / data.response
        return np.concatenate([20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))])

    x = vector(fit, fit.free)
    weight = 20 / OMEGA.size * (1.58 * (1 - np.exp(-coherence))) ** 2
    weights = np.concatenate([weight, 0.01745 * weight])
    assert_allclose(fit.cost, weights @ logarithm(x) ** 2, rtol=1e-9)
    j = numeric_jacobian(logarithm, x)
    units = np.repeat([20 / math.log(10), 180 / math.pi], OMEGA.size)
    if given:
        s2 = np.tile(data.variance / 2 / np.abs(data.response) ** 2, 2)
    else:
        # Random errors of a spectral estimate, scaled by the weighted residuals.
        shape = (1 - coherence) / coherence
        squares = ((logarithm(x) / units) ** 2).reshape(2, -1).sum(axis=0)
        s2 = np.tile(shape / 2 * (weight @ squares) / (weight @ shape) * 40 / (40 - 4), 2)
    bread = np.linalg.inv(j.T @ (weights[:, None] * j))
    meat = j.T @ ((weights**2 * s2 * units**2)[:, None] * j)
    same_covariance(fit.covariance_of(fit.free), bread @ meat @ bread)


# --- what the data do not determine


def test_a_dead_parameter_has_no_error_and_is_named():
    data = measured(Lags(), OMEGA, LAGS, 0.02)
    fit = fitted(gb.Problem(Product(), data, fixed={"K1": 1.0}))
    assert math.isnan(fit.standard_error["idle"])
    assert all(math.isnan(end) for end in fit.interval()["idle"])
    assert np.isnan(fit.covariance_of(["idle"])).all()
    assert any(w.startswith("idle is not determined") for w in fit.warnings)
    same_errors(
        fit,
        fitted(gb.Problem(Product(), data, fixed={"K1": 1.0, "idle": 0.5})),
        ["K2", "T1", "T2", "T"],
        0.02,
    )


def test_a_product_has_an_error_where_its_factors_have_none():
    data = measured(Lags(), OMEGA, LAGS, 0.02)
    fit = fitted(gb.Problem(Product(), data, fixed={"idle": 0.5}))
    whole = fitted(gb.Problem(Lags(), data))
    assert math.isnan(fit.standard_error["K1"])
    assert math.isnan(fit.standard_error["K2"])
    assert math.isnan(fit.standard_error["quotient"])
    assert any("K1" in w and "K2" in w and "combination" in w for w in fit.warnings)
    assert_allclose(fit.derived["K"], whole.estimate["K"], rtol=1e-5)
    same_errors(fit, whole, ["K", "T1", "T2", "T"], 0.02)


def test_fewer_numbers_than_unknowns_leave_no_errors():
    fit = fitted(gb.Problem(Lags(), measured(Lags(), OMEGA[:1], LAGS, 0.02)))
    assert all(math.isnan(error) for error in fit.standard_error.values())
    assert any("2 real numbers of data for 4 unknowns" in w for w in fit.warnings)


def at_bound():
    """Data with an advance, so that the delay ends at zero, and the fit with and without it."""
    data = measured(Lags(), OMEGA, LAGS | {"T": -0.01}, 0.02)
    return fitted(gb.Problem(Lags(), data)), fitted(gb.Problem(Lags(), data, fixed={"T": 0.0}))


def test_a_parameter_at_its_bound_counts_as_fixed_there():
    free, fixed = at_bound()
    assert [q.name for q in free.quantities if q.at_bound] == ["T"]
    assert math.isnan(free.standard_error["T"])
    assert any("T ended at its lower bound" in w for w in free.warnings)
    assert_allclose(vector(free, ["K", "T1", "T2"]), vector(fixed, ["K", "T1", "T2"]), rtol=1e-4)
    same_errors(free, fixed, ["K", "T1", "T2", "ratio"], 0.02)


@pytest.mark.parametrize("high", [1e2, 1e12])
def test_a_wide_box_puts_no_parameter_at_its_bound(high):
    class Wide(gb.TransferFunction):
        input, output = "u", "y"
        K = gb.Parameter(1.0, bounds=(0.1, high))
        T = gb.Parameter(1.0, bounds=(0.1, high))

        def response(self, s, p):
            return p.K / (p.T * s + 1)

    time = np.arange(400) * 0.1
    u = np.sign(np.sin(0.5 * time))
    flown = gb.simulate(Wide(), {"K": 1.48, "T": 2.0}, gb.Record(time, {"u": u}), inputs="held")
    noisy = flown["y"] + 0.02 * np.random.default_rng(1).normal(size=400)
    problem = gb.Problem(
        Wide(), gb.Record(time, {"u": u, "y": noisy}), gb.OutputError(inputs="held")
    )
    fit = gb.fit(problem, starts=[{}], progress=False)
    assert fit.estimate["K"] == pytest.approx(1.48, rel=0.05)
    assert not any(q.at_bound for q in fit.quantities)
    assert all(0 < error < 0.1 for error in fit.standard_error.values())


@pytest.mark.parametrize("off", [0.0, 1e-12, 2e-5])
def test_a_parameter_that_a_solver_leaves_just_off_its_bound_is_at_it(off):
    free, fixed = at_bound()
    nlp = compile_problem(gb.Problem(Lags(), free.parts[0].data))
    x = np.array([free.estimate[name] for name in nlp.free])
    x[nlp.free.index("T")] = off * 0.05  # of the delay's upper bound
    accuracy = accuracy_at(
        nlp, x, [part.trajectory(nlp.scaling.to_solver(x)) for part in nlp.parts]
    )
    assert accuracy.at_bound == ("T",)
    k = nlp.free.index("K")
    assert np.sqrt(accuracy.covariance[k, k]) == pytest.approx(fixed.standard_error["K"], rel=0.02)


def constrained():
    """The fit with an active constraint, and the equivalent one with a tie."""
    data = measured(Lags(), OMEGA, LAGS, 0.02)
    return (
        fitted(gb.Problem(Lags(), data, constraints=[lambda p: p.T1 - 9 * p.T2])),
        fitted(gb.Problem(Lags(), data, tied={"T1": lambda p: 9 * p.T2})),
    )


def test_an_active_constraint_equals_a_tie():
    free, tied = constrained()
    assert_allclose(free.estimate["T1"], 9 * free.estimate["T2"], rtol=1e-5)
    assert_allclose(free.standard_error["T1"], 9 * free.standard_error["T2"], rtol=1e-4)
    same_errors(free, tied, ["K", "T1", "T2", "T"], 0.02)


@pytest.mark.parametrize("pair", [at_bound, constrained])
def test_degrees_of_freedom_count_what_the_data_choose(pair):
    one, other = pair()
    assert one.dof == other.dof
    same_errors(one, other, ["K", "T2"], 1e-4)


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.SquaredRelativeError()])
@pytest.mark.parametrize("weights", [(1.0, 1.0), (25.0, 0.04)])
def test_the_collinearity_index_is_that_of_the_weighted_jacobian(weights, criterion):
    """Brun and others, by the singular values of the columns of length one; over both parts, as the costs weigh them.

    The sum of absolute values weighs a part by the inverse of its noise.
    """
    parts = [
        measured(Lags(), omega, LAGS, noise)
        for omega, noise in ((np.geomspace(0.05, 0.3, 12), 0.2), (np.geomspace(0.5, 3, 8), 0.4))
    ]
    both = [gb.Problem(Lags(), d, criterion, weight=w) for d, w in zip(parts, weights, strict=True)]
    accuracy = accuracy_at(compile_problem(both[0] + both[1]), np.array(list(LAGS.values())))
    point = SimpleNamespace(free=list(LAGS), estimate=LAGS)
    rows = []
    for data, weight in zip(parts, weights, strict=True):
        curvature, _ = criterion.spread(
            gb.frequency_response(Lags(), LAGS, data.omega).response, data, 1.0
        )
        share = weight * curvature
        rows.append(math.sqrt(share) * relative_jacobian(point, Lags(), data))
    j = np.vstack(rows)
    smallest = np.linalg.svd(j / np.linalg.norm(j, axis=0))[1][-1]
    (combination,) = accuracy.combinations
    assert combination.index == pytest.approx(1 / smallest, rel=1e-4)
    assert 20 < combination.index < 1e4


@pytest.mark.parametrize(("stated", "widened"), [(16.0, False), (1 / 16, True)])
def test_stated_variances_hold_unless_the_residuals_are_larger(stated, widened):
    """As scipy's curve_fit with absolute deviations, and with those that the residuals scale."""
    honest = measured(Lags(), OMEGA, LAGS, 0.03, variance=True)
    data = replace(honest, variance=stated * honest.variance)
    fit = fitted(gb.Problem(Lags(), data, criterion=gb.MaximumLikelihood()))
    function = response_of(Lags(), OMEGA, fit.free)
    _, covariance = curve_fit(
        lambda _, *x: stacked(function(x)),
        np.arange(2 * OMEGA.size),
        stacked(data.response),
        p0=vector(fit, fit.free),
        sigma=np.tile(np.sqrt(data.variance / 2), 2),
        absolute_sigma=not widened,
        x_scale=list(LAGS.values()),
        method="trf",
        jac="3-point",
        xtol=1e-13,
    )
    same_covariance(fit.covariance_of(fit.free), covariance, 1e-4)


def responses_with_their_own_gains(stated):
    """Return a fit of responses with given variances; the share by which each is stated."""
    data = [measured(Lags(), OMEGA, LAGS, 0.03, k, variance=True) for k in range(len(stated))]
    problems = [
        gb.Problem(
            Lags(),
            replace(d, variance=factor * d.variance, name=f"flight {k}"),
            gb.MaximumLikelihood(),
            rename={"K": f"K_{k}"},
        )
        for k, (d, factor) in enumerate(zip(data, stated, strict=True))
    ]
    return fitted(sum(problems[1:], problems[0]), {f"K_{k}": 2.0 for k in range(len(stated))})


def test_responses_show_together_whether_their_variances_are_too_small():
    """Each by itself seems up to 1.4 times as noisy as given, by chance; one is in the second fit."""
    given = responses_with_their_own_gains([1.0] * 8)
    function = response_of(Lags(), OMEGA, list(LAGS))
    relative = np.tile(np.geomspace(0.5, 2, OMEGA.size) * 0.03, 2)
    rows = []
    for k in range(8):
        x = np.array([given.estimate[n] for n in (f"K_{k}", "T1", "T2", "T")])
        size = relative * np.tile(np.abs(function(np.array(list(LAGS.values())))), 2)
        slope = numeric_jacobian(lambda x: stacked(function(x)), x) / size[:, None]
        rows.append(np.hstack([slope[:, :1] * (np.arange(8) == k), slope[:, 1:]]))
    names = [*(f"K_{k}" for k in range(8)), "T1", "T2", "T"]
    by_hand = np.sqrt(np.diag(np.linalg.inv(sum(row.T @ row for row in rows))))
    errors = np.array([given.standard_error[n] for n in names])
    assert_allclose(errors, by_hand, rtol=0.05)

    doubted = responses_with_their_own_gains([1.0] * 7 + [1 / 9])
    wider = np.array([doubted.standard_error[n] for n in names]) / errors
    # The last one's own gain has the error of its residuals, which are three times as large as stated.
    assert np.all((wider[:8] > 0.9) & (wider[:8] < 1.4))


def test_an_inactive_constraint_changes_nothing():
    data = measured(Lags(), OMEGA, LAGS, 0.02)
    plain = fitted(gb.Problem(Lags(), data))
    same_errors(
        fitted(gb.Problem(Lags(), data, constraints=[lambda p: p.T1 - p.T2])),
        plain,
        plain.free,
        1e-4,
    )


# --- invariances


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MagnitudePhase()])
def test_the_scale_of_all_weights_changes_nothing(criterion):
    data = [measured(Lags(), OMEGA, LAGS, noise, seed) for seed, noise in ((0, 0.02), (1, 0.05))]
    one, other = (
        fitted(
            sum(
                gb.Problem(Lags(), d, criterion=criterion, weight=w)
                for d, w in zip(data, weights, strict=True)
            )
        )
        for weights in ((1.0, 0.4), (7.0, 2.8))
    )
    same_errors(one, other, one.free, 1e-4)


def test_each_part_of_a_sum_has_its_own_noise():
    """A part of a sum is judged by its own noise: the noisier one has the smaller share of the information."""
    data = [measured(Lags(), OMEGA, LAGS, noise, seed) for seed, noise in ((0, 0.01), (1, 0.08))]
    problem = sum(gb.Problem(Lags(), d) for d in data)
    fit = fitted(problem)
    bread, meat = 0, 0
    for part, d in zip(fit.parts, data, strict=True):
        error = np.abs(part.response - d.response) / np.abs(d.response)
        s = error.mean() * math.sqrt(2 / math.pi) * math.sqrt(80 / 76)
        j = relative_jacobian(fit, Lags(), d)
        bread = bread + 0.5 * math.sqrt(math.pi / 2) / s * j.T @ j
        meat = meat + 0.5 * j.T @ j
    expected = np.linalg.inv(bread) @ meat @ np.linalg.inv(bread)
    same_covariance(fit.covariance_of(fit.free), expected, 0.1)


def independent_parts():
    """Two parts of different length that share no parameter, solved together and alone."""
    few = gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR, 0.02))
    many = gb.Problem(Lags(), measured(Lags(), np.geomspace(1, 60, 60), LAGS, 0.05))
    return fitted(few + many), fitted(few), fitted(many)


def test_parts_that_share_nothing_have_the_errors_they_have_alone():
    both, few, many = independent_parts()
    same_errors(both, few, few.free, 1e-3)
    same_errors(both, many, many.free, 1e-3)


def test_parts_that_share_nothing_have_the_intervals_they_have_alone():
    both, few, many = independent_parts()
    for alone in (few, many):
        for name in alone.free:
            assert_allclose(both.interval()[name], alone.interval()[name], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MaximumLikelihood()])
def test_units_rescale_the_errors(criterion):
    data = measured(Lags(), OMEGA, LAGS, 0.02, variance=True)
    seconds = fitted(gb.Problem(Lags(), data, criterion=criterion))
    milliseconds = fitted(gb.Problem(LagsInMilliseconds(), data, criterion=criterion))
    assert_allclose(milliseconds.estimate["T"], 1000 * seconds.estimate["T"], rtol=1e-5)
    assert_allclose(milliseconds.standard_error["T"], 1000 * seconds.standard_error["T"], rtol=1e-5)
    same_errors(seconds, milliseconds, ["K", "T1", "T2"], 1e-5)


def test_at_the_same_point_units_rescale_the_errors_exactly():
    data = measured(Lags(), OMEGA, LAGS, 0.02)
    point = np.array(list(LAGS.values()))
    one = accuracy_at(compile_problem(gb.Problem(Lags(), data)), point)
    other = accuracy_at(
        compile_problem(gb.Problem(LagsInMilliseconds(), data)), point * [1, 1, 1, 1000]
    )
    scale = np.diag([1.0, 1.0, 1.0, 1000.0])
    same_covariance(other.covariance, scale @ one.covariance @ scale, 1e-9)
    assert_allclose(propagate(other, np.eye(4)), propagate(one, scale), rtol=1e-9)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_a_parameter_in_a_tiny_or_a_huge_unit_is_as_well_determined(size):
    class LagsInUnits(gb.TransferFunction):
        input, output = "u", "y"
        K, T1, T2 = Lags.K, Lags.T1, Lags.T2
        T = gb.Parameter(0.02 * size, bounds=(0, 0.2 * size))

        def response(self, s, p):
            return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) * gb.exp(-s * p.T / size)

    data = measured(Lags(), OMEGA, LAGS, 0.02)
    point = vector(fitted(gb.Problem(Lags(), data)), list(LAGS))
    one = accuracy_at(compile_problem(gb.Problem(Lags(), data)), point)
    other = accuracy_at(compile_problem(gb.Problem(LagsInUnits(), data)), point * [1, 1, 1, size])
    scale = np.diag([1.0, 1.0, 1.0, size])
    assert_allclose(propagate(other, np.eye(4)), propagate(one, scale), rtol=1e-6)


def test_derived_quantities_follow_the_covariance():
    data = measured(Lags(), OMEGA, LAGS, 0.02)
    fit = fitted(gb.Problem(Lags(), data))
    t1, t2 = fit.estimate["T1"], fit.estimate["T2"]
    gradient = np.array([1 / t2, -t1 / t2**2])
    variance = gradient @ fit.covariance_of(["T1", "T2"]) @ gradient
    assert_allclose(fit.standard_error["ratio"], math.sqrt(variance), rtol=1e-10)


def test_intervals_are_student_t():
    fit = fitted(gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR, 0.02)))
    low, high = fit.interval(level=0.9)["K_Omega"]
    assert_allclose((high - low) / 2 / fit.standard_error["K_Omega"], t.ppf(0.95, 15), rtol=1e-9)


# --- first one, then the rest


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.SquaredRelativeError()])
def test_an_earlier_fit_widens_the_errors(criterion):
    rotor = fitted(
        gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR, 0.02), criterion=criterion), ROTOR
    )
    data = measured(Tilt(), OMEGA, TILT, 0.005, seed=1)
    problem = gb.Problem(Tilt(), data, criterion=criterion, fixed=rotor)
    fit = fitted(problem, TILT)
    constants = {name: rotor.estimate[name] for name in ("T_rotor", "T_delay")}
    alone = fitted(problem.with_(fixed=constants), TILT)
    j, own = (
        relative_jacobian(fit, Tilt(), data),
        relative_jacobian(fit, Tilt(), data, tuple(constants)),
    )
    slope = -np.linalg.lstsq(j, own, rcond=None)[0]
    sigma = rotor.covariance_of(tuple(constants))
    same_covariance(
        fit.covariance_of(fit.free), alone.covariance_of(fit.free) + slope @ sigma @ slope.T
    )
    together = fit.covariance_of((*fit.free, *constants))
    assert_allclose(together[-2:, -2:], sigma)
    assert_allclose(together[:-2, -2:], slope @ sigma, rtol=1e-4)
    assert fit.standard_error["a4"] > 2 * alone.standard_error["a4"]
    same_errors(fit, rotor, constants)
    assert alone.standard_error["T_rotor"] == 0


def test_rotor_first_and_pitch_second_have_the_errors_of_both_together():
    """Pitch tells little of the rotor beside the data of the rotor, so that both ways know as much."""
    likelihood = gb.RelativeLikelihood()
    first = gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR, 0.01), likelihood)
    pitch = gb.Problem(
        Tilt(), measured(Tilt(), OMEGA, TILT, 0.05, seed=1), likelihood, free=("T_rotor", "T_delay")
    )
    rotor = fitted(first, ROTOR)
    joint = fitted(first + pitch, {**ROTOR, **TILT})
    second = fitted(pitch.with_(free=(), fixed=rotor), TILT)
    same_errors(second, joint, second.free, 0.05)


def test_an_earlier_fit_moves_the_estimate_as_its_errors_say():
    """The covariance of estimate and constant over the variance of the constant: the slope that refits show."""
    rotor = fitted(
        gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR, 0.02), fixed={"T_delay": 0.0042}),
        ROTOR,
    )
    problem = gb.Problem(
        Tilt(),
        measured(Tilt(), OMEGA, TILT, 1e-4),
        criterion=gb.SquaredRelativeError(),
        fixed=rotor,
    )
    fit = fitted(problem, TILT)
    middle, h = rotor.estimate["T_rotor"], 1e-4
    high, low = (
        fitted(problem.with_(fixed={"T_rotor": middle + d, "T_delay": 0.0042}), TILT)
        for d in (h, -h)
    )
    slope = (vector(high, fit.free) - vector(low, fit.free)) / (2 * h)
    together = fit.covariance_of((*fit.free, "T_rotor"))
    assert_allclose(together[:-1, -1] / together[-1, -1], slope, rtol=5e-2)


def test_an_earlier_fit_without_an_error_is_not_taken_as_exact():
    rotor = fitted(
        gb.Problem(Rotor(), measured(Rotor(), ROTOR_OMEGA, ROTOR | {"T_delay": -0.004}, 0.02)),
        ROTOR,
    )
    assert math.isnan(rotor.standard_error["T_delay"])  # at its bound
    fit = fitted(gb.Problem(Tilt(), measured(Tilt(), OMEGA, TILT, 0.005), fixed=rotor), TILT)
    assert math.isnan(fit.standard_error["T_delay"]) or any("T_delay" in w for w in fit.warnings)


# --- Monte Carlo: a reduced form of benchmarks/coverage.py


@pytest.fixture(scope="module")
def coverage():
    return benchmark("coverage")


@pytest.mark.parametrize(
    ("label", "criterion"),
    [
        ("rotor, 9 points, 2 % noise", "RelativeError"),
        ("lags, 40 points, 5 % noise", "MaximumLikelihood"),
        ("two-step, rotor 2 %, then tilt 5 %", "SquaredRelativeError"),
    ],
)
def test_intervals_hold_the_truth_as_often_as_they_say(coverage, label, criterion):
    """Coverage of every quantity between 92 and 97 %, up to what chance does once in 10 000."""
    repeats = 40
    case = next(case for case in coverage.cases() if case.label == label)
    outcome = coverage.cell(case, criterion, repeats, seed=5)
    assert outcome.difference < 1e-2  # the benchmark's quick way is that of gb.fit
    low, high = binom.ppf(1e-4, repeats, 0.92), binom.ppf(1 - 1e-4, repeats, 0.97)
    for name, share, _, missing, _, ratio in outcome.summary():
        assert missing == 0, name
        assert low <= round(share / 100 * repeats) <= high, f"{name}: {share} %"
        # Of 40 repeats the ratio is known to 11 %.
        assert 0.75 < ratio < 1.3, f"{name}: the printed error is {ratio:.2f} of the actual"


class Level(gb.StateSpace):
    """A constant in time."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("bounds", [(0.5, 10), (-0.5, 0.5)])
def test_a_mean_beyond_a_bound_is_at_it_and_one_within_is_not(bounds, side):
    """A mean of 40 numbers that scatter by 0.1, a tenth beyond the bound and within it."""
    n = 40
    noise = 0.1 * np.random.default_rng(2).normal(size=n)
    near, inward = (bounds[0], 1) if side < 0 else (bounds[1], -1)
    for shift, held in ((-0.1, True), (0.1, False)):
        y = near + inward * shift + noise - noise.mean()
        record = gb.Record(np.arange(n) / 10, {"u": np.ones(n), "y": y})
        fit = gb.fit(gb.Problem(Level(), record, bounds={"K": bounds}), starts=[{}], progress=False)
        (q,) = fit.quantities
        assert q.at_bound == held


def test_degrees_of_freedom_of_a_sum_of_variances_are_those_of_welch_and_satterthwaite():
    """Of two means of 6 and 21 values: (v1 + v2)² / (v1²/5 + v2²/20)."""
    accuracy = replace(
        BARE,
        shares=(
            (np.diag([0.04, 0.0, 0.0]), 5.0),
            (np.diag([0.01, 0.09, 0.0]), 20.0),
            (np.zeros((3, 3)), np.inf),
        ),
    )
    gradient = np.array([[1.0, 1.0, 0.0], [0.0, 2.0, 5.0], [0.0, 0.0, 1.0]])
    assert_allclose(
        degrees(accuracy, gradient), [0.14**2 / (0.04**2 / 5 + 0.1**2 / 20), 20.0, np.inf]
    )
    assert_allclose(degrees(BARE, gradient), 7.0)


BARE = Accuracy(
    nlp=SimpleNamespace(names=("a", "b", "c")),
    x=np.zeros(2),
    trajectories=(),
    covariance=np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 0.25]]),
    blind=np.zeros((3, 0)),
    size=np.array([1.0, 10.0, 0.1]),
    dof=7.0,
    shares=(),
    combinations=(),
    at_bound=(),
    active=(),
    bias=np.zeros(3),
    systematic=np.zeros((3, 0)),
)


def test_errors_follow_the_gradient_but_where_it_has_a_part_that_is_not_seen():
    gradient = np.array([[1.0, -2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 0.1, 0.0], [1.0, -0.1, 0.0]])
    errors = np.sqrt([4 - 4 + 36, 2.25, 4 + 0.2 + 0.09, 4 - 0.2 + 0.09])
    assert_allclose(propagate(BARE, gradient), errors)
    # A rise of both by as much, in multiples of their sizes, is not seen: a/1 less b/10 is.
    lost = replace(BARE, blind=np.array([[1.0], [1.0], [0.0]]) / np.sqrt(2))
    assert_allclose(propagate(lost, gradient), [np.nan, errors[1], np.nan, errors[3]])
    nearly = gradient[3:] + np.array(
        [[0.0, 1.9e-6, 0.0], [0.0, 4e-6, 0.0]]
    )  # a hundred thousandth of it counts as none
    assert np.isnan(propagate(lost, nearly)).tolist() == [False, True]


def test_values_are_known_by_their_derivatives_within_what_is_determined():
    slopes = np.array([[1.0, 0.0, 2.0], [0.0, 5.0, 0.0]])
    accuracy = replace(
        BARE,
        blind=np.array([[0.0, 0.0], [0.6, 0.0], [0.8, 0.0]]),
        shares=((np.eye(3), 1.0),),
        at_bound=("b",),
    )
    found = known_directions(accuracy, np.array([3.0, 4.0]), slopes)
    assert_allclose(found.covariance, slopes @ BARE.covariance @ slopes.T)
    scaled = slopes * BARE.size
    size = np.linalg.norm(scaled, axis=1)
    assert_allclose(found.size, size)
    assert_allclose(found.unseen, scaled @ [[0.0], [0.6], [0.8]] / size[:, None])
    assert found.at.tolist() == [3, 4]
    only_bound = replace(accuracy, blind=np.array([[0.0], [1.0], [0.0]]))
    assert known_directions(only_bound, np.zeros(2), slopes).unseen.shape == (
        2,
        0,
    )  # what ended at its bound is known
    assert (
        known_directions(
            replace(accuracy, covariance=BARE.covariance * np.nan), np.zeros(2), slopes
        )
        is None
    )


def test_directions_that_bounds_and_constraints_close_are_neither_seen_nor_invisible():
    """Of four unknowns the data see the sum of the first two and the third; the fourth is at a bound."""
    jacobian = np.array([[1.0, 1.0, 0.0, 2.0], [0.0, 0.0, 3.0, 1.0], [2.0, 2.0, 3.0, 0.0]])
    seen, invisible = determined_directions(jacobian, np.zeros((0, 4)), [3])
    assert (seen.shape, invisible.shape) == ((4, 2), (4, 1))
    assert_allclose(np.abs(invisible[:, 0]), [math.sqrt(0.5), math.sqrt(0.5), 0, 0], atol=1e-12)
    assert_allclose(seen.T @ seen, np.eye(2), atol=1e-12)
    assert_allclose(seen.T @ invisible, np.zeros((2, 1)), atol=1e-12)
    assert_allclose(seen[3], 0, atol=1e-12)
    seen, invisible = determined_directions(
        jacobian, np.array([[1.0, -1.0, 0.0, 0.0]]), [3]
    )  # with a constraint, equal ones
    assert (seen.shape, invisible.shape) == ((4, 2), (4, 0))
    assert_allclose(seen[0], seen[1], atol=1e-12)
    for share, unseen in ((2e-7, 0), (0.5e-7, 1)):
        assert determined_directions(np.diag([1.0, share]), np.zeros((0, 2)), [])[1].shape == (
            2,
            unseen,
        )


def test_invisible_directions_that_share_no_parameter_are_groups_of_their_own():
    """a with c in units of their sizes, b alone, and d not at all; states whose initial values make up for them."""
    mixed = np.array([[0.6, 0, 0.8, 0], [0, 1.0, 0, 0]]).T @ [[0.8, -0.6], [0.6, 0.8]]
    size = np.array([1.0, 10.0, 0.1, 1.0])
    follow = {"x": np.array([[0.0, 0.0, 1.0, 0.0]]), "v": np.array([[0.0, 1e-5, 0.0, 5.0]])}
    initial = [follow, {"z": np.array([[0.1, 0.0, 0.0, 0.0]])}]
    second, first = invisible_groups(mixed, size, ("a", "b", "c", "d"), initial)
    assert (first.names, first.index, first.directions, first.states) == (
        ("c", "a"),
        math.inf,
        1,
        ("x", "z"),
    )
    assert (second.names, second.directions, second.states) == (("b",), 1, ())
    both = np.linalg.qr(np.array([[1.0, 1, 1, 0], [1, -1, 0, 0]]).T)[0]
    (group,) = invisible_groups(both, size, ("a", "b", "c", "d"), ())
    assert (set(group.names), group.directions) == ({"a", "b", "c"}, 2)
    assert invisible_groups(np.zeros((4, 0)), size, ("a", "b", "c", "d"), ()) == ()


def columns(index):
    """Two columns whose collinearity index is this, and one at right angles to both."""
    angle = math.acos(1 - 1 / index**2)  # their smallest singular value squared is 1 - cos(angle)
    return np.array([[1.0, 0, 0], [math.cos(angle), math.sin(angle), 0], [0, 0, 1]]).T


@pytest.mark.parametrize(("index", "found"), [(20.5, True), (19.5, False), (1e4, True)])
def test_collinear_columns_are_named_from_an_index_of_twenty(index, found):
    nothing, unseen = np.zeros((0, 3)), np.zeros((3, 0))
    jacobian = columns(index) * [5.0, 1e3, 1e-4]  # units do not matter
    combinations = collinear_groups(jacobian, nothing, ("a", "b", "c"), (), unseen)
    assert [set(c.names) for c in combinations] == [{"a", "b"}] * found
    assert all(c.index == pytest.approx(index, rel=1e-4) for c in combinations)
    assert collinear_groups(jacobian, nothing, ("a", "b", "c"), ("b",), unseen) == ()
    held = np.array([[0.0, 1.0, 0.0]])  # a constraint that says what b is
    assert collinear_groups(jacobian, held, ("a", "b", "c"), (), unseen) == ()
    same = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    difference = np.array([[1.0, -1.0, 0.0]]).T / math.sqrt(2)
    assert (
        collinear_groups(same, nothing, ("a", "b", "c"), (), difference) == ()
    )  # said already: it is invisible
    assert len(collinear_groups(same, nothing, ("a", "b", "c"), (), unseen)) == 1


@pytest.mark.parametrize(
    ("share", "names"), [(1e-3, ("a", "b")), (1.2e-5, ("a", "b")), (0.8e-5, ("a",))]
)
def test_a_parameter_with_a_small_part_in_an_invisible_direction_is_named(share, names):
    direction = np.array([[1.0], [share], [0.0]])
    (group,) = invisible_groups(direction, np.ones(3), ("a", "b", "c"), [])
    assert group.names == names


class Plane(gb.StateSpace):
    """A plane over two regressors."""

    inputs, outputs = ("u", "w"), ("y",)
    a = gb.Parameter(1.0, bounds=(-10.0, 10.0))
    b = gb.Parameter(1.0, bounds=(-10.0, 10.0))

    def output(self, x, u, p):
        return (p.a * u.u + p.b * u.w,)


def test_an_unseen_direction_is_looked_at_again_beside_the_estimate():
    """Each value a tenth to a fifth of itself away, each by another share, to where its bounds leave more room."""
    problem = gb.Problem(Product(), measured(Lags(), OMEGA, LAGS, 0.02), fixed={"idle": 0.5})
    nlp = compile_problem(problem)
    for delay, moved in ((0.15, 0.15 * (1 - 0.18)), (0.0, 0.2 * 0.1 * 0.18)):
        x = np.array(
            [{"K1": 1.0, "K2": 2.0, "T1": 0.4, "T2": 0.05, "T": delay}[name] for name in nlp.free]
        )
        found = directions_beside(nlp, x, (), lambda _: ())
        share = 1 + 0.1 * (1 + np.arange(5) / 5)
        wanted = np.where(np.array(nlp.free) == "T", moved, x * share)
        assert nlp.free[-1] == "T"
        assert_allclose(found.at, wanted)
        assert found.unseen.shape[1] == 1
        # The product stays seen there too: its unseen direction is that of both logarithms apart.
        direction = found.unseen[:, 0] * found.size / wanted
        first, second = (direction[nlp.free.index(name)] for name in ("K1", "K2"))
        assert first == pytest.approx(-second, rel=1e-3)
    assert directions_beside(nlp, x, ("T",), lambda _: ()).at[-1] == x[-1]


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(
    ("away", "beyond", "held"),
    [
        (0.009, 1.0, True),  # as close as the data can tell, and pushed against the bound
        (0.011, 1.0, False),
        (0.009, 0.0111 - 0.009, True),  # by a hundredth of the deviation of the gradient
        (0.009, 0.0095 - 0.009, False),
        (0.009, -1.0, False),  # the minimum is inside
        (0.9e-7, -1.0, True),  # of the value itself: rounding
        (1.2e-7, -1.0, False),
    ],
)
def test_a_bound_holds_what_is_close_and_pushed_or_within_rounding(side, away, beyond, held):
    """`away` from the bound and the minimum `beyond` it, in standard errors."""
    random = np.random.default_rng(3)
    regressor, sigma, bound = random.normal(size=50) * 3, 0.4, 5.0 * side
    error = sigma / np.linalg.norm(regressor)
    unit = 5.0 if away < 1e-6 else error
    noise = random.normal(size=50)
    noise -= regressor * (regressor @ noise) / (regressor @ regressor)
    y = (bound + side * beyond * error) * regressor + sigma * noise
    record = gb.Record(np.arange(50.0), {"u": regressor, "w": np.zeros(50), "y": y}, has_time=False)
    bounds = (bound, 10.0) if side < 0 else (-10.0, bound)
    given = {"fixed": {"b": 0.0}, "bounds": {"a": bounds}}
    nlp = compile_problem(gb.Problem(Plane(), record, gb.OutputError(noise={"y": sigma}), **given))
    x = np.array([bound - side * away * unit])
    accuracy = accuracy_at(
        nlp, x, [part.trajectory(nlp.scaling.to_solver(x)) for part in nlp.parts]
    )
    assert accuracy.at_bound == (("a",) if held else ())


@pytest.mark.parametrize(("value", "held"), [(0.976, False), (2e-5, False), (1.0000001e-5, True)])
def test_on_a_logarithmic_scale_a_bound_is_as_far_as_its_ratio(value, held):
    """Of a parameter of which the data tell nothing within its bounds, and which they would lower."""

    class Scaled(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        c = gb.Parameter(1.0, bounds=(1e-5, 1e5), scale="log")

        def output(self, x, u, p):
            return (p.c * u.u,)

    random = np.random.default_rng(3)
    u = 1e-5 * random.normal(size=50)
    y = random.normal(size=50)
    y -= u * (u @ y) / (u @ u) + 0.5 * u / np.linalg.norm(u)  # c is half a standard error below 0
    record = gb.Record(np.arange(50.0), {"u": u, "y": y}, has_time=False)
    nlp = compile_problem(gb.Problem(Scaled(), record, gb.OutputError(noise={"y": 1.0})))
    x = np.array([value])
    accuracy = accuracy_at(
        nlp, x, [part.trajectory(nlp.scaling.to_solver(x)) for part in nlp.parts]
    )
    assert accuracy.at_bound == (("c",) if held else ())
