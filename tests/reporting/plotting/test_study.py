"""Figures of a study: the numbers in their series are those of the members."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import t
from small_study import SPEEDS

import greybox as gb
from greybox.reporting.plotting.study import estimates_figure, structures_figure, trend_figure


def by_name(figure):
    return {series.name: series for series in figure.panels[0].series}


def test_a_trend_has_a_weighted_line_and_its_test(small_study):
    study = small_study.select(model="Lag", seed=0)
    figure = trend_figure(study, "T_lag", SPEEDS)
    points, line = figure.panels[0].series
    fits = [study[f"{name}, Lag"].fit for name in SPEEDS]
    assert points.y.tolist() == [fit.estimate["T_lag"] for fit in fits]
    errors = np.array([fit.standard_error["T_lag"] for fit in fits])
    assert points.high - points.y == pytest.approx(errors)
    # The normal equations of weighted least squares, written out.
    x, weights = np.array([*SPEEDS.values()]), errors**-2
    middle = np.sum(weights * x) / np.sum(weights)
    slope = np.sum(weights * (x - middle) * points.y) / np.sum(weights * (x - middle) ** 2)
    assert (line.y[1] - line.y[0]) / (line.x[1] - line.x[0]) == pytest.approx(slope)
    assert slope == pytest.approx(0.03, rel=0.1)
    shown = float(line.name.split("slope ")[1].split()[0])
    assert shown == pytest.approx(slope, rel=1e-3)
    assert float(line.name.split("p = ")[1]) < 0.05
    assert figure.panels[0].label == "T_lag, s"
    # Another quantity may be the operating point.
    assert trend_figure(study, "T_lag", "K").panels[0].series[0].x == pytest.approx(2.0, rel=0.05)
    with pytest.raises(ValueError, match="no member has the quantity 'mass'"):
        trend_figure(study, "mass", SPEEDS)


def test_scatter_beyond_the_errors_widens_the_error_of_a_trend(small_study):
    """At other speeds the same estimates lie on no line; Student's t by the normal equations."""
    study = small_study.select(model="Lag", seed=0)
    points, line = (
        trend_figure(study, "T_lag", dict(zip(SPEEDS, (1.0, 7.0, 3.0), strict=True)))
        .panels[0]
        .series
    )
    rows = np.array([points.x, np.ones(3)]).T / (points.high - points.y)[:, None]
    target = points.y / (points.high - points.y)
    inverse = np.linalg.inv(rows.T @ rows)
    left = target - rows @ inverse @ rows.T @ target
    assert left @ left > 2
    error = np.sqrt(inverse[0, 0] * (left @ left))  # of one degree of freedom
    p_value = 2 * t.sf(abs(inverse[0] @ rows.T @ target) / error, 1)
    assert float(line.name.split("p = ")[1]) == pytest.approx(p_value, rel=0.05)


def test_estimates_have_a_row_each_and_costs_are_sorted(small_study):
    figure = estimates_figure(small_study, "K")
    (panel,) = figure.panels
    lag = by_name(figure)["Lag"]
    for x, y, note in zip(lag.x, lag.y, lag.notes, strict=True):
        name = note.split(":")[0]
        assert x == small_study[name].answer["estimate"]["K"]
        assert set(panel.ticks[int(y) - 1].split(", ")) >= {
            "Lag",
            small_study[name].factors["data"],
        }
    alike = estimates_figure(small_study.select(model="Lag", seed=0), "K")
    assert alike.panels[0].ticks[-1] == "hover"  # what members share is not repeated
    fits = {name: small_study[f"{name}, Lag"].fit for name in SPEEDS}
    # The values of a dictionary are no sequence, but have a length.
    assert len(estimates_figure(fits.values(), "K").panels[0].ticks) == len(fits)
    costs = estimates_figure(small_study, "cost")
    rows = sorted((y, x) for s in costs.panels[0].series for x, y in zip(s.x, s.y, strict=True))
    assert [x for _, x in rows] == sorted((x for _, x in rows), reverse=True)


def test_maps_of_structures_and_data_sets(small_study):
    figure = structures_figure(gb.compare(small_study))
    names = figure.panels[0].ticks
    best = by_name(figure)["at most 2 above the least BIC"]
    assert {names[int(y) - 1] for y in best.y} == {"Lag"}
    assert best.x.tolist() == [1.0, 2.0, 3.0]
    assert sorted(len(series.x) for series in figure.panels[0].series) == [3, 3, 3]
    agreeing = by_name(structures_figure(small_study))
    assert agreeing["at most half of the starts agree"].notes == ["Broken, slow: 0"]
    assert len(agreeing["more"].x) == 9


def test_names_stand_at_the_axes(small_study):
    ax = gb.plotting.structures(small_study)
    assert [text.get_text() for text in ax.get_xticklabels()] == ["hover", "slow", "fast"]
    assert [text.get_text() for text in ax.get_yticklabels()][-1] == "Lag"
    ax = gb.plotting.estimates(small_study, "T_lag")
    spans = [bar.get_segments()[0] for bar in ax.collections]
    assert spans
    assert all(np.ptp(span[:, 1]) == 0 < np.ptp(span[:, 0]) for span in spans)
    assert gb.plotting.trend(small_study, "K", SPEEDS).get_ylabel() == "K"


def test_values_over_other_data_sets_are_refused(small_study):
    with pytest.raises(ValueError, match="names no data set: give values for hover"):
        trend_figure(small_study, "K", {"hover.csv": 1.0})


def test_the_legend_in_the_axes_of_a_user_covers_no_row(small_study):
    ax = Figure(layout="constrained").subplots()
    gb.plotting.structures(small_study, ax)
    ax.figure.draw_without_rendering()
    legend, rows = ax.get_legend().get_window_extent(), ax.get_window_extent()
    assert rows.y1 <= legend.y0 < legend.y1 <= ax.figure.bbox.y1


def test_estimates_of_fits_have_a_row_each_and_a_color_a_structure(small_study):
    first, *_, last = small_study.select(seed=0, data=next(iter(SPEEDS))).done
    fits = [first.fit, last.fit]
    assert first.factors["model"] != last.factors["model"]
    ax = gb.plotting.estimates(fits, "K")
    assert len({line.get_color() for line in ax.lines}) == 2
    drawn = {round(y): x for line in ax.lines for x, y in line.get_xydata()}
    expected = [fit.estimate["K"] for fit in fits]
    assert [drawn[row] for row in range(len(fits), 0, -1)] == expected
    with pytest.raises(ValueError, match="give at least one fit"):
        gb.plotting.estimates([], "K")


@pytest.mark.parametrize("copies", [1, 13])
def test_names_of_members_neither_overlap_nor_lie_far_apart(small_study, copies):
    fits = [small_study[f"{name}, Lag"].fit for name in SPEEDS] * copies
    figure = gb.plotting.estimates(fits, "K").figure
    figure.draw_without_rendering()
    names = figure.axes[0].get_yticklabels()
    boxes = [name.get_window_extent() for name in names]
    middles = [np.mean(box.intervaly) for box in boxes]
    lines = np.abs(np.diff(middles)) / max(box.height for box in boxes)
    assert len(names) == len(fits)
    assert lines.min() > 1
    assert lines.max() < 10
