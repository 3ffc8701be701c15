"""The rule for substeps, on linear models and a logistic one whose exact solutions are known."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sample_steps import stepped

import greybox as gb
from greybox.modeling.realization import dynamics
from greybox.modeling.step_size import (
    LEAST_GROWTH,
    MOST_GROWTH,
    MOST_SUBSTEPS,
    relative_change,
    stable_substeps,
    substep_growth,
)

SCHEMES = [gb.RungeKutta(), gb.Radau()]


class Decay(gb.StateSpace):
    """x' = -rate x, so that x(t) = exp(-rate t)."""

    states, inputs, outputs = ("x",), (), ("x",)
    rate = gb.Parameter(1.0)

    def derivative(self, x, u, p):
        return (-p.rate * x.x,)

    def output(self, x, u, p):
        return (x.x,)


class Logistic(Decay):
    """x' = rate x (1 - x), so that x(t) = 1 / (1 + (1/x0 - 1) exp(-rate t))."""

    def derivative(self, x, u, p):
        return (p.rate * x.x * (1 - x.x),)


def after(model, scheme, count, start, rate, step=1.0):
    """The state one sample later."""
    one = stepped(dynamics(model()), scheme, count)
    return float(one([start], [], [], [rate], step)[0])


def grows(rate, count):
    """Whether a decaying mode grows in `count` Runge-Kutta substeps of a sample of 1 s."""
    return abs(after(Decay, gb.RungeKutta(), count, 1.0, rate)) >= 1


@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0, 100.0])
def test_as_many_substeps_as_asked_for_are_stable_and_half_of_them_hardly_ever(rate):
    scheme = gb.RungeKutta()
    count = stable_substeps(np.array([-rate + 0j]), 1.0, reach=scheme.reach, wave=scheme.wave)
    assert count == math.ceil(rate / 2.7)
    assert not grows(rate, count)
    assert rate < 2.7 or grows(rate, max(1, int(rate / 2.8)))


def test_oscillations_are_followed_and_growth_counts_like_decay():
    assert stable_substeps(np.array([10j, -10j]), 1.0, reach=2.7, wave=0.7) == 15
    assert stable_substeps(np.array([10j, -10j]), 1.0, reach=2.7) == 4
    assert stable_substeps(np.array([3.0 + 0j]), 2.0, reach=2.7) == 3
    assert stable_substeps(np.zeros((0, 2), dtype=complex), 1.0, reach=2.7) == 1
    assert stable_substeps(np.array([-1e9 + 0j]), 1.0, reach=2.7) == MOST_SUBSTEPS + 1
    assert stable_substeps(np.array([-1e9 + 0j]), 1.0, reach=2.7, most=8) == 8


@pytest.mark.parametrize("scheme", SCHEMES, ids=repr)
def test_half_the_steps_tell_the_error(scheme):
    """Richardson: n substeps err by the difference to 2n of them, divided by 1 - 2^-order."""
    exact = math.exp(-1.0)
    coarse, fine = (after(Decay, scheme, n, 1.0, 1.0) for n in (8, 16))
    assert_allclose((fine - coarse) / (1 - 2.0**-scheme.order), exact - coarse, rtol=0.1)


def test_growth_follows_the_order_within_its_limits():
    assert substep_growth(81e-3, 1e-3, 4) == 3
    assert substep_growth(64e-3, 1e-3, 3) == 4
    assert substep_growth(1.01e-3, 1e-3, 4) == LEAST_GROWTH
    assert substep_growth(1e9, 1e-3, 4) == substep_growth(math.inf, 1e-3, 4) == MOST_GROWTH


def test_changes_are_relative_to_sizes_and_rounding_is_no_size():
    x = np.array([[1e3, -2e3, 0.0], [1e-13, 0.0, -1e-13], [0.5, 0.1, 0.2]])
    change = np.array([[2.0, 0.0], [0.0, -4e-6], [0.0, 0.0]])
    assert relative_change(change, x) == pytest.approx(4e-6 / 2e-3)
    assert relative_change(change[:1], x[:1]) == pytest.approx(2.0 / 2e3)
    assert relative_change(change[:1], x[2:], -3 * x[2:]) == pytest.approx(2.0 / 1.5)
    assert relative_change(np.ones((1, 2)), np.zeros((1, 2))) == 1.0
    assert relative_change(np.zeros((0, 4)), np.zeros((0, 4))) == 0.0
    assert math.isnan(relative_change(np.array([[math.nan]]), np.ones((1, 1))))
