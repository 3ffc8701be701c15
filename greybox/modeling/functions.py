"""Functions for formulas, of numbers, CasADi expressions and functions of s.

A model writes ``gb.exp(-s * p.T)`` once. Read with numpy arrays it gives numbers; with `Complex`,
CasADi expressions of real and imaginary part; with `Rational`, numerator, denominator and delay.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from greybox.modeling.function_of_s import FunctionOfS, is_casadi

g = 9.80665  # m/s², standard acceleration of free fall, as in greybox.data.units


def _function(casadi: Callable[..., Any], doc: str, at_half: float) -> Callable[..., Any]:
    numpy = getattr(np, casadi.__name__)  # with the names of the array API standard, as CasADi's
    name = numpy.__name__

    def apply(x: Any) -> Any:
        # A function of s has its own method; those without a rational form lack it.
        if isinstance(x, FunctionOfS):
            method = getattr(x, name, None)
            if method is None:
                raise ValueError(
                    f"{name} of a function of s has no {type(x).__name__.lower()} form: write the "
                    "response as a ratio of polynomials of s, with delays as gb.exp(-s * T)."
                )
            return method()
        return _applied(casadi, numpy, x)

    apply.__name__ = apply.__qualname__ = name
    apply.__doc__ = (
        f"{doc}, of numbers, CasADi expressions and functions of s.\n\n"
        f"Examples\n--------\n>>> round(float(gb.{name}(0.5)), 3)\n{at_half}\n"
    )
    return apply


exp = _function(ca.exp, "Exponential; `exp(-s * T)` is a delay", 1.649)
log = _function(ca.log, "Natural logarithm (of flights: `logs`)", -0.693)
sqrt = _function(ca.sqrt, "Square root", 0.707)
sin = _function(ca.sin, "Sine", 0.479)
cos = _function(ca.cos, "Cosine", 0.878)
tan = _function(ca.tan, "Tangent", 0.546)
arcsin = _function(ca.asin, "Inverse sine", 0.524)
arccos = _function(ca.acos, "Inverse cosine", 1.047)
arctan = _function(ca.atan, "Inverse tangent", 0.464)
tanh = _function(ca.tanh, "Hyperbolic tangent", 0.462)
ceil = _function(ca.ceil, "Whole number from above", 1.0)
sign = _function(ca.sign, "Sign, 0 at 0", 1.0)


def arctan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y), of numbers or CasADi expressions.

    Examples
    --------
    >>> round(float(gb.arctan2(1.0, -1.0)), 3)  # rad
    2.356
    """
    return _applied(ca.atan2, np.arctan2, y, x)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller of `a` and `b`, elementwise, of numbers or CasADi expressions.

    Examples
    --------
    >>> float(gb.minimum(1.0, 2.0))
    1.0
    """
    return _applied(ca.fmin, np.minimum, a, b)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of `a` and `b`, elementwise, of numbers or CasADi expressions.

    Examples
    --------
    >>> float(gb.maximum(1.0, 2.0))
    2.0
    """
    return _applied(ca.fmax, np.maximum, a, b)


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return `a` where `condition` is true, else `b`, of numbers or CasADi expressions.

    Examples
    --------
    >>> gb.where(np.array([-1.0, 2.0]) > 0, 1.0, 0.0)
    array([0., 1.])
    """
    return _applied(ca.if_else, np.where, condition, a, b)


def _applied(casadi: Callable[..., Any], numpy: Callable[..., Any], *arguments: Any) -> Any:
    return (casadi if any(map(is_casadi, arguments)) else numpy)(*arguments)
