"""Figures of fitted and predicted records show what they hold: lines, gaps, bands, windows."""

import matplotlib as mpl
import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured
from drawn_lines import legend, named
from hardening_spring import Spring, driven

import greybox as gb
from greybox.reporting.plotting.time_history import history_figure

pytestmark = pytest.mark.usefixtures("unjudged_file")

mpl.use("Agg")
WHOLE = driven(20.0, noise=0.05, seed=2)
GAPPED = WHOLE.rows(np.flatnonzero((WHOLE.time < 6) | (WHOLE.time > 7.5)))


@pytest.fixture(scope="module")
def fit():
    return gb.fit(gb.Problem(Spring(), GAPPED), starts=2, progress=False)


@pytest.fixture(scope="module")
def stiff():
    return gb.fit(gb.Problem(Spring(), GAPPED, fixed={"stiffness": 4.4}), starts=2, progress=False)


def line(axis, color):
    (found,) = [
        k
        for k in axis.lines
        if k.get_color() == color and k.get_linestyle() == "-" and len(k.get_xdata()) > 2
    ]
    return found.get_data()


def test_a_fit_is_drawn_over_what_was_measured_with_residuals_and_input(fit):
    axes = gb.plotting.time_history(fit)
    output, below, force = axes
    assert [ax.get_ylabel() for ax in axes] == ["position, m", "Residual, m", "force"]
    assert output.get_title() == "spring"
    time, drawn = line(output, "#0072B2")
    there = np.isfinite(drawn)
    simulated = fit.parts[0].simulated["position"]
    assert np.allclose(np.interp(time[there], GAPPED.time, simulated), drawn[there])
    _, residual = line(below, "#0072B2")
    assert np.sqrt(np.nanmean(residual**2)) == pytest.approx(0.05, rel=0.1)
    _, drawn = line(force, "#222222")
    assert np.isclose(np.nanmax(drawn), GAPPED["force"].max())


def test_of_a_short_record_every_sample_is_a_dot_and_angles_are_in_degrees():
    time = 0.1 * np.arange(40)
    position = np.where(time == 1.0, np.nan, 2 + np.cos(time))
    signals = {"force": np.sin(time), "position": position}
    record = gb.Record(time, signals, {"position": "rad"})
    short = gb.predict(Spring(), {}, record, horizon=1.0)
    output, below, force = history_figure([short]).panels
    assert (output.label, below.label) == ("position, °", "Residual, °")
    dots = named(output, "measured", "points")
    is_finite = np.isfinite(position)
    assert dots.x.tolist() == time[is_finite].tolist()
    assert dots.y == pytest.approx(np.degrees(position[is_finite]))
    residual = named(below, "Spring", "line")
    drawn = np.isfinite(residual.y)
    expected = np.degrees(position - short.record["position"])
    at = np.isfinite(expected)
    assert residual.y[drawn] == pytest.approx(np.interp(residual.x[drawn], time[at], expected[at]))
    half = np.degrees(1.96 * short.record["position_error"])
    shade = named(below, "Spring", "band")
    assert np.nanmax(shade.high) == -np.nanmin(shade.low) == pytest.approx(np.nanmax(half))
    assert force.series[0].y == pytest.approx(record["force"])


def test_long_lines_keep_their_extremes(fit):
    figure = history_figure([fit], columns=20)
    drawn = named(figure.panels[0], "fit", "line")
    assert len(drawn.x) < 100
    assert np.nanmax(drawn.y) == pytest.approx(fit.parts[0].simulated["position"].max())


def test_rows_without_a_time_are_dots_with_bars():
    class Line(gb.StateSpace):
        inputs, outputs = ("x",), ("y",)
        a = gb.Parameter(1.0)

        def output(self, x, u, p):
            return (p.a * u.x,)

    x = np.arange(30.0)
    rows = gb.Record(x, {"x": x, "y": x + 0.1 * np.sin(x**2)}, has_time=False)
    fit = gb.fit(gb.Problem(Line(), rows), starts=[{}], progress=False)
    figure = history_figure([gb.predict(fit)])
    output, below, _ = figure.panels
    assert figure.label == "Row"
    half = 1.96 * gb.predict(fit).record["y_error"]
    for panel in (output, below):
        dots = named(panel, "Line", "points")
        assert dots.x.tolist() == [*range(1, 31)]
        np.testing.assert_allclose(dots.high - dots.y, half, atol=1e-12)
        np.testing.assert_allclose(dots.y - dots.low, half, atol=1e-12)


