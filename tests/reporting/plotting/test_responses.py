"""What a diagram of frequency responses shows: which points and curves, in which colors."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lines import QUICK, TRUTH, curves, legend, points

import greybox as gb
from greybox.models.tilt import Tilt
from greybox.reporting.plotting.nyquist import nyquist_figures


def test_a_joint_fit_shows_every_part_and_a_common_curve_once(rotors):
    (axes,) = gb.plotting.nyquist(rotors)
    assert [line.get_label() for line in points(axes)] == [f"rotor {k}" for k in (1, 2, 3, 4)]
    assert len({line.get_color() for line in points(axes)}) == 4
    assert len(curves(axes)) == 1
    assert legend(axes) == ["rotor 1", "rotor 2", "rotor 3", "rotor 4", "fit of Rotor", "95 % band"]


def test_a_common_curve_over_a_part_of_the_band_is_not_drawn_again(rotors):
    first, second, *_ = rotors.parts
    inside = slice(50, 150)
    shorter = replace(
        second.curve, omega=second.curve.omega[inside], response=second.curve.response[inside]
    )
    fit = replace(rotors, parts=(replace(second, curve=shorter), first))
    (line,) = curves(gb.plotting.nyquist(fit)[0])
    np.testing.assert_array_equal(line.get_xdata(), first.curve.alpha)


def test_different_curves_have_the_color_of_their_data(two_points):
    (axes,) = gb.plotting.nyquist(two_points)
    assert len(curves(axes)) == 2
    for line, part in zip(curves(axes), two_points.parts, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), part.curve.alpha)
        data = next(k for k in points(axes) if k.get_label() == part.name)
        assert data.get_color() == line.get_color()


@pytest.mark.parametrize("draw", [gb.plotting.nyquist, gb.plotting.bode])
def test_an_overlay_draws_shared_data_once(draw, pitch):
    other = gb.fit(gb.Problem(Tilt(), pitch.parts[0].data, fixed={"a1": 0.0}), **QUICK)
    axes = draw(pitch, other, labels=("published", "refitted"))[0]
    (data,) = points(axes)
    assert len({(line.get_color(), line.get_linestyle()) for line in curves(axes)}) == 2
    assert data.get_color() not in {line.get_color() for line in curves(axes)}
    assert legend(axes) == ["pitch", "published", "refitted", "95 % band"]


def test_overlaid_fits_without_labels_are_told_apart(pitch):
    (axes,) = gb.plotting.nyquist(pitch, pitch, level=None)
    assert legend(axes) == ["pitch", "fit of Tilt 1", "fit of Tilt 2"]


@pytest.mark.parametrize("draw", [gb.plotting.nyquist, gb.plotting.bode])
def test_plain_responses_are_points_when_measured_and_lines_when_from_a_model(draw, pitch):
    published = gb.frequency_response(Tilt(), TRUTH, [9.0, 3.0, 1.0])
    axes = draw(published, pitch.parts[0].data)[0]
    (line,), (data,) = curves(axes), points(axes)
    assert (len(line.get_xdata()), len(data.get_xdata())) == (3, 10)
    assert line.get_label() == "Tilt"
    assert len(points(draw(pitch.parts[0].data)[0])) == 1


def test_a_refined_resonance_is_drawn_whole_and_counts_as_the_same_curve(rotors):
    def oscillator(omega):
        return gb.FrequencyResponse(
            omega, 3 / (25 - omega**2 + 0.02j * omega), "u", "y", source="model", name="o"
        )

    dense = 5 + 0.5 * np.sinh(np.linspace(-6, 6, 1500)) / np.sinh(6)
    fine = oscillator(np.union1d(np.geomspace(0.5, 50, 500), dense))
    finer = oscillator(np.union1d(np.geomspace(1, 20, 400), dense))
    parts = [
        replace(part, curve=curve) for part, curve in zip(rotors.parts, (finer, fine), strict=False)
    ]
    (axes,) = gb.plotting.nyquist(replace(rotors, parts=tuple(parts)))
    (line,) = curves(axes)
    np.testing.assert_array_equal(line.get_xdata(), fine.alpha)
    steps = np.diff(axes.transData.transform(line.get_xydata()), axis=0)
    assert np.hypot(*steps.T).max() < 15  # pixels
    phase = curves(gb.plotting.bode(fine)[1])[0].get_ydata()
    assert -180 <= phase.min() < phase.max() <= 0


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("theta", "θ"),
        ("Omega", "Ω"),
        ("ETA", "ETA"),
        ("u", "u"),
        ("u_phi", "u_φ"),
        ("RATE.POut", "RATE.POut"),
    ],
)
def test_signal_names_become_symbols(name, shown):
    data = gb.FrequencyResponse([1.0, 2.0], [1, 1j], input="u", output=name)
    assert nyquist_figures([data])[0].panels[0].label == f"Imaginary part of {shown}/u"


def test_wrong_use_is_said_in_a_sentence(pitch):
    with pytest.raises(ValueError, match="nothing to draw"):
        gb.plotting.nyquist()
    with pytest.raises(TypeError, match="give a Fit or a FrequencyResponse"):
        gb.plotting.bode([pitch])
    with pytest.raises(ValueError, match="1 labels for 2 items"):
        gb.plotting.bode(pitch, pitch, labels=("one",))


def test_curves_of_different_items_have_different_lines(pitch):
    curve = gb.frequency_response(Tilt(), TRUTH, [1.0, 2.0, 5.0])
    axes = gb.plotting.bode(*[replace(curve, response=k * curve.response) for k in range(1, 6)])
    assert [line.get_linestyle() for line in curves(axes[0])] == ["-", "--", ":", "-.", "-"]
