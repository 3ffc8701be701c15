"""Complex numbers of CasADi expressions: a formula in s = jω as real and imaginary part."""

from collections.abc import Callable
from typing import Any

import numpy as np

from greybox.modeling.function_of_s import FunctionOfS, is_casadi, is_whole, whole_power
from greybox.modeling.functions import arctan2, cos, exp, log, sin, sqrt
from greybox.modeling.pade_delay import pade_exponential

REAL = 0.0  # the imaginary part of a real divisor, which saves operations in every derivative


class Complex(FunctionOfS):
    """A complex number, or a column of them, kept as real and imaginary part.

    The parts are CasADi expressions or numpy arrays. With `pade` set, `exp` is replaced by its Padé
    approximation of that order: this is how a delay becomes rational without touching the formula.
    """

    def __init__(self, re: Any, im: Any, pade: int | None = None) -> None:
        self.re = re
        self.im = im
        self.pade = pade

    def _with(self, operand: Any, combine: Callable[..., tuple[Any, Any]]) -> "Complex":
        operand = _complex(operand)
        # The order of s reaches every intermediate result; parameters have none.
        return Complex(
            *combine(self.re, self.im, operand.re, operand.im), self.pade or operand.pade
        )

    def __add__(self, operand: Any) -> "Complex":
        return self._with(operand, lambda a, b, c, d: (a + c, b + d))

    def __mul__(self, operand: Any) -> "Complex":
        return self._with(operand, _product)

    def __truediv__(self, operand: Any) -> "Complex":
        return self._with(operand, _quotient)

    def __rtruediv__(self, operand: Any) -> "Complex":
        return _complex(operand) / self

    def __neg__(self) -> "Complex":
        return Complex(-self.re, -self.im, self.pade)

    def __pow__(self, power: Any) -> "Complex":
        if is_whole(power):
            return whole_power(self, int(power), Complex(1.0, 0.0, self.pade))
        # Never the Padé approximation: this exponential is not a delay.
        return (power * self.log()).exp_exact()

    def __abs__(self) -> Any:
        return sqrt(self.re**2 + self.im**2)

    def exp(self) -> "Complex":
        """Exponential, or its Padé approximation where that was asked for."""
        if self.pade is None:
            return self.exp_exact()
        return pade_exponential(self)

    def exp_exact(self) -> "Complex":
        """Exponential."""
        size = exp(self.re)
        return Complex(size * cos(self.im), size * sin(self.im), self.pade)

    def log(self) -> "Complex":
        """Principal logarithm."""
        return Complex(log(self.re**2 + self.im**2) / 2, arctan2(self.im, self.re), self.pade)

    def sqrt(self) -> "Complex":
        """Principal square root."""
        return self**0.5


def _product(a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any]:
    if d is REAL:
        return a * c, b * c
    return a * c - b * d, a * d + b * c


def _quotient(a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any]:
    if d is REAL:
        return a / c, b / c
    size = c * c + d * d
    return (a * c + b * d) / size, (b * c - a * d) / size


def _complex(value: Any) -> Complex:
    if isinstance(value, Complex):
        return value
    kind = "f" if is_casadi(value) else np.asarray(value).dtype.kind
    if kind not in "fiuc":
        raise TypeError(f"{value!r:.60} in a formula of s: give numbers or expressions.")
    return Complex(np.real(value), np.imag(value)) if kind == "c" else Complex(value, REAL)