def test_a_gap_is_left_open(fit):
    for axis, color in zip(
        gb.plotting.time_history(fit), ("#0072B2", "#0072B2", "#222222"), strict=True
    ):
        time, drawn = line(axis, color)
        kept = time[np.isfinite(time) & np.isfinite(drawn)]
        (gap,) = np.flatnonzero(np.diff(kept) > 1)
        place = np.flatnonzero(time == kept[gap])[0]
        assert np.isnan(time[place + 1 : np.flatnonzero(time == kept[gap + 1])[0]]).any()


def test_several_fits_are_laid_over_one_another(fit, stiff):
    axes = gb.plotting.time_history(fit, stiff, labels=("free", "stiff"))
    assert legend(axes[0]) == ["measured", "free", "stiff"]
    left = [np.nanstd(line(axes[1], color)[1]) for color in ("#0072B2", "#D55E00")]
    assert left[1] > 1.5 * left[0]
    assert legend(gb.plotting.time_history(fit, stiff)[0])[1:3] == [
        "fit of Spring 1",
        "fit of Spring 2",
    ]


def test_predictions_begin_anew_in_every_window_and_have_a_band(fit):
    prediction = gb.predict(fit, record=WHOLE, horizon=2.0)
    output = history_figure([prediction]).panels[0]
    drawn = named(output, "Spring", "line").y
    assert np.isnan(drawn).sum() == len(prediction) - 1 == 8
    shade = named(output, "Spring", "band")
    assert np.isnan(shade.high).sum() == 8
    assert np.nanmax(shade.high) > np.nanmax(drawn)
    assert named(output, "Spring", "line").x[0] == WHOLE.time[prediction.rows[0, 0]]
    assert "95 % band without noise" in legend(gb.plotting.time_history(prediction)[0])


def test_long_records_are_thinned_to_their_extremes():
    time = np.arange(15_000) / 50
    force = np.sin(time)
    force[7_234] = 9.0
    record = gb.Record(time, {"force": force, "position": np.zeros(time.size)})
    axis = gb.plotting.time_history(gb.predict(Spring(), {}, record, horizon=100.0, lead=1.0))[-1]
    shown = line(axis, "#222222")[1]
    assert shown.size < 6000
    assert np.nanmax(shown) == 9.0


def test_plot_shows_the_records_of_a_fit_and_its_responses(fit):
    figure = gb.plot(fit)
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "position, m",
        "Residual, m",
        "force",
        "Cost",
    ]
    response = gb.Problem(Spring(), measured(Spring(), np.geomspace(0.5, 8, 12), noise=0.02))
    both = gb.plot(gb.fit(gb.Problem(Spring(), GAPPED) + response, starts=2, progress=False))
    labels = [axis.get_ylabel() for axis in both.axes]
    assert labels[:4] == ["position, m", "Residual, m", "force", "Cost"]
    assert labels[4].startswith("Magnitude")


def test_wrong_use_is_said_in_a_sentence(fit):
    response = gb.fit(gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA)), starts=3, progress=False)
    with pytest.raises(ValueError, match=r"no record 0: the fit has 0, .* gb\.plot draws"):
        gb.plotting.time_history(response)
    with pytest.raises(
        ValueError, match=r"no frequency response to draw: gb.plotting.time_history draws"
    ):
        gb.plotting.bode(fit)
    with pytest.raises(ValueError, match="there is nothing to draw"):
        gb.plotting.time_history()
    with pytest.raises(TypeError, match="give a Fit or a Prediction"):
        gb.plotting.time_history(WHOLE)
    with pytest.raises(ValueError, match="there is no record 1: the fit has 1"):
        gb.plotting.time_history(fit, record=1)
    with pytest.raises(ValueError, match="belong to different records"):
        gb.plotting.time_history(fit, gb.predict(fit, record=WHOLE))
    with pytest.raises(ValueError, match="there are 2 labels for 1 items"):
        gb.plotting.time_history(fit, labels=("a", "b"))
