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

ORDER = "closest_observation"  # of quantiles: interpolation between infinite values is undefined
SENSITIVITY = "peak |S|"
MARGINS = {"phase margin": "deg", "gain margin": "dB", "gain reduction margin": "dB"}
NOISE, PEAK = "noise from ", "peak of "  # how names of rows begin
REJECTION = "disturbance rejection bandwidth"


class Row(NamedTuple):
    """A number (plants,) of loops with its unit, and whether it should be large."""

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
        Of the estimate, of draws from its distribution, and of plants beside it, which differ in
        what the data do not determine.
    draws : int
    broken_at : str
        Where the margins and the sensitivity are taken.
    tracking : (str, str) or None
        A setpoint, and the signal that follows it.
    responses : tuple of str
        What a moment moves.
    inputs : tuple of str
        Those of the plant that the controllers drive.
    measured : tuple of str
        What the controllers read, with noise.
    horizon : float, s
        Over which responses to a moment are integrated.
    objective : function of loops
        What should be small; by default the response to a moment.
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
        """Return the objective with other gains, relative to today's, and what they worsen.

        Both are those of the estimate alone, which takes little time. The second one has the
        factors by which the numbers with limits get worse.
        """
        alone = replace(self.loops.first, controller=controller)
        with np.errstate(all="ignore"):
            objective = float(self._target(alone)[0] / self.target[0])
        factors = {}
        for name, row in self._limited_rows(alone).items():
            today = self.rows[name].values[:1]
            factors[name] = float(worsening(today, row.values, row.unit, row.is_large_better)[0])
        return objective, factors

    @np.errstate(all="ignore")
    def changes(
        self, controller: LinearController, level: float
    ) -> tuple[GainChange, tuple[GainChange, ...]]:
        """Return how other gains change the objective and each row, with intervals."""
        loops = replace(self.loops, controller=controller)
        rows = self._rows(loops)
        relative = Row(self.target / self.target[0], "")
        other = Row(self._target(loops) / self.target[0], "")
        # An interval of each row that is wide enough to hold together with all others.
        joint = 1 - (1 - level) / len(rows)
        changes = [
            self._change(name, self.rows[name], row, level, joint) for name, row in rows.items()
        ]
        return self._change("objective", relative, other, level, joint), tuple(changes)

    def _change(
        self, name: str, today: Row, changed: Row, level: float, joint: float
    ) -> GainChange:
        factor = worsening(today.values, changed.values, today.unit, today.is_large_better)
        # Today's gains fly: a plant with which they are unstable is not this vehicle.
        factor = np.where(self.loops.is_stable, factor, math.nan)
        drawn, beside = np.split(factor[1:], [self.draws])
        drawn = drawn[~np.isnan(drawn)]
        low = high = math.nan
        if np.allclose(beside, factor[0], rtol=1e-3):
            low, high = _ends(drawn, joint)
        return GainChange(
            name,
            today.unit,
            float(today.values[0]),
            *self._interval(today.values, level),
            float(changed.values[0]),
            *self._interval(changed.values, level),
            float(factor[0]),
            low,
            high,
        )

    def _interval(self, values: Array, level: float) -> tuple[float, float]:
        drawn, beside = np.split(values[1:], [self.draws])
        if not np.allclose(beside, values[0], rtol=1e-3):
            return math.nan, math.nan
        return _ends(drawn[~np.isnan(drawn)], level)

    def _target(self, loops: SampledLoop) -> Array:
        with np.errstate(all="ignore"):  # unstable loops
            return np.where(loops.is_stable, self.objective(loops), math.inf)

    def _rows(self, loops: SampledLoop) -> Rows:
        """Return every number (plants,) of loops by name, the worst for an unstable one."""
        rows = self._margin_rows(loops) | self._limited_rows(loops)
        if self.tracking:
            rows |= self._step_rows(loops, *self.tracking)
        is_stable = loops.is_stable
        return {
            name: row._replace(
                values=np.where(is_stable, row.values, 0.0 if row.is_large_better else math.inf)
            )
            for name, row in rows.items()
        }

    @np.errstate(all="ignore")
    def _limited_rows(self, loops: SampledLoop) -> dict[str, Row]:
        """Return the numbers on which proposed gains have limits: moment, noise, sensitivity."""
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
        unstable = ~loops.is_stable
        return {
            n: row._replace(values=np.where(unstable, math.inf, row.values))
            for n, row in rows.items()
        }

    @np.errstate(all="ignore")
    def _margin_rows(self, loops: SampledLoop) -> dict[str, Row]:
        omega = loop_frequencies(loops)
        numbers = margin_numbers(loops.broken_at(self.broken_at, omega), omega, period=loops.period)
        rows = {name: Row(numbers[name].value, unit, True) for name, unit in MARGINS.items()}
        rows[REJECTION] = Row(numbers[REJECTION].value, "rad/s", True)
        return rows

    @np.errstate(all="ignore")  # unstable loops
    def _step_rows(self, loops: SampledLoop, setpoint: str, response: str) -> dict[str, Row]:
        omega = loop_frequencies(loops)
        final = loops.gains(setpoint, [response], REST / loops.period)[..., 0].real
        size = np.abs(loops.gains(setpoint, [response], omega)[..., 0] / final)
        steps = step_numbers(loops, setpoint, response)
        place = f"of {response}"
        return {
            f"bandwidth {place}": Row(
                crossings(size - math.sqrt(0.5), omega).last.value, "rad/s", True
            ),
            f"rise time {place}": Row(steps["rise time"].value, "s"),
            f"overshoot {place}": Row(steps["overshoot"].value, "%"),
        }


def _ends(drawn: Array, level: float) -> tuple[float, float]:
    """Return the ends of the interval of draws; NaN for none."""
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
    """Return the loop of these controllers.

    The responses to a moment are what the controllers measure, without derivatives where there are
    other signals.
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
        # A moment that moves nothing has no size.
        pairs = [(name, response) for name in inputs for response in responses]
        sizes = {pair: moment_response(loops.first, *pair, horizon)[1][0] for pair in pairs}
        least = 1e-9 * max(sizes.values())
        objective = MomentResponse(
            horizon, {pair: float(size) for pair, size in sizes.items() if size > least}
        )
    return TodaysLoop(
        loops, draws, broken_at, tracking, responses, inputs, measured, horizon, objective
    )


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
def noise_gain(loops: SampledLoop, sensor: str, signal: str) -> Array:
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
