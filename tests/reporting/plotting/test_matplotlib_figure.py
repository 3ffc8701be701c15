"""The renderer draws the values of a figure, into new axes or into those of a user."""

import numpy as np
import pytest
from drawn_lines import TRUTH, curves, legend, points
from matplotlib.figure import Figure as MatplotlibFigure

import greybox as gb
from greybox.data.record import Record, Recording
from greybox.models.tilt import Tilt
from greybox.reporting.plotting.figure import ANGLES, CROSS, GRAY, Figure, Panel, Series, band, rule
from greybox.reporting.plotting.matplotlib_figure import draw

X = np.arange(1.0, 6.0)


def drawn(*series, figure=None, **panel):
    """The axes of one panel."""
    (ax,) = draw(
        [
            Figure(
                "made",
                "x",
                [Panel("y, °", series, **panel)],
                **{"subject": "made", **(figure or {})},
            )
        ]
    )
    return ax


def test_every_kind_of_series_is_drawn_with_its_numbers_and_its_name():
    line = Series("curve", "line", X, np.array([1, 2, np.inf, 4, 5.0]), color=1, style=1)
    dots = Series("data", "points", X, X**2, low=X**2 - 1, high=X**2 + 2)
    failed = Series("failed", "points", X, X, GRAY, CROSS)
    ax = drawn(
        line, dots, failed, band("curve", X, X - 1, X + 1, 1), rule(3.0), figure={"bands": "95 %"}
    )
    (curve,) = curves(ax)
    np.testing.assert_array_equal(curve.get_ydata(), [1, 2, np.nan, 4, 5])
    assert (curve.get_color(), curve.get_linestyle()) == ("#D55E00", "--")
    assert [line.get_marker() for line in points(ax)] == ["o", "x"]
    bars, shade = ax.collections
    segments = np.array([path.vertices[:, 1] for path in bars.get_paths()])
    np.testing.assert_array_equal(segments, np.column_stack([X**2 - 1, X**2 + 2]))
    assert shade.get_paths()[0].get_extents().y1 == 6
    assert ax.get_lines()[-1].get_ydata()[0] == 3
    assert legend(ax) == ["data", "failed", "curve", "95 %"]
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) == ("x", "y, °", "made")


def test_regions_are_filled_or_hollow_and_a_wide_one_is_cut_off():
    x = np.array([np.nan, -1e3, 1e3, 0, np.nan, 1, 2, 1.5])
    filled = Series("", "regions", x, x**2)
    hollow = Series("", "regions", X, X, is_hollow=True)
    plane = {"is_plane": True}
    ax = drawn(Series("p", "points", X, X), filled, hollow, figure=plane)
    assert [len(c.get_paths()) for c in ax.collections] == [2, 1]
    assert [len(c.get_facecolor()) for c in ax.collections] == [1, 0]
    ax.figure.draw_without_rendering()
    assert np.ptp(ax.get_xlim()) < 20
    assert ax.get_aspect() == 1


@pytest.mark.parametrize(("count", "size"), [(20, 1.0), (100, 1.0), (400, 0.5)])
def test_the_ink_of_many_points_is_that_of_a_hundred(count, size):
    x = np.arange(float(count))
    crowd, line = drawn(Series("p", "points", x, x), Series("l", "line", x, x)).get_lines()
    assert crowd.get_markersize() == pytest.approx(size * 5.5)
    assert (crowd.get_zorder() > line.get_zorder()) == (count <= 100)


def test_names_that_matplotlib_would_hide_or_typeset_are_shown():
    ax = drawn(Series("_50 % of $u$", "line", X, X), figure={"subject": "_a $b$"})
    assert legend(ax) == [r"50 % of \$u\$"]
    assert ax.get_title() == r"a \$b\$"
    ax.figure.draw_without_rendering()


