"""A formula as a tree of sums, products, powers and functions, as written on paper."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from greybox.modeling.formula_structure import walk


@dataclass(frozen=True)
class Symbol:
    """A parameter or a signal by its name; `delay` is the name of its delay."""

    name: str
    delay: str = ""


@dataclass(frozen=True)
class Function:
    """A function such as ``sin`` of its arguments, or a relation such as ``<`` of its sides.

    ``^`` has a base and an exponent, ``()`` the sum in the parentheses. ``if`` has a condition and
    the value while it holds; it is zero otherwise.
    """

    name: str
    arguments: tuple["Expression", ...]


Factor = Symbol | Function


@dataclass(frozen=True)
class Term:
    """A number times factors over factors."""

    number: float
    over: tuple[Factor, ...] = ()
    under: tuple[Factor, ...] = ()


Expression = tuple[Term, ...]
"""The sum of these terms; an empty one is zero."""

RELATIONS = {"LT": "<", "LE": "≤", "EQ": "=", "NE": "≠", "AND": "and", "OR": "or"}
# By the name of CasADi's operation.
FUNCTIONS = {
    "LOG": "ln",
    "SIN": "sin",
    "COS": "cos",
    "TAN": "tan",
    "ASIN": "arcsin",
    "ACOS": "arccos",
    "ATAN": "arctan",
    "ATAN2": "arctan2",
    "SINH": "sinh",
    "COSH": "cosh",
    "TANH": "tanh",
    "ASINH": "arsinh",
    "ACOSH": "arcosh",
    "ATANH": "artanh",
    "ERF": "erf",
    "FABS": "abs",
    "SIGN": "sign",
    "FLOOR": "floor",
    "CEIL": "ceil",
    "FMIN": "min",
    "FMAX": "max",
    "FMOD": "mod",
    "NOT": "not",
    "IF_ELSE_ZERO": "if",
    **RELATIONS,
}
NOTATIONS = {getattr(ca, f"OP_{name}"): notation for name, notation in FUNCTIONS.items()}


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
        number(values[name]) if name in values else factor(Symbol(name, delays.get(name, "")))
        for name in symbols
    ]
    z = ca.vertcat(*symbols.values())
    return walk(formula, z, leaves, lambda constant: number(float(constant)), _operate)


def number(value: float) -> Expression:
    """Return a constant."""
    return (Term(value),) if value else ()


def factor(*over: Factor) -> Expression:
    """Return the product of factors."""
    return (Term(1.0, over),)


def power(base: Expression, exponent: Expression) -> Expression:
    """Return a base with an exponent."""
    return factor(Function("^", (base, exponent)))


def size(expression: Expression) -> int:
    """Return the number of written symbols, numbers and functions."""
    # Repeated factors are one object: without this table, time would grow exponentially.
    sizes: dict[int, int] = {}

    def of_factor(part: Factor) -> int:
        if id(part) not in sizes:
            arguments = part.arguments if isinstance(part, Function) else ()
            sizes[id(part)] = 1 + sum(map(of_sum, arguments))
        return sizes[id(part)]

    def of_sum(terms: Expression) -> int:
        return sum(
            (abs(term.number) != 1 or not term.over) + sum(map(of_factor, term.over + term.under))
            for term in terms
        )

    return of_sum(expression)


def _operate(operation: int, terms: list[Expression]) -> Expression:
    if operation in ARITHMETIC:
        return ARITHMETIC[operation](*terms)
    if operation not in NOTATIONS:
        raise ValueError(f"the operation {operation} of CasADi has no notation.")
    return factor(Function(NOTATIONS[operation], tuple(terms)))


def _negative(terms: Expression) -> Expression:
    return tuple(replace(term, number=-term.number) for term in terms)


def _product(over: Sequence[Expression], under: Sequence[Expression] = ()) -> Expression:
    """Return a product of one number and of factors; powers of one symbol are combined."""
    above, below = [list(map(_single, several)) for several in (over, under)]
    # As in CasADi, a division by zero gives infinity or NaN, not an exception.
    with np.errstate(divide="ignore", invalid="ignore"):
        above_all, below_all = (math.prod(t.number for t in several) for several in (above, below))
        value = float(np.divide(above_all, below_all))
    factors = tuple(_combined([*_factors(above, "over"), *_factors(below, "under")]))
    divisors = tuple(_combined([*_factors(above, "under"), *_factors(below, "over")]))
    match factors:
        case (Function("()", (terms,)),) if abs(value) == 1 and not divisors:
            return terms if value == 1 else _negative(terms)
    return (Term(value, factors, divisors),) if value else ()


def _single(terms: Expression) -> Term:
    """Return a sum as one term: in parentheses if it has several."""
    if len(terms) == 1:
        return terms[0]
    return Term(1.0, (Function("()", (terms,)),)) if terms else Term(0.0)


def _factors(terms: Sequence[Term], side: str) -> Iterator[Factor]:
    return (part for term in terms for part in getattr(term, side))


def _combined(factors: Sequence[Factor]) -> Iterator[Factor]:
    """Yield the factors; powers of one symbol, as s · s², become one."""
    exponents: dict[Symbol, float] = {}
    bases: list[Factor] = []
    for part in factors:
        base, exponent = part, 1.0
        match part:
            case Function("^", ((Term(1.0, (Symbol() as base,), ()),), (Term(exponent, (), ()),))):
                pass
        if not isinstance(base, Symbol):
            bases.append(part)
            continue
        if base not in exponents:
            bases.append(base)
        exponents[base] = exponents.get(base, 0.0) + exponent

    for base in bases:
        match base:
            case Symbol() if exponents[base] != 1:
                yield Function("^", (factor(base), number(exponents[base])))
            case _:
                yield base


ARITHMETIC: dict[int, Callable[..., Expression]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a + _negative(b),
    ca.OP_NEG: _negative,
    ca.OP_MUL: lambda a, b: _product([a, b]),
    ca.OP_DIV: lambda a, b: _product([a], [b]),
    ca.OP_INV: lambda a: _product([], [a]),
    ca.OP_TWICE: lambda a: _product([number(2.0), a]),
    ca.OP_SQ: lambda a: power(a, number(2.0)),
    ca.OP_SQRT: lambda a: power(a, number(0.5)),
    ca.OP_POW: power,
    ca.OP_CONSTPOW: power,
    ca.OP_EXP: lambda a: power(factor(Symbol("e")), a),
}
