"""Errors correlated along frequency: how often it is said, of independent errors and of correlated ones."""

import numpy as np
import pytest
from scipy.stats import beta

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.estimate.diagnostics.frequency_correlation import chance_of_more, lag_one_correlation
from greybox.validation.nested_models import cost_scale, with_independent_errors

OMEGA = np.geomspace(0.5, 40, 25)


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


@pytest.mark.parametrize(
    "criterion", [gb.RelativeError(), gb.MaximumLikelihood(), gb.MagnitudePhase()], ids=str
)
def test_correlated_errors_are_said_and_independent_ones_not(criterion):
    assert (
        sum(said(fitted(0.0, criterion, seed)) for seed in range(12)) <= 1
    )  # of 1 %, twice has 0.6 %
    assert sum(said(fitted(0.8, criterion, seed)) for seed in range(6)) >= 5


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


def test_mean_and_variance_are_those_of_projected_noise():
    """Against 4000 draws with the parameters taken away by a projection."""
    rng = np.random.default_rng(0)
    n, p = 9, 4
    jacobian = rng.standard_normal((2 * n, p))
    basis, _ = np.linalg.qr(jacobian)
    draws = rng.standard_normal((4000, 2 * n))
    draws -= draws @ basis @ basis.T
    found = [lag_one_correlation(e[:n] + 1j * e[n:], jacobian) for e in draws]
    r, mean, variance = (np.array(column) for column in zip(*found, strict=True))
    assert mean[0] == pytest.approx(r.mean(), abs=4 * r.std() / np.sqrt(4000))
    assert variance[0] == pytest.approx(r.var(), rel=0.1)
    chances = [chance_of_more(*one) for one in found]
    for share in (0.01, 0.05, 0.5):
        assert np.mean(np.array(chances) < share) == pytest.approx(
            share, abs=3 * np.sqrt(share * (1 - share) / 4000)
        )


def test_too_few_residuals_say_nothing():
    assert lag_one_correlation(np.ones(3, complex), np.eye(6)[:, :3]) is None
    assert lag_one_correlation(np.zeros(9, complex), np.ones((18, 1))) is None


@pytest.mark.parametrize("criterion", [gb.RelativeError(), gb.MaximumLikelihood()], ids=str)
def test_the_correlation_that_is_said_is_that_of_residuals_over_their_sizes(criterion):
    """Less its mean for independent errors of which the parameters took a part; points are not in order."""
    random, order = np.random.default_rng(1), np.random.default_rng(0).permutation(25)
    exact = 2 / (0.3j * OMEGA + 1) * np.exp(-0.03j * OMEGA)
    e = np.cumsum(random.standard_normal(25) + 1j * random.standard_normal(25))
    deviation = 0.02 * np.abs(exact) * np.geomspace(1, 9, 25)
    data = gb.FrequencyResponse(
        OMEGA[order],
        (exact + deviation * e)[order],
        "u",
        "y",
        name="run",
        variance=2 * deviation[order] ** 2,
    )
    fit = gb.fit(
        gb.Problem(Lag(), data, criterion),
        starts=[{"K": 2.0, "tau": 0.3, "T": 0.03}],
        progress=False,
    )
    p = fit.estimate
    lag = 1 / (p["tau"] * 1j * OMEGA + 1)
    model = p["K"] * lag * np.exp(-1j * OMEGA * p["T"])
    measured = exact + deviation * e
    size = (
        deviation * np.sqrt(2) if isinstance(criterion, gb.MaximumLikelihood) else np.abs(measured)
    )
    left = (model - measured) / size
    slopes = (
        np.transpose([model / p["K"], -1j * OMEGA * lag * model, -1j * OMEGA * model])
        / size[:, None]
    )
    rows = np.vstack([slopes.real, slopes.imag])
    rest = np.eye(50) - rows @ np.linalg.pinv(rows)
    neighbors = np.kron(np.eye(2), (np.eye(25, k=1) + np.eye(25, k=-1)) / 2)
    r = np.sum((left[1:] * left[:-1].conj()).real) / np.sum(np.abs(left) ** 2)
    mean = np.trace(rest @ neighbors) / 47
    (text,) = [text for text in fit.warnings if "correlated along frequency" in text]
    assert text.startswith(
        f"the residuals of 'run' are correlated along frequency ({r - mean:.2f} from one point to"
    )


