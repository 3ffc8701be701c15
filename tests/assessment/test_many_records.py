"""The text of an answer from many records: a summary, with the records that stand out."""

import math
import re

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.assessment.checks.finding import Finding, once

pytestmark = pytest.mark.usefixtures("unjudged_file")

COUNT = 14
POOR = 9  # the record with much noise, counted from 1


class Lag(gb.StateSpace):
    """T x' = c u - x."""

    states = ("x",)
    inputs = ("u",)
    outputs = ("x",)
    T = gb.Parameter(0.5, bounds=(0.05, 5.0), unit="s")
    c = gb.Parameter(1.0, bounds=(0.1, 3.0))

    def derivative(self, x, u, p):
        return ((p.c * u.u - x.x) / p.T,)

    def output(self, x, u, p):
        return (x.x,)


@pytest.fixture(scope="module")
def fit():
    random, time, records = np.random.default_rng(3), 0.05 * np.arange(120), []
    for k in range(1, COUNT + 1):
        u = np.repeat(random.standard_normal(12), 10)
        x = np.zeros(120)
        for i in range(119):  # exact for a held input
            x[i + 1] = u[i] + (x[i] - u[i]) * math.exp(-0.05 / 0.4)
        noise = (0.4 if k == POOR else 0.02) * random.standard_normal(120)
        found = ("some lines were lost: 3 of 120.",) if k > 4 else ()
        records.append(gb.Record(time, {"u": u, "x": x + noise}, name=f"run {k}", findings=found))
    noise = {"x": 0.02}
    problem = gb.several(
        Lag(), records, own=("c",), criterion=gb.OutputError(noise=noise, inputs="held")
    )
    return gb.fit(problem, starts=1, progress=False)


def test_the_text_of_many_records_is_a_summary(fit):
    text = str(fit)
    assert len(text.splitlines()) < 30
    (output,) = [line for line in text.splitlines() if line.startswith("  output")]
    percents = [part.fit_percent("x") for part in fit.records]
    assert f"x in {COUNT} records" in output
    assert f"fit {min(percents):.1f} to {max(percents):.1f} %" in output
    assert f"least in 'run {POOR}'" in output
    assert f"... and {COUNT - 3} more" in text
    assert len(fit.quantities) == COUNT + 1  # where each can be looked up


def test_what_holds_for_many_records_is_said_once(fit):
    (lost,) = [text for text in fit.warnings if "lines were lost" in text]
    assert "the same applies to 9 more ('run 6', 'run 7', 'run 8', 'run 9' and 5 more)." in lost
    (noise,) = [text for text in fit.warnings if "given standard deviation" in text]
    assert f"'run {POOR}'" in noise


def test_few_are_told_each():
    found = [Finding("First.", "a", "1"), Finding("Second.", "a", "2"), Finding("Other.", "b", "1")]
    assert list(once(found)) == found


def test_a_record_of_short_stretches_has_errors():
    # A gap behind every few samples leaves fewer lags than the record has samples for.
    random, time = np.random.default_rng(0), 0.05 * np.arange(900)
    u, x = np.repeat(random.choice([-1.0, 1.0], 90), 10), np.zeros(900)
    for i in range(899):
        x[i + 1] = u[i] + (x[i] - u[i]) * math.exp(-0.05 / 0.4)
    flight = {"u": u, "x": x + 0.02 * random.standard_normal(900)}
    # The lag does not run on in these gaps, which nobody can see where the input is the same.
    record = gb.Record(time + 0.25 * (np.arange(900) // 9), flight, gaps="cut")
    problem = gb.Problem(Lag(), record, gb.OutputError(inputs="held"))
    fit = gb.fit(problem, starts=1, progress=False)
    assert fit.estimate["T"] == pytest.approx(0.4, abs=4 * fit.standard_error["T"])
    assert fit.standard_error["T"] < 0.05


def lagged(noise, seed, name):
    """The response of a lag to a held input, with noise (n,)."""
    n = len(noise)
    u, x = np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], n // 10), 10), np.zeros(n)
    for i in range(n - 1):
        x[i + 1] = u[i] + (x[i] - u[i]) * math.exp(-0.05 / 0.4)
    record = gb.Record(0.05 * np.arange(n), {"u": u, "x": x + noise}, name=name)
    return gb.Problem(Lag(), record, gb.OutputError(inputs="held"))


def named_weights(problems):
    fit = gb.fit(sum(problems), [{}], progress=False)
    return fit, [text for text in fit.notes if "weight=" in text]


def test_a_record_with_correlated_errors_has_too_much_weight_beside_a_white_one():
    random = np.random.default_rng(1)
    slow = lfilter([math.sqrt(1 - 0.95**2)], [1, -0.95], random.standard_normal(900))[300:]
    white, colored = 0.05 * random.standard_normal(150), 0.05 * slow
    problems = [lagged(white, 1, "white"), lagged(colored, 2, "slow")]
    fit, (said,) = named_weights(problems)
    share, gain = map(float, re.search(r"of (\S+) for 'slow', .* about (\S+) times", said).groups())
    assert "'white'" not in said
    assert 0.01 < share < 0.3
    problems[1] = problems[1].with_(weight=share)
    better, said = named_weights(problems)
    assert not said
    ratio = [fit.standard_error[name] / better.standard_error[name] for name in ("T", "c")]
    assert 1.25 < gain < 1.3 * max(ratio)
    assert max(ratio) > 1.2


def test_records_with_equal_errors_have_the_right_weights():
    random = np.random.default_rng(2)
    noise = random.standard_normal((3, 300)) * [[0.02], [0.1], [0.05]]
    assert not named_weights([lagged(e, k, f"run {k}") for k, e in enumerate(noise)])[1]
