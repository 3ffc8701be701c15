"""Terms that a model may lack: what each would add to the outputs, to first order.

Records are tried with delays, lags, saturations, offsets, nonlinear terms in the equations of the
states, clock offsets and parameters that change; responses with poles, zeros, delays, modes and
steps of the gain.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.disturbances import Disturbance, DisturbedRecord
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import number
from greybox.modeling.model import Names
from greybox.modeling.state_space import StateSpace

# Time constants of lags, as shares of the time in which the input changes: between its rms and that
# of its derivative. Slower ones are offsets, faster ones look like delays.
LAGS = (0.3, 1.0, 3.0)
LEVELS = (0.2, 0.4, 0.7)  # of saturations and dead zones, over the largest input

Formula = Callable[[Names, Names, Names], Any]


@dataclass(frozen=True, eq=False)
class Term:
    """A term that a model may lack.

    Attributes
    ----------
    family : str
        Terms of one family are one cause: only the best of them is named.
    text, opposite : str
        What it is for a positive and for a negative factor; {} is replaced by the size of the
        factor times `scale`.
    code : str
        How a model gets it.
    scale : float
    """

    family: str
    text: str
    opposite: str
    code: str
    scale: float = 1.0

    def described(self, value: float) -> str:
        """Return what it is for a factor of this value."""
        text = self.text if value > 0 else self.opposite
        return text.format(number(abs(value) * self.scale, 2))


def terms_of_record(
    part: RecordPart, record: DisturbedRecord, candidates: Mapping[str, Formula]
) -> Iterator[tuple[Term, Disturbance]]:
    """Yield the terms that a model may lack, with the disturbances that they are."""
    yield from _of_inputs(part, record)
    yield from _of_outputs(part, record)
    yield from _of_equations(part, record)
    yield from _of_parameters(part)
    yield from _stated(part, record, candidates)


def _of_inputs(part: RecordPart, record: DisturbedRecord) -> Iterator[tuple[Term, Disturbance]]:
    data = part.data
    rows = data.padded([stretch.inputs for stretch in data.stretches], None)
    is_function_of_s = not isinstance(part.problem.model, StateSpace)

    for j, (u, name) in enumerate(zip(rows, part.system.inputs, strict=True)):
        if not np.ptp(u) > 0:
            continue

        def term(
            values: Array, family: str, *texts: str, scale: float = 1.0, place: int = j
        ) -> tuple[Term, Disturbance]:
            text, opposite, code = texts
            named = Term(f"{family} of {part.system.inputs[place]}", text, opposite, code, scale)
            return named, Disturbance("input", place, values)

        rate = _rate(part, u)
        delay = f'delays = {{"{name}": "T_delay"}}'
        if is_function_of_s:
            delay = "response: ... * gb.exp(-s * p.T_delay)"
        held = part.model.between[j].held
        half = part.data.stretches[0].step / 2
        hint = "" if held else f" (held samples look like a delay by {number(half, 2)} s)"
        timing = (f"a delay of {name} by {{}} s{hint}", f"a lead of {name} by {{}} s", delay)
        lag = (
            f"a lag of {name} of {{}} s, one more pole",
            f"a lead of {name} of {{}} s, one more zero",
            f"a state {name}_lag with the derivative (u.{name} - x.{name}_lag) / p.T_lag",
        )
        yield term(-rate, "timing", *timing)
        change = float(np.std(u) / max(np.std(rate), 1e-300))
        for share in LAGS:
            T = share * change
            yield term(_delayed(part, u, T) - u, "timing", *timing, scale=T)
            yield term(_lagged(part, u, T) - u, "lag", *lag, scale=T)
        about = u - np.median(u)
        for share in LEVELS:
            level = share * float(np.abs(about).max())
            size = number(level, 2)
            yield term(
                np.clip(about, -level, level),
                "static curve",
                f"a saturation of {name} near ±{size}",
                f"a dead zone of {name} near ±{size}",
                f"gb.minimum(gb.maximum(u.{name}, -p.limit), p.limit), or u.{name} less that",
            )


def _of_outputs(part: RecordPart, record: DisturbedRecord) -> Iterator[tuple[Term, Disturbance]]:
    outputs = part.simulated_outputs(record.trajectory)
    samples = np.arange(outputs.shape[1])
    inputs = record.inputs()
    for k, (name, y) in enumerate(zip(part.outputs, outputs, strict=True)):
        bias = f'OutputError(biases=["{name}"])'
        text = f"an offset of {name}"
        yield (
            Term(f"offset of {name}", text, text, bias),
            Disturbance("output", k, np.ones(len(y))),
        )
        text = f"a trend of {name}"
        yield (
            Term(f"trend of {name}", text, text, f"subtract the trend of {name}"),
            Disturbance("output", k, samples / len(samples)),
        )
        if len(part.outputs) > 1:
            code = f'late_sensors(model, {{"{name}": "T_{name}"}})'
            yield (
                Term(
                    f"timing of {name}",
                    f"a delay of the sensor of {name} by {{}} s",
                    f"a sensor of {name} that is early by {{}} s",
                    code,
                ),
                Disturbance("output", k, -_rate(part, y)),
            )
        for u, input_name in zip(inputs, part.system.inputs, strict=True):
            text = f"a direct effect of {input_name} on {name}: one more zero"
            code = f"the output {name} gets + p.direct * u.{input_name}"
            yield (
                Term(f"direct effect of {input_name}", text, text, code),
                Disturbance("output", k, u),
            )


def _of_equations(part: RecordPart, record: DisturbedRecord) -> Iterator[tuple[Term, Disturbance]]:
    system, states, inputs = part.system, record.states(), record.inputs()
    if not isinstance(part.problem.model, StateSpace):
        yield from _of_feedback(part, record)
        return

    between = zip(system.inputs, part.model.between, strict=True)
    held = {name: way.held for name, way in between}
    for i, has in _equations(part).items():

        def term(
            values: Array, shape: str, code: str, kind: str = "state", place: int = i
        ) -> tuple[Term, Disturbance]:
            text = f"{shape} in the equation of {system.states[place]}"
            code = f"the derivative of {system.states[place]} gets + p.c * {code}"
            return Term(text, text, text, code), Disturbance(kind, place, values)

        yield term(np.ones(states.shape[1]), "a constant", "1")
        for j, (x, of) in enumerate(zip(states, system.states, strict=True)):
            shapes = _shapes(x, of, f"x.{of}")
            yield from (term(*shape) for shape in shapes if not (of in has and shape[1] == of))
            for other in range(j):
                product = f"{system.states[other]} {of}"
                code = f"x.{system.states[other]} * x.{of}"
                yield term(states[other] * x, product, code)
        for u, name in zip(inputs, system.inputs, strict=True):
            kind = "held state" if held[name] else "state"
            if name not in has:
                yield term(u, name, f"u.{name}", kind)
            for x, of in zip(states, system.states, strict=True):
                yield term(u * x, f"{name} {of}", f"u.{name} * x.{of}", kind)


def _shapes(x: Array, name: str, code: str) -> Iterator[tuple[Array, str, str]]:
    """Yield functions of a signal, their names and their code."""
    yield x, name, code
    yield np.abs(x) * x, f"|{name}| {name}", f"abs({code}) * {code}"
    yield x**3, f"{name}³", f"{code}**3"
    yield x**2, f"{name}²", f"{code}**2"
    yield np.sign(x), f"sign({name})", f"gb.sign({code})"


def _of_feedback(part: RecordPart, record: DisturbedRecord) -> Iterator[tuple[Term, Disturbance]]:
    """Yield functions of the outputs and their rates at the inputs of a transfer function."""
    for name, y in zip(part.outputs, part.simulated_outputs(record.trajectory), strict=True):
        signals = ((y, name, f"x.{name}"), (_rate(part, y), f"d{name}/dt", f"x.{name}_rate"))
        for signal, label, code in signals:
            for values, shape, formula in _shapes(signal, label, code):
                text = f"{shape} fed back to {part.system.inputs[0]}"
                term = Term(text, text, text, f"a StateSpace whose equation gets + p.c * {formula}")
                yield term, Disturbance("input", 0, values)


def _equations(part: RecordPart) -> dict[int, set[str]]:
    """Return the states and inputs with a parameter in the derivative of each state, by its place.

    Derivatives without any parameter or input are kinematic, and left out unless all are.
    """
    system = part.system
    x, u, p = (ca.SX.sym("v", len(n)) for n in (system.states, system.inputs, system.parameters))
    derivative, names = system.derivative(x, u, p), (*system.states, *system.inputs)
    slopes = ca.jacobian(derivative, ca.vertcat(x, u))
    equations = {
        i: {name for k, name in enumerate(names) if ca.depends_on(slopes[i, k], p)}
        for i in range(len(system.states))
        if ca.depends_on(derivative[i], ca.vertcat(u, p))
    }
    return equations or {i: set() for i in range(len(system.states))}


def _of_parameters(part: RecordPart) -> Iterator[tuple[Term, Disturbance]]:
    samples = np.linspace(-0.5, 0.5, part.samples)
    for column, place in enumerate(part.model.active):
        name = part.model.outside_names[place]
        text = f"{name} changes along the record"
        code = f'two records, record[:n] and record[n:], with rename={{"{name}": "{name}_later"}}'
        yield (
            Term(f"{name} over time", text, text, code),
            Disturbance("parameter", column, samples),
        )


def _stated(
    part: RecordPart, record: DisturbedRecord, candidates: Mapping[str, Formula]
) -> Iterator[tuple[Term, Disturbance]]:
    """Yield the candidates of the user, in every equation that has a parameter or an input."""
    system = part.system
    if not candidates:
        return
    x = Names(zip(system.states, record.states(), strict=True))
    u = Names(zip(system.inputs, record.inputs(), strict=True))
    p = Names(zip(part.model.parameters, record.parameters, strict=False))
    for name, formula in candidates.items():
        values = np.broadcast_to(np.asarray(formula(x, u, p), dtype=float), part.samples)
        for i in _equations(part):
            text = f"{name} in the equation of {system.states[i]}"
            code = f"the derivative of {system.states[i]} gets + p.{name} * (its formula)"
            yield Term(text, text, text, code), Disturbance("state", i, values)


def _rate(part: RecordPart, values: Array) -> Array:
    """Return the derivative of a signal (samples,) of all stretches, segments filled up."""
    rates = [
        np.gradient(piece, stretch.step) if len(piece) > 1 else np.zeros(len(piece))
        for piece, stretch in zip(part.data.unpadded(values), part.data.stretches, strict=True)
    ]
    return part.data.padded([rate[None] for rate in rates], None)[0]


def _delayed(part: RecordPart, values: Array, T: float) -> Array:
    """Return a signal that is late by T, which begins at rest."""
    late = []
    for piece, stretch in zip(part.data.unpadded(values), part.data.stretches, strict=True):
        samples = np.arange(len(piece))
        late.append(np.interp(samples - T / stretch.step, samples, piece)[None])
    return part.data.padded(late, None)[0]


def _lagged(part: RecordPart, values: Array, T: float) -> Array:
    """Return a signal behind a lag, which begins at rest."""
    from scipy.signal import lfilter  # noqa: PLC0415  (takes a tenth of a second to import)

    lagged = []
    for piece, stretch in zip(part.data.unpadded(values), part.data.stretches, strict=True):
        a = float(np.exp(-stretch.step / T))
        lagged.append(lfilter([1 - a], [1, -a], piece, zi=[a * piece[0]])[0][None])
    return part.data.padded(lagged, None)[0]


def terms_of_response(part: ResponsePart) -> Iterator[tuple[Term, ComplexArray]]:
    """Yield the terms that the model of a response may lack, as factors (n,) on the response."""
    omega = part.data.omega
    s = 1j * omega
    low, high = float(omega.min()), float(omega.max())
    text = "response: ... "
    yield (
        Term(
            "zero",
            "one more zero",
            "one more zero, in the right half-plane",
            f"{text}* (p.T_zero * s + 1)",
        ),
        s / high,
    )
    for turn in (0.5, 1.0, 2.0):
        T = turn / high
        yield (
            Term(
                "delay",
                "a delay of {} s",
                "a lead of {} s",
                f"{text}* gb.exp(-s * p.T_delay)",
                T,
            ),
            np.exp(-s * T) - 1,
        )
    for a in np.geomspace(low / 2, 2 * high, 9):
        near = number(float(a), 2)
        yield (
            Term(
                "pole",
                f"one more pole near {near} rad/s",
                f"one more zero near {near} rad/s",
                f"{text}/ (p.T_pole * s + 1)",
            ),
            1 / (1 + s / a) - 1,
        )
    for resonance in np.geomspace(low, high, 16):
        denominator = s**2 + 0.1 * resonance * s + resonance**2
        label = f"a lightly damped mode near {number(float(resonance), 2)} rad/s"
        code = f"{text}* (1 + p.mode * s**2 / (s**2 + 2 * p.zeta * p.omega * s + p.omega**2))"
        for numerator in (resonance**2, s * resonance):
            yield Term("mode", label, label, code), numerator / denominator
    edges = np.sqrt(np.unique(omega)[1:] * np.unique(omega)[:-1])
    for edge in edges[:: max(len(edges) // 8, 1)]:
        label = f"a gain that differs above {number(float(edge), 2)} rad/s"
        yield Term("step", label, label, "two responses, response.where(...)"), 1.0 * (omega > edge)
