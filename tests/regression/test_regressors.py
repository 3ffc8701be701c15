"""Signals as the equations need them, against closed forms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from lagged_plant import STEP, TIME, TRUTH, Lagged, flown, force
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from greybox.data.intersample import Intersample
from greybox.modeling.realization import dynamics
from greybox.regression.linear_in_parameters import regressions
from greybox.regression.regressors import FEWEST, REMEMBERED, _linear_response, memory, regressors
from greybox.regression.smoothing import reach


def made(record=None, latest=0.1, **options):
    system = dynamics(Lagged())
    equations = regressions(system, ["u", "v"], {}, TRUTH)
    names = (system.states, system.inputs)
    return regressors(
        equations,
        names,
        flown() if record is None else record,
        TRUTH,
        np.array([latest]),
        {"u": Intersample(False)},
        **options,
    )


def test_at_the_truth_the_blocks_hold():
    """v' = a v + b w to the accuracy of cubic splines; the rows begin when the lag has forgotten its start."""
    data = made()
    (block,) = data.blocks(TRUTH)
    assert data.equations.linear == ("a", "b")
    # Neither the ends of the filter nor what came before the first sample.
    edge, late = (math.ceil(seconds / STEP) for seconds in (reach(data.bands[0]), data.lateness))
    assert len(block.target) == len(block.base) == len(block.slopes) == TIME.size - 2 * edge - late
    error = block.target - block.base - block.slopes @ TRUTH[:2]
    assert np.abs(error).max() < 2e-3 * np.abs(block.target).max()
    assert data.lateness == pytest.approx(0.1 + 0.05 * math.log(1 / REMEMBERED))


def test_another_delay_shifts_the_input():
    data = made()
    late = data._late(np.array([0.123]))
    inside = TIME > 0.2
    assert_allclose(late[0, inside], force(TIME[inside] - 0.123), atol=1e-5)
    assert data._late(np.array([0.0]))[0] is not None


def test_an_unstable_lag_has_no_blocks():
    assert made().blocks(np.array([-1.0, 3.0, -0.05, 0.03])) == []


def test_memory_is_that_of_the_slowest_mode():
    matrix = np.array([[-2.0, 1.0], [0.0, -0.5]])
    equations = SimpleNamespace(simulated_names=("p", "q"), simulated=lambda x, u, p: (np.zeros((2, 1)), matrix))
    assert memory(equations, (("p", "q"), ()), np.zeros(0)) == pytest.approx(math.log(100) / 0.5)
    assert memory(SimpleNamespace(simulated_names=()), ((), ()), np.zeros(0)) == 0.0


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


def test_the_busiest_part_is_that_with_the_most_variance():
    record = flown()
    u = record["u"] * np.where((record.time > 10) & (record.time < 16), 5.0, 0.1)
    part = made(record.with_signals(u=u)).busiest(600)
    assert part.time.size == 600
    assert part.time[0] == pytest.approx(10, abs=0.3)
    assert all(values.size == 600 for values in (*part.states.values(), *part.inputs.values()))
    assert made().busiest(10**6).time.size == TIME.size


def test_stretches_that_are_too_short_give_no_block():
    record = flown()
    v = record["v"].copy()
    v[1000:1003] = np.nan
    both = made(record.with_signals(v=v)).blocks(TRUTH)
    assert len(both) == 2
    assert min(block.target.size for block in both) >= FEWEST
    assert made(record.with_signals(v=v), latest=12.0).blocks(TRUTH)[0].target.size < both[1].target.size


def test_a_band_limits_all_terms():
    assert made(band=2.0).bands == (2.0,)
    assert made(cutoffs={"v": 10.0}).bands == (5.0,)
