"""Gains of a controller that meet requirements on stability, and are no worse than today's.

Begin with `safe_gains`.
"""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.assessment.response_band import require_level
from greybox.assessment.result import Fit, Fits
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Array, BoolArray, Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.json_numbers import plain
from greybox.data.files.named_values import NOTHING, Values, attributes
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import capitalized, listed
from greybox.data.frequency_band import number_pair
from greybox.modeling.model import require_known
from greybox.workflows.experiment.controller import Controller, Controllers
from greybox.workflows.experiment.drawn_loops import BESIDE, drawn_loops
from greybox.workflows.experiment.gain_comparison import GainComparison
from greybox.workflows.experiment.gain_objectives import Objective
from greybox.workflows.experiment.gain_search import (
    STEPS,
    GainSearch,
    TunedControllers,
    gains_between,
)
from greybox.workflows.experiment.required_margins import required_margins
from greybox.workflows.experiment.todays_loop import todays_loop

POINTS = {1: 41, 2: 17, 3: 9}  # values of each gain, by the number of gains
DRAWS = 256  # of them 5 % are 13

PROMISE = (
    "Promised: the fitted models with their errors meet the requirements. Not promised: structural "
    "modes, vibration that a larger D amplifies, and flight conditions other than those of the "
    "fitted flights."
)


