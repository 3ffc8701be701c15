"""States to begin with where the model is not finite at zero."""

import numpy as np
import pytest

import greybox as gb
from greybox.engine.compiled.initial_states import InitialStates, at_samples
from greybox.engine.compiled.sampled_data import SampledData, Stretch
from greybox.modeling.realization import dynamics


class Jet(gb.StateSpace):
    """A tank of which the speed of its jet is measured."""

    states, inputs, outputs = ("h",), ("u",), ("v",)
    k = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (u.u - p.k * gb.sqrt(x.h),)

    def output(self, x, u, p):
        return (p.k * gb.sqrt(x.h),)


@pytest.mark.parametrize("level", [0.01, 1.0, 100.0])
def test_a_hidden_state_has_the_size_that_comes_closest_to_what_was_measured(level):
    measured = np.full((1, 5), 1.1 * np.sqrt(level))
    found = InitialStates(dynamics(Jet()).observed(("v",))).at(
        measured, np.zeros((1, 5)), np.ones(1), np.full(1, np.nan)
    )
    assert found == pytest.approx(np.full((1, 5), level))


class Scale(Jet):
    """The tank on a scale that does not begin at zero, of which the weight is measured."""

    outputs = ("w",)

    def output(self, x, u, p):
        return (2 * x.h + 3,)


def test_a_state_that_an_output_shows_begins_as_measured():
    level = np.array([[0.5, 1.0, 4.0]])
    states = InitialStates(dynamics(Scale()).observed(("w",)))
    found = states.at(2 * level + 3, np.zeros((1, 3)), np.ones(1), np.full(1, np.nan))
    assert found == pytest.approx(level)


class Chain(gb.StateSpace):
    """Two states that are seen, one of them reversed, and one that is not and enters a root."""

    states, inputs, outputs = ("a", "b", "c"), ("u",), ("y", "sum", "z")
    k = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (x.b + u.u, -p.k * x.a - 3 * x.b, -x.c)

    def output(self, x, u, p):
        return (5 - 0.5 * x.a, x.a + x.b, 4 * x.b)


def chain(outputs=("y", "sum", "z")):
    return InitialStates(dynamics(Chain()).observed(outputs))


UNKNOWN = np.full(3, np.nan)


def test_states_that_outputs_show_begin_as_measured_and_others_at_rest():
    a, b = np.array([-2.0, -3.0, -2.5, -2.4]), np.array([1.0, -1.0, 2.0, -1.9])
    measured, inputs = np.array([5 - 0.5 * a, a + b, 4 * b]), np.zeros((1, 4))
    states = chain()
    assert states.as_measured(np.full((3, 4), 7.0), measured) == pytest.approx(
        np.array([a, b, [7.0] * 4])
    )
    found = states.at(measured, inputs, np.ones(1), UNKNOWN)
    assert found == pytest.approx(np.array([a, b, [0.0] * 4]))
    given = states.at(
        measured, inputs, np.ones(1), np.array([9.0, 9.0, -0.3])
    )  # what is shown is not taken as known
    assert given == pytest.approx(np.array([a, b, [-0.3] * 4]))
    assert chain(("sum", "z")).at(measured[1:], inputs, np.ones(1), UNKNOWN) == pytest.approx(
        np.array([[0.0] * 4, b, [0.0] * 4])
    )


def test_poles_are_those_of_the_linearization():
    found = chain().poles(np.zeros((3, 2)), np.zeros((1, 2)), np.array([2.0]))
    assert np.sort(found, axis=1) == pytest.approx(np.array([[-2, -1, -1]] * 2))


class Levels(gb.StateSpace):
    """Two hidden levels above zero, of which what is measured shows products."""

    states, inputs, outputs = ("h", "g"), ("u",), ("v", "w")
    k = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (u.u - gb.sqrt(x.h), gb.sqrt(x.h) - gb.sqrt(x.g))

    def output(self, x, u, p):
        return (gb.sqrt(x.h), 1e3 * gb.sqrt(x.h * x.g) / gb.sqrt(u.u))


