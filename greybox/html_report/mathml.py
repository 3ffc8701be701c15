"""Formulas as MathML, which browsers draw by themselves."""

import math
import re
from collections.abc import Sequence
from xml.etree.ElementTree import Element

from greybox.files.text_table import greek
from greybox.html_report.elements import Child, tag
from greybox.modeling.expression_tree import (
    Expression,
    Function,
    Number,
    Power,
    Product,
    Sum,
    Symbol,
)

DIGITS = 5  # of numbers in a formula

RELATIONS = ("<", "≤", "=", "≠", "and", "or")


def formula(left: Child, right: Expression) -> Element:
    """Return the equation ``left = right`` as a block of its own."""
    return tag("math", tag("mrow", left, operator("="), written(right)), display="block")


def symbol(name: str) -> Element:
    """Return a name as a symbol: ``omega_p`` is ω with the index p, ``a1`` is a with index 1."""
    base, *indices = name.strip("_").split("_") if name.strip("_") else [name]
    numbered = re.fullmatch(r"([^\W\d]+)(\d+)", base)
    if numbered:
        base, number = numbered.groups()
        indices = [number, *indices]
    if not indices:
        return tag("mi", greek(base))
    # Upright: an index such as max in K_max is a word and not a product of variables.
    return tag(
        "msub",
        tag("mi", greek(base)),
        tag("mi", ",".join(map(greek, indices)), mathvariant="normal"),
    )


def operator(text: str) -> Element:
    """Return an operator or a parenthesis."""
    return tag("mo", text)


def written(expression: Expression) -> Element:  # noqa: PLR0911  (one return for each kind)
    """Return an expression."""
    match expression:
        case Number(value):
            return _number(value)
        case Symbol(name, delay):
            past = parenthesized(tag("mi", "t"), operator("−"), symbol(delay)) if delay else None
            return tag("mrow", symbol(name), past) if delay else symbol(name)
        case Sum(terms):
            return _sum(terms)
        case Product(over, under):
            return _product(over, under)
        case Power(base, exponent):
            if exponent == Number(0.5):
                return tag("msqrt", written(base))
            is_atom = isinstance(base, Number | Symbol) and not (
                isinstance(base, Symbol) and base.delay
            )
            return tag(
                "msup", written(base) if is_atom else _in_parentheses(base), written(exponent)
            )
        case Function(name, arguments):
            return _function(name, arguments)


def _number(value: float) -> Element:
    if not math.isfinite(value):
        return tag("mn", "∞" if math.isinf(value) else "?")
    digits, _, power = f"{value:.{DIGITS}g}".partition("e")
    if not power:
        return tag("mn", digits)
    ten = tag("msup", tag("mn", "10"), tag("mn", str(int(power)).replace("-", "−")))
    return tag("mrow", tag("mn", digits), operator("·"), ten)


def _sum(terms: Sequence[tuple[int, Expression]]) -> Element:
    row: list[Element] = []
    for sign, term in terms:
        if row or sign < 0:
            row.append(operator("+" if sign > 0 else "−"))
        row.append(_in_parentheses(term) if _is_relation(term) else written(term))
    return tag("mrow", row)


def _product(over: Sequence[Expression], under: Sequence[Expression]) -> Element:
    if not under:
        return _factors(over)
    # Exponentials are mostly delays: beside the fraction they are read as such.
    beside = [factor for factor in over if isinstance(factor, Power) and factor.base == Symbol("e")]
    above = [factor for factor in over if factor not in beside] or [Number(1.0)]
    fraction = tag("mfrac", _factors(above), _factors(under))
    return tag(
        "mrow", fraction, *(part for factor in beside for part in (_space(), written(factor)))
    )


def _factors(factors: Sequence[Expression]) -> Element:
    if len(factors) == 1:
        return written(factors[0])
    row: list[Element] = []
    for k, factor in enumerate(factors):
        if k:
            row.append(operator("·") if isinstance(factor, Number) else _space())
        row.append(
            _in_parentheses(factor)
            if isinstance(factor, Sum) or _is_relation(factor)
            else written(factor)
        )

    return tag("mrow", row)


def _function(name: str, arguments: Sequence[Expression]) -> Element:
    texts = [written(argument) for argument in arguments]
    if name == "sqrt":
        return tag("msqrt", *texts)
    if name == "abs":
        return tag("mrow", operator("|"), *texts, operator("|"))
    # Iverson's bracket, one while the condition holds and zero otherwise: a brace of cases inside a
    # sum is hard to read.
    if name == "if":
        value = _in_parentheses(arguments[1]) if isinstance(arguments[1], Sum) else texts[1]
        return tag("mrow", operator("["), texts[0], operator("]"), _space(), value)
    if name in RELATIONS:
        return tag("mrow", texts[0], operator(name), texts[1])
    inside = [part for text in texts for part in (operator(","), text)]
    return tag("mrow", tag("mi", name, mathvariant="normal"), parenthesized(*inside[1:]))


def _is_relation(expression: Expression) -> bool:
    return isinstance(expression, Function) and expression.name in RELATIONS


def _in_parentheses(expression: Expression) -> Element:
    return parenthesized(written(expression))


def parenthesized(*children: Element) -> Element:
    """Return elements in parentheses, which are as tall as a fraction in them."""
    # Browsers stretch parentheses around a single letter too, which looks wrong.
    is_tall = any(child.tag == "mfrac" or child.find(".//mfrac") is not None for child in children)
    stretchy = "true" if is_tall else "false"
    return tag(
        "mrow", tag("mo", "(", stretchy=stretchy), *children, tag("mo", ")", stretchy=stretchy)
    )


def _space() -> Element:
    return tag("mspace", width="0.2em")
