"""Terms that a model may lack.

Records are tried with delays, lags, saturations, rate limits, backlash, nonlinear terms in the
equations of the states, late sensors, and parameters that change; responses with poles, zeros,
delays, modes and steps of the gain.
"""

import itertools
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, IntArray, positive_or_one
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.engine.compiled.disturbances import DisturbedRecord, Effect
from greybox.engine.compiled.record_part import RecordPart
from greybox.modeling.added_terms import Formula
from greybox.modeling.colored_disturbance import undisturbed
from greybox.modeling.formula_arguments import Names
from greybox.modeling.functions import maximum, minimum, tanh
from greybox.modeling.state_space import StateSpace
from greybox.modeling.traced_once import once
from greybox.statistics.column_space import beside

# A term in words, also for a negative factor if that differs, and the code that adds it.
TEXTS = {
    "timing": (
        "a delay of {a} by {size} s",
        "a lead of {a} by {size} s",
        "delays = {{'{a}': 'T_delay'}}, or * gb.exp(-s * p.T_delay); for a lead, {a} moved earlier "
        "in the record, if its clock is late",
    ),
    "hold": (
        "a delay of {a} by {size} s, about half a step, as if it were held between samples",
        "hold={{'{a}': math.inf}} in the record if it is held ('held' after the unit in the header "
        "of a table), or delays = {{'{a}': 'T_delay'}}",
    ),
    "lag": (
        "a lag of {a} by {size} s, one more pole",
        "a state {a}_lag with the derivative (u.{a} - x.{a}_lag) / p.T_lag, in place of u.{a}",
    ),
    "negative lag": (
        "a lead of {a} by {size} s, one more zero",
        "a state {a}_lag with the derivative (u.{a} - x.{a}_lag) / p.T_lag, and "
        "u.{a} + p.new * (u.{a} - x.{a}_lag) in place of u.{a}",
    ),
    "flexible": (
        "a lightly damped mode of {a} near {level} rad/s",
        "a flexible part, or a slow motion such as a phugoid: states of a mass on a spring, which "
        "{a} moves",
    ),
    "curve": (
        "a saturation of {a} near ±{level}",
        "a dead zone of {a} near ±{level}",
        "in place of u.{a}, gb.minimum(gb.maximum(u.{a}, -p.limit), p.limit) for a saturation, or "
        "u.{a} less that for a dead zone",
    ),
    "rate": (
        "a rate limit of {a} near ±{level} per second",
        "a state {a}_moved in place of u.{a}, with the derivative gb.minimum(gb.maximum((u.{a} - "
        "x.{a}_moved) / T_short, -p.limit), p.limit), T_short a few samples",
    ),
    "play": (
        "a backlash of {a} of about {level}",
        "a state {a}_moved in place of u.{a}, with the derivative (gb.maximum(u.{a} - x.{a}_moved "
        "- p.play / 2, 0) + gb.minimum(u.{a} - x.{a}_moved + p.play / 2, 0)) / T_short, a few "
        "samples",
    ),
    "slip": (
        "a delay after {a} that grows along the record, as when rows of {a} are lost",
        "a delay after {a} that shrinks along the record, as when rows of outputs are lost",
        "a record in which all signals have one clock, and NaN where rows are lost",
    ),
    "side": (
        "a gain of {a} that is larger beyond {level}",
        "a gain of {a} that is smaller beyond {level}, as with a saturation of one side",
        "u.{a} + p.new * gb.maximum(u.{a} - p.limit, 0) in place of u.{a}, or gb.minimum below it",
    ),
    "between": (
        "{a} runs in curves between its samples, not in straight lines",
        "{a} at a higher rate, as by scipy.signal.resample, with outputs NaN in between",
    ),
    "gain": (
        "an effect of {a}, whose gain is nearly zero",
        "other starts or wider bounds of the parameters that multiply u.{a}",
    ),
    "direct": (
        "a direct effect of {a} on {b}, one more zero",
        "the output {b} gets + p.direct * u.{a}",
    ),
    "cross": (
        "an effect of {a} on the sensor of {b}",
        "the output {b} gets + p.cross times the output {a}",
    ),
    "sensor": (
        "a sensor of {b} that is late by {size} s",
        "a sensor of {b} that is early by {size} s",
        "a state {b}_late as the output {b}, with the derivative (h - x.{b}_late) / p.T_late for "
        "the present output h; if the sensor is early, move {b} later in the record",
    ),
    "offset": (
        "an offset of {b} by {size}",
        "an offset of {b} by -{size}",
        "the output {b} + p.offset",
    ),
    "constant": (
        "a constant {size} in the equation of {b}",
        "a constant -{size} in the equation of {b}",
        "the derivative of {b} gets + p.new",
    ),
    "load": (
        "a constant {size} in the equation of {b} from {level} s on, such as a load",
        "a constant -{size} in the equation of {b} from {level} s on, such as a load",
        "the derivative of {b} gets + p.load * u.is_loaded, an input that is 1 from {level} s on",
    ),
    "jump": (
        "an offset of {b} by {size} from {level} s on",
        "an offset of {b} by -{size} from {level} s on",
        "two records, {b} with an offset in the second",
    ),
    "input offset": (
        "a constant {size} added to {b}",
        "a constant -{size} added to {b}",
        "a record whose input {b} has this constant added",
    ),
    "input load": (
        "a constant {size} added to {b} from {level} s on, such as a load",
        "a constant -{size} added to {b} from {level} s on, such as a load",
        "a record whose input {b} has this constant added",
    ),
    "equation": (
        "{a} in the equation of {b}",
        "the derivative of {b} gets + p.new * {code}",
    ),
    "limit": (
        "a stop or an overflow of {a} near {level} in the equation of {b}",
        "the derivative of {b} gets + p.new * gb.maximum(x.{a} - p.limit, 0), or gb.minimum",
    ),
    "repeated": (
        "an effect on {b} of unknown form, which repeats with the inputs",
        "",
    ),
    "function": (
        "a function of {a} in the equation of {b}",
        "the derivative of {b} gets a function of x.{a} unlike the terms tried: "
        "gb.plotting.residuals draws it",
    ),
    "feedback function": (
        "a function of {a} fed back to {b}",
        "a StateSpace whose input {b} gets a function of {a} unlike the terms tried: "
        "gb.plotting.residuals draws it",
    ),
    "characteristic": (
        "an input {a} with a curved characteristic",
        "a function of u.{a} in place of it, which gb.plotting.residuals draws",
    ),
    "sensor curve": (
        "a sensor of {b} with a curved characteristic",
        "a function of the output {b} in place of it, which gb.plotting.residuals draws",
    ),
    "sensor scale": (
        "a sensor of {b} whose scale changes along the record",
        "two records, with a factor of the output {b} in the second",
    ),
    "initial": (
        "an initial {b} that is larger by {size} ± {error}",
        "an initial {b} that is smaller by {size} ± {error}",
        "no initial={{'{b}': ...}} in the criterion, which then estimates it",
    ),
    "feedback": (
        "{a} fed back to {b}",
        "a StateSpace whose input {b} gets + p.new * {a}",
    ),
    "change": (
        "{a} changes along the record",
        "two records, rename={{'{a}': '{a}_later'}} for the second",
    ),
    "fixed": (
        "a value of {a} that is larger by {size} ± {error} than its fixed one",
        "a value of {a} that is smaller by {size} ± {error} than its fixed one",
        "free=['{a}'] in the problem, no fixed value of it, and finite bounds in the model",
    ),
    "bound": (
        "a value of {a} that is larger by {size} ± {error} than its bound or constraint allows",
        "a value of {a} that is smaller by {size} ± {error} than its bound or constraint allows",
        "wider bounds or constraints of {a}",
    ),
    "own": (
        "a value of {a} that is larger by {size} ± {error} in '{b}' than elsewhere",
        "a value of {a} that is smaller by {size} ± {error} in '{b}' than elsewhere",
        "rename={{'{a}': '{a}_own'}} in the problem '{b}'",
    ),
    "schedule": (
        "{a} grows with {b}, by {size} ± {error} per unit",
        "{a} falls with {b}, by {size} ± {error} per unit",
        "{b} as an input, and p.{a} + p.{a}_by_{b} * u.{b} in place of p.{a}",
    ),
    "trim": (
        "{a} grows with {b}, by {size} ± {error} per unit",
        "{a} falls with {b}, by {size} ± {error} per unit",
        "p.{a} + p.{a}_by_{b} * x.{b} in place of p.{a}",
    ),
    "delay": (
        "a delay of {size} s",
        "a lead of {size} s",
        "response: * gb.exp(-s * p.T_delay)",
    ),
    "zero": (
        "one more zero",
        "one more zero, in the right half-plane",
        "response: * (p.T_zero * s + 1)",
    ),
    "pole": (
        "one more pole near {level} rad/s",
        "response: / (p.T_pole * s + 1)",
    ),
    "negative pole": (
        "a lead near {level} rad/s, one more zero and one more pole",
        "response: * (p.T_zero * s + 1) / (p.T_pole * s + 1)",
    ),
    "mode": (
        "a lightly damped mode near {level} rad/s",
        "response: * (1 + p.new * s**2 / (s**2 + 2 * p.zeta * p.omega * s + p.omega**2))",
    ),
    "step": (
        "a gain that differs above {level} rad/s",
        "two responses, one below and one above",
    ),
}

