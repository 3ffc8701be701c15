import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Record
from greybox.data.spectral.sweeps_and_noise import spectral_response
from greybox.data.spectral.uniform_stretches import JITTER, uniform_stretches

TIME = np.arange(100) / 50
RAMP = 3 + 2 * TIME


def test_stretches_are_cut_at_gaps_and_missing_samples():
    time = np.where(TIME < 1, TIME, TIME + 5)
    hole = np.where(np.arange(100) == 20, np.nan, np.sin(time))
    stretches = uniform_stretches(Record(time, {"u": RAMP, "y": hole}, source="a.bin"), ["u", "y"])
    assert [s.values.shape for s in stretches] == [(2, 20), (2, 29), (2, 50)]
    np.testing.assert_array_equal(stretches[2].values[0], RAMP[50:])
    assert {s.record.source for s in stretches} == {"a.bin"}
    assert stretches[0].step == pytest.approx(0.02)


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
    lost[[1, 3, 6]] = np.nan  # leaves one sample, one, and two before the rest
    sizes = [s.values.shape[1] for s in uniform_stretches(Record(TIME, {"u": lost}), ["u"])]
    assert sizes == [2, 93]
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
