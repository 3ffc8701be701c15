"""States to begin with where the model is not finite at zero."""

import numpy as np
import pytest

import greybox as gb
from greybox.compiled.initial_states import InitialStates
from greybox.modeling.realization import dynamics
from greybox.solve import Strategies


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
    found = InitialStates(dynamics(Jet()), ("v",), Strategies()).at(
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
    states = InitialStates(dynamics(Scale()), ("w",), Strategies())
    found = states.at(2 * level + 3, np.zeros((1, 3)), np.ones(1), np.full(1, np.nan))
    assert found == pytest.approx(level)
