"""Figures show what the fit holds: the curve, every point, every run."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.models.rotor import Rotor
from greybox.models.tilt import Tilt
from greybox.plotting import figures as plotting

DATA = Path(__file__).parents[2] / "problems" / "data"
QUICK = {"starts": 8, "progress": False}
TRUTH = {"a1": -14.61, "a2": 2.97, "a3": 8.47, "a4": 295.5, "T_delay": 0.04}


def table(file, prefix, **options):
    return gb.read_response(DATA / f"{file}.csv", prefix=prefix, **options)


@pytest.fixture(scope="module")
def pitch():
    data = table("table_3_1", "pitch_", input="u", output="theta", name="pitch")
    return gb.fit(gb.Problem(Tilt(), data), **QUICK)


@pytest.fixture(scope="module")
def rotors():
    parts = [gb.Problem(Rotor(), table("table_4_2", f"rotor{k}_", name=f"rotor {k}")) for k in (1, 2, 3, 4)]
    return gb.fit(parts[0] + parts[1] + parts[2] + parts[3], **QUICK)


@pytest.fixture(scope="module")
def two_points():
    hover = gb.Problem(Tilt(), table("table_3_1", "pitch_", name="hover"), rename={"a1": "a1_0", "a3": "a3_0"})
    return gb.fit(hover + gb.Problem(Tilt(), table("table_4_3", "pitch_", name="5°")), **QUICK)


@pytest.fixture(scope="module")
def failed(pitch):
    return gb.fit(gb.Problem(Tilt(), pitch.parts[0].data), **QUICK, solver_options={"max_iter": 2})


@pytest.fixture(scope="module")
def sweep():
    """A delayed tilt whose phase wraps, with coherence and variance, in no order of frequency."""
    omega = np.random.default_rng(0).permutation(np.geomspace(0.5, 200, 40))
    exact = gb.frequency_response(Tilt(), TRUTH, omega).response
    variance = (0.1 * np.abs(exact)) ** 2
    known = {"coherence": np.full(40, 0.9), "variance": variance, "name": "sweep"}
    return gb.FrequencyResponse(omega, exact, "u", "theta", **known)


def points(axes):
    return [line for line in axes.get_lines() if line.get_linestyle() == "None" and line.get_label()[0] != "_"]


def curves(axes):
    return [line for line in axes.get_lines() if line.get_linestyle() != "None" and line.get_label()[0] != "_"]


def numbers(axes):
    return [text.get_text() for text in axes.texts]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_nyquist_draws_the_curve_and_every_point(pitch):
    (axes,) = plotting.plot_nyquist(pitch).axes
    (line,), (data,) = curves(axes), points(axes)
    part = pitch.parts[0]
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([part.curve.alpha, part.curve.beta]))
    np.testing.assert_array_equal(data.get_xydata(), np.column_stack([part.data.alpha, part.data.beta]))
    assert axes.get_aspect() == 1
    assert axes.get_xlabel() == "Real part of θ/u"


def test_nyquist_numbers_the_points_without_overlap(pitch):
    figure = plotting.plot_nyquist(pitch)
    (axes,) = figure.axes
    assert sorted(numbers(axes)) == sorted(["1 rad/s", "2", "3", "3.5", "4", "5.34", "8", "12", "16", "20.1"])
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    spots = axes.transData.transform(points(axes)[0].get_xydata())
    assert not any(box.contains(*spot) for box in boxes for spot in spots)


def test_nyquist_of_many_points_numbers_a_few(sweep):
    assert 4 <= len(numbers(plotting.plot_nyquist(sweep).axes[0])) <= 12


def test_a_joint_fit_shows_every_part_and_a_common_curve_once(rotors):
    figure = plotting.plot_nyquist(rotors)
    (axes,) = figure.axes
    assert [line.get_label() for line in points(axes)] == [f"rotor {k}" for k in (1, 2, 3, 4)]
    assert len({line.get_color() for line in points(axes)}) == 4
    assert len(curves(axes)) == 1
    assert legend(figure) == ["rotor 1", "rotor 2", "rotor 3", "rotor 4", "fit of Rotor"]


def test_a_common_curve_over_a_part_of_the_band_is_not_drawn_again(rotors):
    first, second, *_ = rotors.parts
    inside = slice(50, 150)
    shorter = replace(second.curve, omega=second.curve.omega[inside], response=second.curve.response[inside])
    fit = replace(rotors, parts=(replace(second, curve=shorter), first))
    (line,) = curves(plotting.plot_nyquist(fit).axes[0])
    np.testing.assert_array_equal(line.get_xdata(), first.curve.alpha)


def test_different_curves_have_the_color_of_their_data(two_points):
    (axes,) = plotting.plot_nyquist(two_points).axes
    assert len(curves(axes)) == 2
    for line, part in zip(curves(axes), two_points.parts, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), part.curve.alpha)
        data = next(k for k in points(axes) if k.get_label() == part.name)
        assert data.get_color() == line.get_color()


@pytest.mark.parametrize("draw", [plotting.plot_nyquist, plotting.plot_bode])
def test_an_overlay_draws_shared_data_once(draw, pitch):
    other = gb.fit(gb.Problem(Tilt(), pitch.parts[0].data, fixed={"a1": 0.0}), **QUICK)
    figure = draw(pitch, other, labels=("published", "refitted"))
    axes = figure.axes[0]
    assert len(points(axes)) == 1
    assert len({(line.get_color(), line.get_linestyle()) for line in curves(axes)}) == 2
    assert legend(figure) == ["pitch", "published", "refitted"]


def test_overlaid_fits_without_labels_are_told_apart(pitch):
    other = replace(pitch, name="pitch again")
    assert legend(plotting.plot_nyquist(pitch, other)) == ["pitch", "fit of pitch", "fit of pitch again"]
    assert legend(plotting.plot_nyquist(pitch, pitch)) == ["pitch", "fit 1", "fit 2"]


@pytest.mark.parametrize("draw", [plotting.plot_nyquist, plotting.plot_bode])
def test_plain_responses_are_points_when_measured_and_lines_when_from_a_model(draw, pitch):
    published = gb.frequency_response(Tilt(), TRUTH, [9.0, 3.0, 1.0])
    axes = draw(published, pitch.parts[0].data).axes[0]
    (line,), (data,) = curves(axes), points(axes)
    assert (len(line.get_xdata()), len(data.get_xdata())) == (3, 10)
    assert line.get_label() == "Tilt"
    assert len(points(draw(pitch.parts[0].data).axes[0])) == 1


def test_bode_is_in_decibel_and_degrees(pitch):
    magnitude, phase = plotting.plot_bode(pitch).axes
    part = pitch.parts[0]
    for line, expected in ((curves(magnitude)[0], part.curve), (points(magnitude)[0], part.data)):
        np.testing.assert_allclose(line.get_xdata(), expected.omega)
        np.testing.assert_allclose(line.get_ydata(), 20 * np.log10(np.abs(expected.response)))
    turns = (curves(phase)[0].get_ydata() - np.degrees(np.angle(part.curve.response))) / 360
    np.testing.assert_allclose(turns, turns.round(), atol=1e-9)
    assert magnitude.get_xscale() == "log"


def test_phase_is_unwrapped_and_points_lie_next_to_their_curve(sweep):
    curve = gb.frequency_response(Tilt(), TRUTH, np.geomspace(0.5, 200, 200))
    axes = plotting.plot_bode(curve, sweep).axes[1]
    (line,), (data,) = curves(axes), points(axes)
    degrees = line.get_ydata()
    assert np.abs(np.diff(degrees)).max() < 60
    assert np.ptp(degrees) > 360
    there = np.interp(np.log(data.get_xdata()), np.log(line.get_xdata()), degrees)
    np.testing.assert_allclose(data.get_ydata(), there, atol=2)


def test_each_pair_has_a_panel_when_one_would_vanish_beside_another(rotors, pitch):
    joint = replace(rotors, parts=(*rotors.parts, *pitch.parts))
    for draw in (plotting.plot_nyquist, plotting.plot):
        first, second = draw(joint).axes[:2]
        assert [line.get_label() for line in points(first)] == [f"rotor {k}" for k in (1, 2, 3, 4)]
        assert [line.get_label() for line in points(second)] == ["pitch"]
        assert (len(curves(first)), len(curves(second))) == (1, 1)
        assert (first.get_xlabel(), second.get_xlabel()) == ("Real part of Ω/u", "Real part of θ/u")
        assert numbers(second)
    assert len(plotting.plot_bode(joint).axes) == 2


@pytest.mark.parametrize(("factor", "count"), [(4, 1), (1 / 4, 1), (6, 2), (1 / 6, 2), (1e-9, 2)])
def test_pairs_of_like_size_share_a_panel(factor, count):
    one = gb.FrequencyResponse([1.0, 2.0], [1, 1j], "u", "theta")
    other = gb.FrequencyResponse([1.0, 2.0], [factor, 1j * factor], "u", "phi")
    assert len(plotting.plot_nyquist(one, other).axes) == count
    assert len(plotting.plot_nyquist(one, replace(other, output="theta")).axes) == 1


def test_data_without_names_belong_to_the_pair_of_the_only_curve(sweep):
    data = replace(sweep, response=sweep.response / 100, input="", output="")
    assert len(plotting.plot_nyquist(gb.frequency_response(Tilt(), TRUTH, sweep.omega), data).axes) == 1


def test_a_curve_far_off_leaves_the_data_visible(pitch):
    (part,) = pitch.parts
    off = replace(part, curve=replace(part.curve, response=-1e3 * part.curve.response))
    (axes,) = plotting.plot_nyquist(replace(pitch, parts=(off,))).axes
    assert all(axes.viewLim.contains(*spot) for spot in points(axes)[0].get_xydata())
    assert np.ptp(axes.get_ylim()) < 5 * np.abs(part.data.response).max()
    assert "cut off: curves reach a magnitude of" in axes.get_title()
    assert "cut off" not in plotting.plot_nyquist(pitch).axes[0].get_title()


def test_phases_of_each_pair_begin_within_half_a_turn(rotors, pitch):
    joint = replace(rotors, parts=(*pitch.parts, *rotors.parts))
    axes = plotting.plot_bode(joint).axes[1]
    assert [-180 < line.get_ydata()[0] <= 180 for line in curves(axes)] == [True, True]
    for line in points(axes):
        low, high = (-180, 0) if line.get_label().startswith("rotor") else (60, 200)
        assert np.all((low < line.get_ydata()) & (line.get_ydata() < high))


def test_whole_curves_are_moved_together_within_their_pair_only():
    omega = np.geomspace(1, 10, 50)
    first = gb.FrequencyResponse(omega, np.exp(1j * np.radians(170 - 5 * omega)), "u", "y", source="model", name="a")
    second = replace(first, response=first.response * np.exp(0.5j), name="b")
    third = replace(first, response=np.full(50, np.exp(-1j * np.radians(100))), output="z", name="c")
    one, other, apart = curves(plotting.plot_bode(first, second, third).axes[1])
    np.testing.assert_allclose(apart.get_ydata(), -100)
    np.testing.assert_allclose(one.get_ydata(), 170 - 5 * omega)
    np.testing.assert_allclose(other.get_ydata() - one.get_ydata(), np.degrees(0.5))


def test_phases_that_no_curve_guides_are_unwrapped_by_themselves():
    omega = np.geomspace(1, 10, 60)
    data = gb.FrequencyResponse(omega, np.exp(-1j * np.radians(60 + 40 * omega)), "u", "y")
    off = replace(data, response=np.ones(60), source="model", name="off")
    (line,) = points(plotting.plot_bode(off, data).axes[1])
    np.testing.assert_allclose(np.diff(line.get_ydata()), -40 * np.diff(omega))


def test_a_refined_resonance_is_drawn_whole_and_counts_as_the_same_curve(rotors):
    def oscillator(omega):
        return gb.FrequencyResponse(omega, 3 / (25 - omega**2 + 0.02j * omega), "u", "y", source="model", name="o")

    dense = 5 + 0.5 * np.sinh(np.linspace(-6, 6, 1500)) / np.sinh(6)
    fine = oscillator(np.union1d(np.geomspace(0.5, 50, 500), dense))
    finer = oscillator(np.union1d(np.geomspace(1, 20, 400), dense))
    parts = [replace(part, curve=curve) for part, curve in zip(rotors.parts, (finer, fine), strict=False)]
    (axes,) = plotting.plot_nyquist(replace(rotors, parts=tuple(parts))).axes
    (line,) = curves(axes)
    np.testing.assert_array_equal(line.get_xdata(), fine.alpha)
    steps = np.diff(axes.transData.transform(line.get_xydata()), axis=0)
    assert np.hypot(*steps.T).max() < 15  # pixels
    phase = curves(plotting.plot_bode(fine).axes[1])[0].get_ydata()
    assert -180 <= phase.min() < phase.max() <= 0


def test_many_points_are_small_and_below_the_curve(sweep):
    omega = np.geomspace(0.5, 200, 3000)
    exact = gb.frequency_response(Tilt(), TRUTH, omega)
    data = gb.FrequencyResponse(omega, exact.response * 1e-9, "u", "theta", variance=np.full(3000, 1e-20))
    for draw in (plotting.plot_nyquist, plotting.plot_bode):
        figure = draw(data, replace(exact, response=exact.response * 1e-9))
        axes = figure.axes[0]
        (cloud,), (line,) = points(axes), curves(axes)
        assert len(cloud.get_xdata()) == 3000
        assert cloud.get_markersize() < points(draw(sweep).axes[0])[0].get_markersize()
        assert cloud.get_zorder() < line.get_zorder()
        assert figure.legends[0].get_lines()[0].get_markersize() > cloud.get_markersize()


@pytest.mark.parametrize("omega", [[3.0], [3.0, 4.2], [0.01, 2000.0]])
def test_every_frequency_axis_has_numbers(omega):
    figure = plotting.plot_bode(gb.FrequencyResponse(omega, np.ones(len(omega))))
    (low, high), ticks = figure.axes[-1].get_xlim(), figure.axes[-1].xaxis.get_majorticklocs()
    assert np.sum((low <= ticks) & (ticks <= high)) >= 2


def test_a_wrong_sign_stays_within_half_a_turn_of_the_curve(rotors):
    axes = plotting.plot_bode(rotors).axes[1]
    (line,) = curves(axes)
    for data in points(axes):
        there = np.interp(np.log(data.get_xdata()), np.log(line.get_xdata()), line.get_ydata())
        assert np.abs(data.get_ydata() - there).max() <= 180


def test_phases_of_two_data_do_not_drift_apart_by_whole_turns(sweep):
    turned = replace(sweep, response=sweep.response * np.exp(0.1j), name="turned")
    first, second = points(plotting.plot_bode(sweep, turned).axes[1])
    np.testing.assert_allclose(second.get_ydata() - first.get_ydata(), np.degrees(0.1))


def test_coherence_and_variance_are_shown_where_known(sweep, pitch):
    magnitude, phase, coherence = plotting.plot_bode(sweep).axes
    np.testing.assert_array_equal(points(coherence)[0].get_ydata(), sweep.coherence)
    (bars,) = [c for c in phase.collections if len(c.get_segments()) == len(sweep)]
    low, high = np.array(bars.get_segments())[:, :, 1].T
    np.testing.assert_allclose((high - low) / 2, np.degrees(0.1 / np.sqrt(2)))
    assert magnitude.collections
    assert not plotting.plot_bode(pitch).axes[0].collections


def test_starts_shows_every_run_sorted_and_grouped(pitch):
    (axes,) = plotting.plot_starts(pitch).axes
    drawn = points(axes)
    assert len(drawn) == len(pitch.minima)
    assert [len(line.get_xdata()) for line in drawn] == [len(m.runs) for m in pitch.minima]
    x, y = np.concatenate([line.get_xydata() for line in drawn]).T
    np.testing.assert_array_equal(np.sort(x), np.arange(1, 9))
    np.testing.assert_array_equal(y[np.argsort(x)], sorted(run.cost for run in pitch.runs))
    assert axes.get_title() == f"{pitch.agreeing} of 8 starts agree on the best minimum"


def test_starts_shows_failed_runs_at_the_right_and_never_their_cost(pitch):
    lost = [replace(run, converged=False, cost=0.0, status="Invalid_Number_Detected") for run in pitch.runs[:3]]
    kept = [m for m in (replace(m, runs=tuple(k for k in m.runs if k >= 3)) for m in pitch.minima) if m.runs]
    figure = plotting.plot_starts(replace(pitch, runs=(*lost, *pitch.runs[3:]), minima=tuple(kept)))
    crosses = points(figure.axes[0])[-1]
    np.testing.assert_array_equal(crosses.get_xdata(), [6, 7, 8])
    assert legend(figure)[-1] == "3 × failed"
    assert figure.axes[0].get_ylim()[0] > 0


def test_starts_is_logarithmic_when_costs_span_decades(pitch):
    runs = (*pitch.runs[:-1], replace(pitch.runs[-1], cost=1e4))
    assert plotting.plot_starts(replace(pitch, runs=runs)).axes[0].get_yscale() == "log"
    assert plotting.plot_starts(pitch).axes[0].get_yscale() == "linear"


def test_more_minima_than_colors_share_one_gray(pitch):
    each = tuple(replace(pitch.minima[0], runs=(run.index,)) for run in pitch.runs)
    figure = plotting.plot_starts(replace(pitch, minima=each))
    assert legend(figure)[-1] == "2 runs in 2 further minima"
    assert sum(len(line.get_xdata()) for line in points(figure.axes[0])) == 8
    figure = plotting.plot_starts(replace(pitch, minima=each[:7], runs=pitch.runs[:7]))
    assert legend(figure)[-1] == "1 run in 1 further minimum"


def test_a_fit_that_did_not_converge_shows_its_data_and_says_so(failed):
    for draw in (plotting.plot_nyquist, plotting.plot_bode):
        axes = draw(failed).axes[0]
        assert (len(points(axes)), len(curves(axes))) == (1, 0)
        assert axes.get_title() == "pitch: no start converged"
    assert plotting.plot_starts(failed).axes[0].get_title() == "none of 8 starts converged"
    assert plotting.plot(failed).get_suptitle() == "pitch: no start converged"


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_every_figure_can_be_saved(kind, tmp_path, pitch, rotors, failed, sweep):
    drawn = [plotting.plot(rotors), plotting.plot_starts(failed), plotting.plot_nyquist(pitch, rotors)]
    drawn += [plotting.plot_bode(failed), plotting.plot_bode(pitch, rotors, sweep)]
    for k, figure in enumerate(drawn):
        figure.savefig(tmp_path / f"{k}.{kind}")
        assert (tmp_path / f"{k}.{kind}").stat().st_size > 1000


def test_a_loaded_fit_needs_no_model(pitch):
    assert len(curves(plotting.plot(replace(pitch, models=None)).axes[0])) == 1


def test_one_frequency_and_odd_names_are_drawn():
    data = gb.FrequencyResponse([2.0], [0.0], input="RATE.POut", output="Omega_1", name="_50 % of $u$ and $x")
    curve = gb.frequency_response(Rotor(), {}, [2.0])
    for draw in (plotting.plot_nyquist, plotting.plot_bode):
        draw(data, curve).draw_without_rendering()


@pytest.mark.parametrize(
    ("name", "shown"),
    [("theta", "θ"), ("Omega", "Ω"), ("ETA", "ETA"), ("u", "u"), ("u_phi", "u_φ"), ("RATE.POut", "RATE.POut")],
)
def test_signal_names_become_symbols(name, shown):
    data = gb.FrequencyResponse([1.0, 2.0], [1, 1j], input="u", output=name)
    assert plotting.plot_nyquist(data).axes[0].get_ylabel() == f"Imaginary part of {shown}/u"


def test_wrong_use_is_said_in_a_sentence(pitch):
    with pytest.raises(ValueError, match="nothing to draw"):
        plotting.plot_nyquist()
    with pytest.raises(TypeError, match="give a Fit or a FrequencyResponse"):
        plotting.plot_bode([pitch])
    with pytest.raises(ValueError, match="1 labels for 2 fits"):
        plotting.plot_bode(pitch, pitch, labels=("one",))


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_importing_greybox_loads_no_matplotlib_and_plotting_no_pyplot():
    assert run("import sys, greybox; print('matplotlib' in sys.modules)") == "False"
    assert run("import sys, greybox.plotting.figures; print('matplotlib.pyplot' in sys.modules)") == "False"


def test_a_notebook_shows_the_figure_without_pyplot():
    pytest.importorskip("IPython")
    code = (
        "import sys, greybox as gb\n"
        "from IPython.core.formatters import DisplayFormatter\n"
        "from greybox.plotting.figures import plot_nyquist\n"
        "figure = plot_nyquist(gb.FrequencyResponse([1, 2], [1, 1j]))\n"
        "shown, _ = DisplayFormatter().format(figure)\n"
        "print(shown['image/png'][1:4].decode(), 'matplotlib.pyplot' in sys.modules)"
    )
    assert run(code) == "PNG False"
