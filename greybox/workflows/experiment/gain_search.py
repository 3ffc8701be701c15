"""The choice of proposed gains among those that meet the requirements.

Begin with `GainSearch`.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.modeling.formula_arguments import Names
from greybox.workflows.experiment.controller import Controller
from greybox.workflows.experiment.gain_comparison import ROUNDING, GainComparison, worst_changes
from greybox.workflows.experiment.gain_objectives import shelf
from greybox.workflows.experiment.required_margins import RequiredMargins
from greybox.workflows.experiment.sampled_loop import (
    LinearController,
    SampledLoop,
    linear_controller,
)
from greybox.workflows.experiment.simulated_flights import (
    FLIGHTS,
    MOST_SAMPLES,
    FlightCounts,
    FlightTest,
    fly,
)
from greybox.workflows.experiment.todays_loop import NOISE, PEAK, SENSITIVITY, TodaysLoop

# Most sets that are compared with all draws; others differ little from these.
COMPARED = 8
# Share of today's objective that is worth the risk of new gains.
WORTHWHILE = 0.75
# Peak of the sensitivity, in dB, below which a loop is robust: Astrom and Hagglund (2006), Advanced
# PID Control, section 4.5, recommend maximum sensitivities from 1.4 to 2.
ROBUST = 3.0
# Number of steps that lead from today's gains to the proposed ones.
STEPS = 3


@frozen
class TunedControllers:
    """The controllers that fly, and those of their gains that are tuned.

    Attributes
    ----------
    controllers : tuple of Controller
    today : mapping of gain to float
        Today's values of the tuned gains.
    places : tuple of (int, str)
        For each gain, the number of its controller and its name there.
    """

    controllers: tuple[Controller, ...]
    today: Values
    places: tuple[tuple[int, str], ...]

    def with_gains(self, gains: Values) -> list[Controller]:
        """Return the controllers with other gains."""
        changed = [copy.copy(controller) for controller in self.controllers]
        for (place, name), value in zip(self.places, gains.values(), strict=True):
            law = changed[place]
            law.values = Names({**law.values, name: float(value)}, type(law).__name__)
        return changed

    def linear(self, gains: Values, loops: SampledLoop) -> LinearController:
        """Return the controllers with other gains, linearized for the signals of these loops."""
        key = (*gains.values(), loops.sensors, loops.inputs)
        if key not in self._linear:
            law = self.with_gains(gains)
            self._linear[key] = linear_controller(law, loops.sensors, loops.inputs)
        return self._linear[key]

    @cached_property
    def _linear(self) -> dict[tuple[Any, ...], LinearController]:
        """Linear controllers by gains and signals.

        They are stored, since the differentiation takes as long as the margins of a plant.
        """
        return {}


def gains_between(today: Values, last: Values, share: float) -> dict[str, float]:
    """Return gains at a share of the way from today's to the last ones.

    The way of positive gains is divided in equal ratios.
    """
    gains = {}
    for name, value in last.items():
        first = today[name]
        if share == 1:
            gains[name] = float(value)
        elif first > 0 and value > 0:
            gains[name] = float(first * (value / first) ** share)
        else:
            gains[name] = float(first + share * (value - first))
    return gains


@frozen
class GainSearch:
    """The search for gains that are better than today's and respect limits.

    Attributes
    ----------
    laws : TunedControllers
    todays : tuple of TodaysLoop
        One for each flight.
    required : tuple of RequiredMargins
        One for each flight, in the same order.
    level : float
        The required confidence.
    noise_factor : float
        Largest noise at the actuator, relative to today's.
    change : float
        Largest factor by which a gain may change.
    noise : mapping of signal to float
        Standard deviation of the noise of sensors in simulated flights.
    moment : float
        Size of the step moment in simulated flights.
    """

    laws: TunedControllers
    todays: tuple[TodaysLoop, ...]
    required: tuple[RequiredMargins, ...]
    level: float
    noise_factor: float
    change: float
    noise: Values
    moment: float

    @property
    def aim(self) -> str:
        """The name of the objective."""
        objective = self.todays[0].objective
        return getattr(objective, "about", getattr(objective, "__name__", "objective"))

    @cached_property
    def today_confidence(self) -> float:
        """The share of draws that meet the requirements with today's gains."""
        return self.confidence(self.laws.today)

    @property
    def must_be_better(self) -> bool:
        """Whether proposed gains must have a smaller objective than today's.

        They need not if today's gains probably fail the requirements.
        """
        return not self.today_confidence < 0.5

    def confidence(self, gains: Values) -> float:
        """Return the share of draws that meet the requirements, the smallest of all flights."""
        shares = []
        for flight in self.required:
            shares.append(flight.judged(self.laws.linear(gains, flight.loops))[0])
        # Unlike Python's, numpy's minimum is NaN if one share is NaN.
        return float(np.min(shares))

    def judged(self, sets: Sequence[Values]) -> tuple[Array, str]:
        """Return the confidence (sets,) of each set, and advice on further flights.

        The advice says which flights would measure the crossovers that were measured poorly.
        """
        shares = np.empty((len(self.required), len(sets)))
        cures = []
        for row, flight in zip(shares, self.required, strict=True):
            poor: list[float] = []
            for k, gains in enumerate(sets):
                row[k], crossovers = flight.judged(self.laws.linear(gains, flight.loops))
                poor += crossovers
            cures.append(flight.cure(poor))
        return shares.min(axis=0), " ".join(filter(None, cures))

    def choose(
        self, sets: Sequence[Values], confidence: Array
    ) -> tuple[Array, GainComparison | None, str]:
        """Return the objectives of the sets, a comparison of the best one, and a note.

        Objectives (sets,) are relative to today's; NaN for sets that are not allowed. If no set is
        proposed, the comparison is that of the best refused set and says why; it is None if no
        allowed set has a smaller objective than today's. The note names a set that would be better
        with more noise than allowed.
        """
        allowed = np.flatnonzero(confidence >= self.level)
        ratios = np.full(len(sets), math.nan)
        if not np.all([np.isfinite(today.target[0]) for today in self.todays]):
            # A loop of today's gains is unstable, so that nothing can be better or worse.
            comparison = self.compared(sets[int(allowed[0])]) if allowed.size else None
            return ratios, comparison, ""

        # Sets within all limits at the estimate, and the noise of those that exceed only its limit.
        within_limits: list[int] = []
        noises: dict[int, float] = {}
        for k in map(int, allowed):
            ratios[k], exceeded, noise = self._at_the_estimate(sets[k])
            is_certain = confidence[k] >= self.certainty
            if is_certain and not exceeded:
                within_limits.append(k)
            elif is_certain and exceeded == {NOISE}:
                noises[k] = noise
        candidates = self._candidates(ratios, allowed, within_limits)

        refused = None
        for k in candidates:
            comparison = self.compared(sets[k])
            if not comparison.refusals:
                return ratios, self.flown(comparison), ""
            refused = refused or comparison
            # The following sets have larger objectives.
            if self.must_be_better and ratios[k] > WORTHWHILE:
                break
        return ratios, refused, self._offer(sets, ratios, noises)

    def _candidates(
        self, ratios: Array, allowed: IntArray, within_limits: Sequence[int]
    ) -> list[int]:
        """Return the numbers of the sets to compare with all draws, the best one first.

        Without a set within all limits, this is the best of the allowed ones.
        """
        if self.must_be_better:
            allowed = allowed[ratios[allowed] < 1 - ROUNDING]
            within_limits = [k for k in within_limits if ratios[k] < 1 - ROUNDING]
        if not within_limits and allowed.size:
            return [int(allowed[ratios[allowed].argmin()])]
        return sorted(within_limits, key=lambda k: ratios[k])[:COMPARED]

    def _offer(self, sets: Sequence[Values], ratios: Array, noises: Mapping[int, float]) -> str:
        """Return a note on the set with the least noise beyond its limit that is worthwhile.

        It is empty if there is none.
        """
        better = [k for k in noises if ratios[k] <= WORTHWHILE]
        if not better or not self.must_be_better:
            return ""
        least = min(better, key=lambda k: noises[k])
        gains = ", ".join(f"{name} = {value:.4g}" for name, value in sets[least].items())
        return (
            f"With {number(noises[least], 2)} times today's noise at the actuator (the limit is "
            f"{self.noise_factor:g}), {gains} would lower the {self.aim} by "
            f"{number(100 * (1 - ratios[least]), 2)} %."
        )

    @property
    def certainty(self) -> float:
        """The confidence that proposed gains need: the whole intervals meet the requirements."""
        return (1 + self.level) / 2

    def _at_the_estimate(self, gains: Values) -> tuple[float, set[str], float]:
        """Return objective, exceeded limits and noise of the worst flight, without errors.

        Objective and noise are relative to today's. A limit is named by its row, that of noise by
        `NOISE`.
        """
        ratio = 0.0
        noise = 0.0
        exceeded = set(self._too_far(gains))
        for today in self.todays:
            control = self.laws.linear(gains, today.loops)
            objective, factors = today.at_the_estimate(control)
            ratio = max(ratio, objective)
            for name, factor in factors.items():
                is_noise = name.startswith(NOISE)
                if is_noise:
                    noise = max(noise, factor)
                if not factor <= self._limit(name, float(today.rows[name].values[0])):
                    exceeded.add(NOISE if is_noise else name)
        return ratio, exceeded, noise

    def _too_far(self, gains: Values) -> list[str]:
        """Return a refusal for every gain that changes by more than the limit."""
        far = []
        for name, value in gains.items():
            today = self.laws.today[name]
            if value * today < 0:
                factor = math.inf
            elif value and today:
                factor = abs(value / today)
            else:
                # From or to a gain of zero, there is no factor.
                factor = 1
            if max(factor, 1 / factor) > self.change * (1 + 1e-9):
                far.append(f"changes {name} by more than a factor of {self.change:g}")
        return far

    def _limit(self, name: str, today: float) -> float:
        """Return the largest factor by which a number may get worse; `today` is today's number."""
        if name.startswith(NOISE):
            return self.noise_factor + ROUNDING
        if name.startswith(PEAK) and self.must_be_better:
            return 1 + ROUNDING
        if name == SENSITIVITY and self.must_be_better:
            return max(1.0, 10 ** ((ROBUST - today) / 20)) + ROUNDING
        return math.inf

    def compared(self, gains: Values) -> GainComparison:
        """Return the comparison of gains with today's by all draws, with reasons to refuse them."""
        objectives = []
        changes_of_flights = []
        for today in self.todays:
            control = self.laws.linear(gains, today.loops)
            objective_of_flight, flight_changes = today.changes(control, self.level)
            objectives.append(objective_of_flight)
            changes_of_flights.append(flight_changes)
        [objective] = worst_changes([objectives])
        changes = worst_changes(changes_of_flights)

        refusals = self._too_far(gains)
        if self.must_be_better and not objective.high <= WORTHWHILE:
            less = number(100 * (1 - objective.worsening), 2)
            refusals.append(
                f"lowers the {self.aim} by {less} % only, and at least "
                f"{100 * (1 - WORTHWHILE):.2g} % must be certain"
            )
        for change in changes:
            limit = self._limit(change.name, change.today)
            if change.worsening <= limit and change.high <= limit:
                continue
            if math.isnan(change.high):
                refusals.append(f"has a {change.name} that the data do not determine")
            else:
                factor = number(change.high, 3)
                refusals.append(f"may raise the {change.name} by a factor of {factor}")
        if not self.confidence(gains) >= self.certainty:
            refusals.append(
                f"meets the requirements with less than {100 * self.certainty:.4g} % confidence"
            )
        # The loops of the first flight are for figures, without the plants beside the estimate.
        today = self.todays[0]
        control = self.laws.linear(gains, today.loops)
        drawn = today.loops.of(slice(1 + today.draws))
        return GainComparison(
            gains=dict(gains),
            objective=objective,
            changes=changes,
            refusals=tuple(refusals),
            level=self.level,
            loops=replace(drawn, controller=control),
            today_loops=drawn,
            signal=today.broken_at,
            tracking=today.tracking or (),
            moment=(today.inputs[0], today.responses[0]),
            horizon=today.horizon,
        )

    def flown(self, comparison: GainComparison) -> GainComparison:
        """Return a comparison with simulated flights.

        If these are worse than with today's gains, gains are tried that are nearer to today's: a
        part of the way, in equal steps. If none of them is better, the gains are refused.
        """
        before = self._fly(self.laws.today)
        flights = self._fly(comparison.gains)
        worst = replace(comparison, flights=flights, today_flights=before)
        if not flights.is_worse_than(before):
            return worst
        for step in range(STEPS - 1, 0, -1):
            gains = gains_between(self.laws.today, comparison.gains, step / STEPS)
            nearer = self.compared(gains)
            flights = self._fly(gains)
            if not nearer.refusals and not flights.is_worse_than(before):
                return replace(nearer, flights=flights, today_flights=before)
        reason = "reaches a limit of the control or rings more often in simulated flights"
        return replace(worst, refusals=(reason,))

    def _fly(self, gains: Values) -> FlightCounts:
        """Return the counts of simulated flights with these gains, for the draws of all flights."""
        law = self.laws.with_gains(gains)
        counts = []
        for today in self.todays:
            # The first plant is the estimate.
            draws = slice(1, 1 + min(FLIGHTS, today.draws))
            counts.append(fly(law, today.loops.of(draws), self._test(today)))
        first, *others = counts
        return sum(others, first)

    def _test(self, today: TodaysLoop) -> FlightTest:
        """Return the test: a step of the setpoint, and then a step moment.

        Both take about the same control.
        """
        # Each step has half of the horizon: an oscillation shows within two periods of the
        # crossover.
        samples = min(round(today.horizon / today.loops.period), MOST_SAMPLES)
        name = today.inputs[0]
        steps = {}
        if today.tracking:
            setpoint, response = today.tracking
            omega = np.geomspace(1e-3, 0.9, 200) * math.pi / today.loops.period
            size = float(np.abs(today.loops.first.gains(setpoint, [name], omega)).max())
            # The setpoint of another axis does not move this control.
            if size > 0:
                steps[setpoint] = (self.moment / size, response)
        steps[name] = (self.moment, today.responses[0])
        return FlightTest(samples, steps, self.noise)

    def shelves(self, comparison: GainComparison | None) -> list[str]:
        """Return a note for each set of gains whose rejection bandwidth says little."""
        if comparison is None or comparison.loops is None or comparison.today_loops is None:
            return []
        notes = []
        for label, loops in (
            ("today's gains", comparison.today_loops),
            ("the other gains", comparison.loops),
        ):
            if band := shelf(loops, self.todays[0].broken_at):
                notes.append(
                    f"With {label} |S| lies between -6 and -3 dB from {band[0]:.3g} to "
                    f"{band[1]:.3g} rad/s: the disturbance rejection bandwidth says little."
                )
        return notes
