"""The rational reading of a model: numerator and denominator in s, and a delay.

`rational` reads a model; `Rational` is the arithmetic in which its formula is evaluated for that.
"""

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import ComplexArray
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.public import public
from greybox.modeling.factored_form import factored
from greybox.modeling.function_of_s import (
    FunctionOfS,
    is_casadi,
    is_whole,
    polynomial_value,
    whole_power,
)
from greybox.modeling.functions import exp
from greybox.modeling.linearization import linearize
from greybox.modeling.model import Model, pick_signals, require_operating_point
from greybox.modeling.pade_delay import pade_exponential
from greybox.modeling.state_space import StateSpace
from greybox.modeling.transfer_function import TransferFunction


class Rational(FunctionOfS):
    """A rational function of s with a delay: numerator(s) / denominator(s) · exp(-s delay).

    The coefficients are numbers or CasADi expressions, highest power of s first.
    """

    def __init__(
        self,
        numerator: Sequence[Any],
        denominator: Sequence[Any] = (1.0,),
        delay: Any = 0.0,
        pade: int | None = None,
    ):
        self.numerator = _without_leading_zeros(numerator)
        self.denominator = _without_leading_zeros(denominator)
        self.delay = delay
        self.pade = pade

    def _same_delay(self, operand: "Rational") -> Any:
        # Zero delayed by any time is zero: it takes the delay of the other term.
        if _is_zero(self.numerator[0]):
            return operand.delay
        if _is_zero(operand.numerator[0]) or _is_equal([self.delay], [operand.delay]):
            return self.delay
        raise ValueError(
            "terms with different delays are added (as in a loop around a delay), which has no "
            "rational form: use a Padé approximation, pade=3 here or delay='pade:3' in a problem."
        )

    def __add__(self, operand: Any) -> "Rational":
        operand = as_rational(operand)
        delay = self._same_delay(operand)
        pade = self.pade or operand.pade
        # A product of equal denominators would double the order of the sum.
        if _is_equal(self.denominator, operand.denominator):
            return Rational(_sum(self.numerator, operand.numerator), self.denominator, delay, pade)

        numerator = _sum(
            _convolve(self.numerator, operand.denominator),
            _convolve(operand.numerator, self.denominator),
        )
        return Rational(numerator, _convolve(self.denominator, operand.denominator), delay, pade)

    def __mul__(self, operand: Any) -> "Rational":
        operand = as_rational(operand)
        # Equal factors cancel. Otherwise the order would grow with every product of a formula, and
        # the realization would have unobservable states.
        n1, d2 = _cancel(self.numerator, operand.denominator)
        n2, d1 = _cancel(operand.numerator, self.denominator)
        return Rational(
            _convolve(n1, n2),
            _convolve(d1, d2),
            self.delay + operand.delay,
            self.pade or operand.pade,
        )

    def _inverse(self) -> "Rational":
        return Rational(self.denominator, self.numerator, -self.delay, self.pade)

    def __truediv__(self, operand: Any) -> "Rational":
        return self * as_rational(operand)._inverse()

    def __rtruediv__(self, operand: Any) -> "Rational":
        return operand * self._inverse()

    def __neg__(self) -> "Rational":
        return Rational([-c for c in self.numerator], self.denominator, self.delay, self.pade)

    def __pow__(self, power: Any) -> "Rational":
        if not is_whole(power):
            raise ValueError(
                f"the power {power} of s has no rational form: only whole powers have."
            )
        return whole_power(self, int(power), Rational([1.0], pade=self.pade))

    def exp(self) -> "Rational":
        """exp(-s T) as a delay, or as a rational function where a Padé order is set."""
        # Every result of a formula in s has the order of s, so that a model need not know of it.
        if self.pade is not None:
            return pade_exponential(self)
        is_constant = len(self.denominator) == 1 and _is_zero(self.delay)
        if not is_constant or len(self.numerator) > 2 or not _is_zero(self.numerator[-1]):
            raise ValueError(
                "only exp(-s T) with a T that does not depend on s has a rational form with a "
                "delay."
            )

        return Rational([1.0], delay=-self.numerator[0] / self.denominator[0])

    @property
    def poles(self) -> ComplexArray:
        """Roots of a numeric denominator, rad/s."""
        return np.roots(list(map(float, self.denominator))).astype(complex)

    @property
    def zeros(self) -> ComplexArray:
        """Roots of a numeric numerator, rad/s."""
        return np.roots(list(map(float, self.numerator))).astype(complex)

    def __str__(self) -> str:
        if is_casadi(sum(self.numerator + self.denominator, self.delay)):
            return f"Rational({self.numerator}, {self.denominator}, {self.delay})"
        delay = f" exp(-{number(self.delay, 3)} s)" if self.delay else ""
        return factored(self.numerator, self.denominator) + delay

    def __call__(self, s: Any) -> Any:
        """Evaluate at `s`, numbers or `Complex`."""
        return (
            polynomial_value(self.numerator, s)
            / polynomial_value(self.denominator, s)
            * exp(-s * self.delay)
        )


