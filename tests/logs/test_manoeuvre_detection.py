"""Manoeuvres that were flown are found, named, and nothing else is."""

import numpy as np
import pytest

import greybox as gb
from greybox.logs.manoeuvre_detection import chosen_manoeuvre, manoeuvres_in

TIME = np.arange(0, 110, 0.02)
FLOWN = (  # start and unit, s; pulses in units; size
    ("2-1-1", 5, 0.7, (2, 1, 1), 1.0),
    ("3-2-1-1", 20, 1.0, (3, 2, 1, 1), -0.6),
    ("doublet", 40, 0.8, (1, 1), 0.8),
    ("pulse", 55, 1.2, (1,), 1.0),
    ("doublet", 70, 0.4, (1, 1), 0.5),
)


def pulses(start, unit, pattern, size):
    values, sign = np.zeros_like(TIME), 1
    for count in pattern:
        values += sign * size * ((start <= TIME) & (start + count * unit > TIME))
        start, sign = start + count * unit, -sign
    return values


def flight(noise=0.0, lag=0.0):
    values = sum(pulses(*flown) for _, *flown in FLOWN) + 0.5 * (TIME > 95)
    values = values + np.where((TIME > 80) & (TIME < 84), np.sin((TIME - 80) ** 2) * (84 - TIME) / 4, 0)
    if lag:
        kernel = np.exp(-np.arange(0, 1.5, 0.02) / lag)
        values = np.convolve(values, kernel / kernel.sum())[: TIME.size]
    return values + noise * np.random.default_rng(0).standard_normal(TIME.size)


@pytest.mark.parametrize(("noise", "lag"), [(0.0, 0.0), (0.0, 0.15), (0.03, 0.0), (0.03, 0.15)])
def test_manoeuvres_are_found_and_named(noise, lag):
    """Sharp and through an actuator, with and without noise: kind, time and size; nothing else is found."""
    found = manoeuvres_in(TIME, flight(noise, lag))
    assert [s.kind for s in found] == [kind for kind, *_ in FLOWN] + ["stick input", "step"]
    for segment, (_, start, unit, pattern, size) in zip(found, FLOWN, strict=False):
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
        assert [s for s in manoeuvres_in(TIME, values) if s.kind not in ("stick input", "step")] == []
        assert len(manoeuvres_in(TIME, values)) <= 1


def test_records_and_logs_are_searched_in_their_usual_inputs():
    """A record in its controls; a signal that is named wherever it is; a heading over north is unwrapped."""
    heading = (359 + flight()) % 360
    record = gb.Record(TIME, {"da": flight(), "p": flight(), "psi": heading}, {"psi": "deg"})
    found = gb.logs.find_manoeuvres(record)
    assert {s.axis for s in found} == {"da"}
    assert [s.kind for s in gb.logs.find_manoeuvres(record, "psi")] == [s.kind for s in found]
    assert chosen_manoeuvre(found, "3-2-1-1") is found[1]
    assert chosen_manoeuvre(found, "4") is found[3]
    with pytest.raises(ValueError, match=r"2 manoeuvres of the kind 'doublet': give the number of one, 3, 5"):
        chosen_manoeuvre(found, "doublet")
    with pytest.raises(ValueError, match="there is no manoeuvre 9; the log has 7"):
        chosen_manoeuvre(found, "9")


def test_the_band_of_a_long_input_is_that_of_its_transform():
    """Random levels, 0.8 s each: the band ends where a sum over all samples falls to a tenth."""
    time = np.arange(30_000) / 50
    levels = np.random.default_rng(3).choice([-1.0, 1.0], 700) * 200
    values = 1500 + np.where((time > 10) & (time < 560), levels[(time / 0.8).astype(int) % 700], 0.0)
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
    ("between", "kind"), [(1.3, "step"), (2.0, "stick input"), (-0.3, "step"), (-0.7, "stick input")]
)
def test_a_step_that_swings_far_beyond_its_ends_is_none(between, kind):
    """From zero to one, within half a second by way of another level."""
    time = TIME[TIME < 20]
    values = np.where(time < 10, 0.0, np.where(time < 10.4, between, 1.0))
    (found,) = manoeuvres_in(time, values)
    assert found.kind == kind
