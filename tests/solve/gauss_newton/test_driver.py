"""The run of Gauss-Newton around its iteration: excerpts of long records, and the second attempt of a stalled run."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve.gauss_newton.driver import GaussNewton


class Lag(gb.StateSpace):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(1.0, bounds=(0.01, 50))

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.x),)

    def output(self, x, u, p):
        return (x.x,)


def record(seed, samples=300):
    random = np.random.default_rng(seed)
    time = 0.05 * np.arange(samples)
    u = np.repeat(random.normal(size=samples // 10), 10)
    flown = gb.simulate(Lag(), {"a": 2.0}, gb.Record(time, {"u": u}), inputs="held")
    return gb.Record(time, {"u": u, "x": flown["x"] + 0.05 * random.normal(size=samples)})


HELD = gb.OutputError(inputs="held")


def test_what_is_long_is_the_sum_of_all_records_and_each_is_first_solved_on_excerpts():
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD) + gb.Problem(Lag(), record(1), HELD))
    long = GaussNewton(nlp, settings=replace(nlp.strategies, long_record=400))
    assert long._coarse is not None
    (together,) = long._coarse._parts.parts  # half as many as are long, by each record's share
    assert [part.samples for part in together.parts] == pytest.approx([100, 100], rel=0.15)
    assert GaussNewton(nlp, settings=replace(nlp.strategies, long_record=700))._coarse is None


@pytest.mark.parametrize("status", ["converged", "stalled"])
def test_a_stalled_run_begins_once_more_near_the_data_with_what_is_left_of_its_iterations(status):
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    parts, seen = solver._parts, []

    def iterated(iterate, linearizations, progress, iterations, *, states_only):
        seen.append((iterate, iterations))
        first = len(seen) == 1
        lost = parts.at(iterate.z + 0.1, [nodes + 1.0 for nodes in iterate.nodes])
        return (lost, "stalled", 7) if first else (iterate, status, 3)

    solver._iterate = iterated
    outcome = solver.run(np.array([1.0]), 50)
    (begun, most), (again, left) = seen
    assert (most, left) == (50, 43)
    assert_allclose(again.z, begun.z + 0.1)
    assert_allclose(again.nodes[0], parts.from_data(again.z).nodes[0])
    assert (outcome.status, outcome.iterations) == (status, 10)
    assert_allclose(outcome.nodes[0] - again.nodes[0], 0 if status == "converged" else 1, atol=0.5)