# Time constants of lags and delays, over the rms of an input over that of its rate. The first one
# is less than a sample: the effect of the rate alone, which a delay of any size has.
TIMES = (0.001, 0.3, 1.0, 3.0)
# Levels of saturations, dead zones and backlash, over the largest input.
LEVELS = (0.2, 0.4, 0.7)
# Rate limits, over the mean speed of an input: with a lower one, steps are hardly followed, and a
# sine is nowhere faster than 1.6 times the mean. At 0.7 times a limit, backlash explains more.
RATES = np.geomspace(0.5, 2.5, 6)
# Shares of the samples below stops and overflows, which act seldom.
STOPS = (0.05, 0.15, 0.85, 0.95)
JUMPS = (-0.25, 0.0, 0.25)  # of a parameter, over the samples from their middle
# Parts of a record, in each of which the best beginning of a load is looked for, and how many of
# these, the likeliest ones, are simulated: that of all would take a fifth of the test's time.
PARTS, BEGINNINGS = 20, 5
LATER = {"offset": "jump", "constant": "load", "input offset": "input load"}  # kinds of these
KNOTS, FINE = 11, 41  # of functions, and of those of inputs, which an actuator may quantize
# Dampings of modes. With the first alone, a notch of a response with a damping of 0.3 is seen in
# half of the cases, and with both in nine of ten.
DAMPINGS = 0.05, 0.2
# Periods in the record of the slowest modes. They differ from a drift of the errors by following
# the input: of 20 plants with a phugoid, 5 were called wrong without those below five periods.
PERIODS = np.linspace(0.8, 5.0, 6)
LARGE = 10  # states and inputs beyond which an equation is tried with its own alone
SMOOTH = "zero", "delay", "pole"  # kinds of terms of responses that change all of the band


