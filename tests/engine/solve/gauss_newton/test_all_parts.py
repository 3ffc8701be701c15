"""All parts of a problem.

Costs and penalties that add by their weights, and trajectories that go together.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from spring_lag_tilt import HELD, SPRING, Spring, spring

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.gauss_newton.all_parts import AllParts
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.gauss_newton.iterate import Iterate
from greybox.engine.solve.gauss_newton.settings import Settings


@pytest.fixture(scope="module")
def made():
    """A record of weight two, one of other outputs, and a response.

    An iterate with gaps between the segments.
    """
    omega = np.array([0.5, 2.0, 4.0])
    response = gb.frequency_response(Spring(), SPRING, omega, input="F", output="x").response * (
        1.1 + 0.05j
    )
    data = gb.FrequencyResponse(omega, response, "F", "x")
    second = gb.Record(
        spring(80, seed=1).time, {n: v for n, v in spring(80, seed=1).signals.items() if n != "v"}
    )
    problem = (
        gb.Problem(Spring(), spring(100), HELD, weight=2.0)
        + gb.Problem(Spring(), second, HELD)
        + gb.Problem(Spring(), data, gb.RelativeLikelihood(), weight=3.0)
    )
    nlp = compile_problem(problem)
    parts = AllParts(nlp, GaussNewton(nlp).limits, Settings())
    z = nlp.scaling.to_solver(np.array([SPRING[name] for name in nlp.free]))
    start, random = parts.at(z), np.random.default_rng(0)
    return parts, parts.at(
        z, [nodes + 0.1 * random.normal(size=nodes.shape) for nodes in start.nodes]
    )


def test_costs_and_penalties_add_by_their_weights(made):
    parts, iterate = made
    weights = [part.weight for part in parts.parts]
    assert sorted(weights) == [1, 2, 3]
    each = list(zip(parts.parts, iterate.trajectories, strict=True))
    assert parts.cost(iterate, 0.0) == pytest.approx(
        sum(part.weight * part.cost(t, 0.0) for part, t in each)
    )
    smoothed = parts.cost(iterate, 1e-2) - parts.cost(iterate, 0.0)
    assert smoothed == pytest.approx(
        sum(part.weight * (part.cost(t, 1e-2) - part.cost(t, 0.0)) for part, t in each)
    )
    assert smoothed != 0
    random = np.random.default_rng(1)
    sizes = [random.uniform(1, 2, t.nodes.shape[1]) for t in iterate.trajectories]
    gaps = [t.gaps for t in iterate.trajectories]
    absolute = [w * (np.abs(g) * m).sum() for w, g, m in zip(weights, gaps, sizes, strict=True)]
    assert parts.gap_cost(iterate, sizes) == pytest.approx(sum(absolute))
    squared = [w * (g**2 / m).sum() / 2 for w, g, m in zip(weights, gaps, sizes, strict=True)]
    residual_weights = parts.residual_weights(iterate)
    wanted = sum(
        p.weight * p.squared_cost(t, w) for (p, t), w in zip(each, residual_weights, strict=True)
    )
    assert parts.squared_cost(iterate, residual_weights, sizes) == pytest.approx(
        wanted + sum(squared)
    )
    lost = parts.at(iterate.z, [nodes + np.nan for nodes in iterate.nodes])
    assert parts.cost(lost) == np.inf


def test_signatures_stand_side_by_side(made):
    parts, iterate = made
    each = [part.signature(t) for part, t in zip(parts.parts, iterate.trajectories, strict=True)]
    assert_allclose(parts.signature(iterate), np.concatenate(each))


def simulated_at(parts, z, nodes):
    """Return the iterate whose stretches are simulated from their first nodes to their ends."""
    pairs = zip(parts.parts, nodes, strict=True)
    return Iterate(z, tuple(part.trajectory(z, n, simulated=True) for part, n in pairs))


def test_an_iterate_is_simulated_where_the_one_before_it_was(made):
    parts, iterate = made
    simulated = simulated_at(parts, iterate.z, iterate.nodes)
    with_nodes = [bool(t.nodes.size) for t in iterate.trajectories]
    assert [t.simulated for t in simulated.trajectories] == [True] * 3
    assert not parts.is_continuous(iterate)
    assert parts.is_continuous(simulated)
    again = parts.at(iterate.z, simulated.nodes, simulated)
    assert [t.simulated for t in again.trajectories] == [True] * 3
    plain = parts.at(iterate.z, simulated.nodes)
    assert [
        t.simulated
        for t, has_nodes in zip(plain.trajectories, with_nodes, strict=True)
        if has_nodes
    ] == [False] * 2


@pytest.mark.parametrize(("share", "continuous"), [(0.9, True), (1.1, False)])
def test_gaps_are_rounding_beside_the_largest_value_of_their_own_state(made, share, continuous):
    parts, iterate = made
    even = simulated_at(parts, iterate.z, iterate.nodes)
    trajectory = even.trajectories[0]
    size = np.abs(trajectory.nodes).max(axis=0)
    gaps = np.zeros_like(trajectory.gaps)
    gaps[-2] = share * 1e-9 * size
    moved = (replace(trajectory, gaps=gaps), *even.trajectories[1:])
    assert parts.is_continuous(replace(even, trajectories=moved)) is continuous
