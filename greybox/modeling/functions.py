"""The arithmetic that gives one formula several readings.

A model writes ``gb.exp(-s * p.T)`` once. Read with numpy arrays it gives numbers, read with `Complex` it gives CasADi
expressions of real and imaginary part (CasADi has no complex type), read with `Rational` it gives numerator,
denominator and delay.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

g = 9.8065  # m/s², the paper's value, below (4.24)

_CASADI = (ca.SX, ca.MX, ca.DM)


def _is_casadi(value: Any) -> bool:
    return isinstance(value, _CASADI)


def pade_coefficients(order: int) -> list[float]:
    """Coefficients c_0 ... c_n of the diagonal Padé approximation exp(z) ≈ Σ c_k z^k / Σ c_k (-z)^k.

    Source: Golub and Van Loan, Matrix Computations, section 9.3.1.
    """
    n = order
    return [
        math.factorial(2 * n - k)
        * math.factorial(n)
        / (math.factorial(2 * n) * math.factorial(k) * math.factorial(n - k))
        for k in range(n + 1)
    ]


class Complex:
    """A complex number, or a column of them, kept as real and imaginary part.

    The parts are CasADi expressions or numpy arrays. With `pade` set, `exp` is replaced by its Padé approximation of
    that order: this is how a delay becomes rational without touching the formula.
    """

    __array_ufunc__ = None  # numpy leaves the operators to this class

    def __init__(self, re: Any, im: Any, pade: int | None = None) -> None:
        self.re, self.im, self.pade = re, im, pade

    def _with(self, other: Any, combine: Callable[..., tuple[Any, Any]]) -> "Complex":
        other = _complex(other)
        if other is None:
            return NotImplemented
        return Complex(*combine(self.re, self.im, other.re, other.im), self.pade or other.pade)

    def __add__(self, other: Any) -> "Complex":
        return self._with(other, lambda a, b, c, d: (a + c, b + d))

    def __sub__(self, other: Any) -> "Complex":
        return self._with(other, lambda a, b, c, d: (a - c, b - d))

    def __rsub__(self, other: Any) -> "Complex":
        return self._with(other, lambda a, b, c, d: (c - a, d - b))

    def __mul__(self, other: Any) -> "Complex":
        return self._with(other, _product)

    def __truediv__(self, other: Any) -> "Complex":
        return self._with(other, _quotient)

    def __rtruediv__(self, other: Any) -> "Complex":
        return self._with(other, lambda a, b, c, d: _quotient(c, d, a, b))

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> "Complex":
        return Complex(-self.re, -self.im, self.pade)

    def __pos__(self) -> "Complex":
        return self

    def __pow__(self, power: Any) -> "Complex":
        if _is_integer(power):
            return _integer_power(self, int(power), Complex(1.0, 0.0, self.pade))
        return (power * self.log()).exp_exact()

    def __abs__(self) -> Any:
        return sqrt(self.re**2 + self.im**2)

    def exp(self) -> "Complex":
        """Exponential, or its Padé approximation where that was asked for."""
        if self.pade is None:
            return self.exp_exact()
        coefficients = pade_coefficients(self.pade)
        return _horner(coefficients[::-1], self) / _horner(coefficients[::-1], -self)

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


class Rational:
    """A rational function of s with a delay: numerator(s) / denominator(s) · exp(-s delay).

    The coefficients are numbers or CasADi expressions, highest power of s first.
    """

    __array_ufunc__ = None

    def __init__(
        self, numerator: Sequence[Any], denominator: Sequence[Any] = (1.0,), delay: Any = 0.0, pade: int | None = None
    ):
        self.numerator, self.denominator = _trim(numerator), _trim(denominator)
        self.delay, self.pade = delay, pade

    def _same_delay(self, other: "Rational") -> Any:
        if _is_zero_sum(self.numerator):
            return other.delay
        if _is_zero_sum(other.numerator) or _equal(self.delay, other.delay):
            return self.delay
        raise ValueError(
            "terms with different delays are added (as in a loop around a delay), which has no rational form: "
            "use a Padé approximation, pade=3 here or delay='pade:3' in a problem."
        )

    def __add__(self, other: Any) -> "Rational":
        other = _rational(other)
        if other is None:
            return NotImplemented
        delay, pade = self._same_delay(other), self.pade or other.pade
        if _equal_polynomials(self.denominator, other.denominator):
            return Rational(_sum(self.numerator, other.numerator), self.denominator, delay, pade)
        numerator = _sum(_convolve(self.numerator, other.denominator), _convolve(other.numerator, self.denominator))
        return Rational(numerator, _convolve(self.denominator, other.denominator), delay, pade)

    def __mul__(self, other: Any) -> "Rational":
        other = _rational(other)
        if other is None:
            return NotImplemented
        (n1, d2), (n2, d1) = _cancel(self.numerator, other.denominator), _cancel(other.numerator, self.denominator)
        return Rational(_convolve(n1, n2), _convolve(d1, d2), self.delay + other.delay, self.pade or other.pade)

    def _inverse(self) -> "Rational":
        return Rational(self.denominator, self.numerator, -self.delay, self.pade)

    def __truediv__(self, other: Any) -> "Rational":
        other = _rational(other)
        return NotImplemented if other is None else self * other._inverse()

    def __rtruediv__(self, other: Any) -> "Rational":
        other = _rational(other)
        return NotImplemented if other is None else other * self._inverse()

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> "Rational":
        return Rational([-c for c in self.numerator], self.denominator, self.delay, self.pade)

    def __pos__(self) -> "Rational":
        return self

    def __sub__(self, other: Any) -> "Rational":
        return self + (-other)

    def __rsub__(self, other: Any) -> "Rational":
        return (-self) + other

    def __pow__(self, power: Any) -> "Rational":
        if not _is_integer(power):
            raise ValueError(f"the power {power} of s has no rational form: only whole powers have.")
        return _integer_power(self, int(power), Rational([1.0], pade=self.pade))

    def exp(self) -> "Rational":
        """exp(-s T) as a delay, or as a rational function where a Padé order is set."""
        if self.pade is not None:
            coefficients = pade_coefficients(self.pade)
            return _horner(coefficients[::-1], self) / _horner(coefficients[::-1], -self)
        constant = len(self.denominator) == 1 and not _is_casadi(self.delay) and self.delay == 0
        if not constant or len(self.numerator) > 2 or (len(self.numerator) and not _is_zero(self.numerator[-1])):
            raise ValueError("only exp(-s T) with a T that does not depend on s has a rational form with a delay.")
        return Rational([1.0], delay=-self.numerator[0] / self.denominator[0] if len(self.numerator) == 2 else 0.0)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Roots of a numeric denominator, rad/s."""
        return np.roots([float(c) for c in self.denominator]).astype(complex)

    @property
    def zeros(self) -> NDArray[np.complex128]:
        """Roots of a numeric numerator, rad/s."""
        return np.roots([float(c) for c in self.numerator]).astype(complex)

    def __str__(self) -> str:
        delay = "" if not _is_casadi(self.delay) and self.delay == 0 else f" exp(-{self.delay} s)"
        return f"({_written(self.numerator)}) / ({_written(self.denominator)}){delay}"

    def __call__(self, s: Any) -> Any:
        """Evaluate at `s`, numbers or `Complex`."""
        return _horner(self.numerator, s) / _horner(self.denominator, s) * exp(-s * self.delay)