@frozen
class Term:
    """A term that a model may lack.

    Attributes
    ----------
    kind : str
        Key of `TEXTS`. Terms of one kind, and of the same signals `a` and `b`, are one cause.
    values : (n,) array
        The unit term at the samples of a record, or its factor on a response.
    place : function
        Returns the effect on a record of values there, such as in the equation of a state.
    scale : float
        The size of the term is the size of the factor times this.
    largest : float
        Size beyond which the model hardly responds to the signal `a`, which is then the cause.
    half_step : float, s
        Half of the step between samples if nobody states how the input runs between them.
    added : function or None
        The unit term, if it adds to the derivative of the state `b`.
    code : str
        Such a term as a model has it.
    outputs : mapping of str to float
        Outputs that have this derivative in them, such as accelerations, and its factor there.
    shapes : function or None
        Returns what a response may get, relative to it, (n,) each, if it has levels that a fit can
        refine, such as a frequency and a damping.
    levels : tuple of float
        These levels, above zero.
    knots : int
        Number of knots of the function of these values that may be missing, whatever its shape, or
        zero for the values themselves.
    tries : int
        Number of samples from which the residuals chose that of the term.
    count : int
        Number of terms that count as tried with it: of these, it is among the likeliest ones.
    """

    kind: str
    values: Any
    place: Callable[[Array], Effect] | None = None
    a: str = ""
    b: str = ""
    level: float = 0.0
    scale: float = 1.0
    largest: float = np.inf
    half_step: float = np.inf
    added: Formula | None = None
    code: str = ""
    outputs: Values = field(default_factory=dict)
    shapes: Callable[..., Sequence[ComplexArray]] | None = None
    levels: tuple[float, ...] = ()
    knots: int = 0
    tries: int = 1
    count: int = 1

    @property
    def start(self) -> Array:
        """Numbers of the term (q,) in a fit: factors of zero, and logarithms of the levels."""
        factors = self.shapes(*self.levels) if self.shapes else [self.values]
        return np.append(np.zeros(len(factors)), np.log(self.levels))

    def factor(self, numbers: Array) -> ComplexArray:
        """Return the factor (n,) on a response for such numbers."""
        factors, levels = np.split(numbers, [len(numbers) - len(self.levels)])
        shapes = self.shapes(*np.exp(levels)) if self.shapes else [self.values]
        return 1 + factors @ np.array(shapes)

    @property
    def family(self) -> tuple[str, str, str]:
        """The key that terms with one cause have in common."""
        return self.kind, self.a, self.b

    def described(self, factor: float, error: float) -> tuple[str, str]:
        """Return the term in words for a factor with its error, and the code that adds it."""
        kind = "gain" if abs(factor) * self.scale > self.largest else self.kind
        # A delay that is due to a hold is half a step, to first order: it is 3 to 9 % larger with
        # square waves, steps and sweeps, and half as much again where a fitted lag of few steps has
        # taken a part of the delay. Both cures are named.
        if kind == "timing" and abs(factor * self.scale / self.half_step - 1) < 0.6:
            kind = "hold"
        if factor < 0 and f"negative {kind}" in TEXTS:
            kind = f"negative {kind}"
        *texts, code = TEXTS[kind]
        values = {
            **vars(self),
            "level": number(self.level, 2),
            "size": number(abs(factor) * self.scale, 2),
            "error": number(error * self.scale, 2),
        }
        also = [
            f", and so does the output {name}" + f", {factor:.3g} times" * (f"{factor:.3g}" != "1")
            for name, factor in self.outputs.items()
        ]
        text = texts[-1 if factor < 0 else 0]
        return text.format(**values), code.format(**values) + "".join(also)


