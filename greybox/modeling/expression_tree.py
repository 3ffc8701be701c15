"""A formula as a tree of sums, products, powers and functions, as written on paper."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from greybox.modeling.formula_structure import walk


@dataclass(frozen=True)
class Number:
    """A constant."""

    value: float


@dataclass(frozen=True)
class Symbol:
    """A parameter or a signal by its name; `delay` is the name of its delay."""

    name: str
    delay: str = ""


@dataclass(frozen=True)
class Sum:
    """Terms, each with its sign, 1 or -1."""

    terms: tuple[tuple[int, "Expression"], ...]


@dataclass(frozen=True)
class Product:
    """Factors over factors; an empty product is one."""

    over: tuple["Expression", ...]
    under: tuple["Expression", ...] = ()


@dataclass(frozen=True)
class Power:
    """A base with an exponent."""

    base: "Expression"
    exponent: "Expression"


@dataclass(frozen=True)
class Function:
    """A function such as ``sin`` of its arguments, or a relation such as ``<`` of its sides.

    ``if`` has a condition and the value while it holds; it is zero otherwise.
    """

    name: str
    arguments: tuple["Expression", ...]


Expression = Number | Symbol | Sum | Product | Power | Function

RELATIONS = {
    ca.OP_LT: "<",
    ca.OP_LE: "≤",
    ca.OP_EQ: "=",
    ca.OP_NE: "≠",
    ca.OP_AND: "and",
    ca.OP_OR: "or",
}
FUNCTIONS = {
    ca.OP_LOG: "ln",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "arcsin",
    ca.OP_ACOS: "arccos",
    ca.OP_ATAN: "arctan",
    ca.OP_ATAN2: "arctan2",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "arsinh",
    ca.OP_ACOSH: "arcosh",
    ca.OP_ATANH: "artanh",
    ca.OP_ERF: "erf",
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "abs",
    ca.OP_SIGN: "sign",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMIN: "min",
    ca.OP_FMAX: "max",
    ca.OP_FMOD: "mod",
    ca.OP_NOT: "not",
    ca.OP_IF_ELSE_ZERO: "if",
    **RELATIONS,
}


def expressions(
    formula: ca.SX,
    symbols: Mapping[str, ca.SX],
    delays: Mapping[str, str],
    values: Mapping[str, float] = MappingProxyType({}),
) -> list[Expression]:
    """Return every entry of `formula` (k, 1) as a tree.

    `symbols` are those of the formula by name, `delays` the names of their delays, and `values`
    numbers in place of symbols.

    Raises
    ------
    ValueError
        For an operation without a notation.
    """
    # Traced with numbers, products would be multiplied out: they replace the leaves instead.
    leaves: list[Any] = [
        _number(values[name]) if name in values else Symbol(name, delays.get(name, ""))
        for name in symbols
    ]
    return walk(
        formula,
        ca.vertcat(*symbols.values()),
        leaves,
        lambda constant: _number(float(constant)),
        _operate,
    )


def size(expression: Expression) -> int:
    """Return the number of written symbols, numbers and operations."""
    # Repeated expressions are one object: without this table, time would grow exponentially.
    sizes: dict[int, int] = {}

    def count(part: Expression) -> int:
        if id(part) not in sizes:
            sizes[id(part)] = 1 + sum(map(count, _parts(part)))
        return sizes[id(part)]

    return count(expression)


def _parts(expression: Expression) -> Sequence[Expression]:
    match expression:
        case Sum(terms):
            return [term for _, term in terms]
        case Product(over, under):
            return (*over, *under)
        case Power(base, exponent):
            return (base, exponent)
        case Function(_, arguments):
            return arguments

    return ()


def _operate(operation: int, terms: list[Expression]) -> Expression:
    if operation in ARITHMETIC:
        return ARITHMETIC[operation](*terms)
    if operation not in FUNCTIONS:
        raise ValueError(f"the operation {operation} of CasADi has no notation.")
    return Function(FUNCTIONS[operation], tuple(terms))


def _number(value: float) -> Expression:
    # The sign belongs to a sum, so that a - 2 is not written a + (-2).
    return Sum(((-1, Number(-value)),)) if value < 0 and not math.isnan(value) else Number(value)


def _sum(*terms: tuple[int, Expression]) -> Expression:
    """Return a sum without sums in it, and without zeros."""
    flat: list[tuple[int, Expression]] = []
    for sign, term in terms:
        inner = term.terms if isinstance(term, Sum) else ((1, term),)
        flat += [(sign * inner_sign, part) for inner_sign, part in inner if part != Number(0.0)]
    if len(flat) == 1 and flat[0][0] == 1:
        return flat[0][1]
    return Sum(tuple(flat)) if flat else Number(0.0)


def _product(over: Sequence[Expression], under: Sequence[Expression]) -> Expression:
    """Return a flat product: the sign outside, then one number, then the other factors."""
    number = 1.0
    above: list[Expression] = []
    below: list[Expression] = []
    for factor, is_over in (*((f, True) for f in over), *((f, False) for f in under)):
        inner = factor
        if isinstance(factor, Sum) and len(factor.terms) == 1:
            number *= factor.terms[0][0]
            inner = factor.terms[0][1]
        parts = (inner.over, inner.under) if isinstance(inner, Product) else ((inner,), ())
        above.extend(parts[not is_over])
        below.extend(parts[is_over])

    # As in CasADi, a division by zero gives infinity or NaN, not an exception.
    with np.errstate(divide="ignore", invalid="ignore"):
        number = float(np.divide(number * _numbers(above), _numbers(below)))
    if number == 0:
        return Number(0.0)

    above, below = _powers(above), _powers(below)
    if abs(number) != 1 or not above:
        above.insert(0, Number(abs(number)))
    product = Product(tuple(above), tuple(below)) if below or len(above) > 1 else above[0]
    return Sum(((-1, product),)) if number < 0 else product


def _powers(factors: Sequence[Expression]) -> list[Expression]:
    """Return the factors that are not numbers; powers of one symbol, as s · s², are combined."""
    exponents: dict[Expression, float] = {}
    bases: list[Expression] = []
    for factor in factors:
        base, exponent = (
            (factor.base, factor.exponent) if isinstance(factor, Power) else (factor, Number(1.0))
        )
        if isinstance(base, Symbol) and isinstance(exponent, Number):
            if base not in exponents:
                bases.append(base)
            exponents[base] = exponents.get(base, 0.0) + exponent.value
        elif not isinstance(factor, Number):
            bases.append(factor)

    return [
        Power(factor, Number(exponents[factor]))
        if isinstance(factor, Symbol) and exponents[factor] != 1
        else factor
        for factor in bases
    ]


def _numbers(factors: Sequence[Expression]) -> float:
    """Return the product of those factors that are numbers."""
    return math.prod(factor.value for factor in factors if isinstance(factor, Number))


ARITHMETIC: dict[int, Callable[..., Expression]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: _sum((1, a), (1, b)),
    ca.OP_SUB: lambda a, b: _sum((1, a), (-1, b)),
    ca.OP_NEG: lambda a: _sum((-1, a)),
    ca.OP_MUL: lambda a, b: _product((a, b), ()),
    ca.OP_DIV: lambda a, b: _product((a,), (b,)),
    ca.OP_INV: lambda a: _product((), (a,)),
    ca.OP_TWICE: lambda a: _product((Number(2.0), a), ()),
    ca.OP_SQ: lambda a: Power(a, Number(2.0)),
    ca.OP_POW: Power,
    ca.OP_CONSTPOW: Power,
    ca.OP_EXP: lambda a: Power(Symbol("e"), a),
}
