"""A-priori knowledge against the closed-form posterior of a linear normal problem, and against a joint fit."""

import json
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sampled_lag import SampledLag, lag_record
from unfolded import unfolded

import greybox as gb

X = np.arange(12.0)
SIGMA = 0.5
ONE = {"starts": [{}], "progress": False}


class Line(gb.StateSpace):
    """y = a + b x."""

    inputs, outputs = ("x",), ("y",)
    a = gb.Parameter(0.0)
    b = gb.Parameter(1.0)

    def output(self, x, u, p):
        return (p.a + p.b * u.x,)


class Informed(Line):
    """The same with what is known of a."""

    a = gb.Parameter(0.0, prior=(1.0, 0.3))


class Lag(gb.TransferFunction):
    """A gain and a lag."""

    K = gb.Parameter(2.0, bounds=(0.1, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")

    def response(self, s, p):
        return p.K / (p.T * s + 1)


PRECISION, MEAN = np.diag([1 / 0.3**2, 0]), np.array([1.0, 0.0])


def line(seed):
    """Rows whose residuals at the posterior have exactly the size given, so that no scale factor moves the errors."""
    design = np.column_stack([np.ones(X.size), X])
    information = design.T @ design / SIGMA**2
    covariance = np.linalg.inv(information + PRECISION)
    truth = np.array([1.3, 0.5])
    off = design @ (covariance @ (information @ truth + PRECISION @ MEAN) - truth)
    e = np.random.default_rng(seed).normal(size=X.size)
    e -= design @ np.linalg.lstsq(design, e, rcond=None)[0]
    left = X.size - np.trace(covariance @ information)
    e *= np.sqrt((SIGMA**2 * left - off @ off) / (e @ e))
    return gb.Record(X, {"x": X, "y": design @ truth + e}, has_time=False)


def responses(seed, omega):
    random = np.random.default_rng(seed)
    exact = 2 / (0.5j * omega + 1)
    error = (
        0.05
        * np.abs(exact)
        * (random.normal(size=omega.size) + 1j * random.normal(size=omega.size))
    )
    return gb.FrequencyResponse(
        omega, exact + error, "u", "y", variance=2 * (0.05 * np.abs(exact)) ** 2
    )


def posterior(record):
    """The mean and covariance of a and b in closed form."""
    design = np.column_stack([np.ones(len(record)), record["x"]])
    covariance = np.linalg.inv(design.T @ design / SIGMA**2 + PRECISION)
    return covariance @ (design.T @ record["y"] / SIGMA**2 + PRECISION @ MEAN), covariance


GIVEN = gb.OutputError(noise={"y": SIGMA})


@pytest.mark.parametrize(
    "problem",
    [
        lambda r: gb.Problem(Informed(), r, GIVEN),
        lambda r: gb.Problem(Line(), r, GIVEN, prior={"a": (1.0, 0.3)}),
        lambda r: gb.Problem(Informed(), r, GIVEN, rename={"a": "offset"}),
    ],
)
def test_the_posterior_of_a_line_is_the_closed_form(problem):
    record = line(0)
    fit = gb.fit(problem(record), **ONE)
    mean, covariance = posterior(record)
    assert_allclose(list(fit.estimate.values()), mean, rtol=1e-6)
    assert_allclose(fit.covariance, covariance, rtol=1e-3)
    share = covariance[0, 0] / 0.3**2
    assert_allclose(next(iter(fit.prior_share.values())), share, rtol=1e-6)
    assert "maximum a posteriori" in unfolded(fit)
    assert "1.00 ± 0.30" in unfolded(fit)


def test_a_fit_as_prior_is_the_fit_to_both():
    first, second = (
        responses(seed, np.geomspace(low, 10 * low, 20)) for seed, low in ((1, 0.2), (2, 1.0))
    )
    one, other = (gb.Problem(Lag(), data, gb.MaximumLikelihood()) for data in (first, second))
    both, before = gb.fit(one + other, **ONE), gb.fit(one, **ONE)
    after = gb.fit(other.with_(prior=before), **ONE)
    for name in ("K", "T"):
        assert abs(after.estimate[name] - both.estimate[name]) < 0.1 * both.standard_error[name]
        assert_allclose(after.standard_error[name], both.standard_error[name], rtol=0.1)
        assert 0.05 < after.prior_share[name] < 0.95
    assert len(after.records) == 0
    assert after.response([1.0]).response.size == 1


def test_it_is_saved_and_in_the_numbers(tmp_path):
    fit = gb.fit(
        gb.Problem(Lag(), responses(3, np.geomspace(0.5, 5, 8)), prior={"T": (0.5, 0.05)}), **ONE
    )
    assert fit.criterion == "maximum-likelihood; prior"
    gb.save(fit, tmp_path / "fit.h5")
    again = gb.load(tmp_path / "fit.h5")
    assert again.priors == fit.priors == {"T": (0.5, 0.05)}
    assert again.prior_share == fit.prior_share
    assert (str(again), again.details) == (str(fit), fit.details)
    told = json.loads(fit.to_json())["prior"]["T"]
    assert (told["mean"], told["standard_deviation"]) == (0.5, 0.05)
    assert 0 < told["share"] < 1


def test_knowledge_of_several_parts_counts_once():
    records = [line(seed) for seed in (4, 5)]
    fit = gb.fit(
        gb.Problem(Informed(), records[0], GIVEN) + gb.Problem(Informed(), records[1], GIVEN), **ONE
    )
    design = np.column_stack([np.ones(24), np.tile(X, 2)])
    covariance = np.linalg.inv(design.T @ design / SIGMA**2 + np.diag([1 / 0.3**2, 0]))
    assert_allclose(fit.prior_share["a"], covariance[0, 0] / 0.3**2, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"prior": {"T": (0.5, 0.1)}, "criterion": gb.RelativeError()}, "not a likelihood"),
        ({"prior": {"T": (0.5, 0.0)}}, "standard deviation"),
        ({"prior": {"q": (0.5, 0.1)}}, "no free parameter 'q'"),
        ({"prior": {"T": (0.5, 0.1)}, "fixed": {"T": 0.5}}, "no free parameter 'T'"),
        ({"prior": {"T": (0.5, 0.1)}, "tied": {"T": lambda p: p.K / 4}}, "no free parameter 'T'"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(options, match):
    with pytest.raises(ValueError, match=match):
        gb.Problem(Lag(), responses(6, np.array([1.0, 2.0, 4.0])), **options)


def test_parts_must_not_contradict_and_parameters_must_be_finite():
    data = [responses(seed, np.array([1.0, 2.0, 4.0])) for seed in (7, 8)]
    parts = [
        gb.Problem(Lag(), each, prior={"T": (mean, 0.1)})
        for each, mean in zip(data, (0.4, 0.6), strict=True)
    ]
    with pytest.raises(ValueError, match="different priors of 'T'"):
        gb.fit(parts[0] + parts[1], **ONE)
    with pytest.raises(ValueError, match="prior"):
        gb.Parameter(1.0, prior=(1.0, -1.0))


class Known:
    """An earlier answer of other parameters, or without standard errors."""

    def __init__(self, estimate, covariance):
        self.estimate, self.covariance, self.dof = estimate, covariance, np.inf

    def covariance_of(self, names):
        return self.covariance


@pytest.mark.parametrize(
    ("prior", "error", "words"),
    [
        (
            Known({"a": 1.0, "b": 2.0}, None),
            ValueError,
            "the Fit given as prior has a, b, and none of these is a parameter here: K, T.",
        ),
        (3.0, TypeError, "prior is 3.0: give {name: (mean, standard deviation)} or a Fit."),
        (
            Known({"K": 2.0, "T": 0.5}, np.diag([0.1, np.nan])),
            ValueError,
            "the Fit given as prior has no standard error of T: give prior={name: (mean, standard deviation)} for the "
            "others, or fix it in both.",
        ),
        (
            {"K": Known({"K": 2.0}, np.zeros((1, 1)))},
            ValueError,
            "the Fit given as prior has no standard error of K: give prior={name: (mean, standard deviation)} for the "
            "others, or fix it in both.",
        ),
        (
            {"K": (2.0, -1.0)},
            ValueError,
            "the prior of K (2.0, -1.0) must be two finite numbers (mean, standard",
        ),
        (
            {"K": (np.inf, 1.0)},
            ValueError,
            "the prior of K (inf, 1.0) must be two finite numbers",
        ),
        (
            {"K": (2.0, np.inf)},
            ValueError,
            "the prior of K (2.0, inf) must be two finite numbers",
        ),
        (
            {"K": 2.0},
            ValueError,
            "the prior of K 2.0 must be a pair of numbers",
        ),
        (
            {"K": (1.0, 2.0, 3.0)},
            ValueError,
            "the prior of K (1.0, 2.0, 3.0) must be a pair of numbers",
        ),
    ],
)
def test_knowledge_that_says_nothing_is_refused(prior, error, words):
    with pytest.raises(error, match=f"^{re.escape(words)}"):
        gb.Problem(Lag(), responses(6, np.array([1.0, 2.0, 4.0])), prior=prior)


def test_an_answer_is_knowledge_of_the_parameters_that_it_shares():
    """By their names outside, with the covariance of these; the others keep what they declare."""
    covariance = np.array([[0.04, -0.01], [-0.01, 0.09]])
    known = Known({"gain": 2.5, "T": 0.7, "zeta": 1.0}, covariance)
    problem = gb.Problem(
        Lag(), responses(6, np.array([1.0, 2.0, 4.0])), prior=known, rename={"K": "gain"}
    )
    (prior,) = problem.priors
    assert prior.names == ("gain", "T")
    assert prior.mean.tolist() == [2.5, 0.7]
    assert prior.covariance.tolist() == covariance.tolist()
    assert prior.stated == {"gain": (2.5, 0.2), "T": (0.7, 0.3)}
    own = {"T": (0.6, 0.5)}
    (prior,) = gb.Problem(
        Lag(), responses(6, np.array([1.0, 2.0, 4.0])), prior=own, rename={"T": "lag"}
    ).priors
    assert (prior.names, prior.mean.tolist(), prior.covariance.tolist()) == (
        ("lag",),
        [0.6],
        [[0.25]],
    )


def test_data_that_contradict_a_prior_are_named():
    data = responses(3, np.geomspace(0.5, 5, 8))  # T is 0.5
    warned = [
        any("contradict the prior of T" in warning for warning in fit.warnings)
        for fit in (
            gb.fit(gb.Problem(Lag(), data, prior={"T": (mean, 0.02)}), **ONE)
            for mean in (0.4, 0.48, 0.53, 0.65)
        )
    ]
    assert warned == [True, False, False, True]


def test_a_conflict_that_makes_the_errors_larger_than_the_prior_is_named():
    """A record of a lag of 0.3 s says 0.31 ± 0.011 s beside a prior of 0.5 ± 0.01 s."""
    criterion = gb.OutputError(inputs="held")
    problem = gb.Problem(SampledLag(), lag_record(3, 60), criterion, prior={"T": (0.5, 0.01)})
    assert any("contradict the prior of T" in text for text in gb.fit(problem, **ONE).warnings)