@pytest.mark.parametrize(("parameters", "is_told"), [(4, True), (5, False)])
def test_four_residuals_must_be_left(parameters, is_told):
    random = np.random.default_rng(0)
    residuals = random.normal(size=4) + 1j * random.normal(size=4)
    found = lag_one_correlation(
        residuals, np.hstack([random.normal(size=(8, parameters)), np.zeros((8, 1))])
    )
    assert (found is not None) == is_told


def test_the_answer_says_that_the_standard_errors_account_for_it_or_are_rough():
    (told,) = [
        t for t in fitted(0.6, gb.RelativeError(), 1, n=60).warnings if "along frequency" in t
    ]
    assert told.endswith("the standard errors account for that.")
    (rough,) = [
        t for t in fitted(0.9, gb.RelativeError(), 3, n=12).warnings if "along frequency" in t
    ]
    assert rough.endswith("and the standard errors are rough.")


def test_what_follows_from_the_covariance_is_as_wide():
    """Profiles and replicates, of errors that are correlated: as intervals by the standard errors, or nearly."""
    fit = fitted(0.6, gb.SquaredRelativeError(), 1, n=60)
    alone = with_independent_errors(fit)
    assert "; correlated along frequency like the residuals" in str(fit)
    assert "along frequency" not in str(alone).partition("warning:")[0]
    widened = np.sqrt(np.diag(fit.covariance) / np.diag(alone.covariance))
    assert np.all(widened > 1.4)
    low, high = gb.profile(fit, ["K"]).intervals["K"]
    wald = fit.interval()["K"]
    assert high - low == pytest.approx(wald[1] - wald[0], rel=0.1)
    drawn = gb.bootstrap(fit, "parametric", 400, progress=False)
    assert "with their correlation along frequency" in drawn.about
    assert drawn.standard_error["K"] == pytest.approx(fit.standard_error["K"], rel=0.15)
    small = gb.fit(
        gb.Problem(
            Lag(),
            fit.responses[0].data,
            gb.SquaredRelativeError(),
            fixed={"tau": fit.estimate["tau"] * 1.02},
        ),
        starts=[{"K": 2.0, "T": 0.03}],
        progress=False,
    )
    ratio = (
        gb.validation.nested_test(small, fit).scale / gb.validation.nested_test(small, alone).scale
    )
    assert ratio == pytest.approx(widened[1] ** 2, rel=1e-6)
    assert cost_scale(fit) > widened.min() ** 2 * cost_scale(alone)
    assert fit.dof < alone.dof == 2 * 60 - 3


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
    assert found["told"] is None
    assert found["not told"].mean > 0.8


@pytest.mark.parametrize(("a", "b"), [(3.0, 5.0), (7.5, 2.0)])
def test_the_chance_is_that_of_the_beta_distribution_with_this_mean_and_variance(a, b):
    """On [-1, 1]: twice the standard one less one."""
    mean, variance = 2 * a / (a + b) - 1, 4 * a * b / ((a + b) ** 2 * (a + b + 1))
    for r in (-0.4, 0.1, 0.7):
        assert chance_of_more(r, mean, variance) == pytest.approx(beta.sf((1 + r) / 2, a, b))


def test_mean_and_variance_are_those_of_durbin_and_watson_by_dense_matrices():
    random = np.random.default_rng(5)
    n, p = 7, 3
    jacobian = random.normal(size=(2 * n, p))
    rest = np.eye(2 * n) - jacobian @ np.linalg.pinv(jacobian)
    neighbors = np.kron(np.eye(2), (np.eye(n, k=1) + np.eye(n, k=-1)) / 2)
    z = random.normal(size=2 * n)
    r, mean, variance = lag_one_correlation(
        z[:n] + 1j * z[n:], np.column_stack([jacobian, jacobian[:, 0] * 2])
    )
    turned, k = rest @ neighbors, 2 * n - p
    assert r == pytest.approx(z @ neighbors @ z / (z @ z))
    assert mean == pytest.approx(np.trace(turned) / k)
    assert variance == pytest.approx(
        2 * (np.trace(turned @ turned) - np.trace(turned) ** 2 / k) / (k * (k + 2))
    )
