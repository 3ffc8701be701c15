"""The equation of a model, written from its formula."""

from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

import casadi as ca

from greybox.html_report.elements import tag
from greybox.html_report.mathml import formula, operator, parenthesized, symbol
from greybox.modeling.expression_tree import Expression, Symbol, expressions, factor, size
from greybox.modeling.model import Model
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import (
    parameter_names,
    traced,
    traced_derivative,
    traced_output,
)
from greybox.modeling.transfer_function import TransferFunction

LONGEST = 400  # symbols and operations of one equation: about ten lines


def equations(model: Model, values: Mapping[str, float] | None = None) -> list[Element]:
    """Return the equations of a model; `values` replace parameters.

    Raises
    ------
    ValueError
        If its formula cannot be written, or is too long.
    """
    # Beyond ten lines nobody reads a formula; the author's docstring describes such a model.
    lines = list(_lines(model, values or {}))
    longest = max(size(right) for _, right in lines)
    if longest > LONGEST:
        raise ValueError(
            f"{model.label} has an equation of {longest} symbols and operations, too long to read."
        )
    return [formula(variable, right) for variable, right in lines]


def _lines(model: Model, values: Mapping[str, float]) -> Iterator[tuple[Element, Expression]]:
    parameters = {name: ca.SX.sym(name) for name in model.parameters}
    p = ca.vertcat(*parameters.values())
    if isinstance(model, TransferFunction):
        s = ca.SX.sym("s")
        response = ca.SX(
            traced(f"{model.label}.response", model.response, s, parameter_names(model, p))
        )
        (right,) = expressions(response, {"s": s, **parameters}, {}, values)
        yield _ratio(model), right
        return

    assert isinstance(model, StateSpace)
    signals = {name: ca.SX.sym(name) for name in (*model.states, *model.inputs)}
    z = ca.vertcat(*signals.values())
    symbols = {**signals, **parameters}
    if model.states:
        rates = expressions(traced_derivative(model, z, p), symbols, model.delays, values)
        for name, right in zip(model.states, rates, strict=True):
            yield tag("mover", symbol(name), operator("˙"), accent="true"), right

    outputs = expressions(traced_output(model, z, p), symbols, model.delays, values)
    for name, right in zip(model.outputs, outputs, strict=True):
        if right != factor(Symbol(name)):  # a state that is an output needs no line
            yield symbol(name), right


def _ratio(model: TransferFunction) -> Element:
    def of_s(name: str) -> list[Element]:
        return [symbol(name), parenthesized(tag("mi", "s"))]

    return tag("mfrac", tag("mrow", of_s(model.output)), tag("mrow", of_s(model.input)))
