"""Steps from sample to sample, held against solve_ivp and against the orders that the schemes promise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sample_steps import stepped
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.modeling.realization import dynamics


class Pendulum(gb.StateSpace):
    """Driven, damped, nonlinear."""

    states = ("angle", "rate")
    outputs = ("angle",)
    k = gb.Parameter(9.0)
    c = gb.Parameter(0.5)

    def derivative(self, x, u, p):
        return (
            x.rate,
            -p.k * gb.sin(x.angle) - p.c * x.rate * abs(x.rate) + u.u + 0.3 * u.u * x.angle,
        )

    def output(self, x, u, p):
        return (x.angle,)


class Robertson(gb.StateSpace):
    """Rate constants over nine decades (Robertson 1966), the classical stiff problem."""

    states = ("a", "b", "c")
    inputs = ()
    outputs = ("a",)
    slow = gb.Parameter(0.04)

    def derivative(self, x, u, p):
        made, used, turned = p.slow * x.a, 1e4 * x.b * x.c, 3e7 * x.b**2
        return (-made + used, made - used - turned, turned)

    def output(self, x, u, p):
        return (x.a,)


SCHEMES = (gb.RungeKutta(), gb.Radau())
VALUES = [9.0, 0.5]


def ramp(step, mean=0.7, change=1.2):
    return lambda t: mean + change * (t / step - 0.5)


def exact(step, x=(0.5, -1.0)):
    u = ramp(step)

    def slope(t, x):
        a, r = x
        return (r, -9 * np.sin(a) - 0.5 * r * abs(r) + u(t) * (1 + 0.3 * a))

    return solve_ivp(slope, (0, step), x, rtol=1e-12, atol=1e-13).y[:, -1]


def advanced(scheme, substeps, step, x=(0.5, -1.0)):
    function = stepped(dynamics(Pendulum()), scheme, substeps)
    return function(x, 0.7, 1.2, VALUES, step).full().ravel()


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: type(s).__name__)
def test_the_error_falls_with_the_promised_order(scheme):
    step = 0.3
    errors = np.array(
        [np.abs(advanced(scheme, n, step) - exact(step)).max() for n in (4, 8, 16, 32)]
    )
    orders = np.log2(errors[:-1] / errors[1:])
    assert_allclose(orders[-1], scheme.order, atol=0.25)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: type(s).__name__)
def test_one_step_with_a_ramp_as_input(scheme):
    assert_allclose(advanced(scheme, 3, 0.02), exact(0.02), atol=2 * 0.02**scheme.order)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: type(s).__name__)
def test_the_reach_is_where_a_step_is_still_stable(scheme):
    class Decay(gb.StateSpace):
        states = ("x",)
        inputs = ()
        r = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return (-p.r * x.x,)

        def output(self, x, u, p):
            return (x.x,)

    step = stepped(dynamics(Decay()), scheme, 1)
    reach = min(scheme.reach, 1e4)
    assert abs(float(step(1.0, [], [], [reach], 1.0))) < 1
    beyond = abs(float(step(1.0, [], [], [10 * reach], 1.0)))
    # L-stable: what is much faster than the step has died away.
    assert beyond < 1e-4 if scheme.implicit else beyond > 1


def test_a_stiff_model():
    def slope(t, x):
        made, used, turned = 0.04 * x[0], 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
        return (-made + used, made - used - turned, turned)

    wanted = solve_ivp(
        slope, (0, 41), (1, 0, 0), method="Radau", t_eval=(1, 41), rtol=1e-10, atol=1e-14
    ).y
    system = dynamics(Robertson())
    found = {}
    for scheme in SCHEMES:
        step, x = stepped(system, scheme, 4), wanted[:, 0]
        for _ in range(40):
            x = step(x, [], [], [0.04], 1.0).full().ravel()
        found[scheme.order] = x
    assert_allclose(found[5], wanted[:, 1], rtol=1e-5)
    assert not np.all(np.abs(found[4]) < 10)  # the explicit scheme has run away


def test_a_static_model_stays_without_states():
    class Static(gb.StateSpace):
        states = ()
        k = gb.Parameter(2.0)

        def output(self, x, u, p):
            return (p.k * u.u,)

    assert stepped(dynamics(Static()), gb.RungeKutta(), 3)([], 1.0, 0.0, [2.0], 0.1).shape == (0, 1)


@pytest.mark.parametrize("wrong", [0, -1, 1.5, "2"])
def test_substeps_are_whole_numbers(wrong):
    with pytest.raises(ValueError, match="whole number of at least 1"):
        gb.RungeKutta(wrong)


def test_an_oscillation_is_followed_to_less_than_a_thousandth_in_a_step():
    """In the longest step to begin with, w, a Runge-Kutta step loses w⁶/144 of the amplitude and w⁵/120 rad."""

    class Oscillator(gb.StateSpace):
        states, inputs, outputs = ("a", "b"), (), ("a",)
        w = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return (-p.w * x.b, p.w * x.a)

        def output(self, x, u, p):
            return (x.a,)

    wave = gb.RungeKutta.wave
    a, b = (
        stepped(dynamics(Oscillator()), gb.RungeKutta(), 1)([1, 0], [], [], [wave], 1.0)
        .full()
        .ravel()
    )
    assert 1 - np.hypot(a, b) == pytest.approx(wave**6 / 144, rel=0.1)
    assert wave - np.arctan2(b, a) == pytest.approx(wave**5 / 120, rel=0.2)
    assert 1 - np.hypot(a, b) < 1e-3
