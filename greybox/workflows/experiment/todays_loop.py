"""The loop of a flight with today's gains, and how other gains change its numbers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.workflows.experiment.closed_loop import (
    follows,
    samples_to_settle,
    setpoint_and_response,
    step_numbers,
)
from greybox.workflows.experiment.controller import Controller, outside_names, sensors_of
from greybox.workflows.experiment.crossings import crossings
from greybox.workflows.experiment.gain_comparison import GainChange, worsening
from greybox.workflows.experiment.gain_objectives import (
    MomentResponse,
    Objective,
    moment_horizon,
    moment_response,
)
from greybox.workflows.experiment.loop_numbers import REST, loop_frequencies, margin_numbers
from greybox.workflows.experiment.sampled_loop import DOT, LinearController, SampledLoop

# Method of numpy's quantiles: interpolation between infinite values would be undefined.
ORDER = "closest_observation"
SENSITIVITY = "peak |S|"
MARGINS = {"phase margin": "deg", "gain margin": "dB", "gain reduction margin": "dB"}
# Beginnings of the names of rows.
NOISE = "noise from "
PEAK = "peak of "
REJECTION = "disturbance rejection bandwidth"


class Row(NamedTuple):
    """A number of loops.

    Attributes
    ----------
    values : (plants,) array
    unit : str
    is_large_better : bool
        Whether a larger number is better.
    """

    values: Array
    unit: str
    is_large_better: bool = False


Rows = Mapping[str, Row]


@frozen
class TodaysLoop:
    """The loop of a flight with today's gains, against which other gains are judged.

    Attributes
    ----------
    loops : SampledLoop
        The loops of the estimate, of draws from its distribution, and of plants beside it, which
        differ from the estimate in directions that the data do not determine.
    draws : int
        Number of draws.
    broken_at : str
        The signal at which the margins and the sensitivity are taken.
    tracking : (str, str) or None
        A setpoint, and the signal that follows it.
    responses : tuple of str
        Signals whose response to a moment is judged.
    inputs : tuple of str
        Inputs of the plant that the controllers drive.
    measured : tuple of str
        Signals that the controllers read, with noise.
    horizon : float, s
        Time over which responses to a moment are integrated.
    objective : function of loops
        A number (plants,) that should be small; by default the response to a moment.
    """

    loops: SampledLoop
    draws: int
    broken_at: str
    tracking: tuple[str, str] | None
    responses: tuple[str, ...]
    inputs: tuple[str, ...]
    measured: tuple[str, ...]
    horizon: float
    objective: Objective

    @cached_property
    def rows(self) -> Rows:
        """The numbers with today's gains."""
        return self._rows(self.loops)

    @cached_property
    def target(self) -> Array:
        """The objective (plants,) with today's gains; infinite for an unstable loop."""
        return self._target(self.loops)

    def at_the_estimate(self, controller: LinearController) -> tuple[float, Mapping[str, float]]:
        """Return how other gains change the loop of the estimate.

        These are the objective relative to today's, and the factors by which the numbers with
        limits get worse, by name. Only one plant is evaluated, which takes little time.
        """
        estimate = replace(self.loops.first, controller=controller)
        with np.errstate(all="ignore"):
            objective = float(self._target(estimate)[0] / self.target[0])
        factors = {}
        for name, row in self._limited_rows(estimate).items():
            today = self.rows[name].values[:1]
            factors[name] = float(worsening(today, row.values, row.unit, row.is_large_better)[0])
        return objective, factors

    @np.errstate(all="ignore")
    def changes(
        self, controller: LinearController, level: float
    ) -> tuple[GainChange, tuple[GainChange, ...]]:
        """Return how other gains change the objective and each row, with intervals.

        `level` is the probability of the intervals. The factors of all rows lie in their intervals
        together with this probability.
        """
        loops = replace(self.loops, controller=controller)
        rows = self._rows(loops)
        relative = Row(self.target / self.target[0], "")
        changed = Row(self._target(loops) / self.target[0], "")
        # The level of a single row (Bonferroni).
        joint = 1 - (1 - level) / len(rows)
        objective = self._change("objective", relative, changed, level, joint)
        changes = [
            self._change(name, self.rows[name], row, level, joint) for name, row in rows.items()
        ]
        return objective, tuple(changes)

    def _change(
        self, name: str, today: Row, changed: Row, level: float, joint: float
    ) -> GainChange:
        """Return the change of a number; `joint` is the level of the interval of its factor."""
        factor = worsening(today.values, changed.values, today.unit, today.is_large_better)
        # Today's gains fly: a plant with which they are unstable is not this vehicle.
        factor = np.where(self.loops.is_stable, factor, math.nan)
        today_low, today_high = self._interval(today.values, level)
        changed_low, changed_high = self._interval(changed.values, level)
        low, high = self._interval(factor, joint)
        return GainChange(
            name=name,
            unit=today.unit,
            today=float(today.values[0]),
            today_low=today_low,
            today_high=today_high,
            changed=float(changed.values[0]),
            changed_low=changed_low,
            changed_high=changed_high,
            worsening=float(factor[0]),
            low=low,
            high=high,
        )

    def _interval(self, values: Array, level: float) -> tuple[float, float]:
        """Return the ends of the interval of a number (plants,).

        They are NaN if the data do not determine the number: it then differs between the estimate
        and the plants beside it.
        """
        drawn, beside = np.split(values[1:], [self.draws])
        if not np.allclose(beside, values[0], rtol=1e-3):
            return math.nan, math.nan
        return _ends(drawn[~np.isnan(drawn)], level)

    def _target(self, loops: SampledLoop) -> Array:
        """Return the objective (plants,) of loops; infinite for an unstable one."""
        # Numbers of unstable loops may overflow.
        with np.errstate(all="ignore"):
            return np.where(loops.is_stable, self.objective(loops), math.inf)

    def _rows(self, loops: SampledLoop) -> Rows:
        """Return all numbers of loops by name.

        A number of an unstable loop is zero if it should be large, and infinite otherwise.
        """
        rows = self._margin_rows(loops) | self._limited_rows(loops)
        if self.tracking:
            rows |= self._step_rows(loops, *self.tracking)
        return _with_worst_values(rows, loops)

    @np.errstate(all="ignore")
    def _limited_rows(self, loops: SampledLoop) -> dict[str, Row]:
        """Return the numbers that proposed gains must not make much worse, by name.

        These are the responses to moments, the noise at the actuator, and the peak sensitivity.
        """
        rows = {}
        for name in self.inputs:
            for response in self.responses:
                peak, rms = moment_response(loops, name, response, self.horizon)
                place = f"{response} from a moment at {name}"
                rows[f"rms of {place}"] = Row(rms, "")
                rows[f"{PEAK}{place}"] = Row(peak, "")
        for name in self.inputs:
            for sensor in self.measured:
                gain = noise_gain(loops, sensor, name)
                rows[f"{NOISE}{sensor} to {name}"] = Row(gain, "")
        peak = _peak_sensitivity(loops, self.broken_at)
        rows[SENSITIVITY] = Row(20 * np.log10(peak), "dB")
        return _with_worst_values(rows, loops)

    @np.errstate(all="ignore")
    def _margin_rows(self, loops: SampledLoop) -> dict[str, Row]:
        """Return the margins and the disturbance rejection bandwidth, by name."""
        omega = loop_frequencies(loops)
        numbers = margin_numbers(loops.broken_at(self.broken_at, omega), omega, period=loops.period)
        rows = {name: Row(numbers[name].value, unit, True) for name, unit in MARGINS.items()}
        rows[REJECTION] = Row(numbers[REJECTION].value, "rad/s", True)
        return rows

    @np.errstate(all="ignore")
    def _step_rows(self, loops: SampledLoop, setpoint: str, response: str) -> dict[str, Row]:
        """Return bandwidth, rise time and overshoot of the response to a setpoint, by name."""
        omega = loop_frequencies(loops)
        final = loops.gains(setpoint, [response], REST / loops.period)[..., 0].real
        size = np.abs(loops.gains(setpoint, [response], omega)[..., 0] / final)
        bandwidth = crossings(size - math.sqrt(0.5), omega).last.value
        steps = step_numbers(loops, setpoint, response)
        return {
            f"bandwidth of {response}": Row(bandwidth, "rad/s", True),
            f"rise time of {response}": Row(steps["rise time"].value, "s"),
            f"overshoot of {response}": Row(steps["overshoot"].value, "%"),
        }


