import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, freqz, lfilter

import greybox as gb
from greybox.data.record import Record
from greybox.data.spectral.sweeps_and_noise import spectral_response
from greybox.data.spectral.uniform_stretches import JITTER, uniform_stretches

TIME = np.arange(100) / 50
RAMP = 3 + 2 * TIME


def test_stretches_are_cut_at_gaps_and_missing_samples():
    time = np.where(TIME < 1, TIME, TIME + 5)
    hole = np.sin(time)
    hole[17:21] = np.nan
    stretches = uniform_stretches(Record(time, {"u": RAMP, "y": hole}, source="a.bin"), ["u", "y"])
    assert [s.values.shape for s in stretches] == [(2, 17), (2, 29), (2, 50)]
    np.testing.assert_array_equal(stretches[2].values[0], RAMP[50:])
    assert {s.record.source for s in stretches} == {"a.bin"}
    assert stretches[0].step == pytest.approx(0.02)


def test_short_gaps_are_interpolated():
    """On a curve, to the accuracy of a cubic; the rows of a held signal repeat the value before."""
    rows = np.delete(np.arange(400), [53, 124, 125, 204, 205, 206])
    time, u = rows / 50, np.sin(rows / 8)
    y = np.where(rows == 307, np.nan, np.repeat(np.arange(40.0), 10)[rows])
    (stretch,) = uniform_stretches(Record(time, {"u": u, "y": y}, hold={"y": np.inf}), ["u", "y"])
    whole = np.arange(400)
    # A cubic across a gap of three at an eighth of a radian a row is wrong by ω⁴h⁴/24 at most.
    np.testing.assert_allclose(stretch.values[0], np.sin(whole / 8), atol=(4 / 8) ** 4 / 24)
    np.testing.assert_array_equal(stretch.values[1], whole // 10)
    assert stretch.origin.end == time[-1]
    stated = Record(time, {"u": u}, gaps="cut")
    assert len(uniform_stretches(stated, ["u"])) == 4


def test_a_signal_with_a_rate_of_its_own_is_not_interpolated():
    half = np.where(np.arange(100) % 2, np.nan, RAMP)
    with pytest.raises(ValueError, match="never all present in two samples in a row"):
        uniform_stretches(Record(TIME, {"u": RAMP, "y": half}), ["u", "y"])


@pytest.mark.parametrize("held", [False, True])
def test_a_tenth_of_all_rows_lost_costs_few_points(held):
    """The median error of a response stays below 2 %, and within what is stated."""
    random = np.random.default_rng(0)
    count, w, damping = 12000, 6.0, 0.4
    time = np.arange(count) / 100
    u = lfilter(*butter(2, 0.2), random.normal(size=count))
    plant = cont2discrete(([w * w], [1, 2 * damping * w, w * w]), 0.01, "zoh" if held else "foh")
    y = lfilter(plant[0].ravel(), plant[1], u)
    y = y + 0.01 * np.std(y) * random.normal(size=count)
    hold = {"u": np.inf if held else 0.0}

    def measured(keep):
        signals = {"u": u[keep], "y": y[keep]}
        return spectral_response(gb.Record(time[keep], signals, hold=hold), "u", "y")

    keep = random.random(count) > 0.1
    keep[[0, -1]] = True
    whole, lost = measured(np.ones(count, bool)), measured(keep)
    assert len(lost) > 0.7 * len(whole)
    _, exact = freqz(plant[0].ravel(), plant[1], lost.omega / 100)
    errors = np.abs(lost.response - exact)
    assert np.median(errors / np.abs(exact)) < 0.02
    assert np.median(errors**2 / lost.variance) < 2


@pytest.mark.parametrize(("share", "accepted"), [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("start", [0.0, 1000.0])
def test_a_time_base_may_be_off_by_a_twentieth_of_a_step(share, accepted, start):
    time = start + TIME
    time[30] += share * JITTER * 0.02
    flown = Record(time, {"u": RAMP}, name="flight")
    if accepted:
        assert len(uniform_stretches(flown, ["u"])) == 1
    else:
        with pytest.raises(
            ValueError,
            match=rf"flight is not uniformly sampled \(1.1 ms off at {start + 0.6:.2f} s\)",
        ):
            uniform_stretches(flown, ["u"])


def test_a_stretch_says_where_it_comes_from():
    record = Record(
        10 + TIME, {"u": RAMP, "y": np.where(TIME < 0.5, np.nan, RAMP)}, {"u": "N"}, source="a.bin"
    )
    (stretch,) = uniform_stretches([record], ["u", "y"])
    assert (stretch.origin.start, stretch.origin.end) == (10.5, record.time[-1])
    assert stretch.origin.checksum == record.checksum
    assert stretch.record is record


def test_single_samples_are_no_stretch_and_constants_no_signal():
    lost = RAMP.copy()
    # Leaves one sample, one, and two before the rest.
    lost[[*range(1, 6), *range(7, 12), *range(14, 20)]] = np.nan
    sizes = [s.values.shape[1] for s in uniform_stretches(Record(TIME, {"u": lost}), ["u"])]
    assert sizes == [2, 80]
    for size, moves in ((1e-11, True), (1e-13, False)):
        still = Record(TIME, {"u": RAMP, "y": size * (np.arange(100) % 2)})
        if moves:
            assert len(uniform_stretches(still, ["u", "y"])) == 1
        else:
            with pytest.raises(ValueError, match=r"^y does not change in these records"):
                uniform_stretches(still, ["u", "y"])
    # It is enough that it changes in one of them.
    parts = [Record(TIME, {"u": RAMP}), Record(TIME, {"u": np.ones(100)})]
    assert len(uniform_stretches(parts, ["u"])) == 2
    with pytest.raises(ValueError, match="u, y are never all present in two samples in a row"):
        uniform_stretches(Record(TIME, {"u": RAMP, "y": np.full(100, np.nan)}), ["u", "y", "u"])


@pytest.mark.parametrize(("rate", "quantum"), [(75, 0.01), (800, 1e-3)])
def test_coarse_stamps_give_the_spectra_of_the_clock_that_they_round(rate, quantum):
    time = np.arange(6000) / rate
    u = np.sin(np.cumsum(np.linspace(0.01, 0.4, 6000)))
    y = np.convolve(u, 0.1 * 0.9 ** np.arange(80))[:6000]
    y += 0.001 * np.random.default_rng(0).standard_normal(6000)
    omega = np.array([0.03, 0.1, 0.3]) * rate
    exact, rounded = (
        spectral_response(gb.Record(t, {"u": u, "y": y}), "u", "y", omega=omega).response
        for t in (time, np.round(time / quantum) * quantum)
    )
    np.testing.assert_allclose(rounded, exact, rtol=2e-3)
    uneven = time + 0.3 / rate * np.random.default_rng(1).uniform(-1, 1, 6000)
    with pytest.raises(ValueError, match=r"not uniformly sampled .*prepare it with rate="):
        spectral_response(gb.Record(uneven, {"u": u, "y": y}), "u", "y", omega=omega)
