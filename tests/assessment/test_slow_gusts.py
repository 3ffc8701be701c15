"""Slow gusts that noise of sensors hides from sample to sample: prediction errors say so, and which state they reach."""

import numpy as np
from scipy.linalg import expm

import greybox as gb
from greybox.assessment.verdict import verdict

STEP, SAMPLES = 0.01, 2500
TRUTH = {"d": 1.0, "b": 8.0}
GUST_TIME = 1.0  # s


class Body(gb.StateSpace):
    """The rate and the speed of a body that a control turns, behind an actuator."""

    states, inputs, outputs = ("lag", "v", "q"), ("u",), ("v", "q")
    d = gb.Parameter(2.0, bounds=(-20, 50))
    b = gb.Parameter(5.0, bounds=(0.1, 100))

    def derivative(self, x, u, p):
        return ((u.u - x.lag) / 0.05, 2.0 * x.q - 0.5 * x.v, p.b * x.lag - p.d * x.q - 2.0 * x.v)

    def output(self, x, u, p):
        return (x.v, x.q)


def flown(gust):
    """A flight under control, with gusts on the rate, stepped exactly: the actuator, v, q and the gust."""
    random = np.random.default_rng(0)
    d, b = TRUTH.values()
    dynamics = np.zeros((5, 5))
    dynamics[0, [0, 4]] = -20, 20
    dynamics[1, [1, 2]] = -0.5, 2.0
    dynamics[2, :4] = b, -2.0, -d, 1.0
    dynamics[3, 3] = -1 / GUST_TIME
    step = expm(STEP * dynamics)
    white = gust * np.sqrt(1 - np.exp(-2 * STEP / GUST_TIME)) * random.normal(size=SAMPLES)
    time = STEP * np.arange(SAMPLES)
    wanted = sum(np.sin(w * time + random.uniform(0, 6)) for w in (0.7, 1.3, 2.4, 4.1))
    noise = np.array([[0.02], [0.1]]) * random.normal(size=(2, SAMPLES))
    x, rows = np.zeros(5), []
    for k in range(SAMPLES):
        v, q = x[1:3] + noise[:, k]
        x[4] = 0.3 * wanted[k] - 0.4 * q - 0.3 * v
        rows.append((x[4], v, q))
        x = step @ x
        x[3] += white[k]
    u, v, q = np.array(rows).T
    return gb.Record(time, {"u": u, "v": v, "q": q}, hold={"u": np.inf})


def fitted(gust, criterion):
    problem = gb.Problem(Body(), flown(gust), criterion)
    return gb.fit(problem, starts=1, progress=False, profiles=False)


def errors(fit):
    """The errors of the estimate in standard errors."""
    return [
        abs(fit.estimate[name] - value) / fit.standard_error[name] for name, value in TRUTH.items()
    ]


def test_gusts_that_bias_prediction_errors_are_told_with_the_state_and_the_cure_is_right():
    """From sample to sample, the noise of the rate's sensor is larger than what gusts leave."""
    biased = fitted(1.0, gb.PredictionError())
    assert max(errors(biased)) > 3
    assert verdict(biased).grade != "good"
    (text,) = [text for text in biased.warnings if "prediction errors are not white" in text]
    assert "PredictionError(disturbance={'q': 'colored'})" in text

    cured = fitted(1.0, gb.PredictionError(disturbance={"q": "colored"}))
    assert max(errors(cured)) < 3
    assert not any("not white" in text for text in cured.warnings)


def test_a_simulation_names_the_state_that_gusts_reach_neither_its_actuator_nor_the_next_one():
    fit = fitted(0.3, gb.OutputError())
    advice = [text for text in fit.warnings if "disturbance=" in text]
    assert advice
    assert all("disturbance={'q': 'colored'}" in text for text in advice)


def test_white_prediction_errors_without_gusts_are_not_told():
    fit = fitted(0.0, gb.PredictionError())
    assert not any("not white" in text for text in fit.warnings)
