"""Starts of records that are improved and compared on short segments before any of them is run."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.gauss_newton.screening import (
    Points,
    ShortSegments,
    can_screen,
    descended,
    distinct,
    evaluated,
    improved,
    lower,
)
from greybox.engine.solve.gauss_newton.settings import Settings
from greybox.engine.solve.multistart import multistart
from greybox.engine.solve.promising import Promising

pytestmark = pytest.mark.usefixtures("unjudged_file")

VALUES = {"Z_alpha": -1.2, "M_alpha": -6.0, "M_q": -2.0, "M_de": -8.0, "b_q": 0.02, "b_az": -0.5}


def of_size(value):
    return gb.Parameter(value, bounds=(-30 * abs(value), 30 * abs(value)))


class ShortPeriod(gb.StateSpace):
    """The short-period motion of an aircraft, in boxes of thirty times its values.

    Most points in them are unstable.
    """

    states, inputs, outputs = ("alpha", "q"), ("de",), ("alpha", "q", "az")
    Z_alpha, M_alpha, M_q, M_de, b_q, b_az = map(of_size, VALUES.values())

    def derivative(self, x, u, p):
        return (p.Z_alpha * x.alpha + x.q, p.M_alpha * x.alpha + p.M_q * x.q + p.M_de * u.de)

    def output(self, x, u, p):
        return (x.alpha, x.q + p.b_q, 50 * p.Z_alpha * x.alpha + p.b_az)


def flight(samples=120):
    time = 0.05 * np.arange(samples)
    elevator = gb.Record(time, {"de": 0.1 * np.sign(np.sin(1.5 * time) + 0.3 * np.sin(4 * time))})
    simulated = gb.simulate(ShortPeriod(), VALUES, elevator)
    rng = np.random.default_rng(0)
    noise = {"alpha": 0.002, "q": 0.005, "az": 0.2}
    signals = {
        name: simulated[name] + size * rng.standard_normal(samples) for name, size in noise.items()
    }
    return gb.Record(time, {"de": elevator["de"], **signals})


@pytest.fixture(scope="module")
def aircraft():
    return gb.Problem(ShortPeriod(), flight())


@pytest.fixture(scope="module")
def solver(aircraft):
    return GaussNewton(compile_problem(aircraft))


def drawn(problem, count, seed):
    return gb.solve.Sobol(count, seed).draw(problem.parameters)


def test_derivatives_are_those_of_the_cost(aircraft, solver):
    z = solver.nlp.scaling.to_solver(drawn(aircraft, 3, 0) / 30)
    (part,) = solver.nlp.parts
    record = ShortSegments(part, 3, 32, part.data.segment_length)
    states = record.states_from_data(z) + 0.01
    here = record.evaluated(z, states)
    rng = np.random.default_rng(1)
    dz, dx = rng.standard_normal(z.shape), rng.standard_normal(states.shape)
    h = 1e-6
    ahead, behind = (record.evaluated(z + s * h * dz, states + s * h * dx).cost for s in (1, -1))
    slope = (here.gradient * dz).sum(axis=1) + (here.slope * dx).sum(axis=(1, 2))
    assert_allclose((ahead - behind) / (2 * h), slope, rtol=1e-6)

    # Every point is for itself.
    single = ShortSegments(part, 1, 32, part.data.segment_length)
    alone = single.evaluated(z[1:2], states[1:2])
    for own, together in (
        (alone.cost, here.cost),
        (alone.gradient, here.gradient),
        (alone.hessian, here.hessian),
    ):
        assert_allclose(own[0], together[1], rtol=1e-12)


def test_points_lead_to_the_minimum_over_short_segments(aircraft, solver):
    truth = solver.nlp.scaling.to_solver(np.array(list(VALUES.values())))
    wanted = improved(solver.nlp, solver.limits, truth[None])
    z = solver.nlp.scaling.to_solver(drawn(aircraft, 20, 3))
    found = improved(solver.nlp, solver.limits, z)
    best = distinct(found)[0]
    assert found.cost[best] == pytest.approx(wanted.cost[0], rel=0.05)
    assert np.abs(found.z[best] - truth).max() < 0.05  # of the box


def test_the_search_finds_what_plain_starts_miss(aircraft, solver):
    best = solver.run(np.array(list(VALUES.values()))).cost
    short = GaussNewton(solver.nlp, settings=Settings(max_iter=30))
    plain = [short.run(start) for start in drawn(aircraft, 4, 0)]
    assert sum(run.converged and run.cost < best + 0.1 for run in plain) < 4
    starts = drawn(aircraft, 20, 0)
    search = multistart(solver, starts, promising=Promising((4,), agree=3))
    assert search.minima[0].cost < best + 0.1
    assert len(search.brought) == 4
    for run, start in zip(search.runs, starts, strict=True):
        assert_array_equal(run.start, start)
        assert (run.stage == "screened") == (run.cost == np.inf)


def test_what_was_screened_out_is_kept(tmp_path):
    fit = gb.fit(lag_problem(), progress=False, profiles=False)
    stages = [run.stage for run in fit.runs]
    assert stages[0] == "polished"
    assert stages[:20].count("screened") == 16
    assert len(stages) == 20
    assert "(16 of 20 starts were screened out)" in fit.details
    assert fit.cost == pytest.approx(
        gb.fit(lag_problem(), 1, progress=False, profiles=False).cost, abs=1e-6
    )
    with ThreadPoolExecutor(1) as executor:
        elsewhere = gb.fit(lag_problem(), executor=executor, progress=False, profiles=False)
    assert [run.cost for run in elsewhere.runs] == [run.cost for run in fit.runs]
    gb.save(fit, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5")
    assert [run.stage for run in loaded.runs] == stages
    assert loaded.agreeing == fit.agreeing


def test_a_number_that_is_asked_for_is_tried_as_it_is():
    fit = gb.fit(lag_problem(), 6, progress=False, profiles=False)
    assert {run.stage for run in fit.runs} == {"polished"}
    bound = lag_problem().with_(constraints=[lambda p: p.K - p.T])
    assert not can_screen(compile_problem(bound))


def test_what_is_not_finite_promises_nothing():
    problem = lag_problem()
    solver = GaussNewton(compile_problem(problem))
    starts = drawn(problem, 6, 0)
    starts[2] = np.nan
    screened = solver.screened(starts)
    assert 2 in screened.order[-3:]
    assert sorted(screened.order) == list(range(6))


def test_the_declared_start_is_the_fourth_and_starts_that_lead_to_one_point_are_tried_last(solver):
    starts = drawn(gb.Problem(ShortPeriod(), flight()), 8, 0)
    starts[7] = starts[6]
    order = solver.screened(starts).order.tolist()
    assert order[3] == 0
    assert order[-1] in (6, 7)


def test_starts_that_predict_worse_than_the_mean_begin_where_short_segments_lead(aircraft, solver):
    """Four of these ten fail where nodes follow segments that diverge."""
    best = solver.run(np.array(list(VALUES.values()))).cost
    runs = [solver.run(start / 3) for start in drawn(aircraft, 10, 1)]
    assert sum(run.converged and run.cost < best + 0.1 for run in runs) > 8


def test_workers_move_starts_of_implicit_steps_too(aircraft):
    """They have no criterion, from which a sample could be compiled."""
    solver = GaussNewton(compile_problem(aircraft, gb.MultipleShooting(integrator=gb.Radau())))
    start = drawn(aircraft, 3, 1)[2] / 3
    elsewhere = pickle.loads(pickle.dumps(solver))
    assert elsewhere.run(start).cost == solver.run(start).cost


# --- quadratic models of points and the states of their segments


def positive(random, *shape):
    half = random.normal(size=(*shape, shape[-1]))
    return half @ np.swapaxes(half, -1, -2) + 0.3 * np.eye(shape[-1])


def model_points(r=3, p=2, m=6, n=3):
    """Random points of p variables, and m segments of n states."""
    random = np.random.default_rng(7)
    return Points(
        z=random.normal(size=(r, p)),
        states=random.normal(size=(r, m, n)),
        cost=random.uniform(1, 2, r),
        gradient=random.normal(size=(r, p)),
        hessian=50 * positive(random, r, p),
        curvature=positive(random, r, m, n),
        cross=random.normal(size=(r, m, n, p)),
        slope=random.normal(size=(r, m, n)),
    )


def test_states_are_eliminated_as_from_the_whole_system():
    """Of each point the damped system of all states and parameters, written out."""
    points, damping = model_points(), np.array([0.0, 0.1, 3.0])
    gradient, hessian, follow = points.reduced(damping)
    for k in range(3):
        blocks = [H + damping[k] * np.diag(np.diag(H)) for H in points.curvature[k]]
        sizes = np.cumsum([0, *(len(b) for b in blocks)])
        whole = np.zeros((sizes[-1], sizes[-1]))
        for begin, block in zip(sizes, blocks, strict=False):
            whole[begin : begin + len(block), begin : begin + len(block)] = block
        C, g = np.vstack(points.cross[k]), np.concatenate(points.slope[k])
        assert_allclose(hessian[k], points.hessian[k] - C.T @ np.linalg.solve(whole, C), rtol=1e-9)
        assert_allclose(
            gradient[k], points.gradient[k] - C.T @ np.linalg.solve(whole, g), rtol=1e-9
        )
        moves = -np.linalg.solve(whole, np.column_stack([g, C]))
        assert_allclose(follow[k].reshape(-1, 3), moves, rtol=1e-9)


def test_what_the_segments_do_not_show_stays_where_it_is():
    points = model_points(m=1, n=2)
    points.curvature[:] = np.diag([4.0, 0.0])
    points.cross[..., 1, :], points.slope[..., 1] = 0.0, 0.0
    _, _, follow = points.reduced(np.array([0.5, 0.5, 0.5]))
    assert_allclose(follow[:, 0, 0, 0], -points.slope[:, 0, 0] / 6)
    assert_allclose(follow[:, 0, 1], 0)


def test_states_that_segments_do_not_show_still_move_downhill():
    """The second state has curvature below the rounding errors of the first one, or none."""
    for little in (0.0, 5e-13):
        curvature, slope = np.diag([1.0, little])[None, None], np.array([[[2.0, 1e-13]]])
        cross = np.array([[[[0.5], [0.0]]]])
        one = np.ones((1, 1))
        points = Points(one, slope, np.ones(1), one, np.array([[[3.0]]]), curvature, cross, slope)
        gradient, hessian, follow = points.reduced(np.zeros(1))
        assert np.all(slope * follow[..., 0] < 0)
        # The first state is eliminated: 1 - 0.5·2 and 3 - 0.5².
        assert_allclose(gradient, [[0.0]], atol=1e-10)
        assert_allclose(hessian, [[[2.75]]], rtol=1e-10)


def test_points_closer_than_a_unit_of_cost_to_a_better_one_are_that_one():
    """Half the square of the distance in the Hessian of the better one, whose states follow."""
    points = model_points(r=2)
    _, hessian, _ = points.reduced(np.zeros(2))
    H = hessian[0]
    direction = np.array([0.6, -0.8])
    unit = direction / np.sqrt(direction @ H @ direction / 2)
    far = np.array([3.0, 2.0]) * 100
    shifts = [0 * unit, 0.99 * unit, 1.01 * unit, -0.99 * unit, far, far + 1.5 * unit]
    costs = [1.0, 2.0, 3.0, 4.0, 0.5, np.inf]
    six = Points(*(np.repeat(values[:1], 6, axis=0) for values in points))
    six = six._replace(z=np.array(shifts) + points.z[0], cost=np.array(costs))
    assert distinct(six) == [4, 0, 2]


def test_of_two_points_the_lower_one_is_taken_with_all_it_has():
    first = model_points()
    second = Points(*(values + 1 for values in model_points()))
    second = second._replace(cost=first.cost + np.array([0.1, -0.1, 0.0]))
    for got, one, other in zip(lower(first, second), first, second, strict=True):
        assert_array_equal(got[[0, 2]], one[[0, 2]])
        assert_array_equal(got[1], other[1])


def test_records_add_up_and_what_is_not_finite_anywhere_promises_nothing():
    first, second = model_points(m=4), model_points(m=2)
    second.cross[1, 0, 2, 1] = np.nan
    second.cost[2] = np.inf
    records = [
        SimpleNamespace(evaluated=lambda z, states, own=own: own, chosen=range(count))
        for own, count in ((first, 4), (second, 2))
    ]
    states = np.concatenate([first.states, second.states], axis=1)
    found = evaluated(first.z, states, records)
    assert_allclose(found.cost, [first.cost[0] + second.cost[0], np.inf, np.inf])
    assert_allclose(found.gradient[0], first.gradient[0] + second.gradient[0])
    assert_allclose(found.hessian[0], first.hessian[0] + second.hessian[0])
    assert_array_equal(found.curvature[0], [*first.curvature[0], *second.curvature[0]])
    for array in found[3:]:
        assert np.all(array[1:] == 0)
    assert_array_equal(found.states, states)


def test_steps_are_damped_more_after_a_failure_and_less_after_a_success():
    """Of a cost whose Hessian is stated ten times too small, every undamped step fails."""
    scale, asked = 10.0, []

    def cost_of(z, states):
        asked.append(z[0].copy())
        r = len(z)
        by_states = np.ones((r, 1, 1, 1)), np.zeros((r, 1, 1, 2)), np.zeros((r, 1, 1))
        cost = 0.5 * (z**2).sum(axis=1)
        return Points(z, states, cost, z, np.tile(np.eye(2) / scale, (r, 1, 1)), *by_states)

    limits = SimpleNamespace(clipped=lambda z: np.clip(z, -5.0, 100.0))
    records = [SimpleNamespace(evaluated=cost_of, chosen=[0])]
    begun = evaluated(np.array([[1.0, 0.5]]), np.zeros((1, 1, 1)), records)
    asked.clear()
    end = descended(begun, records, limits, 6)
    # Damping 1e-3 ... 1 fails: the step is 10 / (1 + d) times the way; 10 succeeds, and 1 after it
    # fails again.
    ways = [
        np.clip(np.array([1.0, 0.5]) * (1 - 10 / (1 + d)), -5, 100)
        for d in (1e-3, 1e-2, 1e-1, 1.0, 10.0)
    ]
    assert_allclose(asked[:5], ways, rtol=1e-9)
    assert_allclose(asked[5], ways[4] * (1 - 10 / 2), rtol=1e-9)
    assert_allclose(end.z[0], ways[4], rtol=1e-9)


def test_segments_are_chosen_evenly_and_no_longer_than_they_are(solver):
    (part,) = solver.nlp.parts
    count, length = part.data.segments, part.data.segment_length
    few = ShortSegments(part, 2, 3, length + 7)
    assert few.chosen.tolist() == [0, round((count - 1) / 2), count - 1]
    assert few.length == length
    every = ShortSegments(part, 2, count + 5, 2)
    assert every.chosen.tolist() == list(range(count))
    assert every.length == 2


class Decay(gb.StateSpace):
    states, inputs, outputs = ("x",), (), ("x",)
    rate = gb.Parameter(500.0, bounds=(1, 1e4), unit="1/s")

    def derivative(self, x, u, p):
        return (-p.rate * x.x,)

    def output(self, x, u, p):
        return (x.x,)


def test_stiff_segments_take_whole_implicit_steps():
    """The end of a step of Radau IIA is a rational function; an accurate one would be zero."""
    # The first segment, which is simulated, has measured zeros.
    record = gb.Record(0.1 * np.arange(12), {"x": np.repeat([0.0, 1.0], 6)})
    method = gb.MultipleShooting(integrator=gb.Radau(), segment=3)
    nlp = compile_problem(gb.Problem(Decay(), record), method=method)
    [part] = nlp.parts
    segments = ShortSegments(part, 1, 1, 3)
    z = nlp.scaling.to_solver(np.array([500.0]))
    cost = segments.evaluated(z[None], np.ones((1, 1, 1))).cost
    a = -500 * 0.1
    end = (1 + 2 * a / 5 + a**2 / 20) / (1 - 3 * a / 5 + 3 * a**2 / 20 - a**3 / 60)
    weight = part.initial_weight().item()
    assert_allclose(cost, weight**2 * (1 + end**2 + end**4) / 2, rtol=1e-9)