class Constants(NamedTuple):
    """Terms that act from the beginning of a record, and how outputs (k, c, samples) follow."""

    terms: Sequence[Term]
    effects: Array


def terms_of_record(
    record: DisturbedRecord,
    constants: Constants,
    held: Sequence[str],
    candidates: Mapping[str, Formula],
) -> Iterator[Term]:
    """Yield the terms that the model of a record may lack; `candidates` are the user's.

    Those in equations are functions of the simulated states. Measured ones have noise, which must
    not decide whether the model is wrong.
    """
    part = record.part
    inputs = [*zip(record.inputs, part.system.inputs, part.model.between, strict=True)]
    for j, (u, a, _) in enumerate(inputs):
        if np.ptp(u) > 0:
            yield from _of_input(record, j, u, a)

    for k in range(len(part.outputs)):
        yield from _of_output(record, k, inputs)

    if isinstance(part.problem.model, StateSpace):
        yield from _of_equations(record, candidates)
    else:
        yield from _of_feedback(record)
    yield from _of_loads(record, constants)
    yield from _of_parameters(record, held)


def constants_of_record(record: DisturbedRecord) -> Constants:
    """Return what acts from the beginning of a record."""
    terms = [*_constants(record)]
    return Constants(terms, record.followed_by([(term.place, term.values) for term in terms]))


def _constants(record: DisturbedRecord) -> Iterator[Term]:
    """Yield what acts from the beginning.

    That are errors of known initial states, offsets of the outputs, and constants in the equations,
    or at the input of a model without named states.
    """
    part, ones = record.part, np.ones(record.part.samples)
    # As an impulse that lasts half of the first step.
    impulse = record.by_stretch(lambda row, step: 2 / step * (np.arange(len(row)) == 0), ones)
    for i in np.flatnonzero(part.known_states.any(axis=0)).tolist():
        yield Term("initial", impulse, partial(record.by_state, i), b=part.system.states[i])
    for k, b in enumerate(part.outputs):
        yield Term("offset", ones, partial(record.by_output, k), b=b)
    if isinstance(part.problem.model, StateSpace):
        for i in dynamic_equations(part):
            yield Term("constant", ones, partial(record.by_state, i), b=part.system.states[i])
    else:
        yield Term("input offset", ones, partial(record.by_input, 0), b=part.system.inputs[0])


