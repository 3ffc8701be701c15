"""Margins and closed-loop numbers, with their errors: of a plant with its controllers, or measured.

Begin with `margins`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from greybox.data.frequency_band import number_pair
from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.response_band import require_level
from greybox.estimate.result import Fit
from greybox.experiment.controller import Controller, Controllers
from greybox.experiment.drawn_loops import BESIDE, DRAWN, DRAWS, drawn_loops
from greybox.experiment.loop_numbers import (
    LoopNumbers,
    closed_loop_numbers,
    follows,
    loop_frequencies,
    margin_numbers,
    refined,
)
from greybox.experiment.sampled_loop import DOT, SampledLoop
from greybox.files.argument_checks import require_kind
from greybox.files.arrays import Array, ComplexArray
from greybox.files.frozen_values import frozen
from greybox.files.json_numbers import plain
from greybox.files.named_values import Values, attributes
from greybox.files.numbers_in_text import number
from greybox.files.printed import Printed
from greybox.files.text_table import text_table
from greybox.files.wording import listed
from greybox.modeling.model import Model

UNITS = {
    "phase margin": "deg",
    "gain margin": "dB",
    "gain reduction margin": "dB",
    "delay margin": "s",
    "modulus margin": "",
    "crossover": "rad/s",
    "disturbance rejection bandwidth": "rad/s",
    "disturbance rejection peak": "dB",
    "bandwidth": "rad/s",
    "-180 deg frequency": "rad/s",
    "ADS-33 gain bandwidth": "rad/s",
    "ADS-33 phase bandwidth": "rad/s",
    "ADS-33 bandwidth": "rad/s",
    "phase delay": "s",
    "bandwidth above the boundary": "rad/s",
    "overshoot": "%",
    "rise time": "s",
    "settling time": "s",
    "damping ratio": "",
    "natural frequency": "rad/s",
}
# Noise makes the least distance from -1 too small, and draws from a noisy response make it smaller
# still. So the draws show the bias, and their quantiles are reflected about the value.
LEAST = ("modulus margin", "disturbance rejection peak")

ORDER = "closest_observation"  # of quantiles: interpolation between infinite values is undefined
MAIN = ("phase margin", "gain margin", "delay margin", "crossover")  # of a table of many loops
_INTEGRALS = {"rad": 0, "deg": 0, "rad/s": 1, "deg/s": 1}  # from a response to an attitude


@dataclass(frozen=True)
class Margin:
    """One number of a loop.

    Attributes
    ----------
    name, unit : str
    value : float
        Infinite if no change of this kind makes the loop unstable.
    low, high : float
        Ends of the confidence interval; NaN where there is none.
    omega : float, rad/s
        Where it is found.
    is_extrapolated : bool
        Whether that is outside the frequencies of the fitted data.
    group : str
        The loop or the response that it describes.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    omega: float
    is_extrapolated: bool = False
    group: str = ""


