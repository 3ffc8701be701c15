"""The Bode diagram: decibels, unwrapped phases, coherence."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_lines import QUICK, TRUTH, curves, points
from matplotlib.figure import Figure

import greybox as gb
from greybox.models.tilt import Tilt
from greybox.plotting.bode import _moved, band_limits


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
    joint = replace(rotors, parts=(*pitch.parts, *rotors.parts), known=None)
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


def test_phases_that_no_curve_guides_are_unwrapped_by_themselves():
    omega = np.geomspace(1, 10, 60)
    data = gb.FrequencyResponse(omega, np.exp(-1j * np.radians(60 + 40 * omega)), "u", "y")
    off = replace(data, response=np.ones(60), source="model", name="off")
    (line,) = points(gb.plotting.bode(off, data)[1])
    np.testing.assert_allclose(np.diff(line.get_ydata()), -40 * np.diff(omega))


@pytest.mark.parametrize("omega", [[3.0], [3.0, 4.2], [0.01, 2000.0]])
def test_every_frequency_axis_has_numbers(omega):
    axes = gb.plotting.bode(gb.FrequencyResponse(omega, np.ones(len(omega))))
    (low, high), ticks = axes[-1].get_xlim(), axes[-1].xaxis.get_majorticklocs()
    assert np.sum((low <= ticks) & (ticks <= high)) >= 2


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


def test_coherence_and_variance_are_shown_where_known(sweep, pitch):
    magnitude, phase, coherence = gb.plotting.bode(sweep)
    np.testing.assert_array_equal(points(coherence)[0].get_ydata(), sweep.coherence)
    (bars,) = [c for c in phase.collections if len(c.get_segments()) == len(sweep)]
    low, high = np.array(bars.get_segments())[:, :, 1].T
    np.testing.assert_allclose((high - low) / 2, np.degrees(0.1 / np.sqrt(2)))
    assert magnitude.collections
    assert not gb.plotting.bode(pitch, level=None)[0].collections


def test_errors_and_bands_are_those_of_the_fit(pitch):
    magnitude, phase, error, turn = gb.plotting.bode(pitch, level=0.9)
    part, band = pitch.parts[0], pitch.response_band(level=0.9)
    ratio = part.data.response / part.response
    for ax, expected in (
        (error, 20 * np.log10(np.abs(ratio))),
        (turn, np.degrees(np.angle(ratio))),
    ):
        line = next(line for line in ax.get_lines() if line.get_linestyle() == "None")
        np.testing.assert_allclose(line.get_ydata(), expected)
    top = 20 * np.log10(band.magnitude[1])
    for ax, expected in (
        (magnitude, top.max()),
        (error, (top - 20 * np.log10(np.abs(band.response.response))).max()),
    ):
        (shade,) = [each for each in ax.collections if type(each).__name__ != "LineCollection"]
        np.testing.assert_allclose(shade.get_paths()[0].vertices[:, 1].max(), expected, rtol=1e-6)
    assert phase.collections


def test_errors_of_several_fits_have_the_color_of_their_curves(pitch):
    other = gb.fit(gb.Problem(Tilt(), pitch.parts[0].data, fixed={"a1": 0.0}), **QUICK)
    magnitude, *_, turn = gb.plotting.bode(pitch, other)
    shown = [line.get_color() for line in turn.get_lines() if line.get_linestyle() == "None"]
    assert shown == [line.get_color() for line in curves(magnitude)]


def test_users_axes_may_leave_out_the_errors(pitch, sweep):
    figure = Figure()
    for count in (2, 4):
        assert len(gb.plotting.bode(pitch, axes=figure.subplots(count, 1))) == count
    with pytest.raises(ValueError, match="draws 2 panels"):
        gb.plotting.bode(sweep, axes=figure.subplots(4, 1))


def test_bands_are_the_half_widths_about_the_response_less_its_bias_in_decibel_and_degrees():
    omega = np.array([4.0, 1.0, 2.0])
    offset, half = (
        np.array([[0.0, 0.1, 0.2], [0.0, -0.1, 0.3]]),
        np.array([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]]),
    )
    found, low, high = band_limits(SimpleNamespace(omega=omega, offset=offset, half_width=half))
    order = [1, 2, 0]
    np.testing.assert_array_equal(found, omega[order])
    for limit, sign in ((low, -1), (high, 1)):
        decibel = 20 * np.log10(np.exp(offset[0] + sign * half[0]))
        np.testing.assert_allclose(
            limit, [decibel[order], np.degrees(offset[1] + sign * half[1])[order]]
        )


@pytest.mark.parametrize(
    ("span", "step"), [(100, 15), (300, 45), (1200, 180), (2500, 360), (5500, 1440), (20000, 2880)]
)
def test_phases_have_at_most_eight_lines_at_parts_or_multiples_of_a_turn(span, step):
    omega = np.linspace(1, 2, 600)
    axes = gb.plotting.bode(
        gb.FrequencyResponse(omega, np.exp(-1j * np.radians(span / 1.1 * (omega - 1))))
    )[1]
    low, high = axes.get_ylim()
    ticks = axes.get_yticks()
    assert np.diff(ticks) == pytest.approx(step)
    assert 3 <= np.sum((low <= ticks) & (ticks <= high)) <= 8
    np.testing.assert_allclose(ticks % step, 0)


def test_whole_turns_are_those_between_the_means_over_the_frequencies_that_both_have():
    omega = np.geomspace(1, 100, 50)
    curve = (omega, np.where(omega < 1.2, 190.0, 20.0) - 720)
    beside = (np.geomspace(0.1, 10, 40), np.zeros(40))
    moved = _moved(curve, beside)
    np.testing.assert_array_equal(moved[0], omega)
    np.testing.assert_allclose(moved[1], curve[1] + 720)
    apart = _moved(
        (np.array([20.0, 30.0]), np.array([400.0, 500.0])), beside
    )  # no frequency in common
    np.testing.assert_allclose(apart[1], [40.0, 140.0])
