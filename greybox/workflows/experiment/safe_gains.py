"""Gains of a controller that meet requirements on stability, and are no worse than today's.

Begin with `safe_gains`.
"""

import copy
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.assessment.fitted_part import FittedPart, FittedRecord, FittedResponse
from greybox.assessment.response_band import require_level
from greybox.assessment.result import Fit, Fits
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Array, BoolArray, Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.json_numbers import plain
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, listed
from greybox.data.frequency_band import number_pair
from greybox.data.spectral import spectral_response
from greybox.modeling.formula_arguments import Names
from greybox.modeling.model import require_known
from greybox.workflows.experiment.controller import Controller, Controllers
from greybox.workflows.experiment.drawn_loops import BESIDE, drawn_loops
from greybox.workflows.experiment.gain_comparison import ROUNDING, GainComparison, worst_changes
from greybox.workflows.experiment.loop_numbers import loop_frequencies, margin_numbers
from greybox.workflows.experiment.sampled_loop import SampledLoop, linear_controller
from greybox.workflows.experiment.todays_loop import TodaysLoop, todays_loop

POINTS = {1: 41, 2: 17, 3: 9}  # values of each gain, by the number of gains
DRAWS = 256  # of them 5 % are 13
TRIED = 4.0  # today's gain divided and multiplied by it, where no range is given
FEW = 16  # draws whose poles are computed

# A point is measured well up to these limits of Tischler and Remple (2012), Aircraft and Rotorcraft
# System Identification, sections 7.5 and 9.7: coherence, relative random error.
COHERENCE, RANDOM_ERROR = 0.6, 0.2
SPACING = 2.0  # of the points that surround a crossover

PROMISE = (
    "Promised: the fitted models with their errors meet the requirements. Not promised: structural "
    "modes, saturation, vibration that a larger D amplifies, and flight conditions other than "
    "those of the fitted flights."
)


