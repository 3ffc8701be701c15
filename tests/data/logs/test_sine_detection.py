"""Sines and sweeps in one signal: what is there is found, and nothing else."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sine_schedules import STEP, schedule

from greybox.data.excited_segment import segment_table
from greybox.data.logs.sine_detection import sines_and_sweeps


def assert_found(runs, plan, starts, within=1.0):
    assert [run.kind for run in runs] == ["sine"] * len(plan)
    for run, (omega, _), (start, end) in zip(runs, plan, starts, strict=True):
        assert run.omega == pytest.approx(omega, rel=2e-3)
        assert run.amplitude == pytest.approx(3.0, rel=0.1)
        assert run.start == pytest.approx(start, abs=within * math.pi / omega)
        assert run.end == pytest.approx(end, abs=within * math.pi / omega)


def staircase(t, r, hold=0.012):
    return r[np.searchsorted(t, np.floor(t / hold) * hold)]


@pytest.mark.parametrize("pause", [0.0, 2.0, 7.0])
@pytest.mark.parametrize("spoiled", ["clean", "staircase", "offset", "step", "coarse"])
def test_sines_one_after_another(pause, spoiled):
    plan = [(20.0, 10.0), (8.0, 10.0), (4.0, 15.0), (3.5, 15.0), (2.0, 20.0), (1.0, 40.0)]
    t, r, starts = schedule(plan, pause)
    spoil = {
        "clean": lambda: r,
        "staircase": lambda: staircase(t, r),
        "offset": lambda: r + 5,
        "step": lambda: r + np.where(t < 3, -20.0, 0.0),
        "coarse": lambda: np.round(r, 1),
    }
    assert_found(sines_and_sweeps(t, spoil[spoiled]()), plan, starts)


@given(seed=st.integers(0, 10_000), ratio=st.floats(6, 100), omega=st.floats(1, 15))
@settings(max_examples=6, deadline=None, derandomize=True)
def test_sines_in_noise(seed, ratio, omega):
    plan = [(omega, 15.0 + 20 / omega), (1.3 * omega, 15.0 + 20 / omega)]
    t, r, starts = schedule(plan)
    noisy = r + 3 / ratio * np.random.default_rng(seed).standard_normal(t.size)
    runs = [run for run in sines_and_sweeps(t, noisy) if run.amplitude > 1]
    assert_found(runs, plan, starts, within=8.0)


@given(
    low=st.floats(0.3, 3),
    factor=st.floats(5, 60),
    duration=st.floats(30, 90),
    logarithmic=st.booleans(),
    sign=st.booleans(),
)
@settings(max_examples=8, deadline=None, derandomize=True)
def test_a_sweep_is_not_called_sines(low, factor, duration, logarithmic, sign):
    t = np.arange(0, duration, STEP)
    x = t / duration
    phase = (
        low
        * duration
        * ((factor**x - 1) / math.log(factor) if logarithmic else x + (factor - 1) * x**2 / 2)
    )
    r = np.sin(phase)[:: -1 if sign else 1]
    runs = sines_and_sweeps(t, r)
    assert not [run for run in runs if run.kind == "sine"]


def test_a_sweep_is_called_a_sweep():
    t = np.arange(0, 60, STEP)
    phase = 60 * (30 ** (t / 60) - 1) / math.log(30)
    (run,) = sines_and_sweeps(t, 2 * np.sin(phase))
    assert run.kind == "sweep"
    # Frequencies of the sweep where the segment begins and ends; its first and last piece are some
    # periods long.
    assert run.band == pytest.approx((30 ** (run.start / 60), 30 ** (run.end / 60)), rel=0.2)
    assert run.start < 15
    assert run.end > 55
    assert run.amplitude == pytest.approx(2, rel=0.1)
    assert "sweep" in segment_table([run])


@pytest.mark.parametrize(
    ("duration", "highest", "noise", "way"),
    [(60, 6.0, 0.0, 1), (90, 2.0, 0.05, -1), (120, 6.0, 0.2, 1)],
)
def test_a_sweep_between_other_sticks_is_found_whole(duration, highest, noise, way):
    """Logarithmic from 0.1 Hz, with rests of 6 s and sticks beside it; periods at its beginning differ by a third."""
    rng = np.random.default_rng(duration)
    t = np.arange(0, duration + 80, 0.02)
    since, grows = t - 40, math.log(highest / 0.1)
    inside = (since >= 0) & (since <= duration)
    sweep = 5 * np.sin(
        0.2 * np.pi * duration / grows * np.expm1(np.where(inside, since, 0) / duration * grows)
    )
    sticks = np.convolve(rng.standard_normal(t.size), np.exp(-np.arange(0, 4, 0.02) / 0.5))[
        : t.size
    ]
    sticks *= ((t > 3) & (since < -6)) | (since > duration + 6)
    r = np.round(
        np.where(inside, sweep, 0)
        + 3 * sticks / sticks.std()
        + noise * rng.standard_normal(t.size),
        2,
    )
    found = [run for run in sines_and_sweeps(t, r[::way]) if run.kind == "sweep"]
    (run,) = [run for run in found if run.end > 40 and run.start < 40 + duration]
    assert run.start == pytest.approx(40, abs=0.5)
    assert run.end == pytest.approx(40 + duration, abs=0.5)
    assert np.array(run.band) / (2 * np.pi) == pytest.approx([0.1, highest], rel=0.35)


def test_noise_steps_squares_and_walks_are_no_sines():
    rng = np.random.default_rng(0)
    t = np.arange(0, 40, STEP)
    for r in (
        rng.standard_normal(t.size),
        np.cumsum(rng.standard_normal(t.size)),
        np.sign(np.sin(2 * t)),
        np.repeat(rng.standard_normal(40), 100),
        np.zeros(t.size),
        t,
    ):
        assert not [
            run for run in sines_and_sweeps(t, r) if run.kind == "sine" and run.duration > 3
        ]


@given(st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=1, max_size=60))
@settings(max_examples=40, deadline=None)
def test_any_short_signal_is_survived(values):
    sines_and_sweeps(np.arange(len(values)) * 0.3, np.array(values))


@pytest.mark.parametrize("omega", [2.37, 7.91, 19.3])
def test_the_frequency_of_a_sine_is_refined_to_what_its_duration_allows(omega):
    t = np.arange(0, 30, STEP)
    (run,) = sines_and_sweeps(t, 3 * np.sin(omega * t + 0.4))
    assert run.omega == pytest.approx(omega, rel=2e-5)


def test_a_falling_sweep_has_its_band_from_low_to_high():
    t = np.arange(0, 60, STEP)
    phase = 60 * (30 ** (t / 60) - 1) / math.log(30)
    (run,) = sines_and_sweeps(t, 2 * np.sin(phase)[::-1])
    assert run.kind == "sweep"
    assert run.band == pytest.approx(
        (30 ** (1 - run.end / 60), 30 ** (1 - run.start / 60)), rel=0.2
    )


@pytest.mark.parametrize("samples", [1, 2, 4, 10])
def test_what_is_found_does_not_depend_on_when_the_clock_began(samples):
    """Short bursts of few samples a period among rest."""
    t = np.arange(0, 20, STEP)
    r = np.where(
        (t > 5) & (t < 5 + 12 * samples * STEP),
        np.sin(math.pi * (t - 5) / (samples * STEP) + 0.5),
        0.0,
    )
    first, later = (sines_and_sweeps(start + t, r) for start in (0.0, 5000.0))
    assert [round(run.start, 3) for run in first] == [round(run.start - 5000, 3) for run in later]


@pytest.mark.parametrize(
    ("omega", "begin", "half_waves"), [(7.0, 10.0, 27), (2.3, 8.0, 17), (13.0, 5.0, 60)]
)
@pytest.mark.parametrize(("offset", "trend"), [(0.0, 0.0), (5.0, 0.03), (-40.0, -0.05)])
def test_a_clean_sine_is_found_to_its_numbers(omega, begin, half_waves, offset, trend):
    """It ends where the rest beside it is off the sine by a twentieth of its amplitude, so late by 0.05 rad."""
    t = np.arange(0, 40, STEP)
    end = begin + half_waves * math.pi / omega
    r = offset + trend * t + np.where((t > begin) & (t < end), 3 * np.sin(omega * (t - begin)), 0.0)
    (run,) = sines_and_sweeps(t, r)
    assert run.omega == pytest.approx(omega, rel=1e-9)
    assert run.amplitude == pytest.approx(3.0, rel=1e-9)
    assert run.offset == pytest.approx(offset + trend * (begin + end) / 2, abs=1e-3)
    late = math.asin(0.05) / omega
    assert begin - late - STEP <= run.start <= begin + 1e-9
    assert end - 1e-9 <= run.end <= end + late + STEP


@pytest.mark.parametrize(("third", "found"), [(0.40, 1), (0.44, 0)])
def test_a_sine_explains_85_percent_of_the_variance(third, found):
    """Of a sine with a third harmonic h, a share of h²/(1 + h²) is none of it; up to h = 1/2 that crosses as often."""
    t = np.arange(0, 20, STEP)
    r = np.where((t > 3) & (t < 17), np.sin(4 * (t - 3)) + third * np.sin(12 * (t - 3)), 0.0)
    assert (third**2 / (1 + third**2) < 0.15) == found
    assert len([run for run in sines_and_sweeps(t, r) if run.duration > 10]) == found


def sweeping(law, low, high, duration=60.0, rest=20.0):
    """A sweep between two rests, its frequency at every time, and the times."""
    t = np.arange(0, duration + 2 * rest, STEP)
    since = np.clip(t - rest, 0, duration)
    if law == "logarithmic":
        rate = math.log(high / low) / duration
        phase, omega = low * np.expm1(rate * since) / rate, low * np.exp(rate * since)
    else:
        phase, omega = (
            low * since + (high - low) * since**2 / (2 * duration),
            low + (high - low) * since / duration,
        )
    return t, np.where((t > rest) & (t < rest + duration), 2 * np.sin(phase), 0.0), omega, phase


@pytest.mark.parametrize("law", ["logarithmic", "linear"])
@pytest.mark.parametrize(("low", "high"), [(0.8, 12.0), (1.0, 6.0)])
@pytest.mark.parametrize("way", [1, -1], ids=["rising", "falling"])
def test_a_clean_sweep_is_found_from_its_first_half_wave_to_its_last(law, low, high, way):
    """To half a wave at its slow end, whose half wave may be cut, and to 0.3 s at the fast one; amplitude to 5 %."""
    t, r, omega, _ = sweeping(law, low, high)
    (run,) = sines_and_sweeps(t, r[::way])
    start, end = (run.start, run.end) if way > 0 else (t[-1] - run.end, t[-1] - run.start)
    assert run.kind == "sweep"
    assert -0.02 < start - 20 < math.pi / low / 2
    assert 80 - end == pytest.approx(0.1, abs=0.2)
    assert run.amplitude == pytest.approx(2, rel=0.05)
    slowest = omega[np.searchsorted(t, 20 + 2 * math.pi / low)]  # after its first wave or so
    assert 0.95 * low < run.band[0] < slowest
    assert run.band[1] == pytest.approx(high, rel=0.06)


@pytest.mark.parametrize(
    ("sweep", "omega", "waves", "pause", "kinds"),
    [
        # Three waves belong to a sweep within twice their duration of it, 7.5 s ...
        ((1.0, 6.0, 40.0), 5.0, 3, 6.0, ["sweep"]),
        ((1.0, 6.0, 40.0), 5.0, 3, 9.0, ["sine", "sweep"]),
        # ... or, if they last less than 5 % of the sweep, within 30 % of its duration, 18 s.
        ((1.0, 6.0, 60.0), 8.0, 3, 15.0, ["sweep"]),
        ((1.0, 6.0, 60.0), 8.0, 3, 21.0, ["sine", "sweep"]),
        ((1.0, 6.0, 40.0), 8.0, 3, 6.0, ["sine", "sweep"]),
        ((1.0, 6.0, 60.0), 12.0, 3, 2.0, ["sweep"]),
        # More waves belong to it if they last less than 15 % of it, 9 s, at one of its frequencies.
        ((1.0, 6.0, 60.0), 8.0, 11, 2.0, ["sweep"]),
        ((1.0, 6.0, 60.0), 8.0, 13, 2.0, ["sine", "sweep"]),
        ((1.0, 6.0, 60.0), 10.0, 11, 2.0, ["sine", "sweep"]),
        ((3.0, 12.0, 120.0), 2.4, 5, 2.0, ["sweep"]),
        ((3.0, 12.0, 120.0), 1.7, 4.5, 2.0, ["sine", "sweep"]),
    ],
)
def test_short_waves_next_to_a_sweep_belong_to_it(sweep, omega, waves, pause, kinds):
    low, high, duration = sweep
    t, r, *_ = sweeping("linear", low, high, duration=duration, rest=40.0)
    length = waves * 2 * np.pi / omega  # s
    since = t - (40.0 - pause - length)
    r = r + np.where((since > 0) & (since < length), 2 * np.sin(omega * since), 0)
    assert [run.kind for run in sines_and_sweeps(t, r)] == kinds


@pytest.mark.parametrize(
    ("omega", "duration", "found"), [(20.0, 1.1, 1), (20.0, 0.9, 0), (2.0, 8.0, 1), (2.0, 6.0, 0)]
)
def test_a_sine_lasts_a_second_and_two_periods(omega, duration, found):
    t = np.arange(0, 30, STEP)
    r = np.where((t > 10) & (t < 10 + duration), np.sin(omega * (t - 10)), 0.0)
    assert len([run for run in sines_and_sweeps(t, r) if run.kind == "sine"]) == found


def test_a_constant_beside_a_sweep_changes_nothing():
    t = np.arange(0, 50, 0.02)
    since = np.clip(t - 5, 0, 40)
    r = np.where((t > 5) & (t < 45), 2 * np.sin(40 * (20 ** (since / 40) - 1) / math.log(20)), 0.0)
    (alone,), (beside,), (below,) = (
        sines_and_sweeps(t, r + offset) for offset in (0.0, 300.0, -300.0)
    )
    for found in (beside, below):
        assert (found.start, found.end) == (alone.start, alone.end)
        assert (found.band, found.amplitude) == (
            pytest.approx(alone.band),
            pytest.approx(alone.amplitude),
        )
    assert (alone.start, alone.end) == pytest.approx((5, 45), abs=0.5)


def test_a_sweep_flown_backwards_is_found_backwards():
    """Its first half wave, which begins at the rest, is then its last."""
    t = np.arange(2501) / 50
    since = np.clip(t - 5, 0, 40)
    r = np.where((t > 5) & (t < 45), 2 * np.sin(40 * (20 ** (since / 40) - 1) / math.log(20)), 0.0)
    (there,), (back,) = (sines_and_sweeps(t, each) for each in (r, r[::-1]))
    assert (t[-1] - back.end, t[-1] - back.start) == pytest.approx(
        (there.start, there.end), abs=0.021
    )
    assert back.band == pytest.approx(there.band)
    assert there.start == pytest.approx(5, abs=0.2)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_the_unit_of_a_sweep_does_not_matter(size):
    t = np.arange(2501) / 50
    since = np.clip(t - 5, 0, 40)
    r = np.where((t > 5) & (t < 45), 2 * np.sin(40 * (20 ** (since / 40) - 1) / math.log(20)), 0.0)
    (plain,), (scaled,) = (sines_and_sweeps(t, each) for each in (r, size * r))
    assert (scaled.start, scaled.end, scaled.band) == (
        plain.start,
        plain.end,
        pytest.approx(plain.band),
    )
    assert scaled.amplitude == pytest.approx(size * plain.amplitude)


@pytest.mark.parametrize(("samples", "found"), [(8.4, 1), (7.6, 0)])
def test_a_sine_has_eight_samples_a_period(samples, found):
    t = np.arange(0, 20, STEP)
    omega = 2 * math.pi / (samples * STEP)
    r = np.where((t > 5) & (t < 15), np.sin(omega * (t - 5)), 0.0)
    runs = [run for run in sines_and_sweeps(t, r) if run.kind == "sine" and run.duration > 5]
    assert len(runs) == found


@pytest.mark.parametrize(("amplitude", "found"), [(0.0053, 1), (0.0047, 0)])
def test_a_sine_has_an_amplitude_of_half_a_percent_of_the_range(amplitude, found):
    """Beside a step of one; its turning points are twice as far apart."""
    t = np.arange(0, 30, STEP)
    r = np.where(t < 3, 0.0, 1.0) + np.where(
        (t > 10) & (t < 25), amplitude * np.sin(4 * (t - 10)), 0.0
    )
    runs = [run for run in sines_and_sweeps(t, r) if run.duration > 5]
    assert len(runs) == found
    for run in runs:
        assert (run.amplitude, run.omega) == pytest.approx((amplitude, 4), rel=1e-6)


@pytest.mark.parametrize(("bend", "found"), [(0.11, 1), (0.145, 0)])
def test_a_sine_is_bent_by_0_12_rad_at_most(bend, found):
    """At its ends, of a frequency that changes evenly; one piece that is bent more is no sweep either."""
    t = np.arange(0, 40, STEP)
    since = t - 20
    half = 40 * math.pi / 4 / 2
    r = np.where(np.abs(since) < half, np.sin(4 * since + bend / half**2 * since**2), 0.0)
    assert len([run for run in sines_and_sweeps(t, r) if run.duration > 20]) == found