def _with_worst_values(rows: Rows, loops: SampledLoop) -> dict[str, Row]:
    """Return rows with the worst possible value for every unstable loop."""
    is_stable = loops.is_stable
    answer = {}
    for name, row in rows.items():
        worst = 0.0 if row.is_large_better else math.inf
        answer[name] = row._replace(values=np.where(is_stable, row.values, worst))
    return answer


def _ends(drawn: Array, level: float) -> tuple[float, float]:
    """Return the ends of the interval of draws (d,); NaN if there are none."""
    if not drawn.size:
        return math.nan, math.nan
    low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2], method=ORDER)
    return float(low), float(high)


def todays_loop(
    controllers: Sequence[Controller],
    loops: SampledLoop,
    draws: int,
    broken_at: str,
    objective: Objective | None = None,
) -> TodaysLoop:
    """Return the loop of today's controllers, against which other gains are judged.

    The signals whose response to a moment is judged are those that the controllers measure. If
    there are others, derivatives are left out.

    Parameters
    ----------
    controllers : sequence of Controller
    loops : SampledLoop
        With these controllers.
    draws : int
        Number of draws among the plants.
    broken_at : str
    objective : function of loops, optional
    """
    measured = sensors_of(controllers)
    driven = outside_names(controllers, "outputs")
    inputs = tuple(name for name in loops.inputs if name in driven)
    responses = tuple(name for name in measured if not name.endswith(DOT)) or measured
    tracking = setpoint_and_response(controllers)
    if tracking and not follows(loops, *tracking):
        tracking = None
    horizon = moment_horizon(loops, broken_at)
    if objective is None:
        sizes = {}
        for name in inputs:
            for response in responses:
                _, rms = moment_response(loops.first, name, response, horizon)
                sizes[name, response] = float(rms[0])
        # Responses that a moment does not move are left out.
        least = 1e-9 * max(sizes.values())
        objective = MomentResponse(
            horizon, {pair: size for pair, size in sizes.items() if size > least}
        )
    return TodaysLoop(
        loops=loops,
        draws=draws,
        broken_at=broken_at,
        tracking=tracking,
        responses=responses,
        inputs=inputs,
        measured=measured,
        horizon=horizon,
        objective=objective,
    )


