"""Whether an equation lacks a signal, a product, a power or a sign, or a term of the user."""

import itertools
import re
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.assessment.misfit.equations import Equation
from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array
from greybox.modeling.added_terms import Formula
from greybox.modeling.functions import maximum, minimum, tanh

ADDED = Wording(
    "{signal} in the equation of {target}",
    "the derivative of {target} gets + p.new * {code}",
)
STOP = Wording(
    "a stop or an overflow of {signal} near {level} in the equation of {target}",
    "the derivative of {target} gets + p.new * gb.maximum(x.{signal} - p.limit, 0), or gb.minimum",
)
FED_BACK = Wording(
    "{signal} fed back to {target}",
    "a StateSpace whose input {target} gets + p.new * {signal}",
)
# Shares of the samples below stops and overflows, which act seldom.
STOPS = (0.05, 0.15, 0.85, 0.95)
# Where the model is wrong, its signal crosses zero too early or too late, or creeps. Below this
# share of the largest value its sign counts less.
CREEP = 0.2


@dataclass(frozen=True)
class Candidate:
    """A formula that an equation may lack, if it has these signals already."""

    code: str
    signals: Set[str]
    formula: Formula


def nonlinear_terms(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield the formulas that each equation lacks.

    They are functions of the simulated states: measured ones have noise, which must not decide
    whether the model is wrong.
    """
    if not flight.has_equations:
        return

    candidates = [*_candidates(flight)]
    for equation in flight.equations:
        for candidate in candidates:
            is_new = candidate.code not in equation.present
            if is_new and candidate.signals <= equation.signals:
                yield _added(flight, equation, ADDED, candidate)


def stops(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield what acts on a state beyond levels that it seldom passes."""
    if not flight.has_equations:
        return

    for equation in flight.equations:
        for name, values in flight.states.items():
            if name not in equation.signals:
                continue
            for share, level in zip(STOPS, np.quantile(values, STOPS).tolist(), strict=True):
                bound = maximum if share > 0.5 else minimum
                beyond = _of_signal(name, lambda a, level=level, bound=bound: bound(a - level, 0.0))
                candidate = Candidate(name, {name}, beyond)
                yield _added(flight, equation, STOP, candidate, level)


def feedback(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield outputs and their rates fed back to the input of a model without named states."""
    if flight.has_equations:
        return

    for y in flight.outputs:
        for name, values in ((y.name, y.values), (f"{y.name}'", flight.rate(y.values))):
            for code, form in _forms(name, values).items():
                yield RecordTerm(
                    FED_BACK,
                    code,
                    flight.all_inputs[0].name,
                    values=form(values),
                    effect=flight.at_input(0),
                )


def _candidates(flight: TestedRecord) -> Iterator[Candidate]:
    states, inputs = flight.states, [u.name for u in flight.all_inputs]
    for name in (*states, *inputs):
        yield Candidate(name, frozenset(), _of_signal(name, lambda a: a))

    for a, b in itertools.combinations((*states, *inputs), 2):
        if a in states:
            yield Candidate(f"{a} * {b}", {a, b}, _product(a, b))

    for name, values in states.items():
        for code, form in _forms(name, values).items():
            if code != name:
                yield Candidate(code, {name}, _of_signal(name, form))

    for code, formula in flight.candidates.items():
        yield Candidate(code, frozenset(), formula)


def _added(
    flight: TestedRecord,
    equation: Equation,
    wording: Wording,
    candidate: Candidate,
    level: float = 0.0,
) -> RecordTerm:
    """Return the term that adds a formula to an equation."""
    values = np.zeros(flight.part.samples) + candidate.formula(*flight.formula_arguments)
    factors = flight.record.measured_derivatives[:, equation.index].tolist()
    outputs = zip(flight.part.outputs, factors, strict=True)
    return RecordTerm(
        wording,
        candidate.code,
        equation.state,
        level=level,
        values=values,
        effect=flight.at_state(equation.index),
        addition=candidate.formula,
        code=_in_model(flight, candidate.code),
        outputs={name: factor for name, factor in outputs if factor},
    )


def _in_model(flight: TestedRecord, code: str) -> str:
    """Return a formula as a model has it, with `x.` before states."""
    prefixes = {"sign": "gb."}
    prefixes |= dict.fromkeys(flight.states, "x.")
    prefixes |= dict.fromkeys([u.name for u in flight.all_inputs], "u.")
    return re.sub(r"\w+", lambda word: prefixes.get(word[0], "") + word[0], code)


def _of_signal(name: str, form: Callable[[Any], Any]) -> Formula:
    return lambda x, u, p: form((x if name in x else u)[name])


def _product(a: str, b: str) -> Formula:
    return lambda x, u, p: x[a] * (x if b in x else u)[b]


def _forms(name: str, values: Array) -> dict[str, Callable[[Any], Any]]:
    """Return functions of a signal (samples,), also of its symbol, by their code."""
    creep = CREEP * np.abs(values).max() + 1e-300
    return {
        name: lambda a: a,
        f"abs({name}) * {name}": lambda a: abs(a) * a,
        f"{name}**2": lambda a: a**2,
        f"{name}**3": lambda a: a**3,
        f"sign({name})": lambda a: tanh(a / creep),
    }
