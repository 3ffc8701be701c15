"""Simulations and predictions on uneven clocks, against closed forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Decay(gb.StateSpace):
    """y' = -k y."""

    states = outputs = ("y",)
    inputs = ()
    k = gb.Parameter(0.3, bounds=(0.001, 5), unit="1/s")

    def derivative(self, x, u, p):
        return (-p.k * x.y,)

    def output(self, x, u, p):
        return (x.y,)


class Lag(gb.StateSpace):
    """tau y' = u - y."""

    states = outputs = ("y",)
    inputs = ("u",)
    tau = gb.Parameter(0.5, bounds=(0.01, 10), unit="s")

    def derivative(self, x, u, p):
        return ((u.u - x.y) / p.tau,)

    def output(self, x, u, p):
        return (x.y,)


class Biased(Lag):
    """The lag of a weaker input."""

    def derivative(self, x, u, p):
        return ((0.8 * u.u - x.y) / p.tau,)


def lag(time, u, tau, first=0.0):
    y = np.full(len(time), float(first))
    for k in range(len(time) - 1):
        y[k + 1] = u[k] + (y[k] - u[k]) * np.exp(-(time[k + 1] - time[k]) / tau)
    return y


def rested(time):
    return gb.Record(np.array(time, dtype=float), {"unused": np.zeros(len(time))})


@pytest.mark.parametrize(
    "time",
    [
        [0, 2, 3, 4],
        [0, 1, 2, 3, 10, 11, 12, 13],
        [0, 1, 2, 3, 10],
        [0, 15, 30, 45, 60, 90, 120, 180],
        [0, 10, 22, 30, 41],
        np.r_[np.arange(0, 1, 0.01), 30.0],
        [5, 6],
    ],
    ids=["four", "two runs", "a lonely end", "lab", "nearly even", "long after", "two"],
)
def test_without_an_input_a_simulation_runs_on(time):
    motion = gb.simulate(Decay(), {"k": 0.3}, record=rested(time), initial={"y": 1.0})
    since = np.array(time, dtype=float) - time[0]
    assert_allclose(motion["y"], np.exp(-0.3 * since), atol=1e-7)
    assert "anew" not in motion.name


def test_a_simulation_begins_anew_behind_lost_rows_and_says_so():
    u = np.random.default_rng(0).uniform(-1, 1, 400)
    rows = np.delete(np.arange(400), np.arange(200, 260))
    time = 0.01 * rows
    data = {"u": u[rows]}
    record = gb.Record(time, data, hold={"u": np.inf})
    motion = gb.simulate(Lag(), {}, record=record, initial={"y": [0.0, 2.0]})
    assert "begun anew behind 1 gap" in motion.name
    first, second = slice(None, 200), slice(200, None)
    assert_allclose(motion["y"][first], lag(time[first], u[rows][first], 0.5), atol=1e-8)
    assert_allclose(motion["y"][second], lag(time[second], u[rows][second], 0.5, 2.0), atol=1e-8)
    # Stated as known, it is held all the while.
    bridged = gb.Record(time, data, hold={"u": np.inf}, gaps="bridge")
    motion = gb.simulate(Lag(), {}, record=bridged)
    assert_allclose(motion["y"], lag(time, u[rows], 0.5), atol=1e-8)


def test_lonely_samples_of_a_moving_input_have_values():
    u = np.random.default_rng(0).uniform(-1, 1, 300)
    rows = np.delete(np.arange(300), [100, 102])
    record = gb.Record(0.01 * rows, {"u": u[rows]}, hold={"u": np.inf})
    motion = gb.simulate(Lag(), {}, record=record, initial={"y": 1.0})
    assert np.isfinite(motion["y"]).all()


CLOCKS = {
    "jitter": 0.02 * np.arange(1500) + np.random.default_rng(1).uniform(-8e-3, 8e-3, 1500),
    "50 to 20 Hz": np.r_[0.02 * np.arange(1000), 20 + 0.05 * np.arange(200)],
    "50 to 25 Hz": np.r_[0.02 * np.arange(1000), 20 + 0.04 * np.arange(250)],
    "20 ms stamps of 37 Hz": np.round(np.arange(1000) / 37 / 0.02) * 0.02,
}


def flown(clock, size=0.01):
    time = CLOCKS[clock]
    u = np.repeat(np.random.default_rng(2).uniform(-1, 1, time.size // 10 + 1), 10)[: time.size]
    sampled = np.arange(time.size) / 37 if "stamps" in clock else time
    y = lag(sampled, u, 0.5, 0.7)
    y += size * np.random.default_rng(3).standard_normal(time.size)
    return gb.Record(time, {"u": u, "y": y}, hold={"u": np.inf, "y": 0.0})


@pytest.mark.parametrize("clock", CLOCKS)
def test_windows_last_equally_long_on_uneven_clocks(clock):
    record = flown(clock)
    prediction = gb.predict(Lag(), {}, record=record, horizon=1.0, lead=0.5)
    assert len(prediction) == pytest.approx((record.duration - 0.5) / 1.0, abs=1.5)
    rows = [window[window >= 0] for window in prediction.rows]
    # Predicted samples follow one another, each once.
    assert_allclose(np.concatenate(rows), np.arange(rows[0][0], rows[-1][-1] + 1))
    for window in rows:
        assert 0.9 < np.ptp(record.time[window]) + 0.05 < 1.11
    # The right model predicts the truth.
    truth = flown(clock, 0.0)["y"]
    error = prediction.record["y"] - truth
    assert np.nanstd(error) < 0.01
    assert np.isnan(error).sum() < 100
    later = prediction.rms("y", 0.5), prediction.rms("y", 1.0), prediction.rms("y")
    assert_allclose(later, 0.01, rtol=0.4)
    assert "windows of 1" in str(prediction)


def test_fits_on_uneven_clocks_are_compared():
    record, other = flown("jitter"), flown("50 to 20 Hz")
    fit = gb.fit(gb.Problem(Lag(), record), 1, progress=False)
    worse = gb.fit(gb.Problem(Biased(), record), 1, progress=False)
    table = str(gb.compare(fit, worse, records=[other]))
    assert "identification data" in table
    assert "held-out data" in table


def test_a_schedule_of_eight_samples_is_predicted_and_compared():
    time = np.array([0.0, 15, 30, 45, 60, 90, 120, 180])
    y = np.exp(-0.02 * time) + 0.01 * np.random.default_rng(0).standard_normal(8)
    record = gb.Record(time, {"y": y})
    fit = gb.fit(gb.Problem(Decay(), record), progress=False)
    prediction = gb.predict(fit, record=record, horizon=30, lead=30)
    assert [window[window >= 0].tolist() for window in prediction.rows] == [[2, 3], [4], [5], [6]]
    assert "Decay" in str(gb.compare(fit, fit))


def test_gains_are_for_even_steps():
    record = flown("jitter")
    even = gb.Record(0.02 * np.arange(1500), record.signals, hold=record.hold)
    fit = gb.fit(gb.Problem(Lag(), even, gb.PredictionError()), 1, progress=False)
    with pytest.raises(ValueError, match="constant gain, and the record is not uniformly sampled"):
        gb.predict(fit, record=record)
