"""The step of the parameters against a dense quadratic program, and the merit against its definition."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hard_models import direct_delay
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from spring_lag_tilt import HELD, Spring, spring

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.part import Condensed
from greybox.engine.solve.gauss_newton.all_parts import AllParts
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.gauss_newton.iterate import EXACT, relaxed
from greybox.engine.solve.gauss_newton.line_search import merit_function
from greybox.engine.solve.gauss_newton.normal_equations import (
    EXACTNESS,
    gauss_newton_step,
    largest_multiplier,
)
from greybox.engine.solve.gauss_newton.settings import Settings


def prepared(values, **options):
    """The parts of a spring, an iterate with exact continuity, and its linearizations."""
    nlp = compile_problem(gb.Problem(Spring(), spring(200), HELD, **options))
    solver = GaussNewton(nlp)
    parts = AllParts(nlp, solver.limits, Settings())
    z = nlp.scaling.to_solver(np.array([values[name] for name in nlp.free]))
    start = parts.at(z)
    pairs = zip(parts.parts, start.nodes, strict=True)
    iterate = parts.at(z, [part.trajectory(z, n, simulated=True).nodes for part, n in pairs])
    weights = parts.residual_weights(iterate)
    linearizations = parts.linearize(iterate, weights)
    return nlp, parts, iterate, weights, linearizations


def relaxed_progress(parts, linearizations):
    pairs = zip(parts.parts, linearizations, strict=True)
    return replace(relaxed(), gap_variance=[part.continuity_variance(b) for part, b in pairs])


@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("constraints", [[], [lambda p: 8.0 - p.k]], ids=["free", "constrained"])
def test_the_step_is_that_of_a_dense_quadratic_program(damping, constraints):
    nlp, parts, iterate, _, linearizations = prepared(
        {"k": 7.0, "c": 0.9, "b": 3.5}, constraints=constraints
    )
    progress = replace(EXACT, damping=damping)
    step = gauss_newton_step(parts, iterate, linearizations, progress)
    (system,) = step.condensed
    damped = system.hessian + damping * np.diag(np.diag(system.hessian))
    low, high = (
        nlp.scaling.to_solver(nlp.lower) - iterate.z,
        nlp.scaling.to_solver(nlp.upper) - iterate.z,
    )
    factor = nlp.scaling.factor[nlp.free.index("k")]
    k = nlp.free.index("k")
    slack = {"type": "ineq", "fun": lambda dz: 8.0 - factor * (iterate.z[k] + dz[k])}
    wanted = minimize(
        lambda dz: (dz @ damped @ dz / 2 + system.gradient @ dz) / 1e4,
        np.zeros(3),
        jac=lambda dz: (damped @ dz + system.gradient) / 1e4,
        bounds=np.array([low, high]).T,
        constraints=[slack] if constraints else [],
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert_allclose(step.dz, wanted.x, rtol=1e-3, atol=1e-5)
    if constraints:
        assert factor * (iterate.z[k] + step.dz[k]) <= 8.0 + 1e-9


def test_nodes_alone_do_not_move_the_parameters():
    _, parts, iterate, _, linearizations = prepared({"k": 7.0, "c": 0.9, "b": 3.5})
    alone = gauss_newton_step(parts, iterate, linearizations, EXACT, states_only=True)
    assert not alone.dz.any()
    assert np.abs(gauss_newton_step(parts, iterate, linearizations, EXACT).dz).min() > 1e-6


def test_held_delays_do_not_move():
    nlp = compile_problem(direct_delay())
    parts = AllParts(nlp, GaussNewton(nlp).limits, Settings())
    iterate = parts.at(
        nlp.scaling.to_solver(np.array([p.start for p in direct_delay().parameters.values()]))
    )
    linearizations = parts.linearize(iterate, [part.initial_weight() for part in parts.parts])
    is_delay = np.array([name == "d" for name in nlp.free])
    step = gauss_newton_step(parts, iterate, linearizations, replace(EXACT, held=is_delay))
    assert step.dz[is_delay] == pytest.approx(0, abs=1e-12)
    assert np.abs(step.dz[~is_delay]).min() > 1e-6


@pytest.mark.parametrize("damping", [0.0, 3.0])
@pytest.mark.parametrize("weight", [1.0, 20.0])
def test_a_small_step_decreases_the_merit_as_predicted(damping, weight):
    """The exact merit is the cost, and a penalty on gaps that a step from a continuous trajectory does not have."""
    near = {"k": 8.97, "c": 1.2, "b": 4.0}
    _, parts, iterate, weights, linearizations = prepared(near, weight=weight)
    progress = replace(EXACT, damping=damping)
    step = gauss_newton_step(parts, iterate, linearizations, progress)
    merit = merit_function(parts, weights, progress.with_penalties(step))
    assert merit(iterate) == pytest.approx(parts.cost(iterate), rel=1e-12)
    moved = parts.moved(iterate, step, 1.0)
    assert merit(iterate) - merit(moved) == pytest.approx(step.decrease, rel=0.05)
    assert merit(moved) > parts.cost(moved)  # curvature leaves gaps
    closed = parts.close_gaps(moved, step, 0.0)
    gaps = [parts.gap_cost(at, step.multipliers) for at in (moved, closed)]
    assert gaps[1] < 0.01 * gaps[0]


def test_multipliers_are_those_of_the_active_constraints():
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    slack = np.array([0.0, 0.3, 0.0])
    force = 2.0 * normals[0] + 5.0 * normals[2]
    assert largest_multiplier(force, normals, slack) == pytest.approx(5.0)
    assert largest_multiplier(-force, normals, slack) == pytest.approx(5.0)
    assert largest_multiplier(force, normals, np.ones(3)) == 0.0


@pytest.mark.parametrize("is_exact", [True, False], ids=["exact", "relaxed"])
def test_a_missed_constraint_costs_its_penalty(is_exact):
    """k <= 6.5 is missed by a half.

    The penalty is at least that of the multiplier which holds the step.
    """
    nlp, parts, iterate, weights, linearizations = prepared(
        {"k": 7.0, "c": 0.9, "b": 3.5}, constraints=[lambda p: 6.5 - p.k]
    )
    progress = EXACT if is_exact else relaxed_progress(parts, linearizations)
    progress = replace(progress, constraint_penalty=0.0, multipliers=[np.zeros(2)])
    free = merit_function(parts, weights, progress)(iterate)
    step = gauss_newton_step(parts, iterate, linearizations, progress)
    penalty = step.constraint_penalty
    k, factor = nlp.free.index("k"), nlp.scaling.factor[nlp.free.index("k")]
    assert factor * (iterate.z[k] + step.dz[k]) == pytest.approx(6.5, abs=1e-9)
    force = step.hessian @ step.dz + step.condensed[0].gradient
    assert penalty > 0
    if is_exact:
        assert penalty == pytest.approx(EXACTNESS * abs(force[k]) / factor, rel=1e-3)
    penalized = replace(progress, constraint_penalty=penalty)
    assert merit_function(parts, weights, penalized)(iterate) == pytest.approx(free + penalty / 2)
    larger = replace(progress, constraint_penalty=10 * penalty)
    again = gauss_newton_step(parts, iterate, linearizations, larger)
    assert again.constraint_penalty == 10 * penalty  # it never falls
    assert again.decrease - step.decrease == pytest.approx(9 * penalty * 0.5, rel=1e-6)


@pytest.mark.parametrize("previous", [0.0, 1e9])
def test_penalties_on_gaps_exceed_the_multipliers_and_never_fall(previous):
    _, parts, iterate, _, linearizations = prepared({"k": 7.0, "c": 0.9, "b": 3.5})
    progress = replace(EXACT, multipliers=[np.full(2, previous)])
    step = gauss_newton_step(parts, iterate, linearizations, progress)
    largest = step.condensed[0].largest_multiplier(step.dz)
    assert_allclose(step.multipliers[0], np.maximum(previous, EXACTNESS * largest))
    first = relaxed_progress(parts, linearizations)
    assert not gauss_newton_step(parts, iterate, linearizations, first).multipliers


def test_the_relaxed_merit_is_the_squares_of_residuals_and_gaps_and_infinite_where_nothing_is_finite():
    _, parts, iterate, weights, linearizations = prepared({"k": 7.0, "c": 0.9, "b": 3.5})
    random = np.random.default_rng(0)
    gapped = parts.at(
        iterate.z, [nodes + 20 * random.normal(size=nodes.shape) for nodes in iterate.nodes]
    )
    progress = relaxed_progress(parts, linearizations)
    merit = merit_function(parts, weights, progress)
    squares, gaps = 0.0, 0.0
    for part, t, weight, variance in zip(
        parts.parts, gapped.trajectories, weights, progress.continuity_variance, strict=True
    ):
        squares += part.weight * float(np.trace(weight @ t.products @ weight.T)) / 2
        gaps += part.weight * float((t.gaps**2 / variance).sum()) / 2
    assert gaps > 1e-5 * squares
    assert merit(gapped) == pytest.approx(squares + gaps, rel=1e-9)
    exact = replace(EXACT, multipliers=[np.full(2, 3.0)])
    jumps = 3 * sum(np.abs(t.gaps).sum() for t in gapped.trajectories)
    assert merit_function(parts, weights, exact)(gapped) == pytest.approx(
        parts.cost(gapped) + jumps
    )
    lost = parts.at(iterate.z, [nodes + np.nan for nodes in iterate.nodes])
    for stage in (progress, exact):
        assert merit_function(parts, weights, stage)(lost) == np.inf


def test_damping_of_nodes_shortens_a_step_and_is_no_part_of_what_it_promises():
    """Two parts of one node w and one parameter z.

    The promise is the decrease of the quadratic cost of both.
    """
    damping, slopes = 0.7, np.array([[1.0, -2.0], [-0.5, 3.0]])
    curvatures = np.array([[[2.0, 0.6], [0.6, 3.0]], [[1.5, -0.4], [-0.4, 5.0]]])

    def system(A, g):
        damped = A[0, 0] + damping
        alone, follows = -g[0] / damped, -A[0, 1] / damped
        return Condensed(
            hessian=np.array([[A[1, 1] + A[0, 1] * follows]]),
            gradient=np.array([g[1] + A[0, 1] * alone]),
            node_step=np.array([[alone]]),
            node_sensitivity=np.array([[[follows]]]),
            multiplier=np.zeros((1, 1)),
            multiplier_sensitivity=np.zeros((1, 1, 1)),
            damping=np.array([[damping]]),
            held=np.zeros((1, 1, 1)),
            decrease=-(g[0] * alone + A[0, 0] * alone**2 / 2),
        )

    systems = [system(A, g) for A, g in zip(curvatures, slopes, strict=True)]
    weights = [1.0, 4.0]
    parts = SimpleNamespace(
        settings=Settings(),
        parts=[
            SimpleNamespace(
                condense=lambda *_, one=one, **__: one,
                residual_weight=lambda _: np.eye(1),
                weight=weight,
            )
            for one, weight in zip(systems, weights, strict=True)
        ],
        is_gain=np.zeros(1, dtype=bool),
        gains=[None, None],
        along=lambda *others: zip(parts.parts, [None, None], *others[1:], strict=True),
        limits=SimpleNamespace(
            linearized=lambda *_: (np.zeros((0, 1)), np.zeros(0)), violation=lambda _: 0.0
        ),
    )
    progress = replace(EXACT, damping=damping)
    nodes = [np.zeros((1, 1))] * 2
    iterate = SimpleNamespace(z=np.zeros(1), trajectories=[None, None], nodes=nodes)
    step = gauss_newton_step(parts, iterate, [None, None], progress)
    hessian = sum(w * one.hessian for w, one in zip(weights, systems, strict=True))
    gradient = sum(w * one.gradient for w, one in zip(weights, systems, strict=True))
    assert step.dz == pytest.approx(-gradient / hessian[0] / (1 + damping), rel=1e-8)
    assert step.distance == pytest.approx(step.dz @ hessian @ step.dz / 2)
    promised = 0.0
    for weight, one, A, g in zip(weights, systems, curvatures, slopes, strict=True):
        v = np.array([one.change_of_nodes(step.dz)[0, 0], step.dz[0]])
        promised -= weight * (g @ v + v @ A @ v / 2)
    assert step.decrease == pytest.approx(promised)
    alone = gauss_newton_step(parts, iterate, [None, None], progress, states_only=True)
    assert alone.decrease == pytest.approx(
        sum(w * one.decrease for w, one in zip(weights, systems, strict=True))
    )
    assert alone.distance == 0
