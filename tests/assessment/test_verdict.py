"""The verdict says what a careful reader of the result would."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from page_results import lag
from scipy.signal import lfilter

import greybox as gb
from greybox.assessment.verdict import verdict
from greybox.engine.solve.runs import Runs
from greybox.problems import pitch_two_points


@pytest.fixture(scope="module")
def fit():
    return lag()


def test_a_good_fit_in_three_sentences(fit):
    good = replace(fit, warnings=())
    judged = verdict(good)
    assert judged.grade == "good"
    assert "explains the data" in judged.sentences[0]
    assert judged.sentences[1] == "3 of 3 starts agree on the best minimum."
    assert judged.sentences[2].startswith(
        "The free parameters are well determined, with standard errors of at most "
    )


@pytest.mark.parametrize("count", [1, 2])
def test_a_minimum_that_was_found_once_is_in_doubt(fit, count):
    first, *others = fit.runs
    runs = (first, *(replace(run, cost=run.cost + 5) for run in others[: count - 1]))
    minima = (replace(fit.minima[0], runs=(first.index,), cost=first.cost),)
    judged = verdict(replace(fit, warnings=(), runs=runs, minima=minima, agreeing=1))
    assert judged.grade == "doubt"
    assert "another" in judged.sentences[0]  # the reason first, with its cure
    assert judged.sentences[0].endswith("run more starts.")
    assert judged.level.startswith("In doubt")


def test_what_is_not_determined_is_named(fit):
    shaky = replace(
        fit,
        directions=replace(fit.directions, covariance=fit.directions.covariance * 1e4),
        warnings=(),
    )
    judged = verdict(shaky)
    assert judged.grade == "doubt"
    assert (
        "0 are well determined; b0 and a0 exceeded the guidelines (20 % error"
        in judged.sentences[0]
    )

    bound = tuple(replace(q, at_bound=q.name == "a0") for q in fit.quantities)
    assert (
        "a0 ended at a bound" in verdict(replace(fit, quantities=bound, warnings=())).sentences[0]
    )


def test_a_failed_fit_has_no_estimate(fit):
    runs = tuple(
        replace(run, converged=False, status="Maximum_Iterations_Exceeded") for run in fit.runs
    )
    judged = verdict(replace(fit, runs=Runs.of(runs), minima=()))
    assert judged.grade == "failed"
    assert judged.sentences[0].startswith("There is no estimate: no start converged")


def determined(beyond=(), names="abc", error=(0.05, np.nan, 0.012), alone=0.1):
    return SimpleNamespace(
        beyond=tuple(beyond),
        names=tuple(names),
        error=np.broadcast_to(error, len(names)),
        insensitivity=np.full(len(names), alone),
    )


def told(**parts):
    """What is said of a fit that holds no more than this."""
    given = {
        "parts": (),
        "misfit": None,
        "responses": (),
        "records": (),
        "left_out": (),
        "spectra": (),
        "quantities": (),
        "free": ("a", "b", "c"),
        "warnings": (),
    }
    given |= {
        "converged": True,
        "runs": [SimpleNamespace(stage="polished")] * 3,
        "agreeing": 3,
        "minima": [None],
    }
    given |= {"identifiability": determined()} | parts
    given["at_bound"] = [quantity.name for quantity in given["quantities"] if quantity.at_bound]
    return verdict(SimpleNamespace(**given))


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        ({}, "3 of 3 starts agree on the best minimum."),
        ({"agreeing": 2}, "2 of 3 starts agree on the best minimum."),
        (
            {"agreeing": 1},
            "Only 1 of 3 starts reached the best minimum, so another minimum may be lower: run more starts.",
        ),
        (
            {
                "runs": [SimpleNamespace(stage="screened"), SimpleNamespace(stage="polished")],
                "agreeing": 1,
            },
            "Only one start was run, so another minimum may be lower: run more starts.",
        ),
    ],
)
def test_how_well_the_minimum_is_known(parts, sentence):
    judged = told(**parts)
    assert judged.sentences[0] == sentence
    assert (judged.grade == "good") == ("agree on" in sentence)


def quantity(name, at_bound):
    return SimpleNamespace(name=name, at_bound=at_bound)


@pytest.mark.parametrize(
    ("parts", "sentence", "well"),
    [
        (
            {},
            "The free parameters are well determined, with standard errors of at most 5 % (a).",
            True,
        ),
        (
            {"free": ("a",)},
            "The free parameters are well determined, with standard errors of at most 5 % (a).",
            True,
        ),
        ({"free": ()}, "No parameter was free.", True),
        (
            {"quantities": (quantity("a", True), quantity("b", False))},
            "Of 3 free parameters, 2 are well determined; a ended at a bound. To determine more, fix a parameter or add data.",
            False,
        ),
        (
            {
                "identifiability": determined("c", "c", 0.3),
                "quantities": (quantity("a", True),),
            },
            "Of 3 free parameters, 1 is well determined; a ended at a bound; c exceeded the guidelines (20 % error, "
            "10 % insensitivity). To determine more, fix a parameter or add data.",
            False,
        ),
        (
            {
                "identifiability": determined("abcd", "abcdef", 0.3),
                "free": tuple("abcdef"),
            },
            "Of 6 free parameters, 2 are well determined; a, b, c and d exceeded the guidelines (20 % error, 10 % "
            "insensitivity). To determine more, fix a parameter or add data.",
            False,
        ),
        (
            {"identifiability": determined("c", error=(0.1, 0.1, 3.0), alone=0.6)},
            "Of 3 free parameters, 2 are well determined; c exceeded the guidelines (20 % error, 10 % "
            "insensitivity). To determine more, fix a parameter or add data.",
            False,
        ),
    ],
)
def test_how_well_the_parameters_are_determined(parts, sentence, well):
    judged = told(**parts)
    assert judged.sentences[1 if well else 0] == sentence
    assert (judged.grade == "good") == well


def test_a_warning_leaves_a_fit_in_doubt():
    assert told(warnings=("one",)).grade == "doubt"
    failed = told(
        converged=False,
        best_effort={"a": 1.0},
        status="no start converged",
        warnings=("one", "two"),
    )
    assert failed.sentences == ("There is no estimate: no start converged.", "one")
    assert told(converged=False, best_effort=None, status="x").sentences == (
        "There is no estimate: x.",
    )


def test_grades_differ_by_what_is_wrong():
    # An insensitivity beyond its guideline alone leaves a fit good.
    insensitive = determined("b", error=0.1)
    assert told(identifiability=insensitive).grade == "good"
    for explains, is_large, grade in ((0, 1, "poor"), (0, 0, "doubt"), (1, 0, "good")):
        misfit = SimpleNamespace(
            explains=explains, is_large=is_large, is_drifting=False, likely=(), verdict=""
        )
        judged = told(misfit=misfit)
        assert judged.grade == grade
        # Nothing is well determined by a model that is wrong.
        assert any("well determined" in text for text in judged.sentences) == explains
    assert told(agreeing=0).grade == "poor"


class OneLag(gb.TransferFunction):
    """A lag."""

    K = gb.Parameter(4.0, bounds=(1, 20))
    tau = gb.Parameter(0.2, bounds=(0.01, 1))

    def response(self, s, p):
        return p.K / (p.tau * s + 1)


# A lag that the model lacks, at noise of 2 %: 30 ms of it leave two hundred times the noise.
@pytest.mark.parametrize(("lag_s", "grade"), [(0.0, "good"), (0.0015, "doubt"), (0.03, "poor")])
def test_a_model_is_poor_where_it_leaves_far_more_than_noise(lag_s, grade):
    s = 1j * np.geomspace(1, 60, 40)
    noise = np.random.default_rng(1).standard_normal((2, 40)).T @ (1, 1j)
    measured = 5 / (0.1 * s + 1) / (lag_s * s + 1) * (1 + 0.02 * noise / np.sqrt(2))
    data = gb.FrequencyResponse(s.imag, measured).with_independent_errors()
    fit = gb.fit(gb.Problem(OneLag(), data), starts=5, profiles=False)
    assert verdict(fit).grade == grade


@pytest.mark.parametrize("bias", [0.0, 0.3])
def test_a_bias_near_zero_is_as_well_known_as_another(bias):
    time = np.arange(0, 10, 0.05)
    data = gb.Record(
        time,
        {
            "u": np.sign(np.sin(1.5 * time)),
            "x": bias + 0.02 * np.random.default_rng(2).standard_normal(time.size),
        },
    )
    flown = gb.simulate(Lagging(), {"K": 1.0, "a": 2.0}, record=data, initial={"x": 0.0})
    data = data.with_signals(x=data["x"] + flown["x"])
    fit = gb.fit(
        gb.Problem(Lagging(), data, gb.OutputError(biases=("x",))), starts=2, progress=False
    )
    assert abs(fit.estimate["x_bias"] - bias) < 0.01
    assert verdict(fit).grade == "good"


class Lagging(gb.StateSpace):
    """A lag in time."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    a = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (p.a * (p.K * u.u - x.x),)

    def output(self, x, u, p):
        return (x.x,)