def signals_of_record(record: DisturbedRecord) -> Mapping[str, Array]:
    """Return the states, inputs with their rates, and the time of a record, (samples,)."""
    part = record.part
    signals = dict(zip(part.system.states, record.states, strict=True))
    for u, a in zip(record.inputs, part.system.inputs, strict=True):
        signals |= {a: u, f"rate of {a}": record.by_stretch(_backward, u)}
    return signals | {"time, s": _time(record)}


def _of_loads(record: DisturbedRecord, constants: Constants) -> Iterator[Term]:
    """Yield constants and offsets from some sample on."""
    time = _time(record)
    for constant, effect in zip(constants.terms, constants.effects.swapaxes(0, 1), strict=True):
        if kind := LATER.get(constant.kind):
            for level in time[_onsets(record, effect)].tolist():
                yield replace(
                    constant,
                    kind=kind,
                    values=1.0 * (time >= level),
                    level=level,
                    tries=1 + len(time) // PARTS,
                    count=PARTS // BEGINNINGS,
                )


def _time(record: DisturbedRecord) -> Array:
    """Return the time of the samples of a record, s."""
    return record.part.data.at_samples(record.part.model.record.time)[0]


def _onsets(record: DisturbedRecord, effect: Array) -> IntArray:
    """Return the likeliest samples at which a constant of this effect (k, samples) may begin.

    From a later sample on, the effect is that from the first one, shifted.
    """
    # Slow errors, an offset and a trend hardly change from sample to sample.
    e, effect = np.diff([record.residuals * record.present, effect], prepend=0)
    n, weight = e.shape[1], 1 / positive_or_one(np.var(e, axis=1, keepdims=True))
    pairs = zip(weight * e, effect, strict=True)
    along = sum(np.correlate(*pair, "full")[n - 1 :] for pair in pairs)
    following = np.cumsum(np.sum(weight * effect**2, axis=0))[::-1]
    # What begins in the last part would be a few samples, which may be outliers.
    parts = np.array_split(np.arange(n), min(PARTS, n))[:-1]
    share = along**2 / (following + 1e-300)
    best = np.array([part[np.argmax(share[part])] for part in parts])
    return np.sort(best[np.argsort(-share[best], kind="stable")[:BEGINNINGS]])


def _along(samples: int) -> list[Array]:
    """Return a slope and jumps along a record, (samples,) each."""
    slope = np.linspace(-0.5, 0.5, samples)
    return [slope, *(1.0 * (slope > share) for share in JUMPS)]


def _of_parameters(record: DisturbedRecord, held: Sequence[str]) -> Iterator[Term]:
    part, log = record.part, record.part.model.record
    ones = np.ones(part.samples)
    # Among several records, one may need different values.
    changes = [("own", ones, part.name), *(("change", row, "") for row in _along(part.samples))]
    # A signal that the model does not use, such as an airspeed, may order the flights, or act.
    motion = np.vstack([record.states, record.inputs, ones]).T
    for b in sorted(log.signals.keys() - {*part.system.inputs, *part.system.outputs}):
        # Noise of a sample may be that of the output: what the signal does, it does later.
        past = record.by_stretch(_delayed, *part.data.at_samples(log[b]), record.step)
        # Another sensor of the motion shows gusts, too, and would look like their cause.
        if np.var(beside(past[:, None], motion)) > np.var(past) / 2:
            changes.append(("schedule", past, b))
            for i in dynamic_equations(part):
                a, place = part.system.states[i], partial(record.by_state, i)
                yield Term("equation", past, place, b, a, code=f"u.{b}, an input")
    gains = {f"K_{state}_{output}" for state, output in part.gains}
    for place, k in enumerate(part.model.active):
        # Gains correct for what the model lacks: a gain is not itself a missing term.
        if part.model.parameters[k] in gains:
            continue
        name, by_parameter = part.model.outside_names[k], partial(record.by_parameter, place)
        for kind, row, b in [("bound", ones, "")] if name in held else changes:
            yield Term(kind, row, by_parameter, name, b)
    for k in range(len(part.system.parameters)):
        if k not in part.model.active:
            by_constant = partial(record.by_constant, k)
            yield Term("fixed", ones, by_constant, part.model.outside_names[k])