def _function(name: str, casadi: Callable[..., Any], numpy: Callable[..., Any], doc: str) -> Callable[..., Any]:
    def apply(x: Any) -> Any:
        if isinstance(x, Complex | Rational):
            method = getattr(x, name, None)
            if method is None:
                raise ValueError(f"{name} of a function of s has no {type(x).__name__.lower()} form.")
            return method()
        return casadi(x) if _is_casadi(x) else numpy(x)

    apply.__name__ = apply.__qualname__ = name
    apply.__doc__ = f"{doc}, of numbers, CasADi expressions and functions of s."
    return apply


exp = _function("exp", ca.exp, np.exp, "Exponential; `exp(-s * T)` is a delay")
log = _function("log", ca.log, np.log, "Natural logarithm")
sqrt = _function("sqrt", ca.sqrt, np.sqrt, "Square root")
sin = _function("sin", ca.sin, np.sin, "Sine")
cos = _function("cos", ca.cos, np.cos, "Cosine")
tan = _function("tan", ca.tan, np.tan, "Tangent")
arcsin = _function("arcsin", ca.asin, np.arcsin, "Inverse sine")
arccos = _function("arccos", ca.acos, np.arccos, "Inverse cosine")
arctan = _function("arctan", ca.atan, np.arctan, "Inverse tangent")
tanh = _function("tanh", ca.tanh, np.tanh, "Hyperbolic tangent")
sign = _function("sign", ca.sign, np.sign, "Sign, 0 at 0")


