"""Every run of a fit is shown."""

from dataclasses import replace

import numpy as np
import pytest
from page_results import lag

import greybox as gb
from greybox.engine.solve.runs import SCREENED
from greybox.reporting.plotting.starts import starts_figure


@pytest.fixture(scope="module")
def fit():
    return lag()


def made_of(fit, costs):
    """The fit with one minimum for each cost."""
    runs = [
        replace(fit.runs[0], index=k, cost=cost, converged=True) for k, cost in enumerate(costs)
    ]
    minima = [replace(fit.minima[0], cost=run.cost, runs=(run.index,)) for run in runs]
    return replace(fit, runs=tuple(runs), minima=tuple(minima))


def test_runs_are_sorted_and_grouped(pitch):
    ax = gb.plotting.starts(pitch)
    assert ax.get_title() == f"{pitch.agreeing} of 8 starts agree on the best minimum"
    (panel,) = starts_figure(pitch).panels
    assert [len(series.x) for series in panel.series] == [len(m.runs) for m in pitch.minima]
    x = np.concatenate([series.x for series in panel.series])
    y = np.concatenate([series.y for series in panel.series])
    np.testing.assert_array_equal(np.sort(x), np.arange(1, 9))
    np.testing.assert_array_equal(y[np.argsort(x)], sorted(run.cost for run in pitch.runs))


def test_starts_are_sorted_and_failed_ones_stand_at_the_right(fit):
    first, second, third = fit.runs
    runs = (first, replace(second, converged=False, status="restoration failed"), third)
    minima = (replace(fit.minima[0], runs=(first.index, third.index)),)
    figure = starts_figure(replace(fit, runs=runs, minima=minima, agreeing=2))
    minimum, failed = figure.panels[0].series
    assert minimum.x.tolist() == [1, 2]
    assert failed.x.tolist() == [3]
    assert failed.notes == ["start 1, restoration failed"]
    assert minimum.y.tolist() == sorted(run.cost for run in (first, third))
    low, high = figure.panels[0].limits
    assert low < failed.y[0] < high
    assert [figure.panels[0].label, figure.label, figure.limits] == [
        "Cost",
        "Runs, sorted by cost",
        (0.0, 4.0),
    ]
    assert figure.caption.startswith("2 of 3 starts agree on the best minimum")
    assert "Failed runs are at the right" in figure.caption
    none = replace(fit, runs=tuple(replace(run, converged=False) for run in fit.runs), minima=())
    assert starts_figure(none).caption.startswith("None of 3 starts converged.")


@pytest.mark.parametrize(
    ("costs", "is_logarithmic", "limits"),
    [
        ([], False, (0.0, 1.0)),
        ([2.0, 3.0, 300.0], True, (2 / 1.5, 450.0)),
        ([-5.0, -4.9], False, (-5.5, -3.9)),  # rounding is not a range
        ([1.0, 21.0], False, (-1.0, 25.0)),
        ([0.0, 500.0], False, (-50.0, 600.0)),
    ],
)
def test_the_axis_of_costs_shows_neither_rounding_nor_one_point(fit, costs, is_logarithmic, limits):
    (panel,) = starts_figure(made_of(fit, costs)).panels
    assert panel.is_logarithmic is is_logarithmic
    assert panel.limits == pytest.approx(limits)


def test_minima_have_five_colors_and_further_ones_and_failed_runs_none(fit):
    first = fit.runs[0]
    ended = [
        replace(first, index=k, cost=3.0 + k, iterations=k + 1, converged=True) for k in range(7)
    ]
    lost = [replace(first, index=7 + k, status="stagnated", converged=False) for k in range(2)]
    screened = [replace(first, index=9 + k, stage=SCREENED) for k in range(4)]
    minima = tuple(replace(fit.minima[0], cost=run.cost, runs=(run.index,)) for run in ended[:6])
    minima = (
        replace(minima[0], runs=(6, 0)),
        *minima[1:],
    )  # the dearest run counts to the first as well
    made = replace(fit, runs=(*reversed(ended), *lost, *screened), minima=minima, agreeing=2)
    figure = starts_figure(made)
    *found, failed = figure.panels[0].series
    assert [series.name for series in found] == [
        "minimum 1: 2 × cost 3",
        *(f"minimum {k}: 1 × cost {2 + k}" for k in range(2, 6)),
        "1 run in 1 further minimum",
    ]
    assert [series.x.tolist() for series in found] == [[1, 7], [2], [3], [4], [5], [6]]
    assert [series.y.tolist() for series in found] == [[3, 9], [4], [5], [6], [7], [8]]
    assert [(series.color, series.style) for series in found] == [
        (0, 0),
        (1, 1),
        (2, 2),
        (3, 3),
        (4, 4),
        (-1, 0),
    ]
    assert found[0].notes == ["start 0, cost 3, 1 iteration", "start 6, cost 9, 7 iterations"]
    assert (failed.name, failed.color, failed.x.tolist()) == ("2 × failed", -2, [8, 9])
    assert failed.style not in range(5)
    assert (figure.limits, figure.is_whole) == ((0.0, 10.0), True)
    said = (
        "2 of 9 most promising of 13 starts agree on the best minimum. Failed runs are at the right"
    )
    assert figure.caption.startswith(said)
    alone = starts_figure(
        replace(fit, runs=(ended[0],), minima=(replace(minima[0], runs=(0,)),), agreeing=1)
    )
    assert alone.caption == "1 of 1 start agrees on the best minimum."


@pytest.mark.parametrize("dearest", [6.0, 4e5])
def test_failed_runs_stand_below_the_upper_end_of_their_axis(fit, dearest):
    runs = [replace(fit.runs[0], index=0, cost=3.0), replace(fit.runs[0], index=1, cost=dearest)]
    runs.append(replace(fit.runs[0], index=2, converged=False))
    minima = tuple(replace(fit.minima[0], cost=run.cost, runs=(run.index,)) for run in runs[:2])
    (panel,) = starts_figure(replace(fit, runs=tuple(runs), minima=minima)).panels
    above, top = panel.limits[1], panel.series[-1].y
    assert panel.is_logarithmic is (dearest > 100)
    assert dearest < top[0] < above
