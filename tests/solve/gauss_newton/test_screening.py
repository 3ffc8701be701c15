"""Starts of records that are improved and compared on short segments before any of them is run."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.screening import Screening, distinct
from greybox.solve.multistart import multistart
from greybox.solve.waves import AllAtOnce, PromisingFirst

VALUES = {"Z_alpha": -1.2, "M_alpha": -6.0, "M_q": -2.0, "M_de": -8.0, "b_q": 0.02, "b_az": -0.5}


def of_size(value):
    return gb.Parameter(value, bounds=(-30 * abs(value), 30 * abs(value)))


class ShortPeriod(gb.StateSpace):
    """The short-period motion of an aircraft, in boxes of thirty times its values: most points in them are unstable."""

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
    signals = {name: simulated[name] + size * rng.standard_normal(samples) for name, size in noise.items()}
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
    screening = Screening(solver._nlp, solver._limits)
    z = solver._nlp.scaling.to_solver(drawn(aircraft, 3, 0) / 30)
    (record,) = screening._whole
    states = record.states_from_data(z) + 0.01
    here = record.evaluated(z, states)
    rng = np.random.default_rng(1)
    dz, dx = rng.standard_normal(z.shape), rng.standard_normal(states.shape)
    h = 1e-6
    ahead, behind = (record.evaluated(z + s * h * dz, states + s * h * dx).cost for s in (1, -1))
    slope = (here.gradient * dz).sum(axis=1) + (here.by_states[0][2] * dx).sum(axis=(1, 2))
    assert_allclose((ahead - behind) / (2 * h), slope, rtol=1e-6)

    # Every point is for itself.
    alone = record.evaluated(z[1:2], states[1:2])
    for own, together in ((alone.cost, here.cost), (alone.gradient, here.gradient), (alone.hessian, here.hessian)):
        assert_allclose(own[0], together[1], rtol=1e-12)


def test_points_lead_to_the_minimum_over_short_segments(aircraft, solver):
    screening = Screening(solver._nlp, solver._limits)
    truth = solver._nlp.scaling.to_solver(np.array(list(VALUES.values())))
    wanted = screening.improved(truth[None])
    found = screening.improved(solver._nlp.scaling.to_solver(drawn(aircraft, 20, 3)))
    best = distinct(found)[0]
    assert found.cost[best] == pytest.approx(wanted.cost[0], rel=0.05)
    assert np.abs(found.z[best] - truth).max() < 0.05  # of the box


def test_the_search_finds_what_plain_starts_miss(aircraft, solver):
    best = solver.run(np.array(list(VALUES.values()))).cost
    plain = [solver.run(start, 30) for start in drawn(aircraft, 4, 0)]
    assert sum(run.converged and run.cost < best + 0.1 for run in plain) < 4
    for seed in range(2):
        starts = drawn(aircraft, 20, seed)
        search = multistart(solver._nlp, solver, starts, waves=PromisingFirst(4, 3))
        assert search.minima[0].cost < best + 0.1
        assert len(search.brought) == 4
        for run, start in zip(search.runs, starts, strict=True):
            assert_array_equal(run.start, start)
            assert (run.stage == "screened") == (run.cost == np.inf)


def test_what_was_screened_out_is_kept(tmp_path):
    fit = gb.fit(lag_problem(), progress=False)
    stages = [run.stage for run in fit.runs]
    assert stages[0] == "polished"
    assert stages[:20].count("screened") == 16
    assert len(stages) == 20
    assert "(16 of 20 starts were screened out)" in str(fit)
    assert fit.cost == pytest.approx(gb.fit(lag_problem(), 20, progress=False).cost, abs=1e-6)
    with ThreadPoolExecutor(1) as executor:
        elsewhere = gb.fit(lag_problem(), executor=executor, progress=False)
    assert [run.cost for run in elsewhere.runs] == [run.cost for run in fit.runs]
    gb.save(fit, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5")
    assert [run.stage for run in loaded.runs] == stages
    assert loaded.agreeing == fit.agreeing


def test_a_number_that_is_asked_for_is_tried_as_it_is():
    fit = gb.fit(lag_problem(), 6, progress=False)
    assert {run.stage for run in fit.runs} == {"polished"}
    plain = gb.MultipleShooting(strategies=gb.solve.Strategies(screened_starts=False))
    assert GaussNewton(compile_problem(lag_problem(), plain)).screened(drawn(lag_problem(), 6, 0)) is None
    bound = lag_problem().with_(constraints=[lambda p: p.K - p.T])
    assert not Screening.serves(compile_problem(bound))


def test_what_is_not_finite_promises_nothing():
    problem = lag_problem()
    solver = GaussNewton(compile_problem(problem))
    starts = drawn(problem, 6, 0)
    starts[2] = np.nan
    screened = solver.screened(starts)
    assert 2 in screened.order[-3:]
    assert sorted(screened.order) == list(range(6))
    assert AllAtOnce().screened(solver, starts) is None


def test_the_declared_start_is_the_fourth_as_it_is_and_the_promising_ones_begin_where_they_lead(monkeypatch):
    problem = lag_problem()
    nlp = compile_problem(problem)
    solver = GaussNewton(nlp)
    starts = drawn(problem, 8, 0)
    found = np.clip(1.1 * starts, nlp.lower, nlp.upper)
    points = SimpleNamespace(z=nlp.scaling.to_solver(found[1:]))
    monkeypatch.setattr("greybox.solve.gauss_newton.driver.Screening.improved", lambda self, z: points)
    monkeypatch.setattr("greybox.solve.gauss_newton.driver.distinct", lambda improved: [5, 0, 2, 6])
    screened = solver.screened(starts)
    assert screened.order.tolist() == [6, 1, 3, 0, 7, 2, 4, 5]
    promising = [6, 1, 3, 7]
    assert_allclose(screened.begins[promising], found[promising], rtol=1e-12)
    assert_array_equal(screened.begins[[0, 2, 4, 5]], starts[[0, 2, 4, 5]])