@public
@frozen
class SafeGains(Printed):
    """Sets of gains on a grid, and whether they meet the requirements. It prints its verdict first.

    A set is proposed only if it meets the requirements, makes the objective certainly smaller, and
    keeps the limits on the response to a moment and on noise. Otherwise the answer is to keep
    today's gains.

    Attributes
    ----------
    values : mapping of gain to (n,) array
        The values that were tried; every combination is a set.
    confidence : array (n of the first gain, n of the second ...)
        Share of the draws that meet all requirements at once, for the flight with the smallest
        share; NaN where a flight measured the response poorly at the crossover.
    objective : array
        The objective over that of today's gains, at the estimates: the largest of the flights. NaN
        where the requirements are not met with confidence.
    today : mapping of gain to float
        The gains of the given controller.
    today_confidence : float
    comparison : GainComparison, optional
        The proposed set against today's gains. If none is proposed: the set that was refused
        although it has the smallest objective of those that keep most limits; None if no set that
        meets the requirements has a smaller objective than today's.
    requirements : mapping of name to float
        ``phase margin`` in degrees, ``gain margin`` in dB, ``delay`` in s, ``level``, ``noise`` and
        ``change``, both as factors.
    aim : str
        What the objective is.
    cure : str
        Which flight would measure the response at crossovers where it was measured poorly.
    notes : tuple of str
    """

    values: Mapping[str, Array]
    confidence: Array
    objective: Array
    today: Values
    today_confidence: float
    comparison: GainComparison | None
    requirements: Values
    aim: str
    cure: str
    notes: tuple[str, ...]

    @property
    def allowed(self) -> BoolArray:
        """Which sets meet the requirements with the stated confidence."""
        return self.confidence >= self.requirements["level"]

    @property
    def best(self) -> dict[str, float]:
        """The proposed gains; empty if today's gains are to be kept."""
        if self.comparison and not self.comparison.refusals:
            return dict(self.comparison.gains)
        return {}

    @property
    def steps(self) -> tuple[dict[str, float], ...]:
        """The sets in which `best` is approached, in equal ratios; the last is `best` itself."""
        return tuple(
            gains_between(self.today, self.best, k / STEPS)
            for k in range(1, STEPS + 1)
            if self.best
        )

    @property
    def is_usable(self) -> bool:
        """Whether there is an answer: gains that are proposed, or that today's are to be kept."""
        is_compared = not self.comparison or self.comparison.today_is_stable
        return bool(self.allowed.any()) and is_compared

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        if not self.allowed.any():
            poor = "refused: the response was measured poorly at the crossover."
            further = "Allow a larger change of the gains, or tune others."
            return f"{poor} {self.cure}" if self.cure else f"refused: {self._meeting} {further}"
        comparison = self.comparison
        if comparison and not comparison.today_is_stable:
            return (
                "refused: the loop of today's gains is unstable with the fitted plant, so that no "
                "gains can be compared with them. If they fly, the model or the gains are wrong; "
                "otherwise give gains that stabilize the plant."
            )
        if self.best and comparison:
            chosen = listed([f"{name} = {value:.4g}" for name, value in self.best.items()])
            cause = ", because today's gains miss the required margins" if self.misses else ""
            return f"proposed{cause}: {chosen}; {comparison.sentence}."
        share = 100 * self.requirements["level"]
        fails = self.today_confidence < self.requirements["level"]
        although = f", although they do not meet the requirements with {share:g} % confidence"
        reason = "no other set meets the requirements"
        if comparison:
            reason = f"the best other set {'; it '.join(comparison.refusals)}"
        return f"keep today's gains{although if fails else ''}: {reason}."

    @property
    def misses(self) -> bool:
        """Whether today's gains probably miss the requirements."""
        return self.today_confidence < 0.5

    @property
    def _meeting(self) -> str:
        wanted = self.requirements
        return (
            f"{self.allowed.sum()} of {self.allowed.size} sets of gains have a phase margin of "
            f"{wanted['phase margin']:g} deg and gain margins of {wanted['gain margin']:g} dB with "
            f"{100 * wanted['level']:g} % confidence."
        )

    def renamed(self, names: Sequence[str], notes: Sequence[str] = ()) -> "SafeGains":
        """Return the answer with other names of the gains, such as those of the firmware."""

        def by_name(values: Mapping[str, Any]) -> dict[str, Any]:
            return dict(zip(names, values.values(), strict=True))

        comparison = self.comparison
        if comparison:
            comparison = replace(comparison, gains=by_name(comparison.gains))
        return replace(
            self,
            values=by_name(self.values),
            today=by_name(self.today),
            comparison=comparison,
            notes=(*notes, *self.notes),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; without a proposal, `best` is None."""
        return plain(
            attributes(
                self,
                "verdict",
                "values",
                "confidence",
                "objective",
                "today",
                "today_confidence",
                "requirements",
                "aim",
                "cure",
                "notes",
            )
        ) | {
            "comparison": self.comparison.to_dict() if self.comparison else None,
            "best": self.best or None,
            "steps": [*self.steps],
            "reason": None if self.best else self.verdict,
            "promise": PROMISE,
            "allowed": self.allowed.tolist(),
        }

    def __str__(self) -> str:
        rows = []
        for k, (name, row) in enumerate(self.values.items()):
            used = row[np.moveaxis(self.allowed, k, 0).reshape(len(row), -1).any(axis=1)]
            ends = (used[0], used[-1]) if used.size else (math.nan, math.nan)
            steps = [number(step[name], 3) for step in self.steps] or ["-"]
            rows.append((name, *(number(v, 3) for v in ends), number(self.today[name], 3), *steps))
        header = ["allowed (not all combinations)", "from", "to", "today"]
        header += ["step 1", "step 2", "proposed"] if self.steps else ["proposed"]
        some = f"Some sets were refused: {self.cure}" if self.cure and self.allowed.any() else ""
        at_end = [n for n, value in self.best.items() if value in self.values[n][[0, -1]]]
        wider = f"At an end of the tried range: the proposed {listed(at_end)}." if at_end else ""
        share = number(100 * self.today_confidence, 3)
        today = f"Today's gains meet the requirements with {share} % confidence."
        if math.isnan(self.today_confidence):
            today = "Whether today's gains meet them is not known: their crossover lies there."
        lines = [
            capitalized(self.verdict),
            str(self.comparison) if self.comparison and self.is_usable else "",
            self._meeting if self.allowed.any() else "",
            text_table(header, rows),
            wider,
            some,
            today,
            "Fly the steps one after the other." if self.best else "",
            PROMISE if self.best else "",
            *self.notes,
        ]
        return "\n".join(filter(None, lines))


@public
def safe_gains(  # noqa: PLR0913  (the requirements, and for which loops)
    fits: Fit | Fits,
    controller: Controllers,
    gains: Mapping[str, Interval | None] | Sequence[str],
    *,
    phase_margin: float = 45.0,
    gain_margin: float = 6.0,
    delay: float = 0.0,
    level: float = 0.95,
    broken_at: str = "",
    at: Values | None = None,
    parts: Sequence[int] = (0,),
    objective: Objective | None = None,
    noise_factor: float = 1.5,
    change: float = 2.0,
    noise: Values = NOTHING,
    moment: float = 0.1,
) -> SafeGains:
    """Return which gains meet requirements on the margins, and those that are better than today's.

    A set of gains is allowed if the loops of at least a share `level` of the draws from the
    distribution of the estimates are stable and have all the margins at once, in every flight; and
    if the response was measured well at the crossover: by points within a factor of two of each
    other, with a coherence of 0.6, a random error of 20 %, and within 30 % of the fitted response.
    Otherwise the set is refused, and `SafeGains.cure` says which flight would measure it.

    Of the allowed sets, `SafeGains.best` is the one with the smallest objective: by default the rms
    response to a step moment, over five periods of the crossover of today's loop. A step moment is
    added to an input of the plant that the controllers drive; the response is each signal that they
    measure, but for derivatives of other signals. A set is proposed only if, in every flight,

    - no gain changes by more than the factor `change`;
    - the objective is at most three quarters of today's;
    - the peak response to the step moment is at most today's;
    - the noise at the actuator, the rms of an input from white noise on the samples of each signal
      that the controllers measure, is at most `noise_factor` times today's;
    - the peak of the sensitivity where the loop is broken is at most today's, or 3 dB;
    - of 200 simulated flights no more reach a limit of the control or ring than with today's gains.

    The requirements must then hold with the confidence ``(1 + level) / 2``: the whole intervals of
    the margins meet them. Limits hold at the estimate and in the whole interval of the ratio to
    today's number, over draws of the same plants, for all numbers together with the confidence
    `level`. A ratio that the data do not determine fails. So the more uncertain the plant is, the
    fewer gains are proposed. If today's gains probably fail the requirements, only the limits on
    the change and on noise apply: the set with the smallest objective is proposed. The additional
    `delay` is not in these numbers.

    The simulated flights have draws of the plant, linear as in the margins, and the sampled
    controllers with their limits. A setpoint and then a moment change by a step. If they fail, two
    thirds and one third of the way to the gains are tried.

    Parameters
    ----------
    fits : Fit or several
        Fits of the same vehicle with different batteries, payloads or speeds.
    controller : Controller or several
        With today's gains.
    gains : mapping of gain to (low, high), or names
        One to three parameters of the controllers, as ``"K_P"`` or, if several have it,
        ``"RateController.P"``. Positive ranges are divided in equal ratios. Without a range, or
        with None, today's gain is divided and multiplied by `change`.
    phase_margin : float, degrees
    gain_margin : float, dB
        For larger and for smaller gains.
    delay : float, s
        An additional delay, for effects that were not identified, with which the requirements must
        be met, too.
    level : float
    broken_at : str
        Where the loop is broken, as for `greybox.margins`.
    at : mapping of name to float, optional
        The operating point of an ODE; by default that of each fitted part.
    parts : sequence of int
        The parts of a fit of several problems that are flights of this loop.
    objective : function of a loop, optional
        It returns a number (plants,) for each plant of a `SampledLoop`, smaller ones for better
        gains: ``lambda loop: abs(loop.gains("u", ["theta"], [3.0])[:, 0, 0])`` is the response of
        theta to a moment at 3 rad/s, `greybox.experiment.RejectionBandwidth` is included.
    noise_factor : float
        How many times today's noise at the actuator is accepted.
    change : float
        Largest factor by which a gain may change.
    noise : mapping of signal to float
        Standard deviation of the noise of a measured signal, in the simulated flights.
    moment : float
        Size of the step moment in the simulated flights, in units of the control. The step of the
        setpoint takes as much control.

    Raises
    ------
    ValueError
        For gains that no controller has, ranges that are not increasing, or what `greybox.margins`
        refuses.

    Examples
    --------
    >>> from greybox.models.controller import AttitudeController
    >>> from greybox.problems import sitl_pitch
    >>> fit = gb.fit(sitl_pitch.problem(), starts=3)
    >>> flown = AttitudeController({"K_P": 0.12}, rate=400, signals={"q": "theta_dot"})
    >>> safe = gb.safe_gains(fit, flown, ["K_P"])  # doctest: +SKIP
    >>> safe.best or "keep today's gains"  # doctest: +SKIP
    "keep today's gains"
    """
    require_level(level)
    flights = checked_items("a flight", fits, Fit, "the fit of a flight, or several")
    if not flights or not parts:
        raise ValueError(f"fits={fits!r:.60} and parts={parts!r:.60}: give at least one of both.")
    controllers = checked_items("the controller", controller, Controller, "a controller or several")
    laws = _tuned(controllers, gains)
    today = laws.today
    ranges = gains if isinstance(gains, Mapping) else dict.fromkeys(gains)
    values = {
        name: _divided(name, ranges[name], value, change, POINTS[len(gains)])
        for name, value in today.items()
    }

    wanted = {"phase margin": phase_margin, "gain margin": gain_margin, "delay": delay}
    for name, value in wanted.items():
        if not value >= 0:
            raise ValueError(f"the required {name} is {value:g}: give 0 or more.")
    for name, value in {"noise_factor": noise_factor, "change": change}.items():
        if not value >= 1:
            raise ValueError(f"{name} is {value:g}: give a factor of 1 or more.")

    todays, required = [], []
    for fit, part in itertools.product(flights, parts):
        loops = drawn_loops(fit, controllers, at=at, part=part)
        plants = np.arange(len(loops.A))
        # The estimate, draws, and what the data do not determine.
        some = loops.of(np.r_[plants[: 1 + DRAWS], plants[BESIDE]])
        signal = broken_at or loops.inputs[0]
        todays.append(todays_loop(controllers, some, DRAWS, signal, objective))
        some = loops.of(slice(1 + DRAWS))
        required.append(required_margins(fit, part, some, signal, wanted))

    sets = []
    for row in itertools.product(*values.values()):
        sets.append(dict(zip(today, map(float, row), strict=True)))
    search = GainSearch(
        laws, tuple(todays), tuple(required), level, noise_factor, change, noise, moment
    )
    confidence, cure = search.judged(sets)
    ratios, comparison, offer = search.choose(sets, confidence)
    shape = [*map(len, values.values())]
    notes = [f"The fit warns: {text}" for fit in flights for text in fit.warnings]
    return SafeGains(
        values,
        confidence.reshape(shape),
        ratios.reshape(shape),
        today,
        search.today_confidence,
        comparison,
        wanted | {"level": level, "noise": noise_factor, "change": change},
        search.aim,
        cure,
        (*filter(None, [offer]), *search.shelves(comparison), *notes),
    )


def _tuned(
    controllers: Sequence[Controller], gains: Sequence[str] | Mapping[str, Any]
) -> TunedControllers:
    """Return the controllers with the places of these gains in them."""
    # Gains with the same name have a prefix.
    counts = Counter(name for c in controllers for name in c.parameters)
    owners = {}
    for k, c in enumerate(controllers):
        for name in c.parameters:
            label = name if counts[name] == 1 else f"{type(c).__name__}.{name}"
            owners[label] = (k, name)
    if len(gains) not in POINTS:
        raise ValueError(
            f"{len(gains)} gains were given: give one, two or three of {listed([*owners])}."
        )
    require_known(gains, owners, "gain", "the list of controllers")
    places = tuple(owners[name] for name in gains)
    today = {
        name: float(controllers[k].values[own])
        for name, (k, own) in zip(gains, places, strict=True)
    }
    return TunedControllers(tuple(controllers), today, places)


def _divided(name: str, ends: Interval | None, today: float, change: float, count: int) -> Array:
    if ends is None and not today > 0:
        raise ValueError(f"{name} is {today:g}, which suggests no range: give its range.")
    low, high = number_pair(ends or (today / change, today * change), f"the range of {name}")
    if not -math.inf < low < high < math.inf:
        raise ValueError(f"the range of {name} must be increasing: got {low:g} to {high:g}.")
    return (np.geomspace if low > 0 else np.linspace)(low, high, count)