def test_sizes_are_tried_together_and_then_of_each_state():
    """In units of the outputs, of which one is a thousand times as large; where an input is
    zero nothing is finite.
    """
    inputs = np.array([[1.0, 1.0, 0.0, 1.0]])
    measured = np.array([[0.1] * 4, [1000.0] * 4])
    found = InitialStates(dynamics(Levels()).observed(("v", "w"))).at(
        measured, inputs, np.ones(1), UNKNOWN[:2]
    )
    assert found == pytest.approx(np.array([[0.01] * 4, [100.0] * 4]))
    nowhere = InitialStates(dynamics(Levels()).observed(("v", "w")))
    assert not nowhere.at(measured, 0 * inputs, np.ones(1), UNKNOWN[:2]).any()


def test_samples_without_a_finite_model_take_the_states_of_the_nearest():
    """Levels as measured, below zero in the middle, where the root of the next sample that has
    one is taken.
    """

    class Seen(Jet):
        outputs = ("h",)

        def output(self, x, u, p):
            return (x.h,)

    level = np.array([[2.0, 3.0, -1.0, -1.0, 5.0]])
    found = InitialStates(dynamics(Seen()).observed(("h",))).at(
        level, np.zeros((1, 5)), np.ones(1), UNKNOWN[:1]
    )
    assert found.tolist() == [[2.0, 3.0, 3.0, 5.0, 5.0]]


def test_samples_at_which_states_begin():
    """Every third of each stretch, gaps interpolated; of an output without a value in a stretch
    its mean elsewhere.
    """
    y = np.array([[0.0, 1, np.nan, np.nan, 4, 5, 6], [np.nan] * 7])
    z = np.array([[10.0, 20.0, 30.0, 40.0], [2.0, np.nan, np.nan, 6.0]])
    stretches = (
        Stretch(np.arange(7.0)[None], y, np.arange(7), 0.1),
        Stretch(100 + np.arange(4.0)[None], z, 8 + np.arange(4), 0.1),
    )
    data = SampledData(stretches, 5)
    outputs, inputs = at_samples(data, 3)
    assert outputs == pytest.approx(np.array([[0, 3, 6, 10, 40], [4, 4, 4, 2, 6]]))
    assert inputs.tolist() == [[0, 3, 6, 100, 103]]
    begins = at_samples(data, 3, spread=True)[1]
    assert begins.tolist() == [
        [0, 3, 6, 101]
    ]  # the second stretch begins 0.618 of three samples later


class Gauge(Jet):
    """The tank behind gauges of unlike sizes, one of which counts downward."""

    outputs = ("v", "log")
    sign = gb.Parameter(1.0)

    def output(self, x, u, p):
        return (p.sign * 1e4 * gb.sqrt(x.h), gb.log(x.h))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_missed_counts_in_units_of_the_output_on_either_side_of_zero(sign):
    """A level of 4 by one gauge and of 100 by the other: in units of what was measured, ten
    misses least.
    """
    measured = np.array([[sign * 2e4] * 3, [np.log(100)] * 3])
    missed = {
        h: (np.sqrt(h) / 2 - 1) ** 2 + (np.log(h) / np.log(100) - 1) ** 2 for h in (1, 10, 100)
    }
    assert min(missed, key=missed.get) == 10
    found = InitialStates(dynamics(Gauge()).observed(("v", "log"))).at(
        measured, np.zeros((1, 3)), np.array([1.0, sign]), UNKNOWN[:1]
    )
    assert found.tolist() == [[10.0] * 3]


def test_a_hidden_state_that_is_best_at_zero_returns_there():
    class Offset(Levels):
        def output(self, x, u, p):
            return (gb.log(x.h), gb.log(x.h) + x.g)

        def derivative(self, x, u, p):
            return (u.u - gb.sqrt(x.h), -x.g)

    measured = np.full((2, 3), np.log(10.0))
    found = InitialStates(dynamics(Offset()).observed(("v", "w"))).at(
        measured, np.zeros((1, 3)), np.ones(1), UNKNOWN[:2]
    )
    assert found.tolist() == [[10.0] * 3, [0.0] * 3]


def test_an_output_that_was_never_measured_begins_at_zero():
    stretch = Stretch(
        np.arange(4.0)[None], np.array([[np.nan] * 4, [1.0, 2.0, 3.0, 4.0]]), np.arange(4), 0.1
    )
    outputs, _ = at_samples(SampledData((stretch,), 5), 2)
    assert outputs.tolist() == [[0.0, 0.0], [1.0, 3.0]]
