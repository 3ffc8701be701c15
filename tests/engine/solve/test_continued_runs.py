"""Unfinished runs are continued, and hard records: a longer search never ends higher."""

import pytest
from hard_models import THRUST, conversion, thrust
from nist import certified
from unfinished_runs import without_continued_runs

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


def test_a_run_that_ends_unfinished_and_lowest_goes_on_to_the_minimum():
    case = certified("Lanczos3")
    start = case.starts[0]
    short = gb.fit(
        case.problem,
        starts=[start],
        solver_options={"max_iter": 30},
        progress=False,
        profiles=False,
    )
    assert short.converged
    assert short.runs[0].iterations > 30
    after = gb.fit(
        case.problem,
        starts=[case.values, start],
        solver_options={"max_iter": 30},
        progress=False,
        profiles=False,
    )
    assert after.runs[1].status == "iterations exceeded"  # at a higher cost than the first
    starts = [start, case.starts[1]]
    with without_continued_runs():
        left = gb.fit(
            case.problem,
            starts=starts,
            solver_options={"max_iter": 30},
            progress=False,
            profiles=False,
        )
    assert [run.status for run in left.runs] == ["iterations exceeded", "converged"]
    assert left.cost == pytest.approx(short.cost, abs=1e-6)


def test_an_unfinished_run_below_the_answer_is_named():
    case = certified("Bennett5")
    held = case.problem.with_(fixed={"b2": 40.0})
    (answer,) = gb.fit(held, starts=[{}], progress=False, profiles=False).runs
    with without_continued_runs():
        fit = gb.fit(
            case.problem,
            starts=[case.starts[1]],
            solver_options={"max_iter": 150},
            progress=False,
            profiles=False,
        )
    assert not fit.converged
    assert fit.runs[0].cost < answer.cost


def test_the_limits_of_iterations_and_tolerance_are_options():
    problem = certified("ENSO").problem
    start = [certified("ENSO").starts[0]]
    loose = gb.fit(
        problem, starts=start, solver_options={"tol": 1e-2}, progress=False, profiles=False
    )
    tight = gb.fit(
        problem, starts=start, solver_options={"tol": 1e-10}, progress=False, profiles=False
    )
    assert loose.runs[0].iterations < tight.runs[0].iterations
    with pytest.raises(
        ValueError,
        match="'mu_strategy' is not an option of the Gauss-Newton solver: give max_iter or tol",
    ):
        gb.fit(
            problem,
            starts=start,
            solver_options={"mu_strategy": "adaptive"},
            progress=False,
            profiles=False,
        )
    with pytest.raises(ValueError, match="'max_iter' is 0: give a whole number"):
        gb.fit(
            problem, starts=start, solver_options={"max_iter": 0}, progress=False, profiles=False
        )


def test_initial_states_that_are_hardly_seen_hinder_nothing():
    # They are the four motors' speeds, all near 0.7, of which one output shows the sum.
    found = gb.fit(thrust(), starts=[{}], progress=False, profiles=False)
    assert found.converged
    for name, value in THRUST.items():
        assert abs(found.estimate[name] - value) < 4 * found.standard_error[name]
    assert all(
        abs(float(found.records[0].initial[name][0]) - 0.7) < 0.1
        for name in ("r1", "r2", "r3", "r4")
    )


def test_ipopt_too_begins_near_the_data_where_initial_states_are_hardly_seen():
    # From initial states of several hundred, where steps without damping lead, it stagnates far
    # above.
    found = gb.fit(
        thrust(400),
        starts=[THRUST],
        method=gb.SingleShooting(hessian="exact"),
        progress=False,
        profiles=False,
    )
    assert found.converged
    assert all(
        abs(found.estimate[name] - value) < 4 * found.standard_error[name]
        for name, value in THRUST.items()
    )


def test_an_alias_of_the_integrator_is_no_answer():
    # 101 and 76 turn 64 substeps of RK4 a sample into a slow pole, with the cost and response of
    # the true values.
    starts = [{"k1": 101.0, "k2": 76.0}, {"k1": 1.0, "k2": 1.0}]
    options = {
        "method": gb.MultipleShooting(integrator=gb.RungeKutta(64)),
        "progress": False,
        "profiles": False,
    }
    found = gb.fit(conversion(), starts=starts, **options)
    assert found.estimate["k1"] == pytest.approx(0.8125, rel=1e-3)
    assert [run.converged for run in found.runs] == [False, True]
    assert found.runs[0].status == "integration too coarse"
    assert not any("parameter vectors" in text for text in found.warnings)
    alone = gb.fit(conversion(), starts=starts[:1], **options)
    assert any(text.startswith("the integration is too coarse") for text in alone.warnings)
    # A quarter of the box is stiff, and implicit steps have no alias.
    implicit = gb.fit(conversion(), starts=starts[:1], progress=False, profiles=False)
    assert "Radau" in implicit.records[0].method
    assert not any("too coarse" in text for text in implicit.warnings)
