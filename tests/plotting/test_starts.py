"""Every run of a fit is shown."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lines import legend, points
from matplotlib.figure import Figure

import greybox as gb
from greybox.plotting.starts import _scale_costs


def test_starts_shows_every_run_sorted_and_grouped(pitch):
    axes = gb.plotting.starts(pitch)
    drawn = points(axes)
    assert len(drawn) == len(pitch.minima)
    assert [len(line.get_xdata()) for line in drawn] == [len(m.runs) for m in pitch.minima]
    x, y = np.concatenate([line.get_xydata() for line in drawn]).T
    np.testing.assert_array_equal(np.sort(x), np.arange(1, 9))
    np.testing.assert_array_equal(y[np.argsort(x)], sorted(run.cost for run in pitch.runs))
    assert axes.get_title() == f"{pitch.agreeing} of 8 starts agree on the best minimum"
    low, high = axes.get_ylim()
    assert low < min(y) <= max(y) < high
    assert axes.get_xlim() == (0, 9)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Runs, sorted by cost", "Cost")
    assert legend(axes) == [
        f"minimum {k}: {len(m.runs)} × cost {m.cost:.5g}" for k, m in enumerate(pitch.minima, 1)
    ]


def test_starts_shows_failed_runs_at_the_right_and_never_their_cost(pitch):
    lost = [
        replace(run, converged=False, cost=0.0, status="Invalid_Number_Detected")
        for run in pitch.runs[:3]
    ]
    kept = [
        m
        for m in (replace(m, runs=tuple(k for k in m.runs if k >= 3)) for m in pitch.minima)
        if m.runs
    ]
    axes = gb.plotting.starts(replace(pitch, runs=(*lost, *pitch.runs[3:]), minima=tuple(kept)))
    crosses = points(axes)[-1]
    np.testing.assert_array_equal(crosses.get_xdata(), [6, 7, 8])
    assert legend(axes)[-1] == "3 × failed"
    assert axes.get_ylim()[0] > 0


def test_starts_is_logarithmic_when_costs_span_decades(pitch):
    runs = (*pitch.runs[:-1], replace(pitch.runs[-1], cost=1e4))
    assert gb.plotting.starts(replace(pitch, runs=runs)).get_yscale() == "log"
    assert gb.plotting.starts(pitch).get_yscale() == "linear"


def test_more_minima_than_colors_share_one_gray(pitch):
    each = tuple(replace(pitch.minima[0], runs=(run.index,)) for run in pitch.runs)
    axes = gb.plotting.starts(replace(pitch, minima=each))
    assert legend(axes)[-1] == "2 runs in 2 further minima"
    assert sum(len(line.get_xdata()) for line in points(axes)) == 8
    axes = gb.plotting.starts(replace(pitch, minima=each[:7], runs=pitch.runs[:7]))
    assert legend(axes)[-1] == "1 run in 1 further minimum"


@pytest.mark.parametrize(
    ("costs", "scale", "limits"),
    [
        ([2.0, 3.0, 59.0], "linear", (2 - 5.7, 59 + 11.4)),
        ([2.0, 3.0, 61.0], "log", None),
        (
            [-5.0, -4.9],
            "linear",
            (-5.5, -3.9),
        ),  # rounding is no range: a tenth of the cost below, and two above
        ([0.0, 50.0], "linear", (-5.0, 60.0)),
    ],
)
def test_the_axis_of_costs_shows_neither_rounding_nor_one_point(costs, scale, limits):
    ax = Figure().subplots()
    _scale_costs(ax, costs)
    assert ax.get_yscale() == scale
    if limits:
        assert ax.get_ylim() == pytest.approx(limits)
