"""Samples of different accuracy, and several at one time: the refusal names a way that works."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

import greybox as gb

TIME = np.arange(0, 5, 0.05)
RANDOM = np.random.default_rng(3)


class Decay(gb.StateSpace):
    """A decay that two sensors show, or one sensor in two conditions."""

    states, inputs, outputs = ("x",), (), ("y", "y_poor")
    k = gb.Parameter(0.5, bounds=(0.01, 10))

    def derivative(self, x, u, p):
        return (-p.k * x.x,)

    def output(self, x, u, p):
        return x.x, x.x


@pytest.mark.parametrize("is_poor", [TIME > 2, np.full(TIME.size, True)], ids=["some", "twice"])
def test_further_outputs_weigh_samples_like_scipy(is_poor):
    sizes = {"y": 0.02, "y_poor": 0.2}
    clean = 3 * np.exp(-0.8 * TIME)
    noisy = {name: clean + s * RANDOM.normal(size=TIME.size) for name, s in sizes.items()}
    is_twice = is_poor.all()
    shown = {
        "y": np.where(is_poor & ~is_twice, np.nan, noisy["y"]),
        "y_poor": np.where(is_poor, noisy["y_poor"], np.nan),
    }
    problem = gb.Problem(Decay(), gb.Record(TIME, shown), gb.OutputError(noise=sizes))
    fit = gb.fit(problem, starts=2, progress=False)

    every = [
        (t, y, s)
        for name, s in sizes.items()
        for t, y in zip(TIME, shown[name], strict=True)
        if np.isfinite(y)
    ]
    t, y, sigma = np.array(every).T
    expected, _ = curve_fit(
        lambda t, x0, k: x0 * np.exp(-k * t), t, y, (1, 1), sigma=sigma, absolute_sigma=True
    )
    assert fit.estimate["k"] == pytest.approx(expected[1], rel=1e-5)


class ScaledDecay(gb.StateSpace):
    """A decay whose samples are divided by their standard deviations."""

    states, inputs, outputs = ("x",), ("sigma",), ("y",)
    k = gb.Parameter(0.5, bounds=(0.01, 10))

    def derivative(self, x, u, p):
        return (-p.k * x.x,)

    def output(self, x, u, p):
        return (x.x / u.sigma,)


def test_a_standard_deviation_for_every_sample_is_refused_with_a_way_that_works_like_scipy():
    sigma = 0.01 * np.exp(RANDOM.uniform(0, 4, TIME.size))
    y = 3 * np.exp(-0.8 * TIME) + sigma * RANDOM.normal(size=TIME.size)
    with pytest.raises(ValueError, match=r"'y' 100 numbers.*divide the formula of 'y' and its"):
        gb.OutputError(noise={"y": sigma})

    record = gb.Record(TIME, {"sigma": sigma, "y": y / sigma})
    problem = gb.Problem(ScaledDecay(), record, gb.OutputError(noise={"y": 1.0}))
    fit = gb.fit(problem, starts=2, progress=False)
    expected, _ = curve_fit(
        lambda t, x0, k: x0 * np.exp(-k * t), TIME, y, (1, 1), sigma=sigma, absolute_sigma=True
    )
    assert fit.estimate["k"] == pytest.approx(expected[1], rel=1e-5)
