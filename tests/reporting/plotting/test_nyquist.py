"""The Nyquist diagram shows the curve and every point."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lines import TRUTH, curves, named, numbers, points
from page_results import lag
from scipy import stats

import greybox as gb
from greybox.models.tilt import Tilt
from greybox.reporting.plotting.nyquist import nyquist_figures


def test_nyquist_draws_the_curve_and_every_point(pitch):
    (axes,) = gb.plotting.nyquist(pitch)
    (line,), (data,) = curves(axes), points(axes)
    part = pitch.parts[0]
    np.testing.assert_array_equal(
        line.get_xydata(), np.column_stack([part.curve.alpha, part.curve.beta])
    )
    order = np.argsort(part.data.omega)
    np.testing.assert_array_equal(
        data.get_xydata(), np.column_stack([part.data.alpha, part.data.beta])[order]
    )
    assert axes.get_aspect() == 1
    assert axes.get_xlabel() == "Real part of θ/u"


def test_nyquist_numbers_the_points_without_overlap(pitch):
    (axes,) = gb.plotting.nyquist(pitch)
    assert "1 rad/s" in numbers(axes)
    assert {"2", "3", "4", "8"} < set(numbers(axes))
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    spots = axes.transData.transform(points(axes)[0].get_xydata())
    assert not any(box.contains(*spot) for box in boxes for spot in spots)


def test_nyquist_of_many_points_numbers_a_few(sweep):
    assert 4 <= len(numbers(gb.plotting.nyquist(sweep)[0])) <= len(sweep) / 2


def test_each_pair_has_a_panel_when_one_would_vanish_beside_another(rotors, pitch):
    joint = replace(rotors, parts=(*rotors.parts, *pitch.parts), directions=None)
    for first, second in (gb.plot(joint).axes[:2],):
        assert [line.get_label() for line in points(first)] == [f"rotor {k}" for k in (1, 2, 3, 4)]
        assert [line.get_label() for line in points(second)] == ["pitch"]
        assert (len(curves(first)), len(curves(second))) == (1, 1)
        assert (first.get_xlabel(), second.get_xlabel()) == ("Real part of Ω/u", "Real part of θ/u")
        assert numbers(second)
    assert len(gb.plotting.bode(joint)) == 4


def test_every_pair_has_a_panel():
    one = gb.FrequencyResponse([1.0, 2.0], [1, 1j], "u", "theta")
    other = gb.FrequencyResponse([1.0, 2.0], [2, 2j], "u", "phi")
    assert len(nyquist_figures([one, other])) == 2
    assert len(nyquist_figures([one, replace(other, output="theta")])) == 1


def test_data_without_names_belong_to_the_pair_of_the_only_curve(sweep):
    data = replace(sweep, response=sweep.response / 100, input="", output="")
    curve = gb.frequency_response(Tilt(), TRUTH, sweep.omega)
    assert len(nyquist_figures([curve, data])) == 1


def test_a_curve_far_off_leaves_the_data_visible(pitch):
    (part,) = pitch.parts
    off = replace(part, curve=replace(part.curve, response=-1e3 * part.curve.response))
    (axes,) = gb.plotting.nyquist(replace(pitch, parts=(off,)))
    assert all(axes.viewLim.contains(*spot) for spot in points(axes)[0].get_xydata())
    assert np.ptp(axes.get_ylim()) < 5 * np.abs(part.data.response).max()
    assert "cut off" in axes.get_title()
    assert "cut off" not in gb.plotting.nyquist(pitch)[0].get_title()


def test_points_of_known_variance_have_their_region_and_curves_their_band(pitch):
    data = gb.FrequencyResponse([1.0, 2.0], [1.0, 1j], variance=[0.02, 0.08])
    for given, dof in ((data, 1e9), (replace(data, dof=[6.0, 6.0]), 6)):
        (circles,) = gb.plotting.nyquist(given)[0].collections
        widths = [np.ptp(path.vertices[:, 0]) / 2 for path in circles.get_paths()]
        np.testing.assert_allclose(
            widths, np.sqrt(data.variance * stats.f.ppf(0.95, 2, dof)), rtol=1e-3
        )

    (axes,) = gb.plotting.nyquist(pitch)
    (band,) = axes.collections
    ellipses = pitch.response_band().ellipses()
    np.testing.assert_allclose(
        band.get_paths()[7].vertices[:-1], np.column_stack([ellipses[7].real, ellipses[7].imag])
    )
    assert not gb.plotting.nyquist(pitch, data, level=None)[0].collections


def test_the_values_tell_each_point_and_far_curves_leave_the_data_readable():
    fit = lag()
    (figure,) = nyquist_figures([fit])
    data = fit.responses[0].data
    points = named(figure.panels[0], "lag", "points")
    assert points.x + 1j * points.y == pytest.approx(data.response)
    assert points.notes[0].endswith("at 1 rad/s")
    assert complex(points.notes[3].split()[0]) == pytest.approx(data.response[3], rel=1e-3)
    assert (figure.limits, figure.is_plane) == (None, True)

    part = fit.responses[0]
    far = replace(part, curve=replace(part.curve, response=1e3 * part.curve.response))
    (figure,) = nyquist_figures([replace(fit, parts=(far, fit.parts[1]), models=None)])
    half = np.abs(data.response).max() / 2
    assert figure.limits == pytest.approx((-half, data.response.real.max() + half))
    assert figure.panels[0].limits == pytest.approx((data.response.imag.min() - half, half))
    assert "cut off" in figure.caption
