"""Formulas as MathML, which browsers draw by themselves."""

import math
from collections.abc import Sequence
from xml.etree.ElementTree import Element

from greybox.files.text_table import greek, index_parts
from greybox.html_report.elements import Child, tag
from greybox.modeling.expression_tree import (
    RELATIONS,
    Expression,
    Factor,
    Function,
    Symbol,
    Term,
    factor,
    number,
)

DIGITS = 5  # of numbers in a formula
E = factor(Symbol("e"))


def formula(left: Child, right: Expression) -> Element:
    """Return the equation ``left = right`` as a block of its own."""
    return tag("math", tag("mrow", left, operator("="), written(right)), display="block")


def symbol(name: str) -> Element:
    """Return a name as a symbol: ``omega_p`` is ω with the index p, ``a1`` is a with index 1."""
    base, indices = index_parts(name)
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


def written(expression: Expression) -> Element:
    """Return a sum, or the only relation in it."""
    match expression:
        case ():
            return tag("mn", "0")
        case (Term(1.0, (Function(name, sides),), ()),) if name in RELATIONS.values():
            return tag("mrow", written(sides[0]), operator(name), written(sides[1]))

    row: list[Element] = []
    for term in expression:
        if row or term.number < 0:
            row.append(operator("−" if term.number < 0 else "+"))
        row.append(_term(term))
    return row[0] if len(row) == 1 else tag("mrow", row)


def _term(term: Term) -> Element:
    """Return the size of a term; its sign belongs to the sum."""
    # Exponentials are mostly delays: beside a fraction they are read as such.
    beside = [
        part
        for part in term.over
        if term.under and isinstance(part, Function) and part.arguments[0] == E
    ]
    above = [part for part in term.over if part not in beside]
    is_number = abs(term.number) != 1 or not above
    numerator = _row([_number(abs(term.number))] if is_number else [], above)
    if not term.under:
        return numerator
    return _row([tag("mfrac", numerator, _row([], term.under))], beside)


def _row(elements: list[Element], factors: Sequence[Factor]) -> Element:
    """Return elements and factors beside one another."""
    match factors:
        case (Function("()", (terms,)),) if not elements:  # nothing to be held together
            return written(terms)
    row = [*elements, *map(_factor, factors)]
    spaced = [child for part in row for child in (tag("mspace", width="0.2em"), part)]
    return row[0] if len(row) == 1 else tag("mrow", spaced[1:])


def _number(value: float) -> Element:
    if not math.isfinite(value):
        return tag("mn", "∞" if math.isinf(value) else "?")
    digits, _, exponent = f"{value:.{DIGITS}g}".partition("e")
    if not exponent:
        return tag("mn", digits)
    ten = tag("msup", tag("mn", "10"), tag("mn", str(int(exponent)).replace("-", "−")))
    return tag("mrow", tag("mn", digits), operator("·"), ten)


def _factor(part: Factor) -> Element:  # noqa: PLR0911  (one return for each kind)
    if isinstance(part, Symbol):
        if not part.delay:
            return symbol(part.name)
        past = parenthesized(tag("mi", "t"), operator("−"), symbol(part.delay))
        return tag("mrow", symbol(part.name), past)

    arguments = [written(argument) for argument in part.arguments]
    match part.name:
        case "^":
            return _power(*part.arguments)
        case "()":
            return parenthesized(*arguments)
        case "abs":
            return tag("mrow", operator("|"), arguments, operator("|"))
        case "if":
            # Iverson's bracket, one while the condition holds and zero otherwise: a brace of cases
            # inside a sum is hard to read.
            bracket = tag("mrow", operator("["), arguments[0], operator("]"))
            value = arguments[1] if len(part.arguments[1]) < 2 else parenthesized(arguments[1])
            return _row([bracket, value], [])
    if part.name in RELATIONS.values():
        return parenthesized(written(factor(part)))
    inside = [child for argument in arguments for child in (operator(","), argument)]
    return tag("mrow", tag("mi", part.name, mathvariant="normal"), parenthesized(*inside[1:]))


def _power(base: Expression, exponent: Expression) -> Element:
    if exponent == number(0.5):
        return tag("msqrt", written(base))
    match base:
        case (Term(1.0, (Symbol(delay=""),), ()),) | (Term(_, (), ()),):
            return tag("msup", written(base), written(exponent))
    return tag("msup", parenthesized(written(base)), written(exponent))


def parenthesized(*children: Element) -> Element:
    """Return elements in parentheses, which are as tall as a fraction in them."""
    # Browsers stretch parentheses around a single letter too, which looks wrong.
    is_tall = any(child.tag == "mfrac" or child.find(".//mfrac") is not None for child in children)
    stretchy = "true" if is_tall else "false"
    return tag(
        "mrow", tag("mo", "(", stretchy=stretchy), *children, tag("mo", ")", stretchy=stretchy)
    )
