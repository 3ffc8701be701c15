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

# Relative change of a state, within a controller period, when the substeps are halved. A fifteenth
# of it remains: in a loop of 400 Hz, 3e-6 per second if all errors add up.
TOLERANCE = 1e-7
MOST_SUBSTEPS = 256  # in a controller period; the size of a compiled step grows with them

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

    At every sample the controller reads the sensors and sets the control, which is held until the
    next sample and reaches the plant after its delay, exact to any fraction of a sample. The log
    has the sensor values that the controller reads, and the control commanded at that moment.
    Because the control is held, a response measured from such a log, or from a flown one, has half
    a controller period more delay than the plant; a fit divides the hold out.

    Between samples the plant is integrated by classical Runge-Kutta steps (RK4), which are halved
    until this changes no state by more than 1e-7 of its largest value in any period; the remaining
    error is a fifteenth of that.

    Parameters
    ----------
    model : Model
        Delays are exact; a transfer function is flown by its outputs only.
    values : mapping of parameter name to float, optional
        The true values; by default the declared starts.
    excitation : Excitation or mapping of name to (n,) array
        Each signal is added to the signal of its name: a setpoint of the controller
        (``"reference"``, ``"mixer"``), or an input of the plant (``"u"``), downstream of the
        controller and its limits. The arrays of a mapping have one sample per sample of the loop.
    controller : Controller or several, optional
        It measures outputs or states of the plant; ``"theta_dot"`` is the time derivative of
        ``"theta"``. The outputs of one may be setpoints or inputs of the next. Without a
        controller, the plant flies in open loop, at the rate of the excitation.
    noise : mapping of name to float
        Standard deviation of the white noise of a sensor. A state or a derivative that is named
        here is measured and logged in addition to the outputs, with ``{"q": 0.0}`` without error.
    process_noise : mapping of state name to float
        White noise on the derivative of a state, in units of the state per √s: alone it makes the
        state a random walk with a standard deviation of that times √t. It is held over a controller
        period.
    initial : mapping of name to float
        Initial states, and inputs before the first command (and throughout, if nothing commands
        them); by default zero. ``gb.modeling.linearize(model, values, at).point`` begins at an
        operating point.
    rate : float, Hz, optional
        Rate of the loop without a controller; by default that of the excitation. Arrays need it.
    seed : int
        Seed of the noise; sensors and process noise have random streams of their own.
    name : str

    Returns
    -------
    Record
        The control of every input before its delay (excitation included), the excitation, the
        measured signals, and other outputs of the controllers. `Record.hold` states that controls
        and setpoints are held, and that measured signals are not. `metadata` has the true values:
        ``plant, values, controllers, noise, process_noise, initial, seed, schedule``; `findings`
        say so if the integration did not reach its accuracy.

    Raises
    ------
    ValueError
        For names that do not match, and a flight that diverges; the sentence says when.

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
    # A controller may run faster than the test signal is sampled.
    time = np.arange(math.floor(test.time[-1] * clock + 1e-6) + 1) / clock
    commands = {n: np.interp(time, test.time, v) for n, v in test.signals.items()}

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
    sensed = _checked("noise", noise, loop.measured, low=0)
    # Sensors and process noise have streams of their own: adding a sensor must not change the wind.
    errors = _draws(seed, 0, loop.measured, sensed, time.size)
    forced = _checked("process_noise", process_noise, system.states, low=0)
    forces = _draws(seed, 1, loop.forced, forced, time.size) * math.sqrt(clock)
    log, findings = _fly(loop, np.vstack([*commands.values(), errors, forces]), time)

    # With the true values, a record of a virtual flight can be judged later.
    metadata = {
        "plant": repr(model),
        "values": dict(truth),
        "controllers": tuple(c.truth for c in controllers),
        "noise": dict(noise),
        "process_noise": dict(process_noise),
        "initial": dict(loop.initial),
        "seed": seed,
        "schedule": test.schedule,
    }
    units = {c.outside(n): unit for c in controllers for n, unit in c.units.items()}
    units |= test.units
    return Record(
        time,
        log,
        {n: units.get(n.removesuffix(ADDED), "") for n in log},
        name=name or f"virtual flight of {model.label}",
        metadata=metadata,
        # In seconds, which remain right where a log is thinned.
        hold={n: CONTINUOUS if n in loop.measured else 1 / clock for n in log},
        findings=findings,
    )


@frozen
class _Loop:
    """The plant with its true values, and which signals are connected."""

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
        """Whole controller periods in the delay of every input, and the remaining fractions."""
        delays = np.asarray(self.system.delay(self.p)).ravel()
        whole, part = in_periods(delays, 1 / self.clock, self.system.inputs)
        return whole.tolist(), part.tolist()

    def start(self) -> Array:
        """Return the initial state of the first step: plant, controllers, past controls."""
        plant = [self.initial.get(n, 0.0) for n in self.system.states]
        past = [
            [self.initial.get(n, 0.0)] * (count + 1)
            for n, count in zip(self.system.inputs, self.delays[0], strict=True)
        ]
        return np.concatenate([plant, *(c.initial for c in self.controllers), *past])


