"""The Bode diagram: decibels, unwrapped phases, coherence."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lines import QUICK, TRUTH, curves, named, points
from matplotlib.figure import Figure
from page_results import lag

import greybox as gb
from greybox.models.tilt import Tilt
from greybox.reporting.plotting.bode import bode_figures


def test_bode_is_in_decibel_and_degrees(pitch):
    magnitude, phase, *_ = gb.plotting.bode(pitch)
    part = pitch.parts[0]
    for line, expected in ((curves(magnitude)[0], part.curve), (points(magnitude)[0], part.data)):
        np.testing.assert_allclose(line.get_xdata(), expected.omega)
        np.testing.assert_allclose(line.get_ydata(), 20 * np.log10(np.abs(expected.response)))
    turns = (curves(phase)[0].get_ydata() - np.degrees(np.angle(part.curve.response))) / 360
    np.testing.assert_allclose(turns, turns.round(), atol=1e-9)
    assert magnitude.get_xscale() == "log"


def test_phase_is_unwrapped_and_points_lie_next_to_their_curve(sweep):
    curve = gb.frequency_response(Tilt(), TRUTH, np.geomspace(0.5, 200, 200))
    axes = gb.plotting.bode(curve, sweep)[1]
    (line,), (data,) = curves(axes), points(axes)
    degrees = line.get_ydata()
    assert np.abs(np.diff(degrees)).max() < 60
    assert np.ptp(degrees) > 360
    there = np.interp(np.log(data.get_xdata()), np.log(line.get_xdata()), degrees)
    np.testing.assert_allclose(data.get_ydata(), there, atol=2)


def test_phases_of_each_pair_begin_within_half_a_turn(rotors, pitch):
    joint = replace(rotors, parts=(*pitch.parts, *rotors.parts), directions=None)
    axes = gb.plotting.bode(joint)[1]
    assert [-180 < line.get_ydata()[0] <= 180 for line in curves(axes)] == [True, True]
    for line in points(axes):
        low, high = (-180, 0) if line.get_label().startswith("rotor") else (60, 200)
        assert np.all((low < line.get_ydata()) & (line.get_ydata() < high))


def test_whole_curves_are_moved_together_within_their_pair_only():
    omega = np.geomspace(1, 10, 50)
    first = gb.FrequencyResponse(
        omega, np.exp(1j * np.radians(170 - 5 * omega)), "u", "y", source="model", name="a"
    )
    second = replace(first, response=first.response * np.exp(0.5j), name="b")
    third = replace(
        first, response=np.full(50, np.exp(-1j * np.radians(100))), output="z", name="c"
    )
    one, other, apart = curves(gb.plotting.bode(first, second, third)[1])
    np.testing.assert_allclose(apart.get_ydata(), -100)
    np.testing.assert_allclose(one.get_ydata(), 170 - 5 * omega)
    np.testing.assert_allclose(other.get_ydata() - one.get_ydata(), np.degrees(0.5))


def test_a_wrong_sign_stays_within_half_a_turn_of_the_curve(rotors):
    axes = gb.plotting.bode(rotors)[1]
    (line,) = curves(axes)
    for data in points(axes):
        there = np.interp(np.log(data.get_xdata()), np.log(line.get_xdata()), line.get_ydata())
        assert np.abs(data.get_ydata() - there).max() <= 180


def test_phases_of_two_data_do_not_drift_apart_by_whole_turns(sweep):
    turned = replace(sweep, response=sweep.response * np.exp(0.1j), name="turned")
    first, second = points(gb.plotting.bode(sweep, turned)[1])
    np.testing.assert_allclose(second.get_ydata() - first.get_ydata(), np.degrees(0.1))


def test_errors_of_several_fits_have_the_color_of_their_curves(pitch):
    other = gb.fit(gb.Problem(Tilt(), pitch.parts[0].data, fixed={"a1": 0.0}), **QUICK)
    magnitude, *_, turn = gb.plotting.bode(pitch, other)
    shown = [line.get_color() for line in turn.get_lines() if line.get_linestyle() == "None"]
    assert shown == [line.get_color() for line in curves(magnitude)]


def test_users_axes_may_leave_out_the_errors(pitch, sweep):
    figure = Figure()
    for count in (2, 4):
        assert len(gb.plotting.bode(pitch, axes=figure.subplots(count, 1))) == count
    with pytest.raises(ValueError, match="has 3 panels"):
        gb.plotting.bode(sweep, axes=figure.subplots(4, 1))


def test_the_values_are_data_curve_band_and_errors():
    fit = lag()
    (bode,) = bode_figures([fit])
    part = fit.responses[0]
    labels = [panel.label.partition(",")[0] for panel in bode.panels]
    assert labels == ["Magnitude of y/u", "Phase of y/u", "Coherence γ²", "Error", "Error"]
    magnitude, phase, coherence, error, turn = bode.panels
    measured = named(magnitude, "lag", "points")
    assert measured.y == pytest.approx(20 * np.log10(np.abs(part.data.response)))
    for panel in bode.panels:
        assert named(panel, "lag", "points").x.tolist() == part.data.omega.tolist()
    high = np.abs(part.data.response) + np.sqrt(part.data.variance / 2)
    assert measured.high == pytest.approx(20 * np.log10(high))
    angle = np.degrees(np.angle(part.data.response))
    assert named(phase, "lag", "points").y == pytest.approx(angle)
    assert named(coherence, "lag", "points").y == pytest.approx(part.data.coherence)

    ratio = part.data.response / part.response
    size = np.sqrt(part.data.variance / 2) / np.abs(part.data.response)  # of one component
    left = named(error, "lag", "points")
    assert left.y == pytest.approx(20 * np.log10(np.abs(ratio)))
    assert left.y - left.low == pytest.approx(-20 * np.log10(1 - size))
    assert left.high - left.y == pytest.approx(20 * np.log10(1 + size))
    turned = named(turn, "lag", "points")
    assert turned.y == pytest.approx(np.degrees(np.angle(ratio)))
    assert turned.high - turned.y == pytest.approx(np.degrees(size))

    band = fit.response_band(part.data.omega, part=0)
    low, high = (20 * np.log10(limit) for limit in band.magnitude)
    middle = 20 * np.log10(np.abs(band.response.response))
    for panel, shift in ((magnitude, 0), (error, middle)):
        shade = named(panel, "fit of", "band")
        at = np.log(band.omega)
        assert np.interp(at, np.log(shade.x), shade.low) == pytest.approx(low - shift, abs=1e-3)
        assert np.interp(at, np.log(shade.x), shade.high) == pytest.approx(high - shift, abs=1e-3)
    assert bode.is_logarithmic
    for words in ("95 % confidence band", "one standard deviation", "measured less fitted"):
        assert words in bode.caption
    assert not [s for s in bode_figures([fit], level=None)[0].panels[0].series if s.kind == "band"]


def test_bands_lie_about_the_response_less_its_bias(pitch):
    """In any order of the frequencies."""
    shade = named(bode_figures([pitch])[0].panels[1], "fit of", "band")
    band = pitch.response_band()
    assert np.all(np.diff(shade.x) > 0)
    low, high = (np.unwrap(limit) for limit in band.phase)
    assert shade.high - shade.low == pytest.approx(np.degrees(high - low))


def test_more_pairs_than_colors_have_a_row_each():
    omega = np.geomspace(1, 10, 5)
    responses = [
        gb.FrequencyResponse(omega, (k + 1) / (1j * omega + 1), "u", f"y{k}") for k in range(7)
    ]
    assert len(gb.plotting.bode(*responses[:6])) == 2
    axes = gb.plotting.bode(*responses)
    assert [ax.get_ylabel() for ax in axes[::2]] == [f"Magnitude of y{k}/u, dB" for k in range(7)]
    together = gb.plotting.bode(*responses, axes=Figure().subplots(2, 1))
    assert [len(points(ax)) for ax in together] == [7, 7]


class Notch(gb.TransferFunction):
    """Nothing passes at one frequency."""

    input, output = "u", "y"
    w = gb.Parameter(3.0, bounds=(1, 10), unit="rad/s")

    def response(self, s, p):
        return (s**2 + p.w**2) / (s + 1) ** 2


def test_the_errors_of_points_are_seen_beside_a_zero_of_the_response():
    omega = np.geomspace(1, 10, 30)
    random = np.random.default_rng(2)
    errors = 0.02 * (random.normal(size=30) + 1j * random.normal(size=30))
    exact = gb.frequency_response(Notch(), {"w": 3.0}, omega)
    data = replace(exact, response=exact.response * (1 + errors), source="measured", name="flight")
    fit = gb.fit(gb.Problem(Notch(), data), starts=4, progress=False)
    (bode,) = bode_figures([fit])
    magnitude, _, error, _ = bode.panels
    shade = named(magnitude, "fit of", "band")
    assert 5 < np.max(shade.high - shade.low) <= 40  # dB
    largest = np.abs(named(error, "flight", "points").y).max()
    assert largest < error.limits[1] < 2 * largest < 2