def _peak_sensitivity(loops: SampledLoop, signal: str) -> Array:
    """Return the largest magnitude (plants,) of the sensitivity at a signal."""

    def size(omega: Array) -> Array:
        """Return the magnitudes (plants, n)."""
        return np.abs(loops.gains(signal, [signal], omega)[..., 0])

    omega = loop_frequencies(loops)
    coarse = size(omega)
    # A finer grid covers the peaks of all plants.
    places = coarse.argmax(axis=1)
    low = max(places.min() - 1, 0)
    high = min(places.max() + 1, len(omega) - 1)
    fine = size(np.geomspace(omega[low], omega[high], 400))
    return np.maximum(coarse.max(axis=1), fine.max(axis=1))


# The covariance of an unstable loop overflows.
@np.errstate(all="ignore")
def noise_gain(loops: SampledLoop, sensor: str, signal: str) -> Array:
    """Return the rms (plants,) of a signal, for white noise with an rms of one at a sensor.

    This is the H2 norm of the sampled loop.
    """
    A, B, C, D = loops.closed(sensor, signal)
    # The covariance of the states is the sum of A^k B B' A'^k. Each step doubles the number of its
    # terms.
    covariance = B[:, :, None] * B[:, None]
    for _ in range(math.ceil(math.log2(samples_to_settle(loops, 1e-16)))):
        covariance = covariance + A @ covariance @ A.mT
        A = A @ A
    variance = np.einsum("pi,pij,pj->p", C, covariance, C) + D**2
    return np.sqrt(np.maximum(variance, 0))