def _fly(loop: _Loop, columns: Array, time: Array) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return every signal of the log by name, at the controller's rate, and findings."""
    n = len(loop.system.states)
    substeps = 1
    while True:
        step, names = _step(loop, substeps)
        states, log = (
            np.asarray(v) for v in step.mapaccum("flight", time.size)(loop.start(), columns)
        )
        flown, local = np.split(log, [len(names) + n])
        wrong = ~(np.abs(flown) < 1e9)  # no state of a vehicle in SI units is that large
        reached = np.argmax(wrong.any(axis=0)) if wrong.any() else time.size
        with np.errstate(invalid="ignore"):
            error = relative_change(
                local[:, :reached], flown[len(names) :, :reached], states[:n, :reached]
            )
        # A divergence is judged last: too few substeps make a stable flight diverge, or NaN.
        if not error <= TOLERANCE and substeps < MOST_SUBSTEPS:
            substeps = min(MOST_SUBSTEPS, substeps * substep_growth(error, TOLERANCE, 4))
            continue
        if wrong.any():
            labels = [*map(repr, names), *(f"the state {n!r}" for n in loop.system.states)]
            row = np.flatnonzero(wrong[:, reached])[-1]  # a state, if one is wrong
            raise ValueError(
                f"the flight of {loop.label} diverges: {labels[row]} is {flown[row, reached]:.3g} "
                f"at {time[reached]:.2f} s; give a controller that stabilizes the plant, or a "
                "smaller excitation."
            )
        rough = (
            f"the integration error is {error:.1g} of a state's size in a period: the plant is "
            "stiff or not smooth"
        )
        return dict(zip(names, flown, strict=False)), (rough,) if error > TOLERANCE else ()


@one_thread_at_a_time
def _step(loop: _Loop, substeps: int) -> tuple[ca.Function, list[str]]:
    """Compile one controller period, (all states, a column) -> (all states, log).

    Also return the names in the log. The named signals are followed by the plant's states and by
    their changes if there are twice as many substeps.
    """
    system = loop.system
    periods, parts = loop.delays
    x, *_ = system.symbols
    memory = [ca.SX.sym("c", len(c.states)) for c in loop.controllers]
    past = [ca.SX.sym(n, count + 1) for n, count in zip(system.inputs, periods, strict=True)]
    added, errors, forces = (
        ca.SX.sym("e", len(names)) for names in (loop.excited, loop.measured, loop.forced)
    )
    excitation = entries_by_name(loop.excited, added)
    signals = {n: ca.SX(loop.initial.get(n, 0.0)) for n in system.inputs} | excitation

    def waiting() -> list[ca.SX]:
        """Return the commanded and the past controls of each input, the newest first."""
        return [ca.vertcat(signals[n], h) for n, h in zip(system.inputs, past, strict=True)]

    # What acts before the fraction of the delay has passed is one sample older.
    early = [h[count] for h, count in zip(past, periods, strict=True)]

    # A control that is computed from this sample reaches the plant after it.
    outputs = outside_names(loop.controllers, "outputs")
    now = []
    for k, (name, queue) in enumerate(zip(system.inputs, waiting(), strict=True)):
        is_new = not parts[k] and (periods[k] or name not in outputs)
        now.append(queue[periods[k]] if is_new else early[k])
    y = {
        n: measured_signal(loop.label, system, n, x, ca.vertcat(*now), loop.p) + errors[k]
        for k, n in enumerate(loop.measured)
    }
    remembered = run_controllers(loop.controllers, memory, y, signals, excitation)
    signals |= {n + ADDED: excitation[n] for n in outputs if n in excitation}
    late = [queue[count] for queue, count in zip(waiting(), periods, strict=True)]
    force = ca.SX.zeros(len(system.states))
    for k, n in enumerate(loop.forced):
        force[system.states.index(n)] = forces[k]

    # Between samples the input changes once, where the fraction of its delay has passed.
    coarse = fine = x
    for begin, end in pairwise(sorted({0.0, *parts, 1.0})):
        u = ca.vertcat(
            *[b if begin < part else a for a, b, part in zip(late, early, parts, strict=True)]
        )
        span = (end - begin) / loop.clock
        count = math.ceil(substeps * (end - begin))
        coarse, fine = (
            _integrated(loop, v, u, force, span, k) for v, k in ((coarse, count), (fine, 2 * count))
        )

    log = {**signals, **y}
    state = ca.vertcat(x, *memory, *past)
    column = ca.vertcat(added, errors, forces)
    following = ca.vertcat(fine, *remembered, *(queue[:-1] for queue in waiting()))
    logged = ca.vertcat(*log.values(), x, ca.fabs(fine - coarse))
    return ca.Function("step", [state, column], [following, logged]), [*log]


def _integrated(loop: _Loop, x: ca.SX, u: ca.SX, force: ca.SX, span: float, count: int) -> ca.SX:
    """Integrate over `span` seconds with a constant input in `count` steps of RK4."""
    derivative = loop.system.derivative
    forced = replace(loop.system, derivative=lambda x, u, p: derivative(x, u, p) + force)
    for _ in range(count if loop.system.states else 0):
        x = RungeKutta().advance(forced, x, u, ca.SX.zeros(u.numel()), loop.p, span / count)
    return x


def _as_excitation(given: Excitation | Mapping[str, ArrayLike], rate: float | None) -> Excitation:
    """Return arrays as an excitation of this rate, and an excitation as it is."""
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
    """Return numbers by name once names and sizes are right."""
    require_known(given, places, "place for", what)
    for n, value in given.items():
        if not is_finite_number(value) or value < low:
            raise ValueError(
                f"{what}[{n!r}] is {value!r}: give a number"
                + (" of 0 or more." if low == 0 else ".")
            )
    return {n: float(v) for n, v in given.items()}


def _draws(seed: int, stream: int, names: Sequence[str], deviation: Values, count: int) -> Array:
    """Return white noise of these standard deviations, (k, count)."""
    require_whole("seed", seed, 0)
    drawn = np.random.default_rng([int(seed), stream]).standard_normal((len(names), count))
    return drawn * np.array([deviation.get(n, 0.0) for n in names])[:, None]
