"""The loop of a plant and its sampled controllers as linear equations from one sample to the next.

Begin with `sampled_loop`. The plant is exact between samples: its control is held, and arrives
after a delay of any fraction of a sample. A loop holds many plants at once, one for each draw of
the parameters.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import finite_numbers
from greybox.data.files.arrays import Array, BoolArray, ComplexArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values, places_of
from greybox.modeling.held_inputs import held_response
from greybox.modeling.model import Model, require_known
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.symbolic_reading import entries_by_name
from greybox.modeling.trim import trim_of
from greybox.workflows.experiment.controller import (
    Controller,
    Controllers,
    connected,
    outside_names,
    run_controllers,
    sensors_of,
)

DOT = "_dot"  # after the name of a signal: its derivative in time


class LinearController(NamedTuple):
    """``x+ = F x + G (y, e)``, ``commands = H x + J (y, e)``: all controllers of a loop.

    `y` is what they measure, `e` what is added to each command: a setpoint, or a control.
    """

    commands: tuple[str, ...]
    F: Array
    G: Array
    H: Array
    J: Array

    def response(self, z: ComplexArray) -> ComplexArray:
        """Return the gains (n, commands, sensors + commands) at `z` (n,)."""
        pencil = z[:, None, None] * np.eye(len(self.F)) - self.F
        states = np.linalg.solve(pencil, np.broadcast_to(self.G, (z.size, *self.G.shape)))
        return self.H @ states + self.J


@frozen
class SampledLoop:
    """Many plants, each in a loop with the same controllers.

    The control of sample k reaches the plant between ``whole`` and ``whole + 1`` samples later:
    ``x[k+1] = A x[k] + late u[k-whole] + early u[k-whole-1]``, ``y[k] = C x[k] + D u[k-whole-1]``.

    Attributes
    ----------
    inputs, sensors : tuple of str
        Inputs of the plant, and what is measured.
    A, early, late, C, D : arrays (plants, ...)
    whole : (plants, inputs) array
        Whole samples in the delay of each input.
    controller : LinearController
    period : float, s
    """

    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    A: Array
    early: Array
    late: Array
    C: Array
    D: Array
    whole: IntArray
    controller: LinearController
    period: float

    @property
    def first(self) -> "SampledLoop":
        """The loop of the first plant alone."""
        return self.of(slice(1))

    def of(self, plants: slice | IntArray) -> "SampledLoop":
        """Return the loops of some of the plants."""
        arrays = ("A", "early", "late", "C", "D", "whole")
        return replace(self, **{name: getattr(self, name)[plants] for name in arrays})

    @property
    def signals(self) -> tuple[str, ...]:
        """What is measured and what is commanded."""
        return (*self.sensors, *self.controller.commands)

    def plant_response(self, omega: Array) -> ComplexArray:
        """Return the gains (plants, n, sensors, inputs) of the plants at `omega` (n,) rad/s."""
        z = np.exp(1j * omega * self.period)
        delay = z[:, None, None] ** -self.whole[:, None, None, :]
        earlier_delay = delay / z[:, None, None]
        pencil = z[:, None, None] * np.eye(self.A.shape[-1]) - self.A[:, None]
        driven = self.late[:, None] * delay + self.early[:, None] * earlier_delay
        plant = self.C[:, None] @ np.linalg.solve(pencil, driven) + self.D[:, None] * earlier_delay
        return plant.astype(complex)

    def gains(
        self,
        added_to: str,
        signals: Sequence[str],
        omega: ArrayLike,
        plant: ComplexArray | None = None,
    ) -> ComplexArray:
        """Return the gains (plants, n, signals) of the closed loop from an addition to one signal.

        `added_to` and `signals` are inputs of the plant, setpoints or outputs of controllers, or
        measured signals; the added signal is part of the signal that it is added to. `plant` may
        replace `plant_response(omega)`.

        Raises
        ------
        ValueError
            For a signal that is not in the loop.
        """
        names = self.signals
        require_known((added_to, *signals), names, "signal", "the loop")

        omega = finite_numbers("omega", omega)
        plant = self.plant_response(omega) if plant is None else plant
        control = self.controller.response(np.exp(1j * omega * self.period))
        k = len(self.sensors)
        feedback, commanded = control[..., :k], control[..., k:]
        rows = places_of(self.inputs, self.controller.commands)

        # u = feedback y + command and y = plant u + error; one of command and error is added
        error = np.zeros((k, 1))
        command = np.zeros((len(omega), len(names) - k, 1))
        if added_to in self.sensors:
            error[self.sensors.index(added_to)] = 1
        else:
            command = commanded[..., [self.controller.commands.index(added_to)]]
        # There are fewer inputs than outputs, and a single input needs no matrix.
        open_loop = plant @ command[:, rows] + error
        around = np.eye(len(rows)) - feedback[:, rows] @ plant
        inner = feedback[:, rows] @ open_loop
        inner = inner / around if len(rows) == 1 else np.linalg.solve(around, inner)
        measured = open_loop + plant @ inner
        every = np.concatenate([measured, feedback @ measured + command], axis=2)
        return every[..., places_of(signals, names), 0].astype(complex)

    def broken_at(
        self, signal: str, omega: ArrayLike, plant: ComplexArray | None = None
    ) -> ComplexArray:
        """Return the gain (plants, n) of the loop broken at a signal, with every other loop closed.

        It is that of negative feedback, so that -1 is the critical point.

        Raises
        ------
        ValueError
            For a signal that is not in the loop.
        """
        return 1 / self.gains(signal, [signal], omega, plant)[..., 0] - 1

    def closed(self, added_to: str, signal: str) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C, D (plants, ...) of the closed loops from an addition to a signal.

        ``x[k+1] = A x[k] + B e[k]`` and ``signal[k] = C x[k] + D e[k]``, where `e` is added to a
        command, or to what the controllers read of a measured signal.

        Raises
        ------
        ValueError
            For a signal that is not in the loop.
        """
        commands, F, G, H, J = self.controller
        sensors = self.sensors
        require_known([added_to, signal], self.signals, "signal", "the loop")
        added = self.signals.index(added_to)
        rows = places_of(self.inputs, commands)
        plants, n = self.A.shape[:2]
        m = len(self.inputs)
        length = int(self.whole.max()) + 1  # past controls that have not yet reached some plant
        size = n + len(F) + m * length

        # The last column is the addition. The newest past control of an input is its first one.
        unit, controls = np.eye(size + 1), n + len(F)
        newest = controls + length * np.arange(m)
        earlier = unit[newest + self.whole]  # u[k-whole-1]

        y = self.D @ earlier
        y[:, :, :n] += self.C
        total = J[:, : len(sensors)] @ y
        total[:, :, n:controls] += H
        total[:, :, -1] += J[:, added]
        u = total[:, rows]
        arriving = np.where(self.whole[:, :, None] > 0, unit[newest + self.whole - 1], u)

        following = np.zeros((plants, size, size + 1))
        following[:, :n] = self.late @ arriving + self.early @ earlier
        following[:, :n, :n] += self.A
        following[:, n:controls] = G[:, : len(sensors)] @ y
        following[:, n:controls, n:controls] += F
        following[:, n:controls, -1] += G[:, added]
        # Every past control becomes the next older one.
        following[:, controls:] = np.eye(size - controls, size + 1, controls - 1)
        following[:, newest] = u
        read = np.hstack([y, total])[:, self.signals.index(signal)]
        if signal == added_to and signal in sensors:
            read[:, -1] += 1
        return following[..., :-1], following[..., -1], read[:, :-1], read[:, -1]

    @cached_property
    def poles(self) -> ComplexArray:
        """The poles (plants, states) of the closed loops, in z."""
        return np.linalg.eigvals(self.closed(self.inputs[0], self.inputs[0])[0]).astype(complex)

    @property
    def is_stable(self) -> BoolArray:
        """Whether no signal grows in each closed loop, (plants,)."""
        # A pole at one, such as that of a position that no controller holds, is one to rounding.
        return np.abs(self.poles).max(axis=1) < 1 + 1e-7