def _delays(record: DisturbedRecord, row: Array) -> Iterator[tuple[Array, float]]:
    """Yield what delays of a signal change, and their sizes; leads have negative ones.

    A lead needs later values, which of a signal that a controller moves contain the noise of today.
    """
    times = np.std(row) / (np.std(record.by_stretch(_backward, row)) + 1e-300) * np.array(TIMES)
    for T in (*times, *(-times if all(map(_has_steps, record.inputs)) else ())):
        yield np.sign(T) * (record.by_stretch(_delayed, row, T) - row), T


def _has_steps(u: Array) -> bool:
    """Return whether an input mostly does not change: steps are no response of a controller."""
    return not np.median(np.abs(np.diff(u)))


def _of_input(record: DisturbedRecord, j: int, u: Array, a: str) -> Iterator[Term]:
    step = record.step
    model = record.part.model
    is_unstated = model.criterion.inputs == "record" and a not in model.record.hold
    half_step = step / 2 if is_unstated else np.inf

    by_input = partial(record.by_input, j)

    def term(kind: str, row: Array, level: float = 0.0, scale: float = step) -> Term:
        # Where a gain is nearly zero, only a time longer than the record would explain anything.
        # Terms without a time have a factor with the same limit, in samples: seconds mean little
        # for a tank, and much for a valve.
        return Term(kind, row, by_input, a, "", level, abs(scale), len(u) * step, half_step)

    for row, T in _delays(record, u):
        yield term("timing", row, scale=T)
        yield from (term("slip", row * along, scale=T) for along in _along(len(u)))
        # A shorter lag would change a sample by a rounding error only.
        if step < 9 * T:
            decay = np.exp(-step / T)  # of a lag; the input itself is taken off
            lagged = record.by_stretch(_filtered, u, [-decay, decay], [1, -decay])
            yield term("lag", lagged, scale=T)
    # From a few periods in the record to what the input moves: faster modes look like a delay, and
    # follow the noise that a controller returns. The power of steps is in their differences.
    changes = np.diff(u) if _has_steps(u) else u - u.mean()
    moved = np.cumsum(np.abs(np.fft.rfft(changes)) ** 2)
    fastest = np.clip(np.pi * np.mean(moved < 0.95 * moved[-1]), 0.3, 1.2)
    period = 2 * np.pi / len(u)
    fast = np.geomspace(PERIODS[-1] * period, fastest, 16)
    slow = itertools.product(PERIODS * period, DAMPINGS)
    for angle, damping in (*itertools.product(fast, DAMPINGS[:1]), *slow):
        # The poles of s² + 2 ζ ω s + ω² by Tustin's rule, with ω where it is in the samples.
        w = 2 * float(np.tan(angle / 2))
        poles = [4 + w * (4 * damping + w), 2 * w**2 - 8, 4 + w * (w - 4 * damping)]
        # Filters ω² and ω s over these: a mode is the sum of both.
        for zeros in ([w**2, 2 * w**2, w**2], [2 * w, 0.0, -2 * w]):
            yield term("flexible", record.by_stretch(_filtered, u, zeros, poles), angle / step)
    if not model.between[j].held:
        # Lines through the samples of a sine are smaller by (ωh)²/12, for steps h.
        yield term("between", record.by_stretch(_filtered, u, np.array([-1.0, 2, -1]) / 12, [1.0]))
    yield Term("characteristic", u, by_input, a, knots=FINE)
    about = u - (middle := float(np.median(u)))
    for level in np.mean(np.abs(record.by_stretch(_backward, u))) * RATES:
        yield term("rate", record.by_stretch(_followed, u, level * step, True), level)
    for level in np.abs(about).max() * np.array(LEVELS):
        yield term("play", record.by_stretch(_followed, u, level / 2, False), level)
        yield term("curve", np.clip(about, -level, level), level)
        yield term("side", np.maximum(about, level), middle + level)
        yield term("side", np.minimum(about, -level), middle - level)


