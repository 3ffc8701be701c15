"""The base class of `Complex` and `Rational`, the two readings of a formula in s."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from numbers import Real
from typing import Any, Self

import casadi as ca

CASADI_TYPES = (ca.SX, ca.MX, ca.DM)


class FunctionOfS(ABC):
    """A value that depends on s.

    The functions of `greybox.modeling.functions` call its method of the same name.
    """

    __array_ufunc__ = None  # numpy leaves the operators to this class

    @abstractmethod
    def __add__(self, other: Any) -> Self: ...

    @abstractmethod
    def __mul__(self, other: Any) -> Self: ...

    @abstractmethod
    def __neg__(self) -> Self: ...

    @abstractmethod
    def exp(self) -> Self:
        """Return the exponential."""

    def __radd__(self, other: Any) -> Self:
        return self + other

    def __rmul__(self, other: Any) -> Self:
        return self * other

    def __pos__(self) -> Self:
        return self

    def __sub__(self, other: Any) -> Self:
        return self + (-other)

    def __rsub__(self, other: Any) -> Self:
        return (-self) + other


def is_casadi(value: Any) -> bool:
    """Return whether `value` is a CasADi expression or matrix."""
    return isinstance(value, CASADI_TYPES)


def is_whole(power: Any) -> bool:
    """Return whether a power is a whole number of any type."""
    return isinstance(power, Real) and float(power).is_integer()


def whole_power(base: Any, power: int, unit: Any) -> Any:
    """Raise `base` to a whole power by repeated squaring; `unit` is the one of its arithmetic."""
    result = unit
    for bit in bin(abs(power))[2:]:
        result = result * result
        if bit == "1":
            result = result * base
    return unit / result if power < 0 else result


def polynomial_value(coefficients: Sequence[Any], s: Any) -> Any:
    """Evaluate a polynomial, highest power first, by Horner's scheme in the arithmetic of `s`."""
    result = 0.0
    for c in coefficients:
        result = result * s + c
    return result