@frozen
class Margins(Printed):
    """The margins of a loop broken at one signal. It prints itself, the verdict first.

    Attributes
    ----------
    plant, signal : str
        The name of the fit or of the model, and where its loop is broken.
    setpoint, response : str
        Input and output of the closed loop.
    margins : tuple of Margin
        Every number, in groups. Empty for a loop that is not stable.
    is_stable : bool
        At the estimate.
    instability : float
        Probability that the loop is unstable, from the errors of the parameters.
        NaN without errors.
    level : float
        NaN without errors.
    loop : SampledLoop
        At the estimate, and at the draws.
    notes : tuple of str
        Why an interval is missing, and what the fit warns of.
    points : tuple of FrequencyResponse
        The same loop as it was measured, for figures.
    """

    plant: str
    signal: str
    setpoint: str
    response: str
    margins: tuple[Margin, ...]
    is_stable: bool
    instability: float
    level: float
    loop: SampledLoop | None
    notes: tuple[str, ...] = ()
    points: tuple[FrequencyResponse, ...] = ()

    def __getitem__(self, name: str) -> Margin:
        """Return a margin by its name, such as "phase margin"."""
        for margin in self.margins:
            if margin.name == name:
                return margin
        raise KeyError(
            f"there is no {name!r}; there are {', '.join(m.name for m in self.margins)}."
        )

    @property
    def is_safe(self) -> bool:
        """Whether the loop is stable, at the estimate and at this level."""
        return self.is_stable and not self.instability > (1 - self.level) / 2

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        loop = f"the loop of {self.plant}{f', broken at {self.signal},' if self.signal else ''}"
        if not self.is_stable:
            return f"{loop} is unstable: no margin exists."
        if not self.is_safe:
            return (
                f"{loop} is unstable with a probability of {100 * self.instability:.1f} %: "
                "the data do not show that it is safe."
            )
        beyond = "; the crossover is extrapolated" if self["crossover"].is_extrapolated else ""
        phase, gain = (_stated(self[name]) for name in MAIN[:2])
        return f"{loop} has {phase} and {gain}{beyond}."

    def require_loop(self) -> SampledLoop:
        """Return the loop; ValueError for margins of a measured response."""
        if self.loop is None:
            raise ValueError(
                f"the margins of {self.plant} are measured, and cannot be evaluated elsewhere: "
                "use those of a model."
            )
        return self.loop

    def uncertainty(self, omega: Array) -> Array:
        """Return the relative error (n,) of the broken loop at `omega` (n,), rad/s.

        It is the radius of the disk around the estimate that holds the share `level` of the draws:
        a multiplicative weight for robust design. NaN without errors.
        """
        gain = self.require_loop().broken_at(self.signal, omega)
        if len(gain) == 1:
            return np.full(len(omega), np.nan)
        return np.quantile(np.abs(gain[DRAWN] / gain[0] - 1), self.level, axis=0)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; None where unknown or infinite."""
        return plain(
            attributes(self, "verdict", "plant", "setpoint", "response", "level", "notes")
            | {
                "broken_at": self.signal,
                "stable": self.is_stable,
                "probability_unstable": self.instability,
                "margins": {m.name: m for m in self.margins},
            }
        )

    def __str__(self) -> str:
        rows, group = [], ""
        for m in self.margins:
            # Every group begins with its name.
            if m.group != group:
                group = m.group
                rows.append((f"{group}:", "", "", "", ""))
            ends = f"{number(m.low, 4)} to {number(m.high, 4)}" if math.isfinite(m.low) else "-"
            place = number(m.omega, 4) + (" *" if m.is_extrapolated else "")
            rows.append((m.name, number(m.value, 4), ends, m.unit, place))
        interval = "" if math.isnan(self.level) else f"{100 * self.level:g} % interval"
        header = ("", "value", interval, "unit", "at rad/s")
        table = [text_table(header, rows)] if rows else []
        return "\n".join([self.verdict[0].upper() + self.verdict[1:], *table, *self.notes])


def margins(  # noqa: PLR0913  (what is in the loop, and where to break it)
    plant: Fit | Model | FrequencyResponse,
    controller: Controllers | None = None,
    values: Values | None = None,
    *,
    broken_at: str = "",
    tracking: tuple[str, str] | None = None,
    at: Values | None = None,
    part: int = 0,
    level: float = 0.95,
    boundary: Sequence[tuple[float, float]] = (),
) -> Margins:
    """Return margins and closed-loop numbers of a plant with sampled controllers, with intervals.

    The loop is that of `virtual_flight`: the controllers run at their rate, the control is held
    until the next sample, and the delay of the plant is exact. The first group of numbers describes
    the loop broken at one signal, with every other loop closed:

    - *phase margin*: the smallest phase, lag or lead, that makes the loop unstable, in degrees;
    - *gain margin* and *gain reduction margin*: the smallest factors above and below one that do,
      at rest and at the Nyquist frequency, too;
    - *delay margin*: the smallest additional delay that does; near a fifth of the rate of the loop
      and above it, a delay of a fraction of a sample changes the gain, too, which is not counted;
    - *modulus margin*: the smallest distance of the loop gain from -1, the inverse of the peak of
      the sensitivity;
    - *crossover*: the highest frequency at which the gain is one;
    - *disturbance rejection bandwidth* and *peak*: where the sensitivity first reaches -3 dB, and
      its largest value;
    - *phase margin 1*, *gain margin 1* ...: at every crossing, if there are several, from the
      lowest frequency up; gain margins within 40 dB, negative for a reduction.

    The second group describes the response to a setpoint, over its value at rest:

    - *bandwidth*: the highest frequency at which it is within 3 dB; *-180 deg frequency*;
    - *ADS-33 gain*, *phase bandwidth* and *phase delay* of the attitude, if the unit of the
      response is that of an angle or of a rate (whose integral is taken), at samples of the
      controller, and *ADS-33 bandwidth*: the smaller one where a rate is commanded, that of the
      phase where an attitude is; *bandwidth above the boundary* is positive inside `boundary`;
    - *overshoot*, *rise time* from 10 % to 90 % and *settling time* to 2 % of a step;
    - *damping ratio* and *natural frequency* of the poles with the largest part in that step.

    The intervals are quantiles over draws from the distribution of the estimates, so they need not
    be symmetric. The draws have Student's t distribution with the covariance of the fit, within the
    bounds of the parameters; of fits of frequency responses, every draw is moved until its
    likelihood agrees with its distance (Chandler and Bate), so that the intervals follow the
    profiles. The intervals cover the errors of the parameters, but not effects that the model
    lacks, such as structural modes. If more than ``(1 - level) / 2`` of the draws are unstable,
    their share is the answer.

    Parameters
    ----------
    plant : Fit, Model or FrequencyResponse
        A model has no errors, and its margins no intervals. A measured response is the gain of the
        broken loop, as `greybox.experiment.broken_loop` makes it; its margins need no model and no
        controller: see `greybox.experiment.measured_margins`.
    controller : Controller or several
        With the gains that fly. The outputs of one may be the setpoints of the next.
    values : mapping of parameter name to float, optional
        Values of the parameters of a model; by default the declared starts.
    broken_at : str
        An input of the plant (the actuator; by default the first), a signal that a controller
        measures (the rate, the attitude), or one that a controller commands.
    tracking : (str, str), optional
        A setpoint and the signal that responds to it; by default the first setpoint of a controller
        and its first input.
    at : mapping of name to float, optional
        The operating point of an ODE; by default that of the fitted part.
    part : int
        Whose model it is, in a fit of several problems.
    level : float
    boundary : sequence of (phase delay, bandwidth), s and rad/s, optional
        Corners of a boundary between levels of handling qualities: the least ADS-33 bandwidth, up
        to the largest phase delay.

    Returns
    -------
    Margins

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is none of these, for values given with a fit, for a plant without a
        controller, and for arguments that a measured response does not take.

    Notes
    -----
    A controller is linearized about its initial state: limits that are not reached have no effect.
    The delay of a model that was fitted to a measured frequency response contains the hold of the
    control, half a sample, unless the record stated this hold; it is not counted again.

    Sources: Franklin, Powell, Workman (1998), Digital Control of Dynamic Systems, section 4.3 (the
    sampled plant) and 7.4 (margins); ADS-33E-PRF (2000), Handling Qualities Requirements for
    Military Rotorcraft, paragraph 3.3.2.1 (bandwidth and phase delay of attitudes); Tischler
    et al. (2017), Practical Methods for Aircraft and Rotorcraft Flight Control Design, section 3.3
    (disturbance rejection); Chandler and Bate (2007), Biometrika 94 (the likelihood ratio).

    Examples
    --------
    >>> from greybox.models.controller import AttitudeController
    >>> from greybox.models.tilt import Tilt
    >>> flown = AttitudeController({"K_P": 0.12}, rate=400, signals={"q": "theta_dot"})
    >>> values = {"a1": -14.6, "a2": 3.0, "a3": 8.5, "a4": 295.0, "a5": 0.16, "T_delay": 0.0042}
    >>> margins = gb.margins(Tilt(), flown, values)  # with intervals if the plant is a fit
    >>> print(f"{margins['phase margin'].value:.0f}°")
    56°
    """
    if isinstance(plant, FrequencyResponse):
        if controller or values or broken_at or tracking or at or part or boundary:
            raise TypeError(
                "a measured response is the broken loop itself: give no argument but the level."
            )
        return measured_margins(plant, level=level)
    if controller is None:
        raise TypeError("a plant has margins only in a loop: give its controller.")
    require_level(level)
    corners = sorted(number_pair(corner, "a corner of the boundary") for corner in boundary)
    loop = drawn_loops(plant, controller, values, at=at, part=part)
    fit, model = (plant, plant.model_of(part)) if isinstance(plant, Fit) else (None, plant)
    controllers = [controller] if isinstance(controller, Controller) else controller
    signal = broken_at or loop.inputs[0]
    if tracking and (isinstance(tracking, str) or len(tracking) != 2):
        raise ValueError(
            f"tracking is {tracking!r}: give two names, a setpoint and the signal that follows it."
        )
    # The first setpoint, and what its controller measures first.
    setpoint, response = tracking or next(
        (
            (c.outside(c.setpoints[0]), c.outside(c.inputs[0]))
            for c in controllers
            if c.setpoints and c.inputs
        ),
        ("", ""),
    )
    unit = _unit(response, model, controllers)
    integrals = _INTEGRALS.get(unit)
    if boundary and integrals is None:
        raise ValueError(
            f"boundary needs an angle or its rate, and {response!r} has the unit {unit!r}: declare "
            "it in `units` of the model or the controller, or leave the boundary out."
        )

    answer = Margins(
        fit.name if fit else model.label,
        signal,
        setpoint,
        response,
        (),
        bool(loop.is_stable[0]),
        1 - float(np.mean(loop.is_stable[DRAWN])) if fit else math.nan,
        level if fit else math.nan,
        loop,
        tuple(f"The fit warns: {warning}" for warning in fit.warnings) if fit else (),
    )
    if not answer.is_stable:
        return answer

    groups: dict[str, LoopNumbers] = {
        f"broken at {signal}": lambda loops, omega: margin_numbers(
            loops.broken_at(signal, omega),
            omega,
            is_stable=loops.is_stable,
            period=loops.period,
        )
    }
    if setpoint and follows(loop, setpoint, response):
        groups[f"{setpoint} to {response}"] = partial(
            closed_loop_numbers,
            setpoint=setpoint,
            response=response,
            integrals=integrals,
            boundary=np.array(corners).T,
        )
    fitted = fit.parts[part] if fit else None
    band = np.sort(fitted.data.omega)[[0, -1]] if isinstance(fitted, FittedResponse) else None
    return _with_rows(answer, groups, band)


def margin_table(answers: Sequence[tuple[str, Margins]]) -> str:
    """Return a table of the main margins of loops with labels, such as operating points."""
    rows = []
    for label, answer in answers:
        numbers = {margin.name: _with_interval(margin) for margin in answer.margins}
        risk = number(100 * answer.instability, 2) if answer.is_stable else "100"
        rows.append((label, answer.signal, *(numbers.get(name, "-") for name in MAIN), risk))
    header = ("", "broken at", *(f"{name}, {UNITS[name]}" for name in MAIN), "unstable, %")
    return text_table(header, rows)


def _with_rows(answer: Margins, groups: Mapping[str, LoopNumbers], band: Array | None) -> Margins:
    """Return an answer with its rows, whose intervals are quantiles over the draws."""
    tail = (1 - answer.level) / 2
    loop = answer.require_loop()
    rows, undetermined, missing = [], [], {}
    for group, numbers in groups.items():
        exact = refined(loop, numbers)
        for name, (value, _) in numbers(loop, loop_frequencies(loop)).items():
            first, omega = exact[name].first
            if math.isnan(first):
                continue
            low = high = math.nan
            drawn = value[DRAWN]
            lacking = np.isnan(drawn).sum() / max(drawn.size, 1)
            if not np.allclose(value[BESIDE], value[0], rtol=1e-3):
                undetermined.append(name)
            elif lacking > tail:
                missing[name] = lacking
            elif answer.instability <= tail:
                # Draws that lack the quantity, such as a crossing, count on both sides.
                low, high = (
                    float(np.quantile(np.where(np.isnan(drawn), end, drawn), share, method=ORDER))
                    for end, share in ((-math.inf, tail), (math.inf, 1 - tail))
                )
            beyond = band is not None and bool(omega < band[0] or omega > band[1])
            unit = UNITS[name.rstrip(" 0123456789")]
            rows.append(Margin(name, unit, first, low, high, omega, beyond, group))

    notes = list(answer.notes)
    if any(row.is_extrapolated for row in rows):
        notes.insert(0, "* outside the frequencies of the fitted data: extrapolated.")
    if undetermined:
        names = listed(undetermined)
        notes.insert(0, f"No interval: the data of the fit do not determine the {names}.")
    if missing:
        share = 100 * max(missing.values())
        notes.insert(0, f"No interval: {share:.2g} % of the draws have no {listed([*missing])}.")
    return replace(answer, margins=tuple(rows), notes=tuple(notes))


def _unit(signal: str, model: Model, controllers: Sequence[Controller]) -> str:
    """Return the declared unit of a signal of the loop; empty if it has none."""
    units = {c.outside(n): u for c in controllers for n, u in c.units.items()} | dict(model.units)
    if signal not in units and signal.endswith(DOT):
        return units.get(signal.removesuffix(DOT), "") + "/s"
    return units.get(signal, "")


def _stated(margin: Margin) -> str:
    if math.isnan(margin.value):
        return f"an unmeasured {margin.name}"
    return f"a {margin.name} of {_with_interval(margin)} {margin.unit}"


def _with_interval(margin: Margin) -> str:
    if not math.isfinite(margin.value):
        return "infinity" if margin.value > 0 else "unknown"
    if not math.isfinite(margin.high - margin.low):
        return number(margin.value, 3)
    return f"{number(margin.value, 3)} ({number(margin.low, 3)} to {number(margin.high, 3)})"


def measured_margins(loop: FrequencyResponse, *, level: float = 0.95) -> Margins:
    """Return the margins of a measured broken loop, with negative feedback.

    They are read between the measured points, where magnitude and phase are straight lines over the
    logarithm of frequency, and never beyond them: a note names the margins that do not occur there.
    The intervals come from draws from the errors of the points, which also correct the bias of the
    modulus margin, and are wider by the error of the interpolation, a third of what leaving out
    every second point changes. The loop is taken as stable, because it flew.

    Parameters
    ----------
    loop : FrequencyResponse
        With a variance, as `broken_loop` and `greybox.spectral` give it; without one, there are no
        intervals.
    level : float

    Returns
    -------
    Margins

    Source: Davison and Hinkley (1997), Bootstrap Methods and their Application, section 5.2 (basic
    intervals).
    """
    require_kind(
        "loop",
        loop,
        FrequencyResponse,
        "the FrequencyResponse of a broken loop; gb.margins takes a fit with its controller",
    )
    require_level(level)
    loop = loop.by_frequency
    points, drawn = np.log(loop.omega), _drawn(loop)
    has_errors = len(drawn) > 1
    gain, omega = _between(points, drawn)
    numbers = margin_numbers(gain, omega)
    fewer = margin_numbers(*_between(points[::2], drawn[:1, ::2]))
    ends = [(1 - level) / 2, 0.5, (1 + level) / 2]
    rows, unmeasured = [], []
    for name, (values, places) in numbers.items():
        value = low = high = place = math.nan
        if values[0] and omega[0] < places[0] < omega[-1]:
            value = values[0]
            if has_errors:
                drawn_ends = np.quantile(values[1:], ends, method=ORDER)
                low, _, high = drawn_ends
                if name in LEAST:
                    high, value, low = 2 * value - drawn_ends
            # Straight lines between twice as distant points are four times as wrong.
            change = abs(fewer[name].value[0] - values[0]) / 3 if name in fewer else 0.0
            error = np.nan_to_num(change, posinf=0)
            value, low, high, place = map(float, (value, low - error, high + error, places[0]))
        else:
            unmeasured.append(name)
        unit = UNITS[name.rstrip(" 0123456789")]
        rows.append(Margin(name, unit, value, low, high, place, group="measured"))

    notes = [] if has_errors else ["No intervals: the response has no variance."]
    if unmeasured:
        notes.append(
            f"The measurement, from {omega[0]:.3g} to {omega[-1]:.3g} rad/s with a loop gain of "
            f"{abs(gain[0, 0]):.2g} to {abs(gain[0, -1]):.2g}, does not reach: "
            f"{listed(unmeasured)}. Fly other frequencies; nothing is extrapolated."
        )
    if "phase margin 2" in numbers:
        notes.append("The gain is one at several frequencies; the smallest margin counts.")
    widest = math.exp(np.diff(points).max(initial=0.0))
    # Sines at 0.6, 1.7 and 4.5 rad/s stay below this ratio.
    if widest > 3.0:
        notes.append(
            f"Neighboring points differ by up to a factor of {number(widest, 2)} in frequency, and "
            "lines are assumed between them: measure more of them near the crossings."
        )
    plant = loop.name or "the measured response"
    # A measured response has no controller and no draws, so those fields are empty.
    level = level if has_errors else math.nan
    return Margins(plant, loop.input, "", "", tuple(rows), True, 0.0, level, None, tuple(notes))


def _drawn(loop: FrequencyResponse) -> ComplexArray:
    """Return the response and draws from its errors (1 + draws, n), none without a variance."""
    if loop.variance is None:
        return loop.response[None]
    random = np.random.default_rng(0)
    errors = random.normal(size=(2, DRAWS, len(loop)))
    if loop.dof is not None:
        errors *= np.sqrt(loop.dof / random.chisquare(loop.dof, errors.shape[1:]))
    size = np.sqrt(loop.variance * loop.independent_share / 2)
    drawn = loop.response + size * (errors[0] + 1j * errors[1])
    if loop.common_errors is not None:
        drawn += random.normal(size=(DRAWS, len(loop.common_errors))) @ loop.common_errors
    return np.vstack([loop.response, drawn])


def _between(points: Array, response: ComplexArray) -> tuple[ComplexArray, Array]:
    """Return gains (m, k) interpolated between points (n,) of log omega, and omega (k,)."""
    x = np.unique([*points, *np.linspace(points[0], points[-1], 300)])
    logarithm = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response), axis=1)
    return np.exp([np.interp(x, points, row) for row in logarithm]), np.exp(x)
