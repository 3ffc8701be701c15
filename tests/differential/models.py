"""Random plants: each formula is written once, and read by greybox and by NumPy.

States are of order one, whatever the units of the outputs: a plant with a time scale of 1/`speed`
and outputs in random units tests scales where greybox works, not in the reference.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

import greybox as gb


@dataclass(frozen=True)
class Nonlinearity:
    """An increasing function of one variable, with a slope near one at the origin.

    Attributes
    ----------
    name : str
    symbolic, numeric : function
        The same function of CasADi expressions and of arrays.
    smooth : bool
        Whether its derivative is continuous.
    embedded : bool
        Whether its formula calls a CasADi function.
    """

    name: str
    symbolic: Callable[[Any], Any]
    numeric: Callable[[np.ndarray], np.ndarray]
    smooth: bool = True
    embedded: bool = False


# No motion leaves a table: what lies beyond is another model for each of its readers.
REACH = 400.0


def table(rng: np.random.Generator) -> Nonlinearity:
    """Return a random table, read by linear interpolation."""
    grid = np.linspace(-REACH, REACH, 1601)
    values = np.arcsinh(grid * rng.uniform(0.7, 1.5)) + rng.uniform(-0.2, 0.2)
    lookup = ca.interpolant("lookup", "linear", [grid], values)
    return Nonlinearity("table", lookup, lambda x: np.interp(x, grid, values), False, True)


def spline(rng: np.random.Generator) -> Nonlinearity:
    """Return a random table, read by a cubic spline."""
    slope = rng.uniform(0.7, 1.5)
    grid = np.linspace(-REACH, REACH, 1601)
    lookup = ca.interpolant("lookup", "bspline", [grid], np.arcsinh(grid * slope))

    def numeric(x):
        return np.array(lookup(np.ravel(x))).reshape(np.shape(x))

    return Nonlinearity("spline", lookup, numeric, True, True)


def function(rng: np.random.Generator) -> Nonlinearity:
    """Return a CasADi function that is never expanded into the formula that calls it."""
    z, share = ca.SX.sym("z"), rng.uniform(0.1, 0.4)
    call = ca.Function("call", [z], [z + share * ca.sin(z)], {"never_inline": True})
    return Nonlinearity("function", call, lambda x: x + share * np.sin(x), True, True)


def formula(rng: np.random.Generator, name: str) -> Nonlinearity:
    """Return a nonlinearity that is written with the functions of greybox, with a random constant."""
    c = float(rng.uniform(0.2, 0.6))
    both = {
        "linear": lambda x: x,
        "cubic": lambda x: x + c * x**3,
        "drag": lambda x: c * x + abs(x) * x,
    }
    if name in both:
        return Nonlinearity(name, both[name], both[name])
    if name == "tanh":
        return Nonlinearity(name, lambda x: gb.tanh(x / c) * c, lambda x: np.tanh(x / c) * c)
    if name == "dead zone":
        return Nonlinearity(
            name,
            lambda x: 0.3 * x + gb.maximum(x - c, 0) + gb.minimum(x + c, 0),
            lambda x: 0.3 * x + np.maximum(x - c, 0) + np.minimum(x + c, 0),
            smooth=False,
        )
    if name == "switch":
        return Nonlinearity(
            name,
            lambda x: gb.where(x > 0, x, c * x),
            lambda x: np.where(x > 0, x, c * x),
            smooth=False,
        )
    raise ValueError(f"{name!r} is not a nonlinearity.")


WRITTEN = ("linear", "cubic", "drag", "tanh", "dead zone", "switch")
EMBEDDED = {"table": table, "spline": spline, "function": function}


def nonlinearity(rng: np.random.Generator, names: Sequence[str]) -> Nonlinearity:
    """Return one of the named nonlinearities."""
    name = str(rng.choice(list(names)))
    return EMBEDDED[name](rng) if name in EMBEDDED else formula(rng, name)


@dataclass(frozen=True)
class Plant:
    """A model of greybox, the same in NumPy, and the true values of its parameters.

    Attributes
    ----------
    model : StateSpace
        The parameters start up to 30 % off the truth.
    truth : mapping of parameter to float
    derivative : function of x (n, m), u (inputs, m), p: name to (m,), to (n, m)
    output : function of the same to (outputs, m)
        For m parameter vectors at once.
    speed : float, 1/s
        The inverse of its time scale.
    gain : float
        The input times this is of order one.
    delays : mapping of input to parameter
    curve : Nonlinearity
    """

    model: Any
    truth: dict[str, float]
    derivative: Callable
    output: Callable
    speed: float
    gain: float
    delays: Mapping[str, str] = field(default_factory=dict)
    curve: Nonlinearity = field(default_factory=lambda: formula(np.random.default_rng(0), "linear"))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.model.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.model.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.model.outputs

    def __str__(self) -> str:
        """Describe the plant in a few words."""
        words = [f"{self.curve.name} of order {len(self.states)}"]
        words += [f"{len(self.outputs)} outputs"] if len(self.outputs) > 1 else []
        words += ["delay"] if self.delays else []
        return ", ".join(words)


@dataclass(frozen=True)
class Mechanics:
    """A lag, a mass on a spring with a damper, or such a mass behind an actuator.

    Each formula takes the nonlinearity `f` first, so that it serves greybox and NumPy.

    Attributes
    ----------
    order : int
        1, 2 or 3.
    speed : float, 1/s
    gain : float
        The first input times this is of order one.
    is_damper : bool
        Whether the damper is nonlinear, instead of the spring.
    is_pushed : bool
        Whether a second input moves the mass, too.
    accelerates : bool
        Whether the second output is the acceleration, which inputs reach directly, or the rate.
    scales : (outputs,) array
        Units of the outputs.
    """

    order: int
    speed: float
    gain: float
    is_damper: bool
    is_pushed: bool
    accelerates: bool
    scales: np.ndarray

    def force(self, f: Callable[[Any], Any], x: Any, u: Any, p: Any) -> Any:
        """Return drive less resistance."""
        result = p["k"] * (x[2] if self.order > 2 else self.gain * u[0])
        if self.is_pushed:
            result = result + p["b"] * u[1]
        if self.order == 1:
            return result - p["a"] * f(x[0])
        spring, damper = (x[0], f(x[1])) if self.is_damper else (f(x[0]), x[1])
        return result - p["a"] * spring - p["d"] * damper

    def derivative(self, f: Callable[[Any], Any], x: Any, u: Any, p: Any) -> list[Any]:
        """Return the derivatives of the states."""
        force = self.speed * self.force(f, x, u, p)
        if self.order == 1:
            return [force]
        actuator = [(self.gain * u[0] - x[2]) / p["T"]] if self.order > 2 else []
        return [self.speed * x[1], force, *actuator]

    def output(self, f: Callable[[Any], Any], x: Any, u: Any, p: Any) -> list[Any]:
        """Return one or two outputs."""
        result = [self.scales[0] * x[0]]
        if self.scales.size > 1:
            second = self.force(f, x, u, p) if self.accelerates else x[1]
            result += [self.scales[1] * second]
        return result

    def truth(self, rng: np.random.Generator) -> dict[str, float]:
        """Return random true values, in the units of a model of this speed and gain."""
        values = {"k": rng.uniform(0.6, 2.0), "a": rng.uniform(0.5, 2.0)}
        if self.order > 1:
            values["d"] = rng.uniform(0.4, 1.5)
        if self.order > 2:
            values["T"] = rng.uniform(0.1, 0.5) / self.speed
        if self.is_pushed:
            values["b"] = rng.uniform(0.5, 2.0)
        return {name: float(value) for name, value in values.items()}


def plant(
    rng: np.random.Generator,
    names: Sequence[str] = WRITTEN,
    *,
    delayed: bool = False,
    outputs: int | None = None,
    unstable: bool = False,
    order: int | None = None,
    damping: tuple[float, float] | None = None,
) -> Plant:
    """Return a random plant of order one to three.

    Parameters
    ----------
    names : sequence of str
        Nonlinearities to choose from.
    delayed : bool
        Whether the first input has an unknown delay.
    outputs : int, optional
        How many; a random number by default.
    unstable : bool
        Whether the spring is turned around: the plant then leaves the origin by a factor of e in
        three to ten of its time scales.
    order : int, optional
    damping : (float, float), optional
        Between which the linear damper is drawn.
    """
    curve = nonlinearity(rng, names)
    order = order or int(rng.integers(1, 4))
    mechanics = Mechanics(
        order,
        speed=float(10 ** rng.uniform(-1.5, 2)),
        gain=float(10 ** rng.uniform(-1.5, 1.5)),
        is_damper=order > 1 and not unstable and damping is None and bool(rng.random() < 0.4),
        is_pushed=order > 1 and bool(rng.random() < 0.3),
        # Under a delay, an output that an input reaches directly jumps between two samples.
        accelerates=not delayed and (order == 1 or bool(rng.random() < 0.5)),
        scales=10
        ** rng.uniform(-2, 2, outputs or (1 if delayed and order == 1 else rng.integers(1, 3))),
    )
    truth = mechanics.truth(rng)
    step = 0.1 / mechanics.speed
    if unstable:
        truth["a"] = -float(rng.uniform(0.1, 0.3))
    if damping is not None:
        truth["d"] = float(rng.uniform(*damping))
    if delayed:
        # Not a whole number of samples: the cost of a held input has a kink there.
        truth["delay"] = float(rng.integers(0, 4) + rng.uniform(0.25, 0.75)) * step

    bounds = {name: (value / 5, value * 5) for name, value in truth.items()}
    if unstable:
        bounds["a"] = -2.0, 2.0
    if delayed:
        bounds["delay"] = 0.0, 8 * step
    body = {
        "__doc__": "A random plant.",
        "states": tuple("xvz"[:order]),
        "inputs": ("u", "w") if mechanics.is_pushed else ("u",),
        "outputs": ("q", "r")[: mechanics.scales.size],
        "delays": {"u": "delay"} if delayed else {},
    }
    body["derivative"] = _method(mechanics.derivative, curve, body, tuple(truth))
    body["output"] = _method(mechanics.output, curve, body, tuple(truth))
    for name, value in truth.items():
        start = float(np.clip(value * rng.uniform(0.75, 1.3), *bounds[name]))
        body[name] = gb.Parameter(start, bounds=bounds[name])

    return Plant(
        importable(gb.StateSpace, body)(),
        truth,
        _columns(mechanics.derivative, curve),
        _columns(mechanics.output, curve),
        mechanics.speed,
        mechanics.gain,
        body["delays"],
        curve,
    )


def _method(formula: Callable, curve: Nonlinearity, body: dict, names: tuple[str, ...]) -> Callable:
    """Return a method of a model from a formula."""
    states, inputs = body["states"], body["inputs"]

    def method(_, x, u, p):
        values = {name: getattr(p, name) for name in names}
        x, u = [getattr(x, name) for name in states], [getattr(u, name) for name in inputs]
        return tuple(formula(curve.symbolic, x, u, values))

    return method


def _columns(formula: Callable, curve: Nonlinearity) -> Callable:
    """Return the function of arrays of columns from a formula."""

    def rows(x, u, p):
        shape = np.broadcast_shapes(x[0].shape, p["k"].shape)
        return np.array([np.broadcast_to(row, shape) for row in formula(curve.numeric, x, u, p)])

    return rows


def importable(base: type, body: dict[str, Any]) -> type:
    """Return a class that pickle finds in this module."""
    module = sys.modules[__name__]
    number = sum(name.startswith("Random") for name in vars(module))
    created = type(f"Random{number}", (base,), {"__module__": __name__, **body})
    setattr(module, created.__name__, created)
    return created