def _of_output(
    record: DisturbedRecord, k: int, inputs: Sequence[tuple[Array, str, Any]]
) -> Iterator[Term]:
    outputs = [*zip(record.outputs, record.part.outputs, strict=True)]
    (y, b), by_output = outputs[k], partial(record.by_output, k)
    yield Term("sensor curve", y, by_output, b=b, knots=KNOTS)
    for power in (2, 3):
        yield Term("sensor curve", (y - np.mean(y)) ** power, by_output, b=b)
    # From each sample on, the errors along the output and its squares: a jump of its scale is
    # where the errors show it best, but for the last part.
    along, squares = np.cumsum((y * [record.residuals[k], y])[:, ::-1], axis=1)[:, ::-1]
    later = np.arange(len(y)) >= np.argmax((along**2 / (squares + 1e-300))[: -len(y) // PARTS])
    yield Term("sensor scale", y * later, by_output, b=b, tries=len(y))
    for row, T in _delays(record, y) if len(outputs) > 1 else ():
        # The error of a sample corrects the later outputs of a predictor.
        if T > 0 or not record.is_predicted:
            yield Term("sensor", row, by_output, b=b, scale=abs(T))
    yield from (Term("cross", row, by_output, a, b) for row, a in outputs if a != b)
    for u, a, between in inputs:
        # A controller responds at once: the noise of a sample is in the input at the same time.
        yield Term("direct", record.by_stretch(_delayed, u, record.step), by_output, a, b)
        if between.held and _has_steps(u):
            yield Term("direct", u, by_output, a, b)


def _of_feedback(record: DisturbedRecord) -> Iterator[Term]:
    by_input, name = partial(record.by_input, 0), record.part.system.inputs[0]
    for y, b in zip(record.outputs, record.part.outputs, strict=True):
        for signal, row in ((b, y), (f"{b}'", record.by_stretch(_backward, y))):
            yield Term("feedback function", row, by_input, signal, name, knots=KNOTS)
            for a, form in _forms(signal, row).items():
                yield Term("feedback", form(row), by_input, a, name)


def _of_equations(record: DisturbedRecord, candidates: Mapping[str, Formula]) -> Iterator[Term]:
    system = record.part.system
    x = dict(zip(system.states, record.states, strict=True))
    u = dict(zip(system.inputs, record.inputs, strict=True))
    p = dict(zip(record.part.model.parameters, record.parameters, strict=True))
    signals = (Names(x), Names(u), Names(p))

    prefixes = {**dict.fromkeys(x, "x."), **dict.fromkeys(u, "u."), "sign": "gb."}

    # Functions by their code, with the signals that an equation must have for them.
    formulas = {name: (set[str](), _formula(lambda a: a, name)) for name in (*x, *u)}
    for a, b in itertools.combinations((*x, *u), 2):
        if a in x:
            formulas[f"{a} * {b}"] = ({a, b}, _formula(operator.mul, a, b))
    for name, row in x.items():
        for text, form in _forms(name, row).items():
            formulas.setdefault(text, ({name}, _formula(form, name)))
    formulas |= {text: (set(), formula) for text, formula in candidates.items()}

    for i, (names, present) in dynamic_equations(record.part).items():
        b, by_state = system.states[i], partial(record.by_state, i)
        factors = zip(record.part.outputs, record.measured_derivatives[:, i].tolist(), strict=True)
        outputs = {name: factor for name, factor in factors if factor}
        for a, (needed, formula) in formulas.items():
            if needed <= names and a not in present:
                row = np.zeros(record.part.samples) + formula(*signals)
                code = re.sub(r"\w+", lambda word: prefixes.get(word[0], "") + word[0], a)
                yield Term(
                    "equation", row, by_state, a, b, added=formula, code=code, outputs=outputs
                )
        for a in [name for name in x if name in names]:
            yield Term("function", x[a], by_state, a, b, knots=KNOTS)
            for share, level in zip(STOPS, np.quantile(x[a], STOPS).tolist(), strict=True):
                bound = maximum if share > 0.5 else minimum
                formula = _formula(lambda a, level=level, bound=bound: bound(a - level, 0.0), a)
                row = formula(*signals)
                yield Term("limit", row, by_state, a, b, level, added=formula, outputs=outputs)


def _formula(form: Callable[..., Any], *names: str) -> Formula:
    """Return a function of these states and inputs as a term of a model."""
    return lambda x, u, p: form(*((x if name in x else u)[name] for name in names))


def _forms(name: str, row: Array) -> dict[str, Callable[[Any], Any]]:
    """Return functions of a signal (samples,), also of its symbol, by their code."""
    # Where the model is wrong, its signal crosses zero too early or too late, or creeps.
    # Below a fifth of the largest value its sign counts less.
    creep = 0.2 * np.abs(row).max() + 1e-300
    return {
        name: lambda a: a,
        f"abs({name}) * {name}": lambda a: abs(a) * a,
        f"{name}**2": lambda a: a**2,
        f"{name}**3": lambda a: a**3,
        f"sign({name})": lambda a: tanh(a / creep),
    }


@once  # of constants, of other terms, and of a warning
def dynamic_equations(part: RecordPart) -> dict[int, tuple[frozenset[str], set[str]]]:
    """Return the signals in the derivative of each state by its place, and those with a parameter.

    Signals are states and inputs; in a small model all of them count as being in every derivative.
    Derivatives without any parameter or input are kinematic, and left out unless all are; those of
    colored disturbances are left out, too.
    """
    system = part.system
    x, u, p = system.symbols
    derivative, names = system.derivative(x, u, p), (*system.states, *system.inputs)
    slopes = ca.jacobian(derivative, ca.vertcat(x, u))
    model = undisturbed(part.problem.model)
    own = range(len(model.state_names) or len(system.states))
    dynamic = [i for i in own if ca.depends_on(derivative[i], ca.vertcat(u, p))]

    # With twenty states, the products of all pairs in all equations are thousands of terms, among
    # which a true one is not found.
    present = slopes.sparsity()
    return {
        i: (
            frozenset(
                n for k, n in enumerate(names) if len(names) <= LARGE or present.has_nz(i, k)
            ),
            {n for k, n in enumerate(names) if ca.depends_on(slopes[i, k], p)},
        )
        for i in dynamic or own
    }


def _backward(piece: Array, step: float) -> Array:
    """Return the rate without later values, which may respond to the present noise."""
    return np.diff(piece, prepend=piece[0]) / step


def _delayed(piece: Array, step: float, T: float) -> Array:
    samples = np.arange(len(piece))
    return np.interp(samples - T / step, samples, piece)


def _followed(piece: Array, step: float, reach: float, is_slow: bool) -> Array:
    """Return the lag of what follows a signal by `reach` a sample, or with such a play."""
    y, moved = float(piece[0]), []
    for u in piece.tolist():
        a, b = (u, y) if is_slow else (y, u)
        # The functions `min` and `max` take three times as long.
        y = b + reach if a > b + reach else b - reach if a < b - reach else a
        moved.append(y)
    return np.array(moved) - piece


def _filtered(piece: Array, step: float, b: Any, a: Any) -> Array:
    # As `scipy.signal.lfilter`, which takes a third of a second to import.
    from scipy.linalg import get_blas_funcs  # noqa: PLC0415  (see `greybox.engine.compiled.condensing`)

    moved = np.convolve(piece - piece[0], b)[: len(piece)]
    bands = np.repeat(np.array(a)[:, None], len(piece), axis=1)
    (tbsv,) = get_blas_funcs(("tbsv",), (bands,))
    return tbsv(len(a) - 1, bands, moved, lower=1)


# What a response gets at s (n,), relative to it, with levels that a fit can refine.
SHAPES = {
    "delay": lambda s, T: [np.exp(-s * T) - 1],
    "pole": lambda s, a: [1 / (1 + s / a) - 1],
    "mode": lambda s, w, z: [b / (s**2 + 2 * z * w * s + w**2) for b in (w**2, s * w)],
}


@lru_cache(4)  # responses of a study mostly have the same frequencies
def terms_of_response(*omega: float) -> tuple[Term, ...]:
    """Return the terms that the model of a response at these frequencies may lack."""
    at, low, high = np.array(omega), min(omega), max(omega)
    s = 1j * at

    # A delay in the model absorbs the phase of a zero.
    terms = [Term("zero", s / high), Term("zero", np.abs(1 + s / high) - 1)]
    tried = [
        *(("delay", (T,)) for T in np.array([0.5, 1.0, 2.0]) / high),
        *(("pole", (a,)) for a in np.geomspace(low / 2, 2 * high, 9)),
        *(("mode", pair) for pair in itertools.product(np.geomspace(low, high, 16), DAMPINGS)),
    ]
    for kind, levels in tried:
        shapes = partial(SHAPES[kind], s)
        terms += [
            Term(kind, shape, level=levels[0], scale=levels[0], shapes=shapes, levels=levels)
            for shape in shapes(*levels)
        ]
    edges = np.sqrt(at[1:] * at[:-1])
    # With a step at a wrong point, errors would look correlated.
    steps = edges[:: max(len(edges) // 32, 1)]
    return *terms, *(Term("step", 1.0 * (at > edge), level=edge) for edge in steps)
