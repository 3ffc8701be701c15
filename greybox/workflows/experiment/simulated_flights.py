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
# Most samples of a flight. Each takes half a millisecond for all flights.
MOST_SAMPLES = 4000
# A control saturates if it differs from that without limits by this share of the largest control.
LIMITED = 0.05
# Oscillations with a smaller damping ratio ring.
LOWEST_DAMPING = 0.2
# Ratio of successive swings of an oscillation with this damping.
RATIO = math.exp(-math.pi * LOWEST_DAMPING / math.sqrt(1 - LOWEST_DAMPING**2))
# Smallest swing that counts, as a share of the range of the response.
VISIBLE = 0.1


@frozen
class FlightTest:
    """A test in which signals change by a step, one after the other, with noise of the sensors.

    Attributes
    ----------
    samples : int
        Number of samples, divided equally between the steps.
    steps : mapping of signal to (float, str)
        The size of each step, and the signal whose response is judged.
    noise : mapping of signal to float
        Standard deviation of the white noise of a sensor.
    """

    samples: int
    steps: dict[str, tuple[float, str]]
    noise: Values


@dataclass(frozen=True)
class FlightCounts:
    """Numbers of simulated flights, and of those that reach a limit or ring.

    Attributes
    ----------
    flights : int
    saturating : int
        Flights in which a control reaches a limit.
    ringing : int
        Flights with an oscillation whose damping ratio is below 0.2.
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
    """Fly each plant of a loop with these controllers; count flights that saturate or ring.

    With the same `seed`, flights have the same noise whatever the gains are.
    """
    control, unlimited, _ = simulated(controllers, loops, test, seed)
    size = np.abs(unlimited).max(axis=2, keepdims=True)
    is_limited = (np.abs(control - unlimited) > LIMITED * size).any(axis=(1, 2))

    # Ringing is judged in flights without noise, which itself swings.
    *_, responses = simulated(controllers, loops, replace(test, noise={}), seed)
    share = test.samples // len(test.steps)
    rings = np.zeros(len(responses), dtype=bool)
    for k, (_, signal) in enumerate(test.steps.values()):
        response = responses[:, loops.sensors.index(signal), k * share : (k + 1) * share]
        rings |= [is_ringing(row) for row in response]
    return FlightCounts(len(responses), int(is_limited.sum()), int(rings.sum()))


# Signals of unstable loops overflow.
@np.errstate(all="ignore")
def simulated(
    controllers: Sequence[Controller], loops: SampledLoop, test: FlightTest, seed: int = 0
) -> tuple[Array, Array, Array]:
    """Return the controls, the controls without limits, and the responses of all flights.

    Returns
    -------
    controls : (plants, inputs, samples) array
    unlimited : (plants, inputs, samples) array
        Those of the linearized controllers at the same states and measurements.
    responses : (plants, sensors, samples) array
        The measured signals, without noise.
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
    # Past controls of every plant and input, the newest one first.
    past = np.zeros((plants, len(inputs), int(loops.whole.max()) + 1))
    plant_index = np.arange(plants)[:, None]
    input_index = np.arange(len(inputs))
    controls = []
    unlimited_controls = []
    responses = []
    for k in range(test.samples):
        # The older control acts until the fraction of the delay has passed.
        earlier = past[plant_index, input_index, loops.whole]
        y = (loops.C @ state[..., None] + loops.D @ earlier[..., None])[..., 0]
        noise = random.standard_normal(y.shape) * deviations
        column = np.vstack([(y + noise).T, np.repeat(added[:, k : k + 1], plants, axis=1)])
        u_unlimited = np.asarray(unlimited(memory, column))[rows].T
        memory, total = law(memory, column)
        u = np.asarray(total)[rows].T
        late = np.where(loops.whole > 0, past[plant_index, input_index, loops.whole - 1], u)
        driven = loops.late @ late[..., None] + loops.early @ earlier[..., None]
        state = (loops.A @ state[..., None] + driven)[..., 0]
        past = np.concatenate([u[..., None], past[..., :-1]], axis=2)
        controls.append(u)
        unlimited_controls.append(u_unlimited)
        responses.append(y)
    return (
        np.stack(controls, axis=-1),
        np.stack(unlimited_controls, axis=-1),
        np.stack(responses, axis=-1),
    )


@one_thread_at_a_time
def _compiled(
    controllers: Sequence[Controller], loops: SampledLoop, plants: int
) -> tuple[ca.Function, ca.Function, ca.DM]:
    """Return the controllers and their linearization for all plants, and the initial states.

    The first function is (states, inputs) -> (next states, commands), the second one
    (states, inputs) -> commands; the initial states are (n, plants).
    """
    formulas = controller_formulas(controllers, loops.sensors, loops.inputs)
    initial_values: list[float] = []
    for controller in controllers:
        initial_values += controller.initial
    initial = ca.DM(initial_values)
    x, v, commands = formulas.states, formulas.inputs, formulas.total
    law = ca.Function("law", [x, v], [formulas.next_states, commands])
    slopes = [ca.jacobian(commands, x), ca.jacobian(commands, v)]
    linearization = ca.Function("blocks", [x, v], [commands, *slopes])
    total, by_state, by_input = linearization(initial, ca.DM.zeros(v.numel()))
    linear = total + by_state @ (x - initial) + by_input @ v
    unlimited = ca.Function("unlimited", [x, v], [linear])
    return law.map(plants), unlimited.map(plants), ca.repmat(initial, 1, plants)


def is_ringing(response: Array) -> bool:
    """Return whether the swings of a response (n,) to a step decay too slowly.

    The first swing, from rest to the first peak, does not count: a moment moves the vehicle there
    and back, however well the loop is damped.
    """
    from scipy.signal import find_peaks  # noqa: PLC0415  (takes a tenth of a second to import)

    if not np.isfinite(response).all():
        return True
    size = float(np.ptp(response))
    # The prominence leaves out the many small peaks of noise.
    peaks, _ = find_peaks(response, prominence=VISIBLE * size / 2)
    troughs, _ = find_peaks(-response, prominence=VISIBLE * size / 2)
    places = np.sort(np.concatenate([peaks, troughs]))
    swings = np.abs(np.diff(response[places]))
    decays_slowly = swings[1:] > RATIO * swings[:-1]
    is_visible = swings[1:] > VISIBLE * size
    return bool(np.any(decays_slowly & is_visible))
