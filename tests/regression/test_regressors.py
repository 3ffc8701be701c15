"""Signals as the equations need them, against closed forms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from lagged_plant import STEP, TIME, TRUTH, Lagged, flown, force
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import greybox as gb
from greybox.data.intersample import Intersample
from greybox.modeling.realization import dynamics
from greybox.regression.linear_in_parameters import regressions
from greybox.regression.regressors import (
    FEWEST,
    REMEMBERED,
    _linear_response,
    acting,
    memory,
    regressors,
)
from greybox.regression.smoothing import reach


def made(record=None, latest=0.1, **options):
    system = dynamics(Lagged())
    equations = regressions(system, ["u", "v"], {}, TRUTH)
    return regressors(
        equations,
        flown() if record is None else record,
        TRUTH,
        np.array([latest]),
        {"u": Intersample(False)},
        **options,
    )


def test_at_the_truth_the_blocks_hold():
    """v' = a v + b w to the accuracy of cubic splines; the rows begin when the lag has forgotten its start."""
    data = made()
    block = data.rows(TRUTH)
    assert data.equations.linear == ("a", "b")
    # Neither the ends of the filter nor what came before the first sample.
    edge, late = (math.ceil(seconds / STEP) for seconds in (reach(data.bands[0]), data.lateness))
    assert len(block.target) == len(block.base) == len(block.slopes) == TIME.size - 2 * edge - late
    error = block.target - block.base - block.slopes @ TRUTH[:2]
    assert np.abs(error).max() < 2e-3 * np.abs(block.target).max()
    assert data.lateness == pytest.approx(0.1 + 0.05 * math.log(1 / REMEMBERED))


def test_another_delay_shifts_the_input():
    data = made()
    late = data.delayed_inputs(np.array([0.123]))
    inside = TIME > 0.2
    assert_allclose(late[0, inside], force(TIME[inside] - 0.123), atol=1e-5)
    assert data.delayed_inputs(np.array([0.0]))[0] is not None


def test_an_unstable_lag_has_no_blocks():
    assert not made().rows(np.array([-1.0, 3.0, -0.05, 0.03])).target.size


def test_memory_is_that_of_the_slowest_mode():
    matrix = np.array([[-2.0, 1.0], [0.0, -0.5]])
    equations = SimpleNamespace(
        simulated_names=("p", "q"),
        state_names=("p", "q"),
        input_names=(),
        simulated=lambda x, u, p: (np.zeros((2, 1)), matrix),
    )
    assert memory(equations, np.zeros(0)) == pytest.approx(math.log(100) / 0.5)
    assert memory(SimpleNamespace(simulated_names=()), np.zeros(0)) == 0.0


def test_a_linear_response_is_that_of_solve_ivp():
    matrix = np.array([[-1.0, 4.0], [-4.0, -1.0]])
    drive = np.array([np.cos(2 * TIME), np.sin(3 * TIME)])
    found = _linear_response(matrix, drive.copy(), STEP)
    start = -np.linalg.solve(matrix, drive[:, 0])
    wanted = solve_ivp(
        lambda t, x: matrix @ x + [np.cos(2 * t), np.sin(3 * t)],
        (0, TIME[-1]),
        start,
        t_eval=TIME,
        rtol=1e-10,
        atol=1e-12,
    ).y
    assert_allclose(found, wanted, atol=3e-6)


def test_stretches_that_are_too_short_give_no_block():
    record = flown()
    v = record["v"].copy()
    v[1000:1003] = np.nan
    cut = record.with_signals(v=v)
    data, late = made(cut), made(cut, latest=12.0)
    lost = [
        2 * math.ceil(reach(d.bands[0]) / STEP) + math.ceil(d.lateness / STEP) for d in (data, late)
    ]
    both = 1000 + TIME.size - 1003
    assert data.rows(TRUTH).target.size == both - 2 * lost[0]
    assert late.rows(TRUTH).target.size == sum(
        max(n - lost[1], 0) for n in (1000, TIME.size - 1003)
    )


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


class TwoInputs(gb.StateSpace):
    """A state that is simulated behind another lag than that which is measured, and two inputs with delays."""

    states, inputs, outputs = ("v", "w"), ("u", "r"), ("v", "y")
    delays = {"u": "T", "r": "D"}
    a = gb.Parameter(-1.5, bounds=(-5, 0))
    b = gb.Parameter(2.0, bounds=(0, 9))
    lag = gb.Parameter(0.4, bounds=(0.01, 1))
    T = gb.Parameter(0.07, bounds=(0, 0.1))
    D = gb.Parameter(0.02, bounds=(0, 0.3))

    def derivative(self, x, u, p):
        return (p.a * x.v + p.b * x.w + u.r, (u.u - x.w) / p.lag)

    def output(self, x, u, p):
        return (x.v, p.b * x.v - u.u)


POINT = np.array([-1.5, 2.0, 0.4, 0.07, 0.02])


def two_inputs(record, between, p=POINT, **options):
    system = dynamics(TwoInputs())
    equations = regressions(system, record.signals, {}, p)
    return regressors(
        equations,
        record,
        p,
        np.array([0.1, 0.3]),
        between,
        **options,
    )


CONTINUOUS = {"u": Intersample(False), "r": Intersample(False)}


def driven(count=600, step=0.05):
    time = step * np.arange(count)
    signals = {
        "u": np.sin(1.3 * time) + 2,
        "r": np.cos(2.1 * time),
        "v": np.sin(time),
        "y": np.cos(0.7 * time),
    }
    return gb.Record(time, signals)