def autoregressive(random, count):
    """Errors with a correlation of 0.85 from sample to sample."""
    return lfilter([np.sqrt(1 - 0.85**2)], [1, -0.85], random.normal(size=count + 100))[100:]


def with_line(random, count):
    """White errors and a line of six times their size, above the band of the test."""
    line = np.sin(1.9 * np.arange(count) + random.uniform(0, 6))
    return (random.normal(size=count) + 6 * np.sqrt(2) * line) / 6


@pytest.mark.parametrize(("errors", "grade"), [(autoregressive, "good"), (with_line, "doubt")])
def test_residuals_that_are_not_white_are_told_and_a_line_is_in_doubt(errors, grade):
    random = np.random.default_rng(5)
    time = np.arange(0, 30, 0.05)
    u = np.repeat(random.uniform(-1, 1, time.size // 20), 20)
    data = gb.Record(time, {"u": u, "x": np.zeros(time.size)}, hold={"u": np.inf})
    flown = gb.simulate(Lagging(), {"K": 1.0, "a": 2.0}, record=data, initial={"x": 0.0})
    data = data.with_signals(x=flown["x"] + 0.06 * errors(random, time.size))
    fit = gb.fit(gb.Problem(Lagging(), data), starts=2, progress=False)
    judged = verdict(fit)
    assert judged.grade == grade
    assert "earlier samples" in " ".join(judged.sentences)


def test_parts_that_disagree_by_the_print_of_the_fit_are_not_good():
    """The paper finds that hover and 5° do not share a4; the fit names it, by p = 0.0004."""
    fit = gb.fit(pitch_two_points.problem(), starts=4, progress=False)
    assert "a value of a4 that is smaller" in str(fit)
    assert verdict(fit).grade == "doubt"