@pytest.mark.parametrize(
    ("span", "step"), [(100, 15), (300, 45), (1200, 180), (2500, 720), (5500, 1440), (20000, 3600)]
)
def test_angles_have_few_lines_at_parts_or_multiples_of_a_turn(span, step):
    ax = drawn(Series("p", "line", X, span / 1.1 * (X - 1) / 4), steps=ANGLES)
    (low, high), ticks = ax.get_ylim(), ax.get_yticks()
    assert 3 <= np.sum((low <= ticks) & (ticks <= high)) <= 8
    np.testing.assert_allclose(np.diff(ticks) % 15, 0)


@pytest.mark.parametrize("x", [[3.0], [3.0, 4.2], [40.0, 75.0], [0.01, 2000.0]])
def test_every_logarithmic_axis_has_numbers_without_powers_of_ten(x):
    points = Series("p", "points", np.array(x), np.array(x))
    ax = drawn(points, figure={"is_logarithmic": True}, is_logarithmic=True)
    ax.figure.draw_without_rendering()
    for axis in (ax.xaxis, ax.yaxis):
        (low, high), ticks = axis.get_view_interval(), axis.get_majorticklocs()
        assert np.sum((low <= ticks) & (ticks <= high)) >= 2
        labels = [text.get_text() for text in axis.get_ticklabels(which="both")]
        assert [float(label) for label in labels if label] == pytest.approx(ticks, rel=1e-5)


def test_limits_spans_and_whole_numbers():
    figure = {"spans": [(1.0, 2.0, GRAY)], "limits": (0.0, 9.0), "is_whole": True}
    ax = drawn(Series("p", "points", X, X), limits=(-1.0, 7.0), title="note", figure=figure)
    assert (ax.get_xlim(), ax.get_ylim()) == ((0, 9), (-1, 7))
    assert ax.get_title() == "made\nnote"
    assert len(ax.patches) == 1
    assert all(tick == round(tick) for tick in ax.xaxis.get_major_locator().tick_values(0, 9))


@pytest.mark.parametrize(("width", "columns"), [(4.0, 2), (6.0, 4), (20.0, 5)])
def test_a_legend_below_has_as_many_columns_as_fit(width, columns):
    """A letter takes an eleventh of an inch, a key six letters: of ten letters 16 / 11 in each."""
    lines = [Series(f"{k} {'x' * 8}", "line", X, X) for k in range(5)]
    (ax,) = draw([Figure("made", "x", [Panel("y", lines)])], size=(width, 2.5))
    assert ax.figure.legends[0]._ncols == columns


def test_a_legend_with_keys_of_many_colors_stays_within_the_figure():
    lines = [Series("fit of the model", "line", X, X + k, k) for k in range(8)]
    names = [Series(f"response {k}", "points", X, X, k) for k in range(8)]
    (ax,) = draw([Figure("made", "x", [Panel("y", [*lines, *names])])], size=(5.0, 4.0))
    ax.figure.draw_without_rendering()
    box = ax.figure.legends[0].get_window_extent()
    assert 0 <= box.x0 < box.x1 <= ax.figure.bbox.width


# --- axes of a user


RECORD = Record(
    np.arange(0, 5, 0.01),
    {"u": np.arange(500.0), "theta": np.zeros(500)},
    {"theta": "rad"},
    name="made",
)


@pytest.fixture
def user_axes():
    """A user's figure with a panel of their own, which stays as it is."""
    figure = MatplotlibFigure(figsize=(9, 7))
    axes = figure.subplots(2, 2)
    axes[1, 1].plot([1, 2], [3, 4])
    axes[1, 1].set_title("mine")
    yield axes
    assert figure.get_suptitle() == ""
    assert not figure.legends
    assert tuple(figure.get_size_inches()) == (9, 7)
    assert figure.axes == axes.ravel().tolist()
    assert axes[1, 1].get_title() == "mine"
    assert len(axes[1, 1].lines) == 1


