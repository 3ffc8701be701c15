"""The whole problem as one program for IPOPT, of several records of different lengths and weights."""

import math
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from rate_lag import Lag

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.runs import NOT_FINITE
from greybox.engine.solve.transcribed_program import TranscribedProgram

pytestmark = pytest.mark.usefixtures("unjudged_file")


def record(samples, seed):
    random = np.random.default_rng(seed)
    time, u = 0.1 * np.arange(samples), np.repeat(random.normal(size=samples // 10), 10)
    flown = gb.simulate(Lag(), {"a": 2.0}, gb.Record(time, {"u": u}), inputs="held")
    return gb.Record(
        time, {"u": u, "x": flown["x"] + 0.05 * (1 + seed) * random.normal(size=samples)}
    )


@pytest.mark.parametrize(
    "method", [gb.MultipleShooting(ipopt=True), gb.Collocation()], ids=["shooting", "collocation"]
)
def test_records_of_different_lengths_and_weights_are_one_program(method):
    """Against the Gauss-Newton solver, whose sums are tested against their definition."""
    held = gb.OutputError(inputs="held")
    parts = [gb.Problem(Lag(), record(20 + 20 * k, k), held, weight=1.0 + 2 * k) for k in range(2)]
    problem = parts[0] + parts[1]
    wanted, found = (
        gb.fit(problem, starts=[{}], method=m, progress=False, profiles=False)
        for m in (None, method)
    )
    assert found.converged
    assert found.cost == pytest.approx(wanted.cost, abs=1e-3)
    assert found.estimate["a"] == pytest.approx(wanted.estimate["a"], rel=1e-3)


SOLVED, LOST = "Solve_Succeeded", "Maximum_Iterations_Exceeded"


@pytest.fixture(scope="module")
def transcribed():
    problem = gb.Problem(Lag(), record(40, 0), gb.OutputError(inputs="held"))
    nlp = compile_problem(problem, gb.MultipleShooting(ipopt=True))
    return TranscribedProgram(nlp, {})


@pytest.mark.parametrize(
    ("costs", "statuses", "same_data", "runs", "status"),
    [
        ([9.0, 7.0, 7.0 * (1 - 0.9e-9)], [SOLVED] * 3, True, 3, SOLVED),
        ([9.0, 7.0, 7.0 * (1 - 1.1e-9), 7.0 * (1 - 1.1e-9)], [SOLVED] * 4, True, 4, SOLVED),
        ([0.5, 0.5 - 0.9e-9], [SOLVED] * 2, True, 2, SOLVED),  # of costs below one, of one
        ([-50.0, -50.0 * (1 + 0.9e-9)], [SOLVED] * 2, True, 2, SOLVED),
        ([7.0] * 200, [SOLVED] * 200, False, 100, "relaxations exceeded"),
        ([9.0, 7.0], [SOLVED, LOST], True, 2, LOST),
        ([9.0, math.inf], [SOLVED] * 2, True, 2, SOLVED),
    ],
)
def test_relaxations_go_on_until_the_cost_stays(
    monkeypatch, transcribed, costs, statuses, same_data, runs, status
):
    asked = []

    def solve(solution, w, bounds):
        asked.append(float(np.sum(w)))
        return solution + 0.001, statuses[len(asked) - 1], 3

    def outcome(solution, w):
        return costs[len(asked) - 1], np.full(2, float(len(asked))), same_data

    monkeypatch.setattr(transcribed, "_ipopt", SimpleNamespace(solve=solve))
    monkeypatch.setattr(transcribed, "_outcome", outcome)
    [found] = transcribed.led(np.array([[2.0]]))
    assert len(asked) == runs
    assert asked[1:] == [2.0 * k for k in range(1, runs)]  # weights follow from the last residuals
    assert (found.status, found.iterations) == (status, 3 * runs)
    assert found.cost == costs[runs - 1]
    scaling = transcribed.nlp.scaling
    assert found.estimate == pytest.approx(
        scaling.to_parameters(scaling.to_solver(np.array([2.0])) + 0.001 * runs)
    )
    assert (found.signature is not None) == math.isfinite(costs[runs - 1])


@pytest.mark.parametrize("status", [SOLVED, LOST, "Search_Direction_Becomes_Too_Small"])
def test_an_end_is_judged_by_its_place_and_not_by_its_status(monkeypatch, transcribed, status):
    minimum = transcribed.led(np.array([[2.0]]))[0].estimate
    for x, is_minimum in ((minimum, True), (1.2 * minimum, False)):
        z = transcribed.nlp.scaling.to_solver(x)

        def solve(solution, w, bounds, z=z):
            return np.append(z, solution[1:]), status, 1

        with monkeypatch.context() as patched:
            patched.setattr(transcribed, "_ipopt", SimpleNamespace(solve=solve))
            [end] = transcribed.led(np.array([[2.0]]))
        assert (end.status, end.converged) == (status, is_minimum)


def test_an_end_without_continuous_states_is_no_answer(monkeypatch, transcribed):
    monkeypatch.setattr(
        transcribed,
        "_ipopt",
        SimpleNamespace(solve=lambda solution, w, bounds: (solution, SOLVED, 1)),
    )
    monkeypatch.setattr(transcribed, "_outcome", lambda solution, w: (5.0, w, True))
    broken = replace(transcribed.profile(np.array([2.0])), converged=False)
    monkeypatch.setattr(transcribed._gauss_newton, "profile", lambda x, nodes: broken)
    [found] = transcribed.led(np.array([[2.0]]))
    assert (found.status, found.converged) == ("no continuous states at the estimate", False)
    monkeypatch.setattr(transcribed._gauss_newton, "smoothed", lambda z: None)
    [found] = transcribed.led(np.array([[2.0]]))
    assert (found.status, found.converged, found.cost, found.iterations) == (
        NOT_FINITE,
        False,
        math.inf,
        0,
    )


def test_the_cost_of_a_solution_is_the_weighted_sum_of_the_parts():
    """Each has its unknowns and weights, and all of them must have kept the samples of their delays."""
    held = gb.OutputError(inputs="held")
    problem = gb.Problem(Lag(), record(40, 0), held, weight=2.0) + gb.Problem(
        Lag(), record(70, 1), held, weight=5.0
    )
    nlp = compile_problem(problem, gb.MultipleShooting(ipopt=True))
    made = TranscribedProgram(nlp, {})
    sizes = [program.unknowns.numel() for program in made._programs]
    weights = [program.parameters.numel() for program in made._programs]
    seen = []

    def part(k, same):
        def products(z, unknowns, own):
            seen.append((z.tolist(), unknowns, own))
            return ca.DM(10.0**k)

        def outcome(z, products, own):
            return products.item(), own + 1, same

        return SimpleNamespace(products=products, outcome=outcome, part=nlp.parts[k])

    for same in (True, False):
        seen.clear()
        made._programs = [part(0, True), part(1, same)]
        solution, w = np.arange(1.0 + sum(sizes)), 100.0 + np.arange(sum(weights))
        cost, following, same_data = made._outcome(solution, w)
        assert (cost, same_data) == (2.0 * 1 + 5.0 * 10, same)
        assert following.tolist() == (w + 1).tolist()
        assert [z for z, _, _ in seen] == [[0.0]] * 2
        assert [unknowns.size for _, unknowns, _ in seen] == sizes
        assert (
            np.concatenate([unknowns for _, unknowns, _ in seen]).tolist() == solution[1:].tolist()
        )
        assert [own.size for _, _, own in seen] == weights