def sampled_loop(
    model: Model,
    values: Array,
    controller: Controllers | None,
    *,
    at: Values | None = None,
    measured: Sequence[str] = (),
    rate: float | None = None,
    has_hold: bool = False,
) -> SampledLoop:
    """Return loops of a model with each row of `values` (plants, parameters), linearized at `at`.

    The delay of a response that was measured from logged controls contains the half sample by which
    a held control is late; say so by `has_hold`, and it is not counted twice. `measured`
    are signals in addition to the outputs and what the controllers measure. Without a controller,
    give the `rate` at which the control changes.

    Raises
    ------
    ValueError
        If the controllers do not fit the model, or a signal cannot be measured.
    """
    system = dynamics(model)
    controllers = connected(controller, model.label, system)
    clock = controllers[0].rate if controllers else rate
    if not clock:
        raise ValueError("a loop without a controller has no rate: give rate=... in Hz.")
    commands = {*system.inputs, *outside_names(controllers, "setpoints", "outputs")}
    sensors = unique(
        (*sensors_of(controllers), *system.outputs, *(n for n in measured if n not in commands))
    )
    A, B, C, D, delay = _plants(model, system, sensors, values, at or {})
    period = 1 / clock
    if has_hold:
        delay = np.maximum(delay - period / 2, 0)
    whole, part = in_periods(delay, period, system.inputs)

    # Before a control arrives the one before it acts: exp(A t) and its integral.
    columns = B.mT[..., None]
    alike = np.repeat(A[:, None], B.shape[2], axis=1)  # for each input, whose delay is its own
    before, first = held_response(alike, columns, part * period)
    decay, second = held_response(alike, columns, (1 - part) * period)
    transition = (decay @ before)[:, 0]
    early, late = (block[..., 0].mT for block in (decay @ first, second))
    return SampledLoop(
        system.inputs,
        sensors,
        transition,
        early,
        late,
        C,
        D,
        whole,
        linear_controller(controllers, sensors, system.inputs),
        period,
    )


