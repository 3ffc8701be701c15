"""Which of the gains that meet the requirements are proposed, if any.

Begin with `GainSearch`.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
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

COMPARED = 8  # sets that are compared with all draws; later ones differ from these by little
WORTHWHILE = 0.8  # of today's objective: new gains are a risk, which less does not repay
# Peak of the sensitivity, in dB, below which a loop is robust: Astrom and Hagglund (2006), Advanced
# PID Control, section 4.5, recommend maximum sensitivities from 1.4 to 2.
ROBUST = 3.0
STEPS = 3  # in which proposed gains are approached


@frozen
class TunedControllers:
    """The controllers that fly, and which of their gains are tuned.

    Attributes
    ----------
    controllers : tuple of Controller
    today : mapping of gain to float
    places : tuple of (int, str)
        Of each gain, the number of the controller and its own name there.
    """

    controllers: tuple[Controller, ...]
    today: Values
    places: tuple[tuple[int, str], ...]

    def with_gains(self, gains: Values) -> list[Controller]:
        """Return the controllers with other gains."""
        changed = [copy.copy(controller) for controller in self.controllers]
        for (k, own), value in zip(self.places, gains.values(), strict=True):
            law = changed[k]
            law.values = Names({**law.values, own: float(value)}, type(law).__name__)
        return changed

    def linear(self, gains: Values, loops: SampledLoop) -> LinearController:
        """Return the controllers with other gains, linear in the signals of these loops."""
        key = (*gains.values(), loops.sensors, loops.inputs)
        if key not in self._linear:
            law = self.with_gains(gains)
            self._linear[key] = linear_controller(law, loops.sensors, loops.inputs)
        return self._linear[key]

    @cached_property
    def _linear(self) -> dict[tuple[Any, ...], LinearController]:
        """Laws that were made before: differentiation takes as long as the margins of a plant."""
        return {}


def gains_between(today: Values, last: Values, share: float) -> dict[str, float]:
    """Return gains at this share of the way, in equal ratios where both are positive."""
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
    """The search for gains that are better than today's and keep limits.

    Attributes
    ----------
    laws : TunedControllers
    todays : tuple of TodaysLoop
        One for each flight.
    required : tuple of RequiredMargins
        The same flights.
    level : float
    noise_factor, change : float
        Limits of the noise over today's, and of the factor by which a gain changes.
    noise : mapping of signal to float
        Noise of the sensors in simulated flights.
    moment : float
        The step moment in them.
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
        """What the objective is."""
        objective = self.todays[0].objective
        return getattr(objective, "about", getattr(objective, "__name__", "objective"))

    @cached_property
    def today_confidence(self) -> float:
        """The share of draws that meet the requirements with today's gains."""
        return self.confidence(self.laws.today)

    @property
    def must_be_better(self) -> bool:
        """Whether gains are better only with a smaller objective.

        Today's gains are no measure of that if they probably fail the requirements.
        """
        return not self.today_confidence < 0.5

    def confidence(self, gains: Values) -> float:
        """Return the share of draws that meet the requirements, of the flight with the smallest."""
        shares = []
        for flight in self.required:
            shares.append(flight.judged(self.laws.linear(gains, flight.loops))[0])
        # NaN if one is NaN.
        return float(np.min(shares))

    def judged(self, sets: Sequence[Values]) -> tuple[Array, str]:
        """Return the `confidence` of each set, and which flights would measure their crossovers."""
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
    ) -> tuple[Array, GainComparison | None]:
        """Return the objective of the allowed sets over today's, and the comparison of the best.

        The comparison says why a set is refused if none is proposed. It is None if no allowed set
        has a smaller objective.
        """
        allowed = confidence >= self.level
        is_certain = confidence >= self.certainty
        ratios = np.full(len(sets), math.nan)
        keeping = np.zeros(len(sets), dtype=bool)
        for k in np.flatnonzero(allowed):
            ratios[k], keeping[k] = self._at_the_estimate(sets[k])
        if not np.all([np.isfinite(today.target[0]) for today in self.todays]):
            first = np.flatnonzero(allowed)[:1]
            return ratios, self.compared(sets[first[0]]) if first.size else None

        order = [int(k) for k in np.argsort(ratios, kind="stable") if ratios[k] < 1 - ROUNDING]
        if not self.must_be_better:
            order = [int(k) for k in np.argsort(ratios, kind="stable") if allowed[k]]
        candidates = [k for k in order if keeping[k] and is_certain[k]][:COMPARED] or order[:1]
        refused = None
        for k in candidates:
            comparison = self.compared(sets[k])
            if not comparison.refusals:
                return ratios, self.flown(comparison)
            refused = refused or comparison
            if self.must_be_better and ratios[k] > WORTHWHILE:
                break
        return ratios, refused

    @property
    def certainty(self) -> float:
        """The confidence of proposed gains: the whole intervals of the margins are enough."""
        return (1 + self.level) / 2

    def _at_the_estimate(self, gains: Values) -> tuple[float, bool]:
        """Return the objective over today's, and whether the other limits are kept."""
        ratio, keeps = 0.0, not self._too_far(gains)
        for today in self.todays:
            control = self.laws.linear(gains, today.loops)
            objective, factors = today.at_the_estimate(control)
            ratio = max(ratio, objective)
            keeps &= all(
                factor <= self._limit(name, float(today.rows[name].values[0]))
                for name, factor in factors.items()
            )
        return ratio, keeps

    def _too_far(self, gains: Values) -> list[str]:
        """Return which gains change by more than the limit; a gain of zero has no factor."""
        far = []
        for name, value in gains.items():
            today = self.laws.today[name]
            factor = math.inf if value * today < 0 else abs(value / today) if value and today else 1
            if max(factor, 1 / factor) > self.change * (1 + 1e-9):
                far.append(f"changes {name} by more than a factor of {self.change:g}")
        return far

    def _limit(self, name: str, today: float) -> float:
        """Return the largest factor by which a number may get worse, from its value of today."""
        if name.startswith(NOISE):
            return self.noise_factor + ROUNDING
        if name.startswith(PEAK) and self.must_be_better:
            return 1 + ROUNDING
        if name == SENSITIVITY and self.must_be_better:
            return max(1.0, 10 ** ((ROBUST - today) / 20)) + ROUNDING
        return math.inf

    def compared(self, gains: Values) -> GainComparison:
        """Return gains against today's with all draws, and why they are refused, if they are."""
        pairs = []
        for today in self.todays:
            control = self.laws.linear(gains, today.loops)
            pairs.append(today.changes(control, self.level))
        objectives, flights = zip(*pairs, strict=True)
        (objective,), changes = worst_changes([objectives]), worst_changes(flights)

        refusals = self._too_far(gains)
        if self.must_be_better and not objective.high <= WORTHWHILE:
            refusals.append(
                f"lowers the {self.aim} by {number(100 * (1 - objective.worsening), 2)} % only, and "
                f"at least {100 * (1 - WORTHWHILE):.2g} % must be certain"
            )
        for change in changes:
            limit = self._limit(change.name, change.today)
            if not (change.worsening <= limit and change.high <= limit):
                times = number(change.high, 3)
                refusals.append(
                    f"may raise the {change.name} by a factor of {times}"
                    if not math.isnan(change.high)
                    else f"has a {change.name} that the data do not determine"
                )
        if not self.confidence(gains) >= self.certainty:
            refusals.append(
                f"meets the requirements with less than {100 * self.certainty:.4g} % confidence"
            )
        today = self.todays[0]
        control = self.laws.linear(gains, today.loops)
        drawn = today.loops.of(slice(1 + today.draws))
        return GainComparison(
            dict(gains),
            objective,
            changes,
            tuple(refusals),
            self.level,
            loops=replace(drawn, controller=control),
            today_loops=drawn,
            signal=today.broken_at,
            tracking=today.tracking or (),
            moment=(today.inputs[0], today.responses[0]),
            horizon=today.horizon,
        )

    def flown(self, comparison: GainComparison) -> GainComparison:
        """Return a comparison with simulated flights; a part of the way where they are worse."""
        before = self._fly(self.laws.today)
        first = None
        for step in range(STEPS, 0, -1):
            gains = gains_between(self.laws.today, comparison.gains, step / STEPS)
            trial = comparison if step == STEPS else self.compared(gains)
            if trial.refusals:
                continue
            trial = replace(trial, flights=self._fly(gains), today_flights=before)
            if not trial.flights.is_worse_than(before):
                return trial
            first = first or trial
        reason = "reaches a limit of the control or rings more often in simulated flights"
        return replace(first, refusals=(reason,))

    def _fly(self, gains: Values) -> FlightCounts:
        law = self.laws.with_gains(gains)
        counts = [
            fly(law, today.loops.of(slice(1, 1 + FLIGHTS)), self._test(today))
            for today in self.todays
        ]
        return sum(counts[1:], counts[0])

    def _test(self, today: TodaysLoop) -> FlightTest:
        """Return a step of the setpoint and a step moment; the step takes as much control."""
        samples = min(round(2 * today.horizon / today.loops.period), MOST_SAMPLES)
        name = today.inputs[0]
        steps = {}
        if today.tracking:
            setpoint, response = today.tracking
            omega = np.geomspace(1e-3, 0.9, 200) * math.pi / today.loops.period
            size = np.abs(today.loops.first.gains(setpoint, [name], omega)).max()
            steps[setpoint] = (self.moment / float(size), response)
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
