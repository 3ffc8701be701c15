"""Structures of the literature, with what their outputs cannot determine.

Goodwin's oscillator, the predators and prey, the epidemic, the virus and the compartments are those
on which programs for structural identifiability are compared (SIAN, STRIKE-GOLDD, DAISY); for the
others the answer follows from a change of units of a state that is not measured.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import greybox as gb


class Structure(NamedTuple):
    """A model, and the groups of parameters that cannot be separated: names and directions."""

    model: gb.StateSpace
    groups: tuple[tuple[str, int], ...]


def structure(
    name: str,
    states: str,
    inputs: str,
    parameters: str,
    slopes: Callable[..., Any],
    outputs: Callable[..., Any],
    *groups: tuple[str, int],
    measured: str = "y",
) -> Structure:
    """Return a structure; `slopes` and `outputs` take states, inputs and parameters."""

    class Classic(gb.StateSpace):
        """A classic."""

        def derivative(self, x, u, p):
            """Return the slopes."""
            return slopes(x, u, p)

        def output(self, x, u, p):
            """Return the outputs."""
            return outputs(x, u, p)

    number = gb.Parameter(0.8, bounds=(1e-3, 1e3), starts=(0.3, 2.0))
    signals = {"states": states, "inputs": inputs, "outputs": measured}
    named = {key: tuple(value.split()) for key, value in signals.items()}
    model = type(name, (Classic,), named | dict.fromkeys(parameters.split(), number))
    return Structure(model(), groups)


def _first(x, u, p):
    return tuple(vars(x).values())[:1]


def _both(x, u, p):
    return tuple(vars(x).values())[:2]


def _monod(x, u, p):
    growth = p.mu * x.S / (p.K + x.S) * x.X
    return (growth, -growth / p.Y)


def _motor(x, u, p):
    return ((p.Km * x.i - p.b * x.w) / p.J, (u.v - p.R * x.i - p.Km * x.w) / p.L)


def _prey(x, u, p):
    return (p.a * x.x - p.b * x.x * x.y, -p.c * x.y + p.d * x.x * x.y)


def _duffing(x, u, p, gain=1.0):
    return (x.v, (gain * u.u - p.c * x.v - p.k * x.x - p.k3 * x.x**3) / p.m)


def _goodwin(x, u, p):
    change = p.gamma * x.x2 - p.delta * x.x3
    return (
        -p.b * x.x1 + 1 / (p.c + x.x4),
        p.alpha * x.x1 - p.beta * x.x2,
        change,
        p.sigma * x.x4 * change / x.x3,
    )


def _tanks(x, u, p):
    flows = [k * gb.sqrt(gb.maximum(h + 3, 1e-3)) for k, h in ((p.k1, x.h1), (p.k4, x.h2))]
    return (p.k2 * u.u - flows[0], p.k3 * flows[0] - flows[1])


STRUCTURES = (
    structure(
        "Goodwin",
        "x1 x2 x3 x4",
        "",
        "b c alpha beta gamma delta sigma",
        _goodwin,
        _first,
        ("alpha", 1),
        ("gamma", 1),
    ),
    structure(
        "Vajda",
        "x1 x2",
        "u",
        "t1 t2 t3",
        lambda x, u, p: (
            -p.t1 * x.x1**2 - p.t2 * x.x1 * x.x2 + u.u,
            p.t3 * x.x1**2 - x.x1 * x.x2,
        ),
        _first,
        ("t2 t3", 1),
    ),
    structure("Monod", "X S", "", "mu K Y", _monod, _first, ("K Y", 1)),
    structure("MonodBoth", "X S", "", "mu K Y", _monod, _both, measured="y z"),
    structure("Motor", "w i", "v", "R L Km J b", _motor, _first, ("R L Km J b", 2)),
    structure("MotorBoth", "w i", "v", "R L Km J b", _motor, _both, measured="y z"),
    structure(
        "Epidemic",
        "S I",
        "",
        "beta nu k",
        lambda x, u, p: (-p.beta * x.S * x.I, p.beta * x.S * x.I - p.nu * x.I),
        lambda x, u, p: (p.k * x.I,),
        ("beta k", 1),
    ),
    structure(
        "Virus",
        "T I V",
        "",
        "lam d beta delta N c",
        lambda x, u, p: (
            p.lam - p.d * x.T - p.beta * x.T * x.V,
            p.beta * x.T * x.V - p.delta * x.I,
            p.N * x.I - p.c * x.V,
        ),
        lambda x, u, p: (x.V,),
        ("lam N", 1),
    ),
    structure("Prey", "x y", "", "a b c d", _prey, _first, ("b", 1)),
    structure("PreyBoth", "x y", "", "a b c d", _prey, _both, measured="z w"),
    structure(
        "Compartments",
        "x1 x2",
        "u",
        "k12 k21 k01 k02",
        lambda x, u, p: (
            -(p.k01 + p.k21) * x.x1 + p.k12 * x.x2 + u.u,
            p.k21 * x.x1 - (p.k02 + p.k12) * x.x2,
        ),
        _first,
        ("k12 k21 k01 k02", 1),
    ),
    structure(
        "Michaelis",
        "x",
        "u",
        "Vm Km k c",
        lambda x, u, p: (-p.Vm * x.x / (p.Km + x.x) - p.k * x.x + u.u,),
        lambda x, u, p: (p.c * x.x,),
    ),
    structure(
        "MichaelisScaled",
        "x",
        "u",
        "Vm Km b c",
        lambda x, u, p: (-p.Vm * x.x / (p.Km + x.x) + p.b * u.u,),
        lambda x, u, p: (p.c * x.x,),
        ("Vm Km b c", 1),
    ),
    structure(
        "Pendulum",
        "q w",
        "u",
        "m l c",
        lambda x, u, p: (
            x.w,
            -9.81 / p.l * gb.sin(x.q) - p.c / (p.m * p.l**2) * x.w + u.u / (p.m * p.l**2),
        ),
        _first,
    ),
    structure("Duffing", "x v", "u", "m c k k3", _duffing, _first),
    structure(
        "DuffingGain",
        "x v",
        "u",
        "m c k k3 g",
        lambda x, u, p: _duffing(x, u, p, p.g),
        _first,
        ("m c k k3 g", 1),
    ),
    structure(
        "FitzHugh",
        "V R",
        "",
        "a b c",
        lambda x, u, p: (p.c * (x.V - x.V**3 / 3 + x.R), -(x.V - p.a + p.b * x.R) / p.c),
        _first,
    ),
    structure(
        "Bilinear",
        "x1 x2",
        "u",
        "p1 p2 p3 p4",
        lambda x, u, p: (-p.p1 * x.x1 + p.p2 * u.u, -p.p3 * x.x2 + p.p4 * u.u * x.x1),
        lambda x, u, p: (x.x2,),
        ("p2 p4", 1),
    ),
    structure(
        "Logistic",
        "x",
        "",
        "r K c",
        lambda x, u, p: (p.r * x.x * (1 - x.x / p.K),),
        lambda x, u, p: (p.c * x.x,),
        ("K c", 1),
    ),
    structure("Tanks", "h1 h2", "u", "k1 k2 k3 k4", _tanks, lambda x, u, p: (x.h2,)),
    structure(
        "Drag",
        "v",
        "u",
        "m c g",
        lambda x, u, p: ((p.g * u.u - p.c * abs(x.v) * x.v) / p.m,),
        _first,
        ("m c g", 1),
    ),
    structure(
        "SecondOrder",
        "x v",
        "u",
        "K w z",
        lambda x, u, p: (x.v, -(p.w**2) * x.x - 2 * p.z * p.w * x.v + p.K * u.u),
        _first,
    ),
    structure(
        "Idle", "x", "u", "a b c", lambda x, u, p: (-p.a * x.x + p.b * u.u,), _first, ("c", 1)
    ),
    structure(
        "Actuator",
        "x v",
        "u",
        "K T w",
        lambda x, u, p: ((p.K * u.u - x.x) / p.T, -p.w * x.v + x.x),
        lambda x, u, p: (x.v,),
    ),
)