def arctan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y), of numbers or CasADi expressions."""
    return ca.atan2(y, x) if _is_casadi(y) or _is_casadi(x) else np.arctan2(y, x)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller of `a` and `b`, elementwise, of numbers or CasADi expressions."""
    return ca.fmin(a, b) if _is_casadi(a) or _is_casadi(b) else np.minimum(a, b)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of `a` and `b`, elementwise, of numbers or CasADi expressions."""
    return ca.fmax(a, b) if _is_casadi(a) or _is_casadi(b) else np.maximum(a, b)


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return `a` where `condition` holds, else `b`, of numbers or CasADi expressions."""
    if any(_is_casadi(x) for x in (condition, a, b)):
        return ca.if_else(condition, a, b)
    return np.where(condition, a, b)


def _product(a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any]:
    return a * c - b * d, a * d + b * c


def _quotient(a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any]:
    size = c * c + d * d
    return (a * c + b * d) / size, (b * c - a * d) / size


def _complex(value: Any) -> Complex | None:
    if isinstance(value, Complex):
        return value
    if isinstance(value, (int, float, np.floating, np.integer, *_CASADI)):
        return Complex(value, 0.0)
    if isinstance(value, (complex, np.complexfloating)) or (
        isinstance(value, np.ndarray) and value.dtype.kind in "fiuc"
    ):
        return Complex(np.real(value), np.imag(value))
    return None


def _rational(value: Any) -> Rational | None:
    if isinstance(value, Rational):
        return value
    if isinstance(value, (int, float, np.floating, np.integer, *_CASADI)) or np.ndim(value) == 0:
        return Rational([value])
    return None


def _is_integer(power: Any) -> bool:
    return isinstance(power, (int, float, np.integer, np.floating)) and float(power).is_integer()


def _integer_power(base: Any, power: int, one: Any) -> Any:
    result = one
    for bit in bin(abs(power))[2:]:
        result = result * result
        if bit == "1":
            result = result * base
    return one / result if power < 0 else result


def _horner(coefficients: Sequence[Any], s: Any) -> Any:
    result: Any = 0.0
    for c in coefficients:
        result = result * s + c
    return result


def _is_zero(c: Any) -> bool:
    return c.is_zero() if _is_casadi(c) else bool(c == 0)


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, ca.MX) or isinstance(b, ca.MX):
        return ca.is_equal(ca.MX(a), ca.MX(b), 8)
    if _is_casadi(a) or _is_casadi(b):
        return ca.is_equal(ca.SX(a), ca.SX(b), 8)
    return bool(a == b)


def _written(polynomial: Sequence[Any]) -> str:
    """Write a polynomial in s, e.g. ``2 s² + 0.3 s + 1``."""
    terms = []
    for power, c in zip(reversed(range(len(polynomial))), polynomial, strict=True):
        if not _is_zero(c) or len(polynomial) == 1:
            size = str(c) if _is_casadi(c) else f"{c:.6g}"
            terms.append(size + ("", " s")[power > 0] + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(d)] for d in str(power) if power > 1))
    return " + ".join(terms).replace("+ -", "- ")


def _trim(polynomial: Sequence[Any]) -> list[Any]:
    """Drop leading coefficients that are zero."""
    terms = list(polynomial)
    while len(terms) > 1 and _is_zero(terms[0]):
        terms.pop(0)
    return terms


def _is_zero_sum(polynomial: list[Any]) -> bool:
    return all(_is_zero(c) for c in polynomial)


def _equal_polynomials(a: list[Any], b: list[Any]) -> bool:
    return a is b or (len(a) == len(b) and all(_equal(x, y) for x, y in zip(a, b, strict=True)))


def _cancel(numerator: list[Any], denominator: list[Any]) -> tuple[list[Any], list[Any]]:
    """Drop a numerator and a denominator that are the same polynomial."""
    if len(numerator) > 1 and _equal_polynomials(numerator, denominator):
        return [1.0], [1.0]
    return numerator, denominator


def _sum(a: list[Any], b: list[Any]) -> list[Any]:
    size = max(len(a), len(b))
    a, b = [0.0] * (size - len(a)) + a, [0.0] * (size - len(b)) + b
    return [x + y for x, y in zip(a, b, strict=True)]


def _convolve(a: list[Any], b: list[Any]) -> list[Any]:
    result: list[Any] = [0.0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for k, y in enumerate(b):
            result[i + k] = result[i + k] + x * y
    return result
