"""Flights in simulation: a plant, a sampled controller and a test signal, logged as in flight.

Begin with `virtual_flight`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import require
from greybox.data.files.argument_checks import is_finite_number, require_whole
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import NOTHING, Values
from greybox.data.files.public import public
from greybox.data.intersample import CONTINUOUS
from greybox.data.record import Record
from greybox.modeling.integrators import RungeKutta
from greybox.modeling.model import Model, require_known
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.step_size import relative_change, substep_growth
from greybox.modeling.symbolic_reading import entries_by_name
from greybox.workflows.experiment.controller import (
    Controller,
    Controllers,
    connected,
    outside_names,
    run_controllers,
    sensors_of,
)
from greybox.workflows.experiment.excitation import Excitation
from greybox.workflows.experiment.sampled_loop import in_periods, measured_signal

# Largest relative change of a state, within a controller period, when the substeps are halved. The
# remaining error is a fifteenth of it: in a loop of 400 Hz, 3e-6 per second if all errors add up.
TOLERANCE = 1e-7
# Most substeps in a controller period. The size of a compiled step grows with their number.
MOST_SUBSTEPS = 256

ADDED = "_excitation"  # suffix of the excitation of a signal


@public
def virtual_flight(  # noqa: PLR0913 - one keyword for each choice of the experiment
    model: Model,
    values: Values | None,
    excitation: Excitation | Mapping[str, ArrayLike],
    *,
    controller: Controllers | None = None,
    noise: Values = NOTHING,
    process_noise: Values = NOTHING,
    initial: Values = NOTHING,
    rate: float | None = None,
    seed: int = 0,
    name: str = "",
) -> Record:
    """Fly an experiment in simulation: the closed loop of (3.14), or the plant alone.

    At every sample the controller reads the sensors and sets the control. The control is held until
    the next sample, and reaches the plant after its delay, which may be any fraction of a sample.
    The log contains the sensor values that the controller reads, and the control that it commands
    at that moment. Because the control is held, a response that is measured from such a log, or
    from one of a real flight, has half a controller period more delay than the plant. A fit divides
    the response by that of the hold.

    Between samples the plant is integrated by classical Runge-Kutta steps (RK4). The steps are
    halved until this changes no state by more than 1e-7 of its largest value in any period. The
    remaining error is a fifteenth of that.

    Parameters
    ----------
    model : Model
        Delays are exact. A transfer function has no states by name: only its output is measured.
    values : mapping of parameter name to float, optional
        The true values; by default the declared starts.
    excitation : Excitation or mapping of name to (n,) array
        Each signal is added to the signal of the same name. This is a setpoint of the controller
        (``"reference"``, ``"mixer"``) or an input of the plant (``"u"``), downstream of the
        controller and its limits. The arrays of a mapping have one entry for every sample of the
        loop.
    controller : Controller or sequence of Controller, optional
        It measures outputs or states of the plant; ``"theta_dot"`` is the time derivative of
        ``"theta"``. The outputs of a controller may be setpoints or inputs of the next one. Without
        a controller, the plant flies in open loop, at the rate of the excitation.
    noise : mapping of name to float
        Standard deviation of the white noise of a sensor. A state or a derivative with a name here
        is measured and logged in addition to the outputs; ``{"q": 0.0}`` measures q without error.
    process_noise : mapping of state name to float
        White noise on the derivative of a state, in units of the state per √s. A state that is
        driven by noise s alone is a random walk with a standard deviation of s √t. The noise is
        constant during a controller period.
    initial : mapping of name to float
        Initial states, and inputs before the first command; by default zero. An input that nothing
        commands keeps this value. ``gb.modeling.linearize(model, values, at).point`` begins at an
        operating point.
    rate : float, Hz, optional
        Rate of the loop without a controller, by default that of the excitation. Required if the
        excitation is a mapping of arrays.
    seed : int
        Seed of the noise. Sensors and process noise have separate random streams.
    name : str
        Name of the record; by default it contains the model's.

    Returns
    -------
    Record
        The control of every input before its delay, with the excitation included; the excitation,
        the measured signals, and other outputs of the controllers. `Record.hold` states that
        controls and setpoints are held, and that measured signals are not. `metadata` has the true
        values: ``plant, values, controllers, noise, process_noise, initial, seed, schedule``. A
        sentence in `findings` tells if the integration did not reach its accuracy.

    Raises
    ------
    ValueError
        If names do not match, or if the flight diverges; the message says when.

    Examples
    --------
    >>> from greybox.models.controller import AttitudeController
    >>> from greybox.models.tilt import LinearTilt
    >>> truth = {"a1": -14.6, "a2": 3.0, "a3": 8.5, "a4": 295.0}
    >>> sines = gb.experiment.sine_schedule([1.7, 4.5], 0.1, rate=100, periods=2, least=5)
    >>> loop, noise = AttitudeController(rate=100), {"theta": 0.002}  # rad
    >>> record = gb.virtual_flight(LinearTilt(), truth, sines, controller=loop, noise=noise)
    >>> sorted(record.signals)
    ['q', 'q_reference', 'reference', 'theta', 'u', 'v']
    """
    if not isinstance(model, Model):
        raise TypeError(f"{model!r} is not a model: give an instance, such as LinearTilt().")

    system = dynamics(model)
    truth = model.values(values)
    controllers = connected(controller, model.label, system)
    clock = controllers[0].rate if controllers else rate
    test = _as_excitation(excitation, clock)
    clock = float(clock or test.rate)
    places = (*outside_names(controllers, "setpoints"), *system.inputs)
    require_known(test.signals, places, "place for", model.label)
    # The rate of the controller may be higher than that of the test signal.
    time = np.arange(math.floor(test.time[-1] * clock + 1e-6) + 1) / clock
    commands = {name: np.interp(time, test.time, samples) for name, samples in test.signals.items()}

    loop = _Loop(
        model.label,
        system,
        np.array(list(truth.values()), dtype=float),
        controllers,
        clock,
        excited=tuple(commands),
        measured=unique((*system.outputs, *sensors_of(controllers), *noise)),
        forced=tuple(process_noise),
        initial=_checked("initial", initial, (*system.states, *system.inputs)),
    )
    # Sensors and process noise have separate random streams, so that another sensor does not change
    # the wind.
    deviations = _checked("noise", noise, loop.measured, low=0)
    errors = _draws(seed, 0, loop.measured, deviations, time.size)
    deviations = _checked("process_noise", process_noise, system.states, low=0)
    forces = _draws(seed, 1, loop.forced, deviations, time.size) * math.sqrt(clock)
    log, findings = _fly(loop, np.vstack([*commands.values(), errors, forces]), time)

    # With the true values, estimates from this record can be judged later.
    metadata = {
        "plant": repr(model),
        "values": dict(truth),
        "controllers": tuple(controller.truth for controller in controllers),
        "noise": dict(noise),
        "process_noise": dict(process_noise),
        "initial": dict(loop.initial),
        "seed": seed,
        "schedule": test.schedule,
    }
    units: dict[str, str] = {}
    for law in controllers:
        units |= {law.outside(own_name): unit for own_name, unit in law.units.items()}
    units |= test.units
    return Record(
        time,
        log,
        {signal: units.get(signal.removesuffix(ADDED), "") for signal in log},
        name=name or f"virtual flight of {model.label}",
        metadata=metadata,
        # Holds in seconds remain correct if the log is thinned later.
        hold={signal: CONTINUOUS if signal in loop.measured else 1 / clock for signal in log},
        findings=findings,
    )


@frozen
class _Loop:
    """A plant with its true values in a loop with controllers.

    Attributes
    ----------
    label : str
        Name of the plant.
    system : Dynamics
    p : (k,) array
        Values of the parameters.
    controllers : tuple of Controller
    clock : float, Hz
        Rate of the loop.
    excited : tuple of str
        Signals to which an excitation is added.
    measured : tuple of str
    forced : tuple of str
        States with process noise.
    initial : mapping of name to float
    """

    label: str
    system: Dynamics
    p: Array
    controllers: tuple[Controller, ...]
    clock: float
    excited: tuple[str, ...]
    measured: tuple[str, ...]
    forced: tuple[str, ...]
    initial: Values

    @cached_property
    def delays(self) -> tuple[list[int], list[float]]:
        """Whole controller periods in the delays of all inputs (m,), and remaining fractions."""
        delays = np.asarray(self.system.delay(self.p)).ravel()
        whole, fraction = in_periods(delays, 1 / self.clock, self.system.inputs)
        return whole.tolist(), fraction.tolist()

    def start(self) -> Array:
        """Return the state before the first step: those of plant and controllers, past controls."""
        plant = [self.initial.get(name, 0.0) for name in self.system.states]
        controllers = [controller.initial for controller in self.controllers]
        whole, _ = self.delays
        past_controls = []
        for name, periods in zip(self.system.inputs, whole, strict=True):
            past_controls.append([self.initial.get(name, 0.0)] * (periods + 1))
        return np.concatenate([plant, *controllers, *past_controls])


def _fly(loop: _Loop, columns: Array, time: Array) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return every signal of the log by name, (samples,), and the findings on the flight.

    `columns` (k, samples) are the excitation, the errors of sensors and the process noise.
    """
    n = len(loop.system.states)
    substeps = 1
    while True:
        step, names = _step(loop, substeps)
        flight = step.mapaccum("flight", time.size)
        states, log = map(np.asarray, flight(loop.start(), columns))
        # The rows of the log: signals and states, then changes of states with twice the substeps.
        flown, changes = np.split(log, [len(names) + n])
        # No state of a vehicle in SI units is that large.
        is_diverged = ~(np.abs(flown) < 1e9)
        reached = np.argmax(is_diverged.any(axis=0)) if is_diverged.any() else time.size
        with np.errstate(invalid="ignore"):
            error = relative_change(
                changes[:, :reached], flown[len(names) :, :reached], states[:n, :reached]
            )
        # The accuracy is judged first: with too few substeps, a stable flight may diverge or
        # become NaN.
        if not error <= TOLERANCE and substeps < MOST_SUBSTEPS:
            substeps = min(MOST_SUBSTEPS, substeps * substep_growth(error, TOLERANCE, 4))
            continue
        if is_diverged.any():
            labels = [*map(repr, names), *(f"the state {name!r}" for name in loop.system.states)]
            # The last row is a state, if one has diverged.
            row = np.flatnonzero(is_diverged[:, reached])[-1]
            raise ValueError(
                f"the flight of {loop.label} diverges: {labels[row]} is {flown[row, reached]:.3g} "
                f"at {time[reached]:.2f} s; give a controller that stabilizes the plant, or a "
                "smaller excitation."
            )
        findings = ()
        if error > TOLERANCE:
            findings = (
                f"the integration error is {error:.1g} of a state's size in a period: the plant is "
                "stiff or not smooth",
            )
        # The states come after the signals, and are left out here.
        return dict(zip(names, flown, strict=False)), findings


