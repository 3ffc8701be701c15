"""Likelihoods add to likelihoods alone, and a response without a criterion becomes one beside a record."""

import numpy as np
import pytest
from declared_models import Lag, measured
from scipy.stats import norm

import greybox as gb
from greybox.assessment.validation.same_data import count_unknowns

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"K": 5.0, "T": 0.3}
OMEGA = np.geomspace(0.5, 20, 25)
RESPONSE = measured(Lag(), OMEGA, TRUTH, noise=0.05, name="sines")
TIME = np.arange(0.0, 20.0, 0.05)
INPUT = np.sign(np.sin(0.7 * TIME**1.2))
EXACT = gb.simulate(Lag(), TRUTH, gb.Record(TIME, {"u": INPUT}), inputs="held")["y"]
HELD = gb.OutputError(inputs="held")


def record(noise, seed):
    random = np.random.default_rng(seed)
    return gb.Record(
        TIME, {"u": INPUT, "y": EXACT + noise * random.normal(size=TIME.size)}, name="flight"
    )


def test_a_response_without_a_criterion_becomes_a_likelihood_beside_a_record():
    response, flight = gb.Problem(Lag(), RESPONSE), gb.Problem(Lag(), record(0.5, 1))
    assert response.criterion == gb.RelativeError()
    for total in (
        response + flight,
        flight + response,
        sum([response, response.with_(name="again"), flight]),
    ):
        kinds = {type(part.data): part.criterion for part in total.parts}
        assert kinds == {gb.FrequencyResponse: gb.RelativeLikelihood(), gb.Record: gb.OutputError()}
    known = gb.FrequencyResponse(OMEGA, RESPONSE.response, variance=np.abs(RESPONSE.response) ** 2)
    beside = response + gb.Problem(Lag(), known, gb.MaximumLikelihood())
    assert [part.criterion for part in beside.parts] == [
        gb.RelativeLikelihood(),
        gb.MaximumLikelihood(),
    ]


def test_responses_among_themselves_keep_the_relative_error():
    total = gb.Problem(Lag(), RESPONSE) + gb.Problem(Lag(), RESPONSE, rename={"K": "K2"})
    assert [part.criterion for part in total.parts] == [gb.RelativeError(), gb.RelativeError()]


@pytest.mark.parametrize(
    "criterion", [gb.RelativeError(), gb.SquaredRelativeError(), gb.MagnitudePhase()], ids=repr
)
def test_a_criterion_that_is_no_likelihood_is_refused_beside_one(criterion):
    asked, flight = gb.Problem(Lag(), RESPONSE, criterion), gb.Problem(Lag(), record(0.5, 1))
    wanted = rf"'sines' has the criterion {type(criterion).__name__}\(.*'flight' OutputError.*RelativeLikelihood\(\)"
    for first, second in ((asked, flight), (flight, asked)):
        with pytest.raises(ValueError, match=wanted):
            first + second


@pytest.mark.parametrize(
    "other",
    [gb.MagnitudePhase(), gb.SquaredRelativeError(), gb.RelativeError(normalized="model")],
    ids=repr,
)
def test_different_criteria_that_are_no_likelihoods_are_refused(other):
    """Minima of a sum of dB² and of relative errors change with the units of either; equal ones add."""
    first = gb.Problem(Lag(), RESPONSE, name="first")
    second = gb.Problem(Lag(), RESPONSE, other, rename={"K": "K2"}, name="second")
    for a, b in (
        (first, second),
        (second, first),
        (first.with_(criterion=gb.RelativeError()), second),
    ):
        with pytest.raises(
            ValueError, match=rf"{b.name!r} has .*{a.name!r} .*give both the same criterion"
        ):
            a + b
    assert [part.criterion for part in (first.with_(criterion=other) + second).parts] == [
        other,
        other,
    ]


def test_what_else_is_changed_leaves_the_criterion_open():
    response = gb.Problem(Lag(), RESPONSE).with_(name="renamed", tied={"T": lambda p: 0.06 * p.K})
    flight = gb.Problem(Lag(), record(0.5, 1), rename={"T": "lag"})
    assert [part.criterion for part in (response + flight).parts] == [
        gb.RelativeLikelihood(),
        gb.OutputError(),
    ]
    assert response.with_(criterion=gb.MagnitudePhase()).criterion == gb.MagnitudePhase()
    with pytest.raises(ValueError, match="has the criterion RelativeError"):
        response.with_(criterion=gb.RelativeError()) + flight


def test_the_answer_says_which_likelihoods_were_added():
    problem = gb.Problem(Lag(), RESPONSE) + gb.Problem(Lag(), record(0.5, 1), HELD)
    said = gb.fit(problem, starts=[TRUTH]).details
    assert (
        "maximum likelihood, one unknown relative variance; output error, estimated variances"
        in said
    )


def test_a_joint_error_is_no_larger_than_either_alone_and_what_repeats_show():
    """8 draws: the standard deviation of the two estimates is known to 1 / √14 = 27 % each."""
    random = np.random.default_rng(4)
    exact = gb.frequency_response(Lag(), TRUTH, OMEGA).response
    values, errors = [], []
    for k in range(8):
        noise = 0.05 * (random.normal(size=25) + 1j * random.normal(size=25))
        response = gb.Problem(Lag(), gb.FrequencyResponse(OMEGA, exact * (1 + noise)))
        flight = gb.Problem(Lag(), record(0.5, [4, k]), HELD)
        joint, *alone = (
            gb.fit(p, starts=[TRUTH], profiles=False)
            for p in (response + flight, response, flight)[: 1 if k else 3]
        )
        values.append([joint.estimate[name] for name in TRUTH])
        errors.append([joint.standard_error[name] for name in TRUTH])
        for fit in alone:
            assert np.all(np.array(errors[0]) < [fit.standard_error[name] for name in TRUTH])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / np.std(values, axis=0)
    assert np.all((ratio > 0.65) & (ratio < 1.6))


def test_likelihoods_with_given_and_estimated_variances_are_compared_by_their_densities():
    """AIC of both is twice what scipy's density says, but for the common constants of the data."""
    variance = 2 * (0.05 * np.abs(gb.frequency_response(Lag(), TRUTH, OMEGA).response)) ** 2
    data = gb.FrequencyResponse(OMEGA, RESPONSE.response, variance=variance)
    fits = [
        gb.fit(gb.Problem(Lag(), data, c), starts=[TRUTH])
        for c in (gb.MaximumLikelihood(), gb.RelativeLikelihood())
    ]

    def negative(fit, variance):
        model = fit.parts[0].response
        scale = np.sqrt(variance / 2)
        parts = norm.logpdf(data.response.real, model.real, scale) + norm.logpdf(
            data.response.imag, model.imag, scale
        )
        return -np.sum(parts)

    relative = np.mean(np.abs(1 - data.response / fits[1].parts[0].response) ** 2)
    estimated = relative * np.abs(fits[1].parts[0].response) ** 2
    expected = negative(fits[1], estimated) - negative(fits[0], variance)
    assert fits[1].cost - fits[0].cost == pytest.approx(expected, rel=1e-6)
    assert [count_unknowns(fit) for fit in fits] == [2, 3]
