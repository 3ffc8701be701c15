"""The loop of a flight with today's gains, and how other gains change its numbers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.workflows.experiment.closed_loop import samples_to_settle
from greybox.workflows.experiment.controller import Controller, outside_names, sensors_of
from greybox.workflows.experiment.gain_comparison import ROUNDING, SENSITIVITY, GainChange
from greybox.workflows.experiment.loop_numbers import REST, loop_frequencies
from greybox.workflows.experiment.sampled_loop import DOT, LinearController, SampledLoop

ORDER = "closest_observation"  # of quantiles: interpolation between infinite values is undefined
STEPS = 256  # samples of a step response, before their spacing is doubled


@frozen
class TodaysLoop:
    """The loop of a flight with today's gains, against which other gains are judged.

    Attributes
    ----------
    loops : SampledLoop
        Of the estimate, of draws from its distribution, and of plants beside it, which differ in
        what the data do not determine.
    draws : int
    broken_at : str
        Where the sensitivity is taken.
    responses : tuple of str
        What a moment moves.
    inputs : tuple of str
        Those of the plant that the controllers drive.
    measured : tuple of str
        What the controllers read, with noise.
    """

    loops: SampledLoop
    draws: int
    broken_at: str
    responses: tuple[str, ...]
    inputs: tuple[str, ...]
    measured: tuple[str, ...]

    @cached_property
    def numbers(self) -> Mapping[str, Array]:
        """The numbers (plants,) that should be small, with today's gains."""
        return self._numbers(self.loops)

    def is_worse_at_the_estimate(self, controller: LinearController) -> bool:
        """Return whether other gains are worse with the estimate, which takes little time."""
        changed = self._numbers(replace(self.loops.first, controller=controller))
        return any(
            not _ratios(changed[name], today)[0] <= 1 + ROUNDING
            for name, today in self.numbers.items()
        )

    def changes(self, controller: LinearController, level: float) -> tuple[GainChange, ...]:
        """Return how other gains change each number, with intervals over the draws."""
        changed = self._numbers(replace(self.loops, controller=controller))
        ends = [(1 - level) / 2, (1 + level) / 2]
        answer = []
        for name, today in self.numbers.items():
            ratio = _ratios(changed[name], today)
            drawn, beside = np.split(ratio[1:], [self.draws])
            # Today's gains fly: a plant with which they are unstable is not this vehicle.
            drawn = drawn[~np.isnan(drawn)]
            low = high = math.nan
            if drawn.size and np.allclose(beside, ratio[0], rtol=1e-3):
                low, high = map(float, np.quantile(drawn, ends, method=ORDER))
            pair = float(today[0]), float(changed[name][0])
            answer.append(GainChange(name, *pair, float(ratio[0]), low, high))
        return tuple(answer)

    def _numbers(self, loops: SampledLoop) -> Mapping[str, Array]:
        """Return the numbers (plants,) of loops by name; infinite for an unstable one."""
        answer = {SENSITIVITY: _peak_sensitivity(loops, self.broken_at)}
        for name in self.inputs:
            for response in self.responses:
                key = f"peak {response} after a step moment at {name}"
                answer[key] = _step_peak(loops, name, response)
        for name in self.inputs:
            for sensor in self.measured:
                answer[f"noise from {sensor} to {name}"] = _noise_gain(loops, sensor, name)
        return {key: np.where(loops.is_stable, v, math.inf) for key, v in answer.items()}


def todays_loop(
    controllers: Sequence[Controller], loops: SampledLoop, draws: int, broken_at: str
) -> TodaysLoop:
    """Return the loop of these controllers.

    The responses to a moment are what the controllers measure, without derivatives where there are
    other signals.
    """
    measured = sensors_of(controllers)
    driven = outside_names(controllers, "outputs")
    inputs = tuple(name for name in loops.inputs if name in driven)
    responses = tuple(name for name in measured if not name.endswith(DOT)) or measured
    return TodaysLoop(loops, draws, broken_at, responses, inputs, measured)


@np.errstate(all="ignore")
def _ratios(changed: Array, today: Array) -> Array:
    """Return ratios (plants,): NaN where today's loop is unstable, one for zero over zero."""
    ratio = np.where((changed == 0) & (today == 0), 1.0, changed / today)
    return np.where(np.isinf(today), math.nan, ratio)


def _peak_sensitivity(loops: SampledLoop, signal: str) -> Array:
    """Return the largest magnitude (plants,) of the sensitivity at a signal, at all frequencies."""

    def size(omega: Array) -> Array:
        return np.abs(loops.gains(signal, [signal], omega)[..., 0])

    omega = loop_frequencies(loops)
    coarse = size(omega)
    # The peaks of all plants lie between these points of the grid.
    places = coarse.argmax(axis=1)
    low, high = max(places.min() - 1, 0), min(places.max() + 1, len(omega) - 1)
    fine = size(np.geomspace(omega[low], omega[high], 400))
    return np.maximum(coarse.max(axis=1), fine.max(axis=1))


@np.errstate(all="ignore")  # unstable loops
def _step_peak(loops: SampledLoop, added_to: str, signal: str) -> Array:
    """Return the largest magnitude (plants,) of the response to a unit step, at the samples.

    Later samples are farther apart, by at most 1/256 of the time since the step.
    """
    A, B, C, D = loops.closed(added_to, signal)
    # With the constant input as a state, the next state is M x.
    M = np.zeros((len(A), A.shape[1] + 1, A.shape[1] + 1))
    M[:, :-1, :-1], M[:, :-1, -1], M[:, -1, -1] = A, B, 1
    read = np.hstack([C, D[:, None]])[:, None]
    state = np.broadcast_to(np.eye(M.shape[1])[:, -1:], (len(M), M.shape[1], 1))

    # What settles more slowly than the first plant ends at the response at rest.
    peak = np.abs(loops.gains(added_to, [signal], REST / loops.period)[:, 0, 0].real)
    for _ in range(1 + math.ceil(math.log2(1 + samples_to_settle(loops) / STEPS))):
        states, power = state, M
        while states.shape[2] < STEPS:
            states = np.concatenate([states, power @ states], axis=2)
            power = power @ power
        peak = np.maximum(peak, np.abs(read @ states)[:, 0].max(axis=1))
        state, M = power @ state, M @ M
    return peak


@np.errstate(all="ignore")  # unstable loops
def _noise_gain(loops: SampledLoop, sensor: str, signal: str) -> Array:
    """Return the rms (plants,) of a signal per rms of white noise on the samples of a sensor.

    It is the norm H2 of the sampled loop.
    """
    A, B, C, D = loops.closed(sensor, signal)
    # The sum of A^k B B' A'^k is doubled in length by each step.
    covariance = B[:, :, None] * B[:, None]
    for _ in range(math.ceil(math.log2(samples_to_settle(loops, 1e-16)))):
        covariance = covariance + A @ covariance @ A.mT
        A = A @ A
    variance = np.einsum("pi,pij,pj->p", C, covariance, C) + D**2
    return np.sqrt(np.maximum(variance, 0))