def test_without_inputs_nothing_is_late():
    time = 0.05 * np.arange(200)
    system = dynamics(Autonomous())
    record = gb.Record(time, {"v": np.exp(-1.0 * time)})
    data = regressors(
        regressions(system, ["v"], {}, np.array([-1.0])),
        record,
        np.array([-1.0]),
        np.zeros(0),
        {},
    )
    assert (data.lateness, data.step) == (0.0, pytest.approx(0.05))
    rows = data.rows(np.array([-1.0]))
    assert_allclose(rows.target, -rows.slopes[:, 0], rtol=0.05)


def test_a_stretch_begins_late_by_the_longest_delay_and_the_memory_of_the_slowest_lag():
    """A value that is held lasts a step, and one that is interpolated acts late by what is known of it."""
    remembered = 0.4 * math.log(100)
    held, late = Intersample(True), Intersample(False, 0.04)
    for between, longest in (
        (CONTINUOUS, 0.3),
        ({"u": held, "r": CONTINUOUS["r"]}, 0.3),
        ({"u": CONTINUOUS["u"], "r": held}, 0.35),
        ({"u": held, "r": late}, 0.34),
    ):
        data = two_inputs(driven(), between)
        assert data.lateness == pytest.approx(longest + remembered)
        # The lag and the delays; the output needs no simulated state, and yet waits as long.
        edges = [math.ceil(reach(band) / 0.05) for band in data.bands]
        wanted = [600 - 2 * edge - math.ceil(data.lateness / 0.05) for edge in edges]
        assert np.bincount(data.rows(POINT).equation).tolist() == wanted


def test_inputs_arrive_after_their_delays_and_before_the_first_sample_as_it_was():
    record = driven()
    time, inside = record.time, slice(20, -20)
    data = two_inputs(record, CONTINUOUS | {"r": Intersample(False, 0.04)})
    u, r = data.delayed_inputs(np.array([0.07, 0.02]))
    assert_allclose(u[inside], np.sin(1.3 * (time[inside] - 0.07)) + 2, atol=1e-6)
    assert_allclose(r[inside], np.cos(2.1 * (time[inside] - 0.06)), atol=1e-5)
    assert u[:2].tolist() == [2.0, 2.0]
    # Held: between two values, in shares of the part of a step.
    acts = acting(time, record["u"])
    data = two_inputs(record, CONTINUOUS | {"u": Intersample(True)})
    later = data.delayed_inputs(np.array([0.07, 0.0]))
    assert_allclose(later[0, 2:], 0.6 * acts[1:-1] + 0.4 * acts[:-2])  # 1.4 steps
    assert later[1] is not None
    assert_allclose(later[1], record["r"])


def test_a_simulated_state_is_that_of_its_lag_over_each_stretch():
    record = driven()
    u = record["u"].copy()
    u[300:304] = np.nan
    data = two_inputs(record.with_signals(u=u), CONTINUOUS)
    x = np.full((2, 600), np.nan)
    data.simulate(x, data.delayed_inputs(np.zeros(2)), POINT)
    assert np.isnan(x[0]).all()
    assert np.flatnonzero(np.isnan(x[1])).tolist() == [300, 301, 302, 303]
    # Of a lag: the gain and the phase of the sine, once the start is forgotten.
    wanted = 2 + np.imag(np.exp(1.3j * record.time) / (1 + 0.4 * 1.3j))
    settled = np.r_[100:300, 404:600]
    assert_allclose(x[1, settled], wanted[settled], atol=5e-5)
    unstable = POINT * [1, 1, -1, 1, 1]
    unknown = np.full((2, 600), np.nan)
    data.simulate(unknown, data.delayed_inputs(np.zeros(2)), unstable)
    assert np.isnan(unknown).all()
    assert 0 not in data.rows(unstable).equation


def test_a_stretch_is_used_from_four_rows_on():
    """What smoothing and delays need at its ends is left out of each."""
    record, band = driven(), 8.0
    edge, late = math.ceil(reach(band) / 0.05), math.ceil((0.3 + 0.4 * math.log(100)) / 0.05)
    for rows in (FEWEST - 1, FEWEST):
        count = 2 * edge + late + rows
        short = record.rows(slice(count))
        data = two_inputs(short, CONTINUOUS, cutoffs=dict.fromkeys(("v", "y"), 2 * band))
        assert data.bands == (band, band)
        sizes = np.bincount(data.rows(POINT).equation, minlength=2).tolist()
        assert sizes == [FEWEST * (rows == FEWEST)] * 2


def test_a_band_is_half_the_lowest_cutoff():
    cutoffs = {"v": 10.0, "y": 6.0}
    assert two_inputs(driven(), CONTINUOUS, cutoffs=cutoffs).bands == (5.0, 5.0)


def test_a_short_stretch_behind_a_long_one_gives_no_block():
    record, band = driven(), 8.0
    edge, late = math.ceil(reach(band) / 0.05), math.ceil((0.3 + 0.4 * math.log(100)) / 0.05)
    for rows in (FEWEST - 1, FEWEST):
        count = 2 * edge + late + rows
        v = record["v"].copy()
        v[600 - count - 3 : 600 - count] = np.nan
        cut = record.with_signals(v=v)
        data = two_inputs(cut, CONTINUOUS, cutoffs=dict.fromkeys(("v", "y"), 2 * band))
        of_v = np.count_nonzero(data.rows(POINT).equation == 0)
        assert of_v == 600 - count - 3 - 2 * edge - late + FEWEST * (rows == FEWEST)
