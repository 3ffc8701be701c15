"""The Padé approximation of a delay, in the frequency domain and as states of an ODE.

exp(-s T) ≈ Σ c_k (-s T)^k / Σ c_k (s T)^k, k = 0 ... n. A problem asks for it with
``delay="pade:n"``. In a formula, `Complex` and `Rational` replace their `exp` by
`pade_exponential`; in the time domain, `realization` replaces a delayed input by the output of
`pade_rows`.
"""

import math
import re
from collections.abc import Sequence
from typing import Any

from greybox.modeling.function_of_s import polynomial_value


def delay_order(delay: str) -> int | None:
    """Return the Padé order in ``"pade:n"``, or None for ``"exact"``."""
    if delay == "exact":
        return None
    match = re.fullmatch(r"pade:([1-9]\d?)", delay) if isinstance(delay, str) else None
    if match is None:
        raise ValueError(
            f"delay {delay!r} is not known: use 'exact' or 'pade:n' with an order n from 1 to 99."
        )
    return int(match[1])


def pade_coefficients(order: int) -> list[float]:
    """Return c_0 ... c_n of the diagonal Padé approximation exp(z) ≈ Σ c_k z^k / Σ c_k (-z)^k.

    Source: Golub and Van Loan, Matrix Computations, section 9.3.1.
    """
    n = order
    # Factorials of integers are exact, whatever the order.
    return [
        math.factorial(2 * n - k)
        * math.factorial(n)
        / (math.factorial(2 * n) * math.factorial(k) * math.factorial(n - k))
        for k in range(n + 1)
    ]


def pade_exponential(z: Any, order: int) -> Any:
    """Return the approximation of exp(z) in the arithmetic of `z`; z = -s T is a delay by T."""
    coefficients = pade_coefficients(order)[::-1]
    return polynomial_value(coefficients, z) / polynomial_value(coefficients, -z)


def observer_form(
    x: Sequence[Any], u: Any, numerator: Sequence[Any], denominator: Sequence[Any]
) -> tuple[Any, list[Any]]:
    """Return the output of a rational function of s, and the derivatives of its states x (n,).

    The coefficients (n + 1,) have the highest power first. The states of the observer canonical
    form are always observable. Source: Kailath 1980, Linear Systems, section 2.1.
    """
    a = [c / denominator[0] for c in denominator]
    # Without the direct feedthrough, the rest is strictly proper.
    feedthrough = numerator[0] / denominator[0]
    b = [c / denominator[0] - feedthrough * a[k] for k, c in enumerate(numerator)]
    following = [*x[1:], 0]
    rows = [following[k] - a[k + 1] * x[0] + b[k + 1] * u for k in range(len(x))]
    return (x[0] if x else 0) + feedthrough * u, rows


def pade_rows(x: Sequence[Any], u: Any, delay: Any, order: int) -> tuple[Any, list[Any]]:
    """Return the delayed input and the derivatives of its states x (order,), in observer form.

    Time is in units of the delay, so that the states are of the input's size whatever the delay.
    """
    # exp(-z) ≈ Σ c_k (-z)^k / Σ c_k z^k with z = s · delay
    denominator = pade_coefficients(order)[::-1]
    numerator = [c * (-1) ** (order - k) for k, c in enumerate(denominator)]
    output, rows = observer_form(x, u, numerator, denominator)
    return output, [row / delay for row in rows]


def pade_steady(u: Any, order: int) -> list[Any]:
    """Return the states at which `pade_rows` is zero for a constant input."""
    # The output is the input, less its feedthrough of 1 or -1; every row then gives its successor.
    first = u - (-1) ** order * u
    _, rows = pade_rows([first, *[0] * (order - 1)], u, 1.0, order)
    return [first, *(-row for row in rows[:-1])]
