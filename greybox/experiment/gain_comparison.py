"""Whether other gains make a loop worse than today's: sensitivity, moments and noise.

Begin with `TodaysLoop`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greybox.experiment.controller import Controller, outside_names, sensors_of
from greybox.experiment.loop_numbers import REST, loop_frequencies, samples_to_settle
from greybox.experiment.sampled_loop import DOT, LinearController, SampledLoop
from greybox.files.arrays import Array
from greybox.files.frozen_values import frozen
from greybox.files.named_values import Values
from greybox.files.numbers_in_text import number
from greybox.files.printed import Printed
from greybox.files.text_table import text_table
from greybox.files.wording import listed

ORDER = "closest_observation"  # of quantiles: interpolation between infinite values is undefined
ROUNDING = 1e-6  # of a ratio, with the same gains on both sides
SENSITIVITY = "peak |S|"
STEPS = 256  # samples of a step response, before their spacing is doubled


@dataclass(frozen=True)
class GainChange:
    """A number of the loop that should be small, with today's gains and with others.

    Attributes
    ----------
    name : str
    today, changed : float
        At the estimate; infinite for an unstable loop.
    ratio : float
        Of the changed number over today's, at the estimate. NaN if today's loop is unstable.
    low, high : float
        Ends of the interval of the ratio. Both numbers of a ratio are those of the same plant, so
        that errors which the two loops share cancel. NaN if the data do not determine the ratio.
    """

    name: str
    today: float
    changed: float
    ratio: float
    low: float
    high: float

    @property
    def is_not_worse(self) -> bool:
        """Whether the number is at most today's, at the estimate and in the whole interval."""
        return self.ratio <= 1 + ROUNDING and self.high <= 1 + ROUNDING

    @property
    def judgement(self) -> str:
        """Return "worse", "may be worse" or "not worse"."""
        if self.is_not_worse:
            return "not worse"
        return "worse" if self.low > 1 else "may be worse"


@frozen
class GainComparison(Printed):
    """A set of gains against today's gains, with the same plants. It prints itself as a table.

    Attributes
    ----------
    gains : mapping of gain to float
    bandwidth, today_bandwidth : float, rad/s
        The lowest disturbance rejection bandwidth of the estimates; NaN where an estimate does not
        meet the requirements.
    changes : tuple of GainChange
        Peak of the sensitivity (a factor), peak response to a step moment, and noise at the
        actuator: of several flights, that with the highest end of the interval.
    level : float
    """

    gains: Values
    bandwidth: float
    today_bandwidth: float
    changes: tuple[GainChange, ...]
    level: float

    def __getitem__(self, name: str) -> GainChange:
        """Return a change by its name, such as "peak |S|"."""
        for change in self.changes:
            if change.name == name:
                return change
        raise KeyError(f"there is no {name!r}; there are {listed([c.name for c in self.changes])}.")

    @property
    def today_is_stable(self) -> bool:
        """Whether the estimates are stable with today's gains: if not, nothing can be compared."""
        return all(math.isfinite(change.today) for change in self.changes)

    @property
    def worse(self) -> tuple[str, ...]:
        """What is worse than today, or may be."""
        return tuple(change.name for change in self.changes if not change.is_not_worse)

    def __str__(self) -> str:
        rows = [_printed(change) for change in self.changes]
        pair = [number(value, 3) for value in (self.today_bandwidth, self.bandwidth)]
        rows.append(("disturbance rejection bandwidth, rad/s", *pair, "", ""))
        label = ", ".join(f"{name} = {value:.4g}" for name, value in self.gains.items())
        kind = "refused" if self.worse else "proposed"
        header = (label, "today", kind, f"change ({100 * self.level:g} % interval)", "")
        return text_table(header, rows, left=(0, 4))


def _printed(change: GainChange) -> tuple[str, ...]:
    """Return a row: the peak of the sensitivity in dB, other numbers relative to today's."""
    is_sensitivity = change.name == SENSITIVITY
    shown = [change.ratio, change.low, change.high]
    if is_sensitivity:
        shown = [_decibels(value) for value in shown]
        pair = [number(_decibels(value), 3) for value in (change.today, change.changed)]
    else:
        shown = [100 * (value - 1) for value in shown]
        pair = ["1", number(change.ratio, 3)]
    # Equal numbers differ by rounding, of which nobody wants to read three digits.
    shown = [v if math.isinf(v) or math.isnan(v) else round(v, 4) for v in shown]
    value, low, high = (f"{'+' if v > 0 else ''}{number(v + 0.0, 3)}" for v in shown)
    unit = "dB" if is_sensitivity else "%"
    interval = f"({low} to {high})" if not math.isnan(change.high) else "(not determined)"
    name = f"{change.name}, {'dB' if is_sensitivity else 'relative'}"
    return (name, *pair, f"{value} {unit} {interval}", change.judgement)


def _decibels(factor: float) -> float:
    if factor == 0:
        return -math.inf
    return 20 * math.log10(factor)


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


def worst_changes(flights: Sequence[Sequence[GainChange]]) -> tuple[GainChange, ...]:
    """Return the change of every number in the flight in which it is or may be worst."""
    by_name: dict[str, list[GainChange]] = {}
    for change in (change for changes in flights for change in changes):
        by_name.setdefault(change.name, []).append(change)
    return tuple(max(changes, key=_badness) for changes in by_name.values())


def _badness(change: GainChange) -> tuple[float, ...]:
    return tuple(math.inf if math.isnan(v) else v for v in (change.high, change.ratio))


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