@one_thread_at_a_time
def _step(loop: _Loop, substeps: int) -> tuple[ca.Function, list[str]]:
    """Compile one controller period with this number of integration steps.

    Returns
    -------
    step : casadi.Function
        (state, column) -> (next state, logged values). The state contains those of plant and
        controllers, and the past controls of every input. The logged values are the named signals,
        the states of the plant, and their changes with twice as many integration steps.
    names : list of str
        Names of the logged signals.
    """
    system = loop.system
    inputs = range(len(system.inputs))
    whole, fraction = loop.delays
    x, *_ = system.symbols
    memory = [ca.SX.sym("c", len(controller.states)) for controller in loop.controllers]
    past = [ca.SX.sym(system.inputs[i], whole[i] + 1) for i in inputs]
    added = ca.SX.sym("e", len(loop.excited))
    errors = ca.SX.sym("e", len(loop.measured))
    forces = ca.SX.sym("e", len(loop.forced))
    excitation = entries_by_name(loop.excited, added)
    # The signals of the loop by name; controllers add their outputs below.
    signals = {name: ca.SX(loop.initial.get(name, 0.0)) for name in system.inputs}
    signals |= excitation

    def queues() -> list[ca.SX]:
        """Return the commanded control of each input and its past controls, the newest first."""
        return [ca.vertcat(signals[system.inputs[i]], past[i]) for i in inputs]

    # Until the fraction of a delay has passed, the control of one sample earlier acts.
    early = [past[i][whole[i]] for i in inputs]

    # The inputs that act at the moment of the sample. A control that is computed from this sample
    # acts only afterwards.
    outputs = outside_names(loop.controllers, "outputs")
    now = []
    for i, queue in enumerate(queues()):
        is_known = whole[i] > 0 or system.inputs[i] not in outputs
        now.append(queue[whole[i]] if is_known and fraction[i] == 0 else early[i])
    measured = {}
    for k, name in enumerate(loop.measured):
        exact = measured_signal(loop.label, system, name, x, ca.vertcat(*now), loop.p)
        measured[name] = exact + errors[k]

    next_memory = run_controllers(loop.controllers, memory, measured, signals, excitation)
    signals |= {name + ADDED: excitation[name] for name in outputs if name in excitation}
    late = [queue[whole[i]] for i, queue in enumerate(queues())]
    force = ca.SX.zeros(len(system.states))
    for k, name in enumerate(loop.forced):
        force[system.states.index(name)] = forces[k]

    # Between samples an input changes once, when the fraction of its delay has passed.
    coarse = fine = x
    for begin, end in pairwise(sorted({0.0, *fraction, 1.0})):
        u = ca.vertcat(*[early[i] if begin < fraction[i] else late[i] for i in inputs])
        span = (end - begin) / loop.clock
        count = math.ceil(substeps * (end - begin))
        coarse = _integrated(loop, coarse, u, force, span, count)
        fine = _integrated(loop, fine, u, force, span, 2 * count)

    log = {**signals, **measured}
    state = ca.vertcat(x, *memory, *past)
    column = ca.vertcat(added, errors, forces)
    # The oldest control of every queue has acted and is dropped.
    next_past = [queue[:-1] for queue in queues()]
    next_state = ca.vertcat(fine, *next_memory, *next_past)
    logged = ca.vertcat(*log.values(), x, ca.fabs(fine - coarse))
    return ca.Function("step", [state, column], [next_state, logged]), [*log]


