"""Manoeuvres that were flown are found, and nothing else is."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.logs.manoeuvre_detection import manoeuvres_in
from greybox.data.record import Recording

TIME = np.arange(0, 110, 0.02)
FLOWN = (  # start and unit, s; pulses in units; size
    (5, 0.7, (2, 1, 1), 1.0),
    (20, 1.0, (3, 2, 1, 1), -0.6),
    (40, 0.8, (1, 1), 0.8),
    (55, 1.2, (1,), 1.0),
    (70, 0.4, (1, 1), 0.5),
)


def pulses(start, unit, pattern, size):
    values, sign = np.zeros_like(TIME), 1
    for count in pattern:
        values += sign * size * ((start <= TIME) & (start + count * unit > TIME))
        start, sign = start + count * unit, -sign
    return values


def flight(noise=0.0, lag=0.0):
    values = sum(pulses(*flown) for flown in FLOWN) + 0.5 * (TIME > 95)
    values = values + np.where(
        (TIME > 80) & (TIME < 84), np.sin((TIME - 80) ** 2) * (84 - TIME) / 4, 0
    )
    if lag:
        kernel = np.exp(-np.arange(0, 1.5, 0.02) / lag)
        values = np.convolve(values, kernel / kernel.sum())[: TIME.size]
    return values + noise * np.random.default_rng(0).standard_normal(TIME.size)


@pytest.mark.parametrize(("noise", "lag"), [(0.0, 0.0), (0.0, 0.15), (0.03, 0.0), (0.03, 0.15)])
def test_manoeuvres_are_found(noise, lag):
    """Sharp and through an actuator, with and without noise: kind, time and size; nothing else is found."""
    found = manoeuvres_in(TIME, flight(noise, lag))
    assert [s.kind for s in found] == ["manoeuvre"] * 6 + ["step"]
    for segment, (start, unit, pattern, size) in zip(found, FLOWN, strict=False):
        assert segment.start == pytest.approx(start, abs=0.1)
        assert segment.end == pytest.approx(start + unit * sum(pattern), abs=0.1 + 4 * lag)
        assert segment.amplitude == pytest.approx(abs(size), rel=0.15 + 4 * noise)


def test_sines_sweeps_noise_and_trim_are_no_manoeuvres():
    """They have functions of their own, or are nothing."""
    random = np.random.default_rng(1)
    active = (TIME > 20) & (TIME < 80)
    for values in (
        np.where(active, np.sin(2 * TIME), 0),
        np.where(active, np.sin(0.1 * (TIME - 20) ** 2), 0),
        random.standard_normal(TIME.size),
        0.001 * TIME,
        np.zeros_like(TIME),
    ):
        assert len(manoeuvres_in(TIME, values)) <= 1


def test_records_and_logs_are_searched_in_their_usual_inputs():
    """A record in its controls; a signal that is named wherever it is; a heading over north is unwrapped."""
    heading = (359 + flight()) % 360
    record = gb.Record(TIME, {"da": flight(), "p": flight(), "psi": heading}, {"psi": "deg"})
    found = gb.logs.find_manoeuvres(record)
    assert {s.axis for s in found} == {"da"}
    assert [s.kind for s in gb.logs.find_manoeuvres(record, "psi")] == [s.kind for s in found]


def test_the_band_of_a_long_input_is_that_of_its_transform():
    """Random levels, 0.8 s each: the band ends where a sum over all samples falls to a tenth."""
    time = np.arange(30_000) / 50
    levels = np.random.default_rng(3).choice([-1.0, 1.0], 700) * 200
    values = 1500 + np.where(
        (time > 10) & (time < 560), levels[(time / 0.8).astype(int) % 700], 0.0
    )
    found = max(manoeuvres_in(time, values), key=lambda s: s.duration)
    inside = (time >= found.start - 1) & (time <= found.end + 1)
    omega = np.linspace(0.9, 1.1, 41) * found.band[1]
    size = np.abs(np.exp(-1j * np.outer(omega, time[inside])) @ (values[inside] - found.offset))
    usual = np.abs(np.fft.rfft(values[inside] - found.offset)).max()
    assert size[omega <= found.band[1]].max() > 0.095 * usual


def test_the_band_of_a_pulse_begins_at_a_period_over_it_and_its_rests():
    """A pulse is strongest at zero; a second of rest on both sides."""
    (found,) = manoeuvres_in(TIME[TIME < 30], pulses(10.0, 1.2, (1,), 1.0)[TIME < 30])
    assert found.band[0] == pytest.approx(2 * np.pi / (1.2 + 2), rel=0.05)


@pytest.mark.parametrize(
    ("between", "kind"),
    [(1.3, "step"), (2.0, "manoeuvre"), (-0.3, "step"), (-0.7, "manoeuvre")],
)
def test_a_step_that_swings_far_beyond_its_ends_is_none(between, kind):
    """From zero to one, within half a second by way of another level."""
    time = TIME[TIME < 20]
    values = np.where(time < 10, 0.0, np.where(time < 10.4, between, 1.0))
    (found,) = manoeuvres_in(time, values)
    assert found.kind == kind


def kinds(*levels):
    """Kinds in levels held one after the other, (level, seconds), between rests of 8 s at zero."""
    values = [np.full(round(50 * t), x) for x, t in ((0.0, 8.0), *levels, (0.0, 8.0))]
    values = np.concatenate(values)
    return [segment.kind for segment in manoeuvres_in(np.arange(values.size) / 50, values)]


def test_a_second_of_rest_ends_a_manoeuvre_and_six_at_another_level_too():
    assert kinds((1.0, 0.9), (0.0, 0.94), (1.0, 0.9)) == ["manoeuvre"]
    assert kinds((1.0, 0.9), (0.0, 1.06), (1.0, 0.9)) == ["manoeuvre", "manoeuvre"]
    assert kinds((1.0, 5.9)) == ["manoeuvre"]
    assert kinds((1.0, 6.1)) == ["step", "step"]


def test_what_stays_within_two_percent_of_the_range_is_rest():
    assert kinds((1.0, 2.0), (0.0, 8.0), (0.019, 2.0)) == ["manoeuvre"]
    assert len(kinds((1.0, 2.0), (0.0, 8.0), (0.021, 2.0))) > 1


def test_times_size_and_first_level_are_those_that_were_held():
    time = np.arange(0, 20, 0.02)
    (found,) = manoeuvres_in(time, 3.0 + np.where((time >= 8) & (time < 10), -0.7, 0.0))
    assert (found.start, found.end) == pytest.approx((8, 10), abs=0.03)
    assert (found.amplitude, found.offset) == pytest.approx((0.7, 3.0))


def test_the_level_of_rest_is_no_part_of_the_band():
    doublet = pulses(10.0, 0.8, (1, 1), 0.8)[TIME < 30]
    (alone,), (trimmed,) = (
        manoeuvres_in(TIME[TIME < 30], doublet + level) for level in (0.0, 1500.0)
    )
    assert trimmed.band == pytest.approx(alone.band)
    assert alone.band[1] > 3


@pytest.mark.parametrize(("channel", "found"), [("C1", 1), ("C4", 1), ("C5", 0), ("C8", 0)])
def test_switches_beside_the_four_sticks_are_not_searched(channel, found):
    time = np.arange(0, 40, 0.05)
    pulse = 1500 + 300 * ((time > 15) & (time < 16)) - 300 * ((time >= 16) & (time < 17))
    sticks = {
        name: pulse if name == channel else np.full(time.size, 1500.0)
        for name in ("C1", "C4", "C5", "C8")
    }
    log = Recording({"RCIN": gb.Record(time, sticks)})
    assert [segment.axis for segment in gb.logs.find_manoeuvres(log)] == [f"RCIN.{channel}"] * found


@pytest.mark.parametrize(
    ("clock", "size", "level"), [(1000.0, -3.0, 1500.0), (-50.0, 0.01, -1500.0)]
)
def test_neither_clock_nor_sign_nor_unit_nor_trim_matter(clock, size, level):
    values = flight()[::2]
    plain, other = (
        manoeuvres_in(TIME[::2], values),
        manoeuvres_in(TIME[::2] + clock, level + size * values),
    )
    assert [s.kind for s in other] == [s.kind for s in plain]
    assert [s.start for s in other] == pytest.approx([s.start + clock for s in plain])
    assert [s.end for s in other] == pytest.approx([s.end + clock for s in plain])
    assert [s.amplitude for s in other] == pytest.approx([abs(size) * s.amplitude for s in plain])
    assert np.array([s.band for s in other]) == pytest.approx(
        np.array([s.band for s in plain]), rel=1e-3
    )
    assert [s.offset for s in other] == pytest.approx(
        [level + size * s.offset for s in plain], abs=1e-6
    )


@pytest.mark.parametrize(("pattern", "unit"), [((1, 1), 1.5), ((2, 1, 1), 1.0)])
def test_the_band_of_a_short_input_is_that_of_its_transform(pattern, unit):
    """Down to a tenth of its largest magnitude, beyond which there is nothing for an octave; times of whole samples."""
    time = np.arange(0, 40, 1 / 64)
    values, at, sign = np.zeros(time.size), 16.0, 2.0
    for count in pattern:
        values[(time >= at) & (time < at + count * unit)] = sign
        at, sign = at + count * unit, -sign
    (found,) = manoeuvres_in(time, values)
    assert (found.start, found.end) == (16 - 1 / 64, at)
    low = 2 * np.pi / (found.duration + 2)
    assert found.band[0] == pytest.approx(low, rel=1e-9)
    omega = np.geomspace(low, 0.8 * np.pi * 64, 1000)
    here = np.abs(values) > 0
    size = np.abs(np.exp(-1j * np.outer(omega, time[here])) @ values[here])
    strong = omega[size >= 0.1 * size.max()]
    ends = strong[np.append(np.diff(np.log(strong)) > np.log(2), True)]
    assert found.band[1] == pytest.approx(ends[0], rel=0.05)


def test_the_band_of_a_step_is_that_of_its_derivative():
    """A way up as (1 - cos)/2 in 0.8 s, of whose derivative, a half sine, the transform is cos(x)/(1 - (2 x/π)²)."""
    time = np.arange(0, 20, 1 / 64)
    (found,) = manoeuvres_in(time, (1 - np.cos(np.pi * np.clip((time - 8) / 0.8, 0, 1))) / 2)
    assert found.kind == "step"
    x = np.linspace(2, 4.7, 10_000)  # up to its first zero; the other lobes are below a tenth
    expected = x[np.cos(x) / (1 - (2 * x / np.pi) ** 2) >= 0.1].max() / 0.4
    assert found.band[1] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("size", "found"), [(1e-101, 0), (1e-99, 1), (1e99, 1), (1e101, 0)])
def test_numbers_whose_squares_vanish_or_overflow_are_left_alone(size, found):
    values = size * pulses(10.0, 1.2, (1,), 1.0)[TIME < 30]
    assert len(manoeuvres_in(TIME[TIME < 30], values)) == found


@pytest.mark.parametrize("level", [1e6, -1e6])
def test_what_rounding_leaves_of_a_large_level_is_no_manoeuvre(level):
    """A part in 10¹²; a hundred times that is one."""
    pulse = pulses(10.0, 1.2, (1,), 1.0)[TIME < 30]
    assert manoeuvres_in(TIME[TIME < 30], level + 5e-7 * pulse) == []
    assert [s.kind for s in manoeuvres_in(TIME[TIME < 30], level + 1e-4 * pulse)] == ["manoeuvre"]


def test_the_usual_inputs_are_sticks_then_setpoints_and_controls():
    time = np.arange(0, 30, 0.05)
    pulse = 1.0 * ((time > 15) & (time < 16))

    def axes(**records):
        made = {name: gb.Record(time, signals) for name, signals in records.items()}
        return [s.axis for s in gb.logs.find_manoeuvres(Recording(made))]

    controls = {"DesPitch": pulse}
    assert axes(RCIN={"C1": pulse, "C2": 0 * pulse}, ATT=controls) == ["RCIN.C1"]
    assert axes(RCIN={"C7": pulse}, ATT=controls) == ["ATT.DesPitch"]
    assert axes(flown={"de": pulse, "q": pulse}) == ["de"]
    assert axes(one={"de": pulse}, two={"da": pulse}) == []  # names without a message, of two
    for stick in ("roll", "pitch", "yaw", "throttle"):
        assert axes(manual_control_setpoint={stick: pulse}) == [f"manual_control_setpoint.{stick}"]
    rows = gb.Record(None, {"de": pulse})
    assert gb.logs.find_manoeuvres(Recording({"table": rows})) == ()


def test_a_band_ends_at_two_fifths_of_the_sampling_rate():
    """Of levels that change from sample to sample by chance, which are strong everywhere."""
    values = np.zeros(1000)
    values[400:550] = np.random.default_rng(2).choice([-1.0, 1.0], 150)
    (found,) = manoeuvres_in(np.arange(1000) / 50, values)
    assert found.band[1] == pytest.approx(0.4 * 2 * np.pi * 50, rel=0.03)


@pytest.mark.parametrize(("seed", "size", "noise"), [(1, 2.5, 0.45), (1, 3.0, 0.45), (4, 2.5, 0.4)])
def test_a_step_in_noise_begins_before_it_ends(seed, size, noise):
    """The rests before and behind it overlap."""
    time = np.arange(0, 10, 0.02)
    values = size * (time >= 5) + noise * np.random.default_rng(seed).standard_normal(time.size)
    (step,) = manoeuvres_in(time, values)
    assert 4.5 < step.start < step.end < 5.5


def test_a_second_of_rest_at_the_end_of_the_record_ends_a_manoeuvre():
    flown = pulses(*FLOWN[0])
    last = np.flatnonzero(flown)[-1]
    second = last + 1 + round(1 / 0.02)
    (segment,) = manoeuvres_in(TIME[:second], flown[:second])
    assert segment.end == pytest.approx(TIME[last], abs=0.05)
