"""Bands of fitted outputs against textbook regression, Monte Carlo by scipy, and simulation; what tells of what."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import t
from spring_lag_tilt import HELD, FullTilt, Spring, fit, spring, tilt_flight

import greybox as gb

STEP = 0.1
U = np.repeat(np.random.default_rng(3).normal(size=20), 6)


class Line(gb.StateSpace):
    """y = a + b x."""

    inputs, outputs = ("x",), ("y",)
    a = gb.Parameter(0.0)
    b = gb.Parameter(1.0)

    def output(self, x, u, p):
        return (p.a + p.b * u.x,)


class Decay(gb.StateSpace):
    """A lag with an unknown initial state."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(0.01, 20), unit="1/s")

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.y),)

    def output(self, x, u, p):
        return (x.y,)


def decayed(p):
    """The same at the samples, exact for held inputs; p are the rate and the initial state."""
    keep = np.exp(-p[0] * STEP)
    return lfilter([0, 1 - keep], [1, -keep], U) + p[1] * keep ** np.arange(U.size)


@pytest.fixture(scope="module")
def moved():
    return fit(gb.Problem(Spring(), spring(n=300), HELD))


def test_the_band_of_a_line_is_that_of_the_textbook():
    x = np.arange(12.0)
    y = 1 + 0.5 * x + 0.1 * np.random.default_rng(0).normal(size=12)
    answer = fit(gb.Problem(Line(), gb.Record(x, {"x": x, "y": y}, has_time=False)))
    low, high = answer.output_band()["y"]
    slope, offset = np.polyfit(x, y, 1)
    e = y - offset - slope * x
    s = np.sqrt(e @ e / 10)
    half = (
        t.ppf(0.975, 10) * s * np.sqrt(1 / 12 + (x - x.mean()) ** 2 / np.sum((x - x.mean()) ** 2))
    )
    assert_allclose((high - low) / 2, half, rtol=1e-5)
    assert_allclose((high + low) / 2, offset + slope * x, rtol=1e-5)


def test_the_band_of_a_simulation_is_that_of_monte_carlo_by_scipy():
    truth = np.array([1.5, 0.8])
    random = np.random.default_rng(1)
    draws = [decayed(truth) + 0.1 * random.normal(size=U.size) for _ in range(210)]
    found = [decayed(least_squares(lambda p, y=y: y - decayed(p), truth).x) for y in draws]
    records = [gb.Record(np.arange(U.size) * STEP, {"u": U, "y": y}) for y in draws[:10]]
    answers = [fit(gb.Problem(Decay(), record, HELD)) for record in records]
    error = np.sqrt(np.mean([answer.records[0].error[0] ** 2 for answer in answers], axis=0))
    ratio = error[:-1] / np.std(found, axis=0)[:-1]
    assert np.all(
        (ratio > 0.8) & (ratio < 1.25)
    )  # the initial state decides at first, the rate later
    bands = [answer.output_band()["y"] for answer in answers]
    assert (
        np.mean([(low <= decayed(truth)) & (decayed(truth) <= high) for low, high in bands]) > 0.85
    )


def test_errors_are_those_of_a_simulation_with_the_errors_of_the_fit(moved):
    simulated = gb.simulate(moved)
    for name, error in zip(("x", "v"), moved.records[0].error, strict=True):
        assert_allclose(
            error, simulated[f"{name}_error"], rtol=0.02
        )  # which takes initial states as white


def test_an_unstable_model_has_its_band_however_long_the_record():
    # 20 s are more than 20 times what the tilt takes to grow by e: no simulation from the first
    # state has digits left.
    answer = fit(gb.Problem(FullTilt(), tilt_flight(20), HELD))
    (part,) = answer.records
    compared = np.isfinite([part.residual(name) for name in part.outputs])
    assert np.isfinite(part.error[compared]).all()
    assert np.nanmax(part.error[2]) < 0.01  # rad


def test_shares_of_the_data_add_up_and_lie_where_the_input_moves(moved, tmp_path):
    part = moved.records[0]
    for shares in (part.information, part.information_alone):
        assert shares.shape == (3, 2 * 200)
        assert_allclose(shares.sum(axis=1), 1, rtol=1e-6)
    gb.save(moved, tmp_path / "fit.h5")
    (again,) = gb.load(tmp_path / "fit.h5").records
    for name in ("information", "information_alone", "error"):
        assert_allclose(getattr(again, name), getattr(part, name))

    time = np.arange(100) * 0.1
    y = np.where(time < 5, 0, 1 - np.exp(-1.5 * (time - 5))) + 0.01 * np.random.default_rng(
        0
    ).normal(size=100)
    step = gb.Record(time, {"u": np.where(time < 5, 0.0, 1.0), "y": y})
    shares = fit(gb.Problem(Decay(), step, HELD)).records[0].information
    assert shares[0, :100].sum() < 0.02  # before the step nothing tells of the rate
    peak = np.argmax(shares[0]) / 2 * 0.1 - 5
    assert peak == pytest.approx(1 / 1.5, abs=0.15)  # t e^(-a t) is largest at 1/a


def test_what_has_no_band_says_so(moved):
    response = gb.fit(
        gb.Problem(Decay(), gb.FrequencyResponse([1.0, 2.0], [0.8 - 0.4j, 0.5 - 0.5j])),
        starts=[{}],
        progress=False,
    )
    with pytest.raises(ValueError, match=r"response_band"):
        response.output_band()
    with pytest.raises(ValueError, match="not a frequency response"):
        moved.response_band()