def _integrated(loop: _Loop, x: ca.SX, u: ca.SX, force: ca.SX, span: float, count: int) -> ca.SX:
    """Return the states x (n,) after `span` seconds with a constant input, by `count` RK4 steps.

    `force` (n,) is added to the derivative of the states.
    """
    if not loop.system.states:
        return x
    derivative = loop.system.derivative
    forced = replace(loop.system, derivative=lambda x, u, p: derivative(x, u, p) + force)
    for _ in range(count):
        x = RungeKutta().advance(forced, x, u, ca.SX.zeros(u.numel()), loop.p, span / count)
    return x


def _as_excitation(given: Excitation | Mapping[str, ArrayLike], rate: float | None) -> Excitation:
    """Return an excitation unchanged, and arrays by name as an excitation of this rate, Hz."""
    if isinstance(given, Excitation):
        return given
    if not isinstance(given, Mapping):
        raise TypeError(
            f"the excitation is a {type(given).__name__}: give an Excitation, or {{name: array}}."
        )
    if rate is None or not 0 < rate < math.inf:
        raise ValueError(
            f"rate is {rate!r}, and arrays alone have no sampling rate: give samples per second "
            "above 0, or an Excitation."
        )
    size = max(map(np.size, given.values()), default=0)
    test = Excitation(np.arange(size) / rate, given)  # type: ignore[arg-type]  (it converts them)
    for name, values in test.signals.items():
        require(name, values, np.isfinite(values), "give finite numbers")
    return test


def _checked(what: str, given: Values, places: Sequence[str], low: float = -math.inf) -> Values:
    """Return numbers by name, after a check of the names and of a lowest value."""
    require_known(given, places, "place for", what)
    for name, value in given.items():
        if not is_finite_number(value) or value < low:
            raise ValueError(
                f"{what}[{name!r}] is {value!r}: give a number"
                + (" of 0 or more." if low == 0 else ".")
            )
    return {name: float(value) for name, value in given.items()}


def _draws(seed: int, stream: int, names: Sequence[str], deviation: Values, count: int) -> Array:
    """Return white noise of these standard deviations, (k, count)."""
    require_whole("seed", seed, 0)
    drawn = np.random.default_rng([int(seed), stream]).standard_normal((len(names), count))
    deviations = np.array([deviation.get(name, 0.0) for name in names])
    return drawn * deviations[:, None]
