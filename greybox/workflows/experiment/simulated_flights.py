"""Many short simulated flights of a loop, and how many of them saturate or ring.

The plant of each flight is another draw from the distribution of the estimates. It is linear, as in
the margins; the controllers are those that fly, sample by sample, with their limits.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.workflows.experiment.controller import Controller
from greybox.workflows.experiment.sampled_loop import (
    SampledLoop,
    controller_formulas,
    linear_controller,
)

FLIGHTS = 200
MOST_SAMPLES = 4000  # of a flight; each takes half a millisecond for all flights
LIMITED = 0.05  # of the largest control: by so much it differs from that without limits
LOWEST_DAMPING = 0.2
# Of successive swings of an oscillation with this damping
RATIO = math.exp(-math.pi * LOWEST_DAMPING / math.sqrt(1 - LOWEST_DAMPING**2))
VISIBLE = 0.1  # smallest swing that counts, over the largest one


@frozen
class FlightTest:
    """What is flown: a step of a setpoint, then a step moment, with noise of the sensors.

    Attributes
    ----------
    samples : int
        They are shared equally by the steps.
    steps : mapping of signal to (float, str)
        The size of each step, and the signal that responds to it; the first at the beginning.
    noise : mapping of signal to float
        Standard deviation of the white noise of a sensor.
    """

    samples: int
    steps: dict[str, tuple[float, str]]
    noise: Values


@dataclass(frozen=True)
class FlightCounts:
    """How many of several simulated flights reach a limit or ring.

    Attributes
    ----------
    flights, saturating, ringing : int
        Ringing has a damping ratio below 0.2.
    """

    flights: int
    saturating: int
    ringing: int

    def is_worse_than(self, other: "FlightCounts") -> bool:
        """Return whether more of these flights saturate or ring."""
        return self.saturating > other.saturating or self.ringing > other.ringing

    def __add__(self, other: "FlightCounts") -> "FlightCounts":
        """Return the counts of both."""
        return FlightCounts(
            self.flights + other.flights,
            self.saturating + other.saturating,
            self.ringing + other.ringing,
        )

    def __str__(self) -> str:
        return (
            f"of {self.flights} flights with drawn plants, {self.saturating} reach a limit of the "
            f"control and {self.ringing} ring with a damping below {LOWEST_DAMPING:g}."
        )


def fly(
    controllers: Sequence[Controller], loops: SampledLoop, test: FlightTest, seed: int = 0
) -> FlightCounts:
    """Fly each plant of a loop with these controllers, and count what saturates and rings.

    The noise of a flight is the same for any gains.
    """
    control, unlimited, _ = simulated(controllers, loops, test, seed)
    size = np.abs(unlimited).max(axis=2, keepdims=True)
    is_limited = (np.abs(control - unlimited) > LIMITED * size).any(axis=(1, 2))

    # Noise swings, too: whether a loop rings is seen without it.
    *_, responses = simulated(controllers, loops, replace(test, noise={}), seed)
    share = test.samples // len(test.steps)
    rings = np.zeros(len(responses), dtype=bool)
    for k, (_, signal) in enumerate(test.steps.values()):
        response = responses[:, loops.sensors.index(signal), k * share : (k + 1) * share]
        rings |= [is_ringing(row) for row in response]
    return FlightCounts(len(responses), int(is_limited.sum()), int(rings.sum()))


@np.errstate(all="ignore")  # unstable loops
def simulated(
    controllers: Sequence[Controller], loops: SampledLoop, test: FlightTest, seed: int = 0
) -> tuple[Array, Array, Array]:
    """Return the controls (plants, inputs, n), those of laws without limits, and the responses.

    The responses (plants, sensors, n) are without noise. A law without limits has the same states
    as the controllers that fly, and is linear.
    """
    plants, inputs = len(loops.A), loops.inputs
    law, unlimited, memory = _compiled(controllers, loops, plants)
    linear = linear_controller(controllers, loops.sensors, inputs)
    rows = [linear.commands.index(name) for name in inputs]
    added = np.zeros((len(linear.commands), test.samples))
    share = test.samples // len(test.steps)
    for k, (name, (size, _)) in enumerate(test.steps.items()):
        added[linear.commands.index(name), k * share :] = size
    deviations = np.array([test.noise.get(name, 0.0) for name in loops.sensors])
    random = np.random.default_rng(seed)

    state = np.zeros(loops.A.shape[:2])
    # The newest past control is the first one.
    past = np.zeros((plants, len(inputs), int(loops.whole.max()) + 1))
    everyone, each = np.arange(plants)[:, None], np.arange(len(inputs))
    controls, free, responses = [], [], []
    for k in range(test.samples):
        earlier = past[everyone, each, loops.whole]
        y = (loops.C @ state[..., None] + loops.D @ earlier[..., None])[..., 0]
        noise = random.standard_normal(y.shape) * deviations
        column = np.vstack([(y + noise).T, np.repeat(added[:, k : k + 1], plants, axis=1)])
        without = np.asarray(unlimited(memory, column))[rows].T
        memory, total = law(memory, column)
        u = np.asarray(total)[rows].T
        late = np.where(loops.whole > 0, past[everyone, each, loops.whole - 1], u)
        driven = loops.late @ late[..., None] + loops.early @ earlier[..., None]
        state = (loops.A @ state[..., None] + driven)[..., 0]
        past = np.concatenate([u[..., None], past[..., :-1]], axis=2)
        controls.append(u)
        free.append(without)
        responses.append(y)
    return (
        np.stack(controls, axis=-1),
        np.stack(free, axis=-1),
        np.stack(responses, axis=-1),
    )


@one_thread_at_a_time
def _compiled(
    controllers: Sequence[Controller], loops: SampledLoop, plants: int
) -> tuple[ca.Function, ca.Function, ca.DM]:
    """Return the law and its linear part for all plants, and the initial states."""
    formulas = controller_formulas(controllers, loops.sensors, loops.inputs)
    initial = ca.DM([value for c in controllers for value in c.initial])
    x, v = formulas.states, formulas.inputs
    law = ca.Function("law", [x, v], [formulas.next_states, formulas.total])
    about = ca.Function("blocks", [x, v], [formulas.total, *_gradients(formulas.total, x, v)])
    total, by_state, by_input = about(initial, ca.DM.zeros(v.numel()))
    linear = total + by_state @ (x - initial) + by_input @ v
    unlimited = ca.Function("unlimited", [x, v], [linear])
    return law.map(plants), unlimited.map(plants), ca.repmat(initial, 1, plants)


def _gradients(expression: ca.SX, *variables: ca.SX) -> list[ca.SX]:
    return [ca.jacobian(expression, variable) for variable in variables]


def is_ringing(response: Array) -> bool:
    """Return whether swings of a response (n,) to a step decay too slowly.

    The first swing, from rest to the first peak, is not part of the oscillation: a moment moves the
    vehicle there and back however well the loop is damped.
    """
    from scipy.signal import find_peaks  # noqa: PLC0415  (takes a tenth of a second to import)

    if not np.isfinite(response).all():
        return True
    reach = float(np.ptp(response))
    # Noise turns a response often, by little.
    turns = [find_peaks(sign * response, prominence=VISIBLE * reach / 2)[0] for sign in (1, -1)]
    places = np.sort(np.concatenate(turns))
    swings = np.abs(np.diff(response[places]))
    is_slow = swings[1:] > RATIO * swings[:-1]
    return bool(np.any(is_slow & (swings[1:] > VISIBLE * reach)))