@public
def rational(
    model: Model,
    values: Values | None = None,
    *,
    input: str = "",
    output: str = "",
    at: Values | None = None,
    pade: int | None = None,
) -> Rational:
    """Read a model as numerator and denominator (highest power of s first) and a delay in s.

    With `pade`, the delay becomes part of the rational function, approximated to that order.

    Raises
    ------
    ValueError
        If the formula has no rational form, as a loop around an exact delay.
    """
    input, output = pick_signals(model, input, output)
    if isinstance(model, TransferFunction):
        require_operating_point(model, at)
        return as_rational(model.response(Rational([1.0, 0.0], pade=pade), model.values(values)))

    assert isinstance(model, StateSpace)
    system = linearize(model, values, at)
    i = system.inputs.index(input)
    k = system.outputs.index(output)
    b = system.B[:, i]
    c = system.C[k]
    d = system.D[k, i]

    # The response is a power series in 1/s with the Markov parameters d, c b, c A b, ... Its
    # product with the denominator is the numerator, whose terms beyond the order vanish.
    denominator = np.atleast_1d(np.poly(system.poles)).real
    markov = [d, *(c @ np.linalg.matrix_power(system.A, j) @ b for j in range(len(b)))]
    numerator = np.convolve(denominator, markov)[: len(denominator)]
    delay = exp(Rational([-1.0, 0.0], pade=pade) * system.delays[i])
    return Rational(numerator.tolist(), denominator.tolist()) * delay


def as_rational(value: Any) -> Rational:
    """Return a number or an expression as a rational function of s."""
    if isinstance(value, Rational):
        return value
    if not is_casadi(value) and np.ndim(value):
        raise TypeError(f"{value!r:.60} in a formula of s: give one number for each coefficient.")
    return Rational([value])


def _is_zero(c: Any) -> bool:
    return ca.SX(c).is_zero()


def _is_equal(a: Sequence[Any], b: Sequence[Any]) -> bool:
    """Return whether two polynomials have the same coefficients."""
    return len(a) == len(b) and ca.is_equal(ca.SX(ca.vertcat(*a)), ca.SX(ca.vertcat(*b)), 8)


def _without_leading_zeros(polynomial: Sequence[Any]) -> list[Any]:
    """Drop leading coefficients that are zero."""
    terms = list(polynomial)
    while len(terms) > 1 and _is_zero(terms[0]):
        terms.pop(0)
    return terms


def _cancel(numerator: list[Any], denominator: list[Any]) -> tuple[list[Any], list[Any]]:
    """Drop a numerator and a denominator that are the same polynomial."""
    if len(numerator) > 1 and _is_equal(numerator, denominator):
        return [1.0], [1.0]
    return numerator, denominator


def _sum(a: list[Any], b: list[Any]) -> list[Any]:
    # The lowest powers are last: from there, the shorter one is filled up with zeros.
    pairs = zip_longest(reversed(a), reversed(b), fillvalue=0.0)
    return [x + y for x, y in pairs][::-1]


def _convolve(a: list[Any], b: list[Any]) -> list[Any]:
    # `np.convolve` does not take CasADi expressions.
    result = [0.0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for k, y in enumerate(b):
            result[i + k] = result[i + k] + x * y
    return result
