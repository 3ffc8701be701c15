"""What gains should make small: functions of a loop, of which `safe_gains` takes any.

An objective is a function of a `SampledLoop`, which holds many plants in the loop of the same
controllers, and returns one number for each plant. Smaller numbers are better.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.public import public
from greybox.workflows.experiment.closed_loop import samples_to_settle
from greybox.workflows.experiment.loop_numbers import REST, loop_frequencies, margin_numbers
from greybox.workflows.experiment.sampled_loop import SampledLoop

Objective = Callable[[SampledLoop], Array]
"""A function of a loop that returns a number (plants,) for each of its plants."""

STEPS = 256  # samples of a step response, before their spacing is doubled
PERIODS = 5.0  # of the crossover of today's loop, over which a response to a moment is integrated
# Ratio of the frequencies at which the sensitivity is -3 dB and -6 dB. It is 1.2 to 1.5 on a usual
# slope.
SHELF = 2.0


@dataclass(frozen=True)
class MomentResponse:
    """The rms response to a step moment over some time, relative to `sizes`.

    Attributes
    ----------
    horizon : float, s
    sizes : mapping of (input, signal) to float
        The responses that count, and the rms at which each counts as one. The mean of their squares
        counts.
    """

    horizon: float
    sizes: Mapping[tuple[str, str], float]
    about: str = field(default="response to a step moment", init=False)

    def __call__(self, loops: SampledLoop) -> Array:
        """Return the relative responses (plants,)."""
        squares = [
            (moment_response(loops, *pair, self.horizon)[1] / size) ** 2
            for pair, size in self.sizes.items()
        ]
        return np.sqrt(np.mean(squares, axis=0))


@public
@dataclass(frozen=True)
class RejectionBandwidth:
    """The inverse of the disturbance rejection bandwidth of the loop broken at a signal.

    The sensitivity may stay just below -3 dB over a wide band. This bandwidth then says little:
    disturbances within it are hardly rejected. `SafeGains` notes such a shelf.

    Attributes
    ----------
    signal : str
        By default the first input of the plant.
    """

    signal: str = ""
    about: str = field(default="disturbance rejection bandwidth", init=False)

    def __call__(self, loops: SampledLoop) -> Array:
        """Return the inverse bandwidths (plants,), s/rad."""
        omega = loop_frequencies(loops)
        gain = loops.broken_at(self.signal or loops.inputs[0], omega)
        numbers = margin_numbers(gain, omega, period=loops.period)
        with np.errstate(divide="ignore"):
            return 1 / numbers["disturbance rejection bandwidth"].value


def moment_horizon(loops: SampledLoop, signal: str) -> float:
    """Return the time in s over which responses to a moment are compared: periods of the crossover.

    What remains later is slow: a pilot or an outer loop deals with it. A loop without an integrator
    would otherwise be judged by its response at rest alone.
    """
    omega = loop_frequencies(loops.first)
    gain = loops.first.broken_at(signal, omega)
    crossover = margin_numbers(gain, omega)["crossover"].first[0]
    if crossover > 0:
        return PERIODS * math.tau / crossover
    return samples_to_settle(loops) * loops.period


@np.errstate(all="ignore")  # unstable loops
def moment_response(
    loops: SampledLoop, added_to: str, signal: str, horizon: float
) -> tuple[Array, Array]:
    """Return the peak and the rms (plants,) of the response of a signal to a unit step moment.

    The peak is that at all samples, and includes the response at rest. The rms is that until
    `horizon`, s.
    """
    time, response = moment_steps(loops, added_to, signal)
    rest = np.abs(loops.gains(added_to, [signal], REST / loops.period)[:, 0, 0].real)
    peak = np.maximum(np.abs(response).max(axis=1), rest)
    is_before = time <= max(horizon, loops.period)
    square = np.trapezoid(response[:, is_before] ** 2, time[is_before], axis=1)
    return peak, np.sqrt(square / time[is_before][-1])


@np.errstate(all="ignore")  # unstable loops
def moment_steps(loops: SampledLoop, added_to: str, signal: str) -> tuple[Array, Array]:
    """Return times (n,) and responses (plants, n) of a signal to a unit step, until it settles.

    Later samples are farther apart, by at most 1/256 of the time since the step.
    """
    A, B, C, D = loops.closed(added_to, signal)
    # With the constant input as a state, the next state is M x.
    M = np.zeros((len(A), A.shape[1] + 1, A.shape[1] + 1))
    M[:, :-1, :-1], M[:, :-1, -1], M[:, -1, -1] = A, B, 1
    read = np.hstack([C, D[:, None]])[:, None]
    state = np.broadcast_to(np.eye(M.shape[1])[:, -1:], (len(M), M.shape[1], 1))

    begin, spacing = 0, 1
    samples, responses = [], []
    for _ in range(1 + math.ceil(math.log2(1 + samples_to_settle(loops) / STEPS))):
        states, power = state, M
        while states.shape[2] < STEPS:
            states = np.concatenate([states, power @ states], axis=2)
            power = power @ power
        responses.append((read @ states)[:, 0])
        samples.append(begin + spacing * np.arange(STEPS))
        state, M = power @ state, M @ M
        begin, spacing = begin + spacing * STEPS, 2 * spacing
    return np.concatenate(samples) * loops.period, np.hstack(responses)


def shelf(loops: SampledLoop, signal: str) -> tuple[float, float] | None:
    """Return the band in rad/s in which the sensitivity of the first plant lies just below -3 dB.

    None if it falls to -6 dB within a factor of two below the disturbance rejection bandwidth.
    """
    omega = loop_frequencies(loops.first)
    size = np.abs(loops.first.gains(signal, [signal], omega)[0, :, 0])
    above = np.flatnonzero(size > math.sqrt(0.5))
    if not above.size or above[0] == 0:
        return None
    end = above[0]
    inside = np.flatnonzero(size[:end] < 0.5)
    begin = omega[inside[-1]] if inside.size else omega[0]
    return (float(begin), float(omega[end])) if omega[end] > SHELF * begin else None
