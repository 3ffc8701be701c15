"""Substeps and segments that a record begins with, from what the poles and the errors of small
models ask for.
"""

import math

import numpy as np
import pytest

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.step_size import drawn_parameters
from greybox.modeling.step_size import MOST_SUBSTEPS, stable_substeps

STEP = 0.1
TIME = STEP * np.arange(200)


class Plant(gb.StateSpace):
    """x' = pole x + u, the pole in a box of decades."""

    states, outputs = ("x",), ("x",)
    pole = gb.Parameter(-1.0, bounds=(-1000, 10), starts=(-1.0, -0.9))

    def derivative(self, x, u, p):
        return (p.pole * x.x + u.u,)

    def output(self, x, u, p):
        return (x.x,)


def plant(start, starts):
    return type(
        "Plant", (Plant,), {"pole": gb.Parameter(start, bounds=(-1e9, 1e3), starts=starts)}
    )()


def chosen(model, method=None):
    u = np.sign(np.sin(1.3 * TIME))
    record = gb.Record(TIME, {"u": u, "x": np.sin(TIME)})
    problem = gb.Problem(model, record, gb.OutputError(inputs="held"))
    (part,) = compile_problem(problem, method or gb.MultipleShooting()).parts
    return part.substeps, part.data.segment_length


def test_slow_poles_need_one_substep():
    assert chosen(plant(-0.01, (-0.02, 0.0)))[0] == 1


@pytest.mark.parametrize("rate", [100.0, 300.0])
def test_fast_poles_ask_for_stable_steps_at_the_declared_value(rate):
    """The box is slow; the declared value is not."""
    assert chosen(plant(-rate, (-1.0, -0.9)))[0] >= math.ceil(rate * STEP / 2.7)


def test_the_upper_quartile_of_the_box_counts():
    """Of rates that are even in 0 to 540 the upper quartile is about 405, which 15 substeps
    follow.
    """
    assert 11 <= chosen(plant(-1.0, (-540.0, 0.0)))[0] <= 20


def test_what_is_too_fast_gets_implicit_steps_unless_explicit_ones_are_asked_for():
    assert chosen(plant(-1e6, (-1e6, -1e5)))[0] == 1
    explicit = gb.MultipleShooting(integrator=gb.RungeKutta())
    assert chosen(plant(-1e6, (-1e6, -1e5)), explicit)[0] == MOST_SUBSTEPS


@pytest.mark.parametrize(("growth", "segment"), [(0.0, 10), (2.4, 8), (100.0, 5)])
def test_segments_are_as_long_as_an_unstable_mode_allows(growth, segment):
    assert chosen(plant(growth, (growth - 1e-9, growth + 1e-9)))[1] == segment


def test_what_the_method_says_holds():
    method = gb.MultipleShooting(segment=7, integrator=gb.RungeKutta(substeps=3))
    assert chosen(plant(-1e6, (-1e6, -1e5)), method) == (3, 7)
    assert chosen(plant(-1e6, (-1e6, -1e5)), gb.MultipleShooting(segment=7))[1] == 7
    assert (
        chosen(
            plant(-1e6, (-1e6, -1e5)), gb.MultipleShooting(integrator=gb.RungeKutta(substeps=3))
        )[0]
        == 3
    )


@pytest.mark.parametrize("rate", [3.0, 12.0, 25.0])
def test_a_model_and_its_mirror_image_ask_for_the_same_steps(rate):
    """x to -x and u to -u is the same motion: falling states count as rising ones."""
    time = STEP * np.arange(200)
    u, x = 1 + np.exp(-time), 2 * np.exp(-0.3 * time)

    def asked(sign):
        record = gb.Record(time, {"u": sign * u, "x": sign * x})
        problem = gb.Problem(
            plant(-rate, (-rate, -0.9 * rate)), record, gb.OutputError(inputs="held")
        )
        (part,) = compile_problem(problem, gb.MultipleShooting()).parts
        return part.substeps

    assert asked(1) == asked(-1)


def test_the_upper_quartile_of_the_draws_is_stable():
    u = np.sign(np.sin(1.3 * TIME))
    record = gb.Record(TIME, {"u": u, "x": np.sin(TIME)})
    for start in (-1.0, -530.0):
        problem = gb.Problem(plant(start, (-540.0, 0.0)), record, gb.OutputError(inputs="held"))
        method = gb.MultipleShooting()
        (part,) = compile_problem(problem, method).parts
        rates = drawn_parameters(problem)[:, 0]
        assert (rates[0], rates.size) == (start, 17)
        assert np.unique(rates).size == 17
        scheme = method.scheme
        counts = [
            stable_substeps(np.array([[r]]), STEP, reach=scheme.reach, wave=scheme.wave)
            for r in rates
        ]
        assert part.substeps == max(counts[0], np.quantile(counts, 0.75))


def test_a_model_that_falls_to_rest_has_the_longest_segments():
    assert chosen(plant(-0.5, (-0.6, -0.4)))[1] == 10