def test_a_bode_diagram_goes_into_two_panels_of_a_users_figure(user_axes, pitch):
    drawn = gb.plotting.bode(pitch, axes=user_axes[:, 0])
    assert drawn.tolist() == [user_axes[0, 0], user_axes[1, 0]]
    assert [text.get_text() for text in user_axes[0, 0].get_legend().get_texts()] == [
        "pitch",
        "fit of Tilt",
        "95 % band",
    ]
    assert user_axes[1, 0].get_legend() is None
    assert [ax.get_xscale() for ax in drawn] == ["log", "log"]
    assert [ax.get_xlabel() for ax in drawn] == ["ω, rad/s", "ω, rad/s"]
    assert drawn[0].get_xlim() == drawn[1].get_xlim()


def test_a_coherence_needs_a_third_panel(user_axes, sweep, pitch):
    assert len(gb.plotting.bode(sweep, axes=user_axes[0])) == 2
    drawn = gb.plotting.bode(sweep, axes=[*user_axes[0], user_axes[1, 0]])
    np.testing.assert_array_equal(points(drawn[2])[0].get_ydata(), sweep.coherence)
    with pytest.raises(ValueError, match=r"has 4 panels .*, but `axes` has 5"):
        gb.plotting.bode(pitch, axes=MatplotlibFigure().subplots(5, 1))


def test_a_bode_diagram_drawn_over_another_shows_the_frequencies_of_both(user_axes):
    drawn = gb.plotting.bode(gb.frequency_response(Tilt(), TRUTH, [1.0, 2.0]), axes=user_axes[0])
    gb.plotting.bode(gb.frequency_response(Tilt(), TRUTH, [5.0, 90.0]), axes=drawn)
    low, high = drawn[0].get_xlim()
    assert low < 1
    assert high > 90


def test_a_nyquist_diagram_takes_one_panel_for_each_pair(user_axes, rotors, pitch):
    _, second = gb.plotting.nyquist(rotors, pitch, axes=user_axes[:, 0])
    assert second is user_axes[1, 0]
    assert len(points(second)) == len(curves(second)) == 1
    with pytest.raises(ValueError, match=r"has 2 panels .*, but `axes` has 3"):
        gb.plotting.nyquist(rotors, pitch, axes=user_axes.ravel()[:3])


def test_starts_go_into_one_panel(user_axes, pitch):
    assert gb.plotting.starts(pitch, ax=user_axes[0, 1]) is user_axes[0, 1]
    assert user_axes[0, 1].get_legend() is not None


def test_a_log_goes_into_given_panels(user_axes):
    assert gb.plotting.traces(RECORD, axes=user_axes[0]).tolist() == user_axes[0].tolist()
    assert [ax.get_xlabel() for ax in user_axes[0]] == ["Time, s", "Time, s"]
    log = Recording({"table": RECORD}, "made.csv")
    assert gb.plotting.recording(log, axes=user_axes[0]).tolist() == user_axes[0].tolist()
    with pytest.raises(ValueError, match=r"Log has 2 panels .*, but `axes` has 1"):
        gb.plotting.recording(log, axes=user_axes[0, 0])


def test_what_is_no_axes_is_refused(pitch):
    with pytest.raises(TypeError, match=r"cannot draw into 'left': give matplotlib Axes"):
        gb.plotting.bode(pitch, axes=["left", "right"])
    with pytest.raises(TypeError, match="cannot draw into <Figure"):
        gb.plotting.starts(pitch, ax=MatplotlibFigure())


def test_only_the_lowest_of_stacked_panels_is_labeled(pitch):
    assert [ax.get_xlabel() for ax in gb.plotting.bode(pitch)] == ["", "", "", "ω, rad/s"]
    stacked = MatplotlibFigure().subplots(2, 1, sharex=True)
    assert [ax.get_xlabel() for ax in gb.plotting.bode(pitch, axes=stacked)] == ["", "ω, rad/s"]