@frozen
class SafeGains(Printed):
    """Sets of gains on a grid, and whether they meet the requirements. It prints its verdict first.

    A set is proposed only if it meets the requirements, has a higher disturbance rejection
    bandwidth than today's gains, and is not worse than these in any of: the peak of the
    sensitivity, the peak response to a step moment, the noise at the actuator. Otherwise the answer
    is to keep today's gains.

    Attributes
    ----------
    values : mapping of gain to (n,) array
        The values that were tried; every combination is a set.
    confidence : array (n of the first gain, n of the second ...)
        Share of the draws that meet all requirements at once, for the flight with the smallest
        share; NaN where a flight measured the response poorly at the crossover.
    bandwidth : array, rad/s
        The lowest disturbance rejection bandwidth of the estimates; NaN where an estimate does not
        meet the requirements.
    today : mapping of gain to float
        The gains of the given controller.
    today_confidence : float
    today_bandwidth : float, rad/s
    comparison : GainComparison, optional
        The proposed set against today's gains. If none is proposed: the one that was refused
        although it has the highest bandwidth of those that meet the requirements; None if no such
        set has a higher bandwidth than today's gains.
    requirements : mapping of name to float
        ``phase margin`` in degrees, ``gain margin`` in dB, ``delay`` in s, ``level``.
    cure : str
        Which flight would measure the response at crossovers where it was measured poorly.
    notes : tuple of str
    """

    values: Mapping[str, Array]
    confidence: Array
    bandwidth: Array
    today: Values
    today_confidence: float
    today_bandwidth: float
    comparison: GainComparison | None
    requirements: Values
    cure: str
    notes: tuple[str, ...]

    @property
    def allowed(self) -> BoolArray:
        """Which sets meet the requirements with the stated confidence."""
        return self.confidence >= self.requirements["level"]

    @property
    def faster(self) -> BoolArray:
        """Which allowed sets have a higher disturbance rejection bandwidth than today's gains.

        All of them, if the estimate with today's gains does not meet the requirements.
        """
        return self.allowed & ~(self.bandwidth <= self.today_bandwidth * (1 + ROUNDING))

    @property
    def best(self) -> dict[str, float]:
        """The proposed gains; empty if today's gains are to be kept."""
        if self.comparison and not self.comparison.worse:
            return dict(self.comparison.gains)
        return {}

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
            return f"{poor} {self.cure}" if self.cure else self._meeting
        if self.best:
            chosen = listed([f"{name} = {value:.4g}" for name, value in self.best.items()])
            return (
                f"proposed: {chosen}, the highest disturbance rejection bandwidth of the sets that "
                "meet the requirements and are not worse than today's gains."
            )
        if self.comparison and not self.comparison.today_is_stable:
            return (
                "refused: the loop of today's gains is unstable with the fitted plant, so that no "
                "gains can be compared with them. If they fly, the model or the gains are wrong; "
                "otherwise give gains that stabilize the plant."
            )
        share = 100 * self.requirements["level"]
        fails = self.today_confidence < self.requirements["level"]
        although = f", although they do not meet the requirements with {share:g} % confidence"
        keep = f"keep today's gains{although if fails else ''}"
        if not self.comparison:
            best, today = (
                number(value, 3)
                for value in (self.bandwidth[self.allowed].max(), self.today_bandwidth)
            )
            return (
                f"{keep}: no set that meets the requirements has a higher disturbance rejection "
                f"bandwidth ({best} rad/s, {today} today)."
            )
        found = counted(int(self.faster.sum()), "set")
        faster = " and have a higher disturbance rejection bandwidth"
        return (
            f"{keep}: {found} would meet the requirements"
            f"{'' if math.isnan(self.today_bandwidth) else faster}, but none is shown to be as "
            "good in peak |S|, response to a moment and noise."
        )

    @property
    def _meeting(self) -> str:
        wanted = self.requirements
        return (
            f"{self.allowed.sum()} of {self.allowed.size} sets of gains have a phase margin of "
            f"{wanted['phase margin']:g} deg and gain margins of {wanted['gain margin']:g} dB with "
            f"{100 * wanted['level']:g} % confidence."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; without a proposal, `best` is None."""
        fields = plain(self)
        if self.comparison:
            fields["comparison"]["worse"] = [*self.comparison.worse]
        return fields | {
            "verdict": self.verdict,
            "best": self.best or None,
            "reason": None if self.best else self.verdict,
            "promise": PROMISE,
            "allowed": self.allowed.tolist(),
        }

    def __str__(self) -> str:
        rows = []
        for k, (name, row) in enumerate(self.values.items()):
            used = row[np.moveaxis(self.allowed, k, 0).reshape(len(row), -1).any(axis=1)]
            ends = (used[0], used[-1]) if used.size else (math.nan, math.nan)
            chosen = (self.best.get(name, math.nan), self.today[name])
            rows.append((name, *(number(v, 3) for v in (*ends, *chosen))))
        header = ("allowed (not all combinations)", "from", "to", "proposed", "today")
        some = f"Some sets were refused: {self.cure}" if self.cure and self.allowed.any() else ""
        at_end = [n for n, value in self.best.items() if value in self.values[n][[0, -1]]]
        wider = f"At an end of the tried range: the proposed {listed(at_end)}." if at_end else ""
        share = number(100 * self.today_confidence, 3)
        today = f"Today's gains meet the requirements with {share} % confidence."
        if math.isnan(self.today_confidence):
            today = "Whether today's gains meet them is not known: their crossover lies there."
        lines = [
            self.verdict[0].upper() + self.verdict[1:],
            str(self.comparison) if self.comparison and self.is_usable else "",
            self._meeting if self.allowed.any() else "",
            text_table(header, rows),
            wider,
            some,
            today,
            PROMISE if self.best else "",
            *self.notes,
        ]
        return "\n".join(filter(None, lines))


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
) -> SafeGains:
    """Return which gains meet requirements on the margins, and those that are better than today's.

    A set of gains is allowed if the loops of at least a share `level` of the draws from the
    distribution of the estimates are stable and have all the margins at once, in every flight; and
    if the response was measured well at the crossover: by points within a factor of two of each
    other, with a coherence of 0.6, a random error of 20 %, and within 30 % of the fitted response.
    Otherwise the set is refused, and `SafeGains.cure` says which flight would measure it.

    Of the allowed sets, `SafeGains.best` is the one with the highest disturbance rejection
    bandwidth that is not worse than today's gains in

    - the peak of the sensitivity where the loop is broken, |S|;
    - the peak response to a step moment: a step added to an input of the plant that the controllers
      drive. The response is each signal that they measure, but for derivatives of other signals;
    - the noise at the actuator: the rms of the same input from white noise on the samples of each
      signal that the controllers measure.

    A set is not worse if, for each of these numbers, the ratio to that of today's gains is at most
    one at the estimate and in its whole interval, in every flight. The interval has the quantiles
    ``(1 - level) / 2`` and ``(1 + level) / 2`` of the draws, and both numbers of a ratio are those
    of the same drawn plant. A ratio that the data do not determine counts as worse, and so does a
    loop that is unstable with the set. So the more uncertain the plant is, the fewer gains are
    proposed. If no set remains whose bandwidth is higher than today's, nothing is proposed. The
    additional `delay` is not in these numbers.

    Parameters
    ----------
    fits : Fit or several
        Fits of the same vehicle with different batteries, payloads or speeds.
    controller : Controller or several
        With today's gains.
    gains : mapping of gain to (low, high), or names
        One to three parameters of the controllers, as ``"K_P"`` or, if several have it,
        ``"RateController.P"``. Positive ranges are divided in equal ratios. Without a range, or
        with None, a quarter to four times today's gain is tried.
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

    Raises
    ------
    ValueError
        For gains that no controller has, ranges that are not increasing, or what `greybox.margins`
        refuses.
    """
    require_level(level)
    flights = checked_items("a flight", fits, Fit, "the fit of a flight, or several")
    if not flights or not parts:
        raise ValueError(f"fits={fits!r:.60} and parts={parts!r:.60}: give at least one of both.")
    controllers = checked_items("the controller", controller, Controller, "a controller or several")
    # The controller of each gain, and its name; gains with the same name have a prefix.
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
    places = [owners[name] for name in gains]
    today = {name: controllers[k].values[own] for name, (k, own) in zip(gains, places, strict=True)}
    ranges = gains if isinstance(gains, Mapping) else dict.fromkeys(gains)
    values = {
        name: _divided(name, ranges[name], value, POINTS[len(gains)])
        for name, value in today.items()
    }

    laws = []
    for row in (*itertools.product(*values.values()), today.values()):
        law = [copy.copy(c) for c in controllers]
        for (k, own), value in zip(places, row, strict=True):
            law[k].values = Names({**law[k].values, own: float(value)}, type(law[k]).__name__)
        laws.append(law)
    wanted = {"phase margin": phase_margin, "gain margin": gain_margin, "delay": delay}
    for name, value in wanted.items():
        if not value >= 0:
            raise ValueError(f"the required {name} is {value:g}: give 0 or more.")
    flown = [
        (fit, part, drawn_loops(fit, controllers, at=at, part=part))
        for fit in flights
        for part in parts
    ]
    answers = [_judged(fit, part, loops, laws, wanted, broken_at) for fit, part, loops in flown]
    confidences, bandwidths, cures = zip(*answers, strict=True)
    confidence, bandwidth = np.min(confidences, axis=0), np.min(bandwidths, axis=0)
    shape = [*map(len, values.values())]
    safe = SafeGains(
        values,
        confidence[:-1].reshape(shape),
        bandwidth[:-1].reshape(shape),
        today,
        float(confidence[-1]),
        float(bandwidth[-1]),
        None,
        wanted | {"level": level},
        " ".join(filter(None, cures)),
        tuple(f"The fit warns: {text}" for fit in flights for text in fit.warnings),
    )
    todays = []
    for _, _, loops in flown:
        plants = np.arange(len(loops.A))
        # The estimate, as many draws as above, and what the data do not determine.
        some = loops.of(np.r_[plants[: 1 + DRAWS], plants[BESIDE]])
        todays.append(todays_loop(controllers, some, DRAWS, broken_at or loops.inputs[0]))
    return replace(safe, comparison=_comparison(safe, todays, laws, level))


def _comparison(
    safe: SafeGains,
    todays: Sequence[TodaysLoop],
    laws: Sequence[Sequence[Controller]],
    level: float,
) -> GainComparison | None:
    """Return the first of the faster sets, the fastest first, that is not worse than today's gains.

    Otherwise return the fastest one, and None if there is none.
    """
    bandwidth, faster = safe.bandwidth.ravel(), safe.faster.ravel()
    candidates = [int(k) for k in np.argsort(-bandwidth, kind="stable") if faster[k]]
    sets = list(itertools.product(*safe.values.values()))
    fastest = None
    for k in candidates:
        pairs = [(t, linear_controller(laws[k], t.loops.sensors, t.loops.inputs)) for t in todays]
        # The draws take far more time than the estimate.
        if fastest and any(today.is_worse_at_the_estimate(control) for today, control in pairs):
            continue
        comparison = GainComparison(
            dict(zip(safe.values, map(float, sets[k]), strict=True)),
            float(bandwidth[k]),
            safe.today_bandwidth,
            worst_changes([today.changes(control, level) for today, control in pairs]),
            level,
        )
        if not comparison.worse:
            return comparison
        fastest = fastest or comparison
    return fastest


def _divided(name: str, ends: Interval | None, today: float, count: int) -> Array:
    if ends is None and not today > 0:
        raise ValueError(f"{name} is {today:g}, which suggests no range: give its range.")
    low, high = number_pair(ends or (today / TRIED, today * TRIED), f"the range of {name}")
    if not -math.inf < low < high < math.inf:
        raise ValueError(f"the range of {name} must be increasing: got {low:g} to {high:g}.")
    return (np.geomspace if low > 0 else np.linspace)(low, high, count)


def _judged(
    fit: Fit,
    part: int,
    loops: SampledLoop,
    laws: Sequence[Sequence[Controller]],
    wanted: Values,
    broken_at: str,
) -> tuple[Array, Array, str]:
    """Return confidence and bandwidth (sets,) of a flight, and the cure of poor measurements."""
    loops = loops.of(slice(1 + DRAWS))
    signal = broken_at or loops.inputs[0]
    omega = loop_frequencies(loops, 260)  # margins to 0.1 degrees
    late = np.exp(-1j * omega * wanted["delay"])[:, None, None]
    plants = loops.plant_response(omega)
    points, is_good = _measured_points(fit.parts[part], loops)

    def judged(loop: SampledLoop) -> tuple[BoolArray, float, list[float]]:
        """Return which plants meet the requirements, bandwidth and crossovers of the first."""
        plant = plants[: len(loop.A)]
        # A loop becomes unstable only if its gain passes -1, and loops that meet the requirements
        # stay away from it. So the poles of a few draws suffice, which takes a tenth of the time.
        is_stable = np.ones(len(plant), dtype=bool)
        is_stable[:FEW] = loop.of(slice(FEW)).is_stable
        with_and_without = [
            margin_numbers(loop.broken_at(signal, omega, response), omega, period=loop.period)
            for response in ([plant, plant * late] if wanted["delay"] else [plant])
        ]
        # A loop that is stable without the delay is stable for any delay below its delay margin.
        first = with_and_without[0]
        meets = is_stable & (first["delay margin"].value >= wanted["delay"])
        for numbers in with_and_without:
            for name, least in (("phase", "phase"), ("gain", "gain"), ("gain reduction", "gain")):
                meets &= numbers[f"{name} margin"].value >= wanted[f"{least} margin"]
        places = [first[name].first[1] for name in ("phase margin", "crossover")]
        return meets, first["disturbance rejection bandwidth"].first[0], places

    confidence, bandwidth = np.zeros(len(laws)), np.full(len(laws), np.nan)
    poor: list[float] = []
    for k, law in enumerate(laws):
        control = linear_controller(law, loops.sensors, loops.inputs)
        # Where the estimate itself fails, its draws are not tried.
        meets, rejection, places = judged(replace(loops.first, controller=control))
        if meets[0]:
            bandwidth[k] = rejection
            confidence[k] = np.mean(judged(replace(loops, controller=control))[0][1:])
            # A loop without a crossover has it below the lowest frequency, if at all.
            bad = [w for w in places if not _is_between(points, is_good, w)]
            confidence[k] = math.nan if bad else confidence[k]
            poor += [w for w in bad if w > 0]

    if not poor:
        return confidence, bandwidth, ""
    cure = (
        f"In the conditions of {fit.name!r}, fly sines or a sweep from "
        f"{min(poor) / SPACING:.2g} to {max(poor) * SPACING:.2g} rad/s, with a larger amplitude "
        "where the points were noisy."
    )
    return confidence, bandwidth, cure


def _measured_points(part: FittedPart, loops: SampledLoop) -> tuple[Array, BoolArray]:
    """Return the frequencies (n,) of a flight's response, and where it was measured well."""
    nothing = np.zeros(0), np.zeros(0, dtype=bool)
    if isinstance(part, FittedResponse):
        data, fitted = part.data, part.response
    elif isinstance(part, FittedRecord):
        try:
            data = spectral_response(part.data, loops.inputs[0], part.outputs[0])
        except ValueError:  # too short
            return nothing
        place = loops.sensors.index(part.outputs[0])
        fitted = loops.first.plant_response(data.omega)[0, :, place, 0]
    else:
        return nothing

    is_good = np.abs(data.response / fitted - 1) <= 0.3  # 17 degrees
    if data.variance is not None:
        is_good &= data.relative_error <= RANDOM_ERROR
    if data.coherence is not None:
        is_good &= data.coherence >= COHERENCE
    order = np.argsort(data.omega)
    return data.omega[order], is_good[order]


def _is_between(points: Array, is_good: BoolArray, omega: float) -> bool:
    """Return whether good points, not far from each other, lie on both sides of a frequency."""
    k = int(np.searchsorted(points, omega))
    return 0 < k < len(points) and bool(
        is_good[k - 1] and is_good[k] and points[k] <= SPACING * points[k - 1]
    )
