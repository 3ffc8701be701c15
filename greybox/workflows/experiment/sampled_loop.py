"""The loop of a plant and its sampled controllers as linear equations from one sample to the next.

Begin with `sampled_loop`. The equations are exact, because the control is held between samples; its
delay may be any fraction of a sample. A loop contains many plants, one for each draw of the
parameters.
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

DOT = "_dot"  # suffix for the derivative in time of a signal


class LinearController(NamedTuple):
    """All controllers of a loop: ``x+ = F x + G (y, e)``, ``commands = H x + J (y, e)``.

    `y` are the measured signals. Commands are setpoints and controls, and `e` has an addition to
    each of them.
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

    Let d be the whole samples in the delay of an input. Then
    ``x[k+1] = A x[k] + late u[k-d] + early u[k-d-1]`` and ``y[k] = C x[k] + D u[k-d-1]``: the older
    control acts first, until the fraction of the delay has passed.

    Attributes
    ----------
    inputs, sensors : tuple of str
        Inputs of the plant, and measured signals.
    A : (plants, n, n) array
    early, late : (plants, n, inputs) arrays
    C : (plants, sensors, n) array
    D : (plants, sensors, inputs) array
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
        return replace(
            self,
            A=self.A[plants],
            early=self.early[plants],
            late=self.late[plants],
            C=self.C[plants],
            D=self.D[plants],
            whole=self.whole[plants],
        )

    @property
    def signals(self) -> tuple[str, ...]:
        """All measured and commanded signals."""
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
        """Return the gains of the closed loop from an addition to one signal.

        Parameters
        ----------
        added_to : str
            Input of the plant, setpoint or output of a controller, or measured signal. This signal
            includes the addition.
        signals : sequence of str
            Signals of the same kinds.
        omega : (n,) array, rad/s
        plant : (plants, n, sensors, inputs) array, optional
            `plant_response(omega)`, if it is known.

        Returns
        -------
        (plants, n, signals) array of complex

        Raises
        ------
        ValueError
            For a signal that is not in the loop.
        """
        names = self.signals
        require_known((added_to, *signals), names, "signal", "the loop")

        omega = finite_numbers("omega", omega)
        if plant is None:
            plant = self.plant_response(omega)
        control = self.controller.response(np.exp(1j * omega * self.period))
        k = len(self.sensors)
        feedback = control[..., :k]
        by_command = control[..., k:]
        rows = places_of(self.inputs, self.controller.commands)

        # u = feedback y + command and y = plant u + error. The addition is one of the last two.
        error = np.zeros((k, 1))
        command = np.zeros((len(omega), len(names) - k, 1))
        if added_to in self.sensors:
            error[self.sensors.index(added_to)] = 1
        else:
            command = by_command[..., [self.controller.commands.index(added_to)]]
        # Solved for the part of u that is fed back: there are fewer inputs than outputs, and a
        # single input needs no system of equations.
        open_loop = plant @ command[:, rows] + error
        difference = np.eye(len(rows)) - feedback[:, rows] @ plant
        fed_back = feedback[:, rows] @ open_loop
        if len(rows) == 1:
            fed_back = fed_back / difference
        else:
            fed_back = np.linalg.solve(difference, fed_back)
        measured = open_loop + plant @ fed_back
        all_signals = np.concatenate([measured, feedback @ measured + command], axis=2)
        return all_signals[..., places_of(signals, names), 0].astype(complex)

    def broken_at(
        self, signal: str, omega: ArrayLike, plant: ComplexArray | None = None
    ) -> ComplexArray:
        """Return the gain (plants, n) of the loop broken at a signal, with all other loops closed.

        Its sign is that of negative feedback, so that -1 is the critical point.

        Raises
        ------
        ValueError
            For a signal that is not in the loop.
        """
        if self.inputs != (signal,):
            return 1 / self.gains(signal, [signal], omega, plant)[..., 0] - 1

        # The loop of a single control is the product of plant and controllers, which takes a third
        # of the time.
        omega = finite_numbers("omega", omega)
        if plant is None:
            plant = self.plant_response(omega)
        control = self.controller.response(np.exp(1j * omega * self.period))
        feedback = control[:, self.controller.commands.index(signal), : len(self.sensors)]
        return -np.einsum("ns,pns->pn", feedback, plant[..., 0]).astype(complex)

    def closed(self, added_to: str, signal: str) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of the closed loops from an addition to a signal.

        ``x[k+1] = A x[k] + B e[k]`` and ``signal[k] = C x[k] + D e[k]``, where `e` is added to a
        command, or to the value of a measured signal that the controllers read.

        Returns
        -------
        A : (plants, n, n) array
            The n states are those of plant and controllers, and past controls.
        B, C : (plants, n) arrays
        D : (plants,) array

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
        # Past controls of an input that have not reached the plant yet.
        length = int(self.whole.max()) + 1
        # The vector has the states of the plant, those of the controllers, the past controls of
        # each input with the newest one first, and the addition. Signals are rows that multiply it.
        controls = n + len(F)
        size = controls + m * length
        unit = np.eye(size + 1)
        newest = controls + length * np.arange(m)
        older_control = unit[newest + self.whole]  # u[k-d-1]

        y = self.D @ older_control
        y[:, :, :n] += self.C
        total = J[:, : len(sensors)] @ y
        total[:, :, n:controls] += H
        total[:, :, -1] += J[:, added]
        u = total[:, rows]
        newer_control = np.where(self.whole[:, :, None] > 0, unit[newest + self.whole - 1], u)

        # The states at the next sample.
        next_states = np.zeros((plants, size, size + 1))
        next_states[:, :n] = self.late @ newer_control + self.early @ older_control
        next_states[:, :n, :n] += self.A
        next_states[:, n:controls] = G[:, : len(sensors)] @ y
        next_states[:, n:controls, n:controls] += F
        next_states[:, n:controls, -1] += G[:, added]
        # Every past control becomes the next older one, and the control of this sample the newest.
        next_states[:, controls:] = np.eye(size - controls, size + 1, controls - 1)
        next_states[:, newest] = u
        row = np.hstack([y, total])[:, self.signals.index(signal)]
        if signal == added_to and signal in sensors:
            row[:, -1] += 1
        return next_states[..., :-1], next_states[..., -1], row[:, :-1], row[:, -1]

    @cached_property
    def poles(self) -> ComplexArray:
        """The poles (plants, states) of the closed loops, in z."""
        A, *_ = self.closed(self.inputs[0], self.inputs[0])
        return np.linalg.eigvals(A).astype(complex)

    @property
    def is_stable(self) -> BoolArray:
        """Whether each closed loop is stable, (plants,): no signal grows."""
        # The pole of a position that no controller holds is one, apart from rounding.
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
    """Return the loops of a model with each row of values.

    Parameters
    ----------
    model : Model
    values : (plants, parameters) array
    controller : Controller or sequence of Controller or None
    at : mapping of name to float, optional
        The operating point at which the model is linearized.
    measured : sequence of str
        Signals in addition to the outputs and the signals that the controllers measure.
    rate : float, Hz, optional
        The rate at which the control changes; required without a controller.
    has_hold : bool
        Whether the delays of the model contain the half sample by which a held control is late, as
        in a response that was measured from logged controls. It is then subtracted.

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
    others = [name for name in measured if name not in commands]
    sensors = unique((*sensors_of(controllers), *system.outputs, *others))
    A, B, C, D, delay = _plants(model, system, sensors, values, at or {})
    period = 1 / clock
    if has_hold:
        delay = np.maximum(delay - period / 2, 0)
    whole, fraction = in_periods(delay, period, system.inputs)

    # Each sample has two parts: the older control acts until the fraction of the delay has passed,
    # and the newer one afterwards. Every input has its own delay, and so its own parts.
    columns = B.mT[..., None]
    A_of_inputs = np.repeat(A[:, None], B.shape[2], axis=1)
    first_decay, first_response = held_response(A_of_inputs, columns, fraction * period)
    decay, response = held_response(A_of_inputs, columns, (1 - fraction) * period)
    return SampledLoop(
        inputs=system.inputs,
        sensors=sensors,
        A=(decay @ first_decay)[:, 0],
        early=(decay @ first_response)[..., 0].mT,
        late=response[..., 0].mT,
        C=C,
        D=D,
        whole=whole,
        controller=linear_controller(controllers, sensors, system.inputs),
        period=period,
    )


def in_periods(delay: Array, period: float, inputs: tuple[str, ...]) -> tuple[IntArray, Array]:
    """Return the whole periods in delays (..., inputs), s, and the remaining fractions of a period.

    Raises
    ------
    ValueError
        For a delay that is negative or not finite.
    """
    wrong = np.argwhere(~((delay >= 0) & (delay < np.inf)))
    if wrong.size:
        name, value = inputs[wrong[0, -1]], delay[tuple(wrong[0])]
        raise ValueError(f"the delay of {name!r} is {value:g} s: give a value of 0 or more.")
    # By rounding, a delay of whole periods must not become one period less and a fraction of nearly
    # one.
    whole = np.floor(delay / period + 1e-9).astype(int)
    fraction = delay / period - whole
    return whole, np.where(fraction > 1e-9, fraction, 0.0)


@one_thread_at_a_time
def _plants(
    model: Model, system: Dynamics, sensors: tuple[str, ...], values: Array, at: Values
) -> tuple[Array, Array, Array, Array, Array]:
    """Return A, B, C and D of the plants, (plants, ...) each, and their delays (plants, inputs).

    C and D are those of the sensors.
    """
    x, u, p = system.symbols
    f = system.derivative(x, u, p)
    y = ca.vertcat(*[measured_signal(model.label, system, name, x, u, p) for name in sensors])
    jacobians = [ca.jacobian(f, x), ca.jacobian(f, u), ca.jacobian(y, x), ca.jacobian(y, u)]
    matrices = ca.Function("plant", [p, x, u], [*jacobians, system.delay(p)])
    q = ca.MX.sym("p", p.numel())
    states, inputs = trim_of(model, at).closed().call([q])
    # A realized transfer function has states that the model does not declare.
    states = ca.vertcat(states, ca.DM.zeros(x.numel() - states.numel()))
    plant = ca.Function("plant", [q], matrices.call([q, states, inputs]))
    # One call for all plants. A call for each would take a quarter of the time of margins.
    count = len(values)
    blocks = []
    for block in plant.map(count).call([ca.DM(values.T)]):
        # The matrices of all plants stand side by side.
        blocks.append(block.full().reshape(block.shape[0], count, -1).swapaxes(0, 1))
    A, B, C, D, delay = blocks
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
        if stem in names:
            value = values[names.index(stem)]
            # Otherwise the derivative contains that of the input.
            if not ca.depends_on(value, u):
                return ca.jacobian(value, x) @ system.derivative(x, u, p)
    known = unique((*system.outputs, *system.states))
    raise ValueError(
        f"{label} has no {name!r} to measure; it has {', '.join(known)} and their time "
        f"derivatives, such as '{known[0]}{DOT}': name one of them for {name!r} in the signals "
        "of the controller."
    )


class ControllerFormulas(NamedTuple):
    """A chain of controllers as expressions.

    Attributes
    ----------
    commands : tuple of str
        Names of the commands: setpoints and controls.
    states : (n,) symbols
    inputs : (sensors + commands,) symbols
        The measured signals, and an addition to every command.
    next_states : (n,) expression
    total : (commands,) expression
        The commands, with their additions.
    """

    commands: tuple[str, ...]
    states: ca.SX
    inputs: ca.SX
    next_states: ca.SX
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
    memory = [ca.SX.sym("x", len(controller.states)) for controller in controllers]

    # `run_controllers` adds the outputs to the signals.
    signals = dict(added)
    next_states = run_controllers(controllers, memory, entries_by_name(sensors, y), signals, added)
    total = ca.vertcat(*[signals[name] for name in commands])
    return ControllerFormulas(
        commands=commands,
        states=ca.SX(ca.vertcat(*memory)),
        inputs=ca.vertcat(y, e),
        next_states=ca.SX(ca.vertcat(*next_states)),
        total=ca.SX(total),
    )


@one_thread_at_a_time
def linear_controller(
    controllers: Sequence[Controller], sensors: tuple[str, ...], inputs: tuple[str, ...]
) -> LinearController:
    """Return the chain of controllers, linearized at their initial states and signals of zero."""
    commands, x, v, next_states, total = controller_formulas(controllers, sensors, inputs)
    jacobians = [
        ca.jacobian(next_states, x),
        ca.jacobian(next_states, v),
        ca.jacobian(total, x),
        ca.jacobian(total, v),
    ]
    initial: list[float] = []
    for controller in controllers:
        initial += controller.initial
    matrices = ca.Function("controller", [x, v], jacobians)(initial, np.zeros(v.numel()))
    F, G, H, J = (matrix.full() for matrix in matrices)
    return LinearController(commands, F, G, H, J)
