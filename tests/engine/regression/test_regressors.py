"""Signals as the equations need them, against closed forms."""

import math

import numpy as np
import pytest
from lagged_plant import TIME, TRUTH, Lagged, flown
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline

import greybox as gb
from greybox.data.intersample import Intersample
from greybox.engine.regression.linear_in_parameters import regressions
from greybox.engine.regression.regressors import (
    FEWEST,
    acting,
    regressors,
)
from greybox.engine.regression.smoothing import reach
from greybox.modeling.realization import dynamics

KNOWN = {"tau": TRUTH[2], "T": TRUTH[3]}


def made(record=None):
    equations = regressions(dynamics(Lagged()), ["u", "v", "w"], KNOWN)
    record = flown() if record is None else record
    return regressors(equations, record, TRUTH[:2], {"u": Intersample(False)})


STEP = (TIME[-1] - TIME[0]) / (TIME.size - 1)


def ends(band, lateness, step=STEP):
    """Samples that are lost at the ends of a stretch: of the filter, and before the first input."""
    return 2 * math.ceil(reach(band) / step) + math.ceil(lateness / step - 1e-6)


def test_at_the_truth_the_blocks_hold():
    """v' = a v + b w to the accuracy of cubic splines; the rows begin behind the filter and the delay."""
    block, bands = made()
    lateness = KNOWN["T"]
    lost = ends(bands[0], lateness)
    assert len(block.target) == len(block.base) == len(block.slopes) == TIME.size - lost
    error = block.target - block.base - block.slopes @ TRUTH[:2]
    assert np.abs(error).max() < 2e-3 * np.abs(block.target).max()


def test_every_stretch_loses_its_ends_and_one_that_is_too_short_gives_no_block():
    record = flown()
    lateness = KNOWN["T"]
    v = record["v"].copy()
    v[1000:1003] = np.nan
    rows, bands = made(record.with_signals(v=v))
    lost = ends(bands[0], lateness)
    assert rows.target.size == TIME.size - 3 - 2 * lost
    for more in (0, FEWEST - 1, FEWEST):
        v = record["v"].copy()
        v[lost + more : lost + more + 3] = np.nan
        rows, bands = made(record.with_signals(v=v))
        if ends(bands[0], lateness) == lost:
            assert rows.target.size == TIME.size - 3 - 2 * lost - more * (more < FEWEST)


def test_a_record_that_is_too_short_is_refused():
    with pytest.raises(ValueError, match="no stretch without a gap is long enough: the longest"):
        made(flown().rows(slice(14)))


def test_what_is_held_acts_as_the_smooth_slope_of_what_integrates_it():
    """x(k+1) = x(k) + h u(k) over two stretches, of which a spline gives the slope; the rest is of (ωh)⁴."""
    step = 0.1
    time = np.concatenate([step * np.arange(90), 30 + step * np.arange(70)])
    u = np.sin(5 * time)
    for rows in (slice(0, 90), slice(90, 160)):
        acts = acting(time[rows], u[rows])
        x = step * np.concatenate([[0.0], np.cumsum(u[rows][:-1])])
        inside = slice(8, -8)
        assert_allclose(acts[inside], CubicSpline(time[rows], x)(time[rows], 1)[inside], atol=3e-3)
        first = CubicSpline(time[rows], u[rows])  # before the first sample nothing is known
        assert acts[0] == pytest.approx(
            first(time[rows][0]) - step**2 / 24 * first(time[rows][0], 2)
        )


class Autonomous(gb.StateSpace):
    """Nothing drives it."""

    states, inputs, outputs = ("v",), (), ("v",)
    a = gb.Parameter(-1.0, bounds=(-5, 0))

    def derivative(self, x, u, p):
        return (p.a * x.v,)

    def output(self, x, u, p):
        return (x.v,)


def test_without_inputs_nothing_is_late():
    time = 0.05 * np.arange(200)
    record = gb.Record(time, {"v": np.exp(-1.0 * time)})
    equations = regressions(dynamics(Autonomous()), ["v"], {})
    rows, bands = regressors(equations, record, np.array([-1.0]), {})
    assert rows.target.size == 200 - ends(bands[0], 0.0, 0.05)
    assert_allclose(rows.target, -rows.slopes[:, 0], rtol=0.05)


class Driven(gb.StateSpace):
    """The slope of the state is a late input, without a filter in between."""

    states, inputs, outputs = ("v",), ("u",), ("v", "y")
    delays = {"u": "T"}
    b = gb.Parameter(2.0, bounds=(0, 9))
    T = gb.Parameter(0.07, bounds=(0, 0.1))

    def derivative(self, x, u, p):
        return (p.b * u.u,)

    def output(self, x, u, p):
        return (x.v, p.b * u.u)


@pytest.mark.parametrize(
    ("between", "late"),
    [
        (Intersample(False), 0.07),
        (Intersample(False, 0.04), 0.11),
        (Intersample(True), 0.07 + 0.05),
    ],
)
def test_inputs_arrive_after_their_delays(between, late):
    """An output that no signal has smoothed shows them; a held value also lasts a step."""
    time = 0.05 * np.arange(600)
    record = gb.Record(time, {"u": np.sin(1.3 * time) + 2, "y": np.cos(0.7 * time)})
    point = np.array([2.0, 0.07])
    equations = regressions(dynamics(Driven()), record.signals, {})
    rows, bands = regressors(equations, record, point, {"u": between})
    assert bands == (np.inf,)
    used = time[math.ceil(late / 0.05) :]
    u = rows.slopes[:, 0]
    if between.held:
        # Between two values, in shares of the part of a step.
        acts = acting(time, record["u"])
        assert_allclose(u, (0.6 * acts[1:-1] + 0.4 * acts[:-2])[-u.size :])
    else:
        assert_allclose(u[20:-20], np.sin(1.3 * (used - late))[20:-20] + 2, atol=1e-5)
    assert u.size == used.size