def in_periods(delay: Array, period: float, inputs: tuple[str, ...]) -> tuple[IntArray, Array]:
    """Return whole periods in delays (..., inputs), s, and the remaining fractions of a period.

    Raises
    ------
    ValueError
        For a delay that is negative or not finite.
    """
    wrong = np.argwhere(~((delay >= 0) & (delay < np.inf)))
    if wrong.size:
        name, value = inputs[wrong[0, -1]], delay[tuple(wrong[0])]
        raise ValueError(f"the delay of {name!r} is {value:g} s: give a value of 0 or more.")
    # A delay of whole periods must not become one period less and a fraction by rounding.
    whole = np.floor(delay / period + 1e-9).astype(int)
    part = delay / period - whole
    return whole, np.where(part > 1e-9, part, 0.0)


@one_thread_at_a_time
def _plants(
    model: Model, system: Dynamics, sensors: tuple[str, ...], values: Array, at: Values
) -> tuple[Array, Array, Array, Array, Array]:
    """Return A, B, and C, D of the sensors, and the delays (plants, inputs)."""
    x, u, p = system.symbols
    f = system.derivative(x, u, p)
    y = ca.vertcat(*[measured_signal(model.label, system, name, x, u, p) for name in sensors])
    jacobians = [ca.jacobian(e, v) for e in (f, y) for v in (x, u)]
    matrices = ca.Function("plant", [p, x, u], [*jacobians, system.delay(p)])
    q = ca.MX.sym("p", p.numel())
    states, inputs = trim_of(model, at).closed().call([q])
    # A realized transfer function has states that the model does not declare.
    states = ca.vertcat(states, ca.DM.zeros(x.numel() - states.numel()))
    plant = ca.Function("plant", [q], matrices.call([q, states, inputs]))
    # One mapped call for all plants: a call for each takes a quarter of the time of margins.
    count = len(values)
    A, B, C, D, delay = (
        block.full().reshape(block.shape[0], count, -1).swapaxes(0, 1)
        for block in plant.map(count).call([ca.DM(values.T)])
    )
    return A, B, C, D, delay[:, :, 0]


def measured_signal(
    label: str, system: Dynamics, name: str, x: ca.SX, u: ca.SX, p: ca.SX | Array
) -> ca.SX:
    """Return an output, a state, or the time derivative of either, as an expression.

    Raises
    ------
    ValueError
        If the model has no such signal, or its derivative contains that of an input.
    """
    stem = name.removesuffix(DOT)
    for names, values in ((system.outputs, system.output(x, u, p)), (system.states, x)):
        if name in names:
            return values[names.index(name)]
        if stem in names and not ca.depends_on(value := values[names.index(stem)], u):
            return ca.jacobian(value, x) @ system.derivative(x, u, p)
    known = unique((*system.outputs, *system.states))
    raise ValueError(
        f"{label} has no {name!r} to measure; it has {', '.join(known)} and their time "
        f"derivatives, such as '{known[0]}{DOT}': name one of them for {name!r} in the signals "
        "of the controller."
    )


class ControllerFormulas(NamedTuple):
    """A chain of controllers as expressions.

    Their `states`, what they measure and what is added to their commands (`inputs`), the states
    after the sample (`following`), and the `total` of every command.
    """

    commands: tuple[str, ...]
    states: ca.SX
    inputs: ca.SX
    following: ca.SX
    total: ca.SX


@one_thread_at_a_time
def controller_formulas(
    controllers: Sequence[Controller], sensors: tuple[str, ...], inputs: tuple[str, ...]
) -> ControllerFormulas:
    """Return the chain of controllers with symbols for its states and inputs."""
    outside = outside_names(controllers, "setpoints", "outputs")
    commands = unique((*outside, *inputs))
    y = ca.SX.sym("y", len(sensors))
    e = ca.SX.sym("e", len(commands))
    added = entries_by_name(commands, e)
    memory = [ca.SX.sym("x", len(c.states)) for c in controllers]

    signals = dict(added)
    following = run_controllers(controllers, memory, entries_by_name(sensors, y), signals, added)
    total = ca.vertcat(*[signals[name] for name in commands])
    return ControllerFormulas(
        commands,
        ca.SX(ca.vertcat(*memory)),
        ca.vertcat(y, e),
        ca.SX(ca.vertcat(*following)),
        ca.SX(total),
    )


@one_thread_at_a_time
def linear_controller(
    controllers: Sequence[Controller], sensors: tuple[str, ...], inputs: tuple[str, ...]
) -> LinearController:
    """Linearize the chain of controllers about their initial states and signals of zero."""
    commands, x, v, following, total = controller_formulas(controllers, sensors, inputs)
    blocks = [ca.jacobian(f, z) for f in (following, total) for z in (x, v)]
    initial = [value for c in controllers for value in c.initial]
    numbers = ca.Function("controller", [x, v], blocks)(initial, np.zeros(v.numel()))
    return LinearController(commands, *[matrix.full() for matrix in numbers])
