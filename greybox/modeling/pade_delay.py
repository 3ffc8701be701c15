"""The Padé approximation of a delay, in the frequency domain and as states of an ODE.

exp(-s T) ≈ Σ c_k (-s T)^k / Σ c_k (s T)^k, k = 0 ... n. A problem asks for it with
``delay="pade:n"``. In a formula, `Complex` and `Rational` replace their `exp` by
`pade_exponential`; in the time domain, `realization` replaces a delayed input by the output of
`pade_rows`. Their poles go to infinity as the delay goes to zero, so no integrator follows them:
`pade_step` has the exact solution.
"""

import math
import re
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

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
    # Quotients of whole numbers are exact to rounding, whatever the order.
    return [math.comb(order, k) / math.perm(2 * order, k) for k in range(order + 1)]


def pade_exponential(z: Any) -> Any:
    """Return the approximation of exp(z) in the arithmetic of `z`; z = -s T is a delay by T."""
    coefficients = pade_coefficients(z.pade)[::-1]
    return polynomial_value(coefficients, z) / polynomial_value(coefficients, -z)


def _monic(order: int) -> list[float]:
    """Return the denominator (order + 1,), highest power of s first, with time in delays."""
    last, *rest = reversed(pade_coefficients(order))
    return [1.0, *(c / last for c in rest)]


def pade_rows(x: Sequence[Any], u: Any, delay: Any, order: int) -> tuple[Any, list[Any]]:
    """Return the delayed input and the derivatives of its states x (order,), in observer form.

    Time is in units of the delay, so that the states are of the input's size whatever the delay.
    """
    moved = [state - rest for state, rest in zip(x, pade_steady(u, order), strict=True)]
    pairs = zip(_monic(order)[1:], [*moved[1:], 0], strict=True)
    return u + moved[0], [(following - a * moved[0]) / delay for a, following in pairs]


def pade_steady(u: Any, order: int) -> list[Any]:
    """Return the states at which `pade_rows` is zero for a constant input."""
    # The numerator has the denominator's coefficients, with alternating signs.
    return [a * (1 - (-1) ** (order + k)) * u for k, a in enumerate(_monic(order)[:-1])]


def pade_step(x: Any, u: Any, slope: Any, delay: Any, h: Any) -> tuple[Any, Any, Any]:
    """Return the states x (order,) a step h later, and the delayed input as a line over the step.

    The input is a line that begins at `u`. The states are exact, and so are the first two moments
    of the delayed input, from which its line follows. A delay of zero leaves the input as it is.
    """
    order = x.numel()
    # x' = A (x - rest · u) / delay; the first state less its rest is what the delay adds to u.
    A = np.eye(order, k=1)
    A[:, 0] -= _monic(order)[1:]
    steady = ca.DM(pade_steady(1.0, order))

    # exp(A h / delay), mode by mode; those of conjugate poles have the same expressions.
    transition = ca.SX.zeros(order, order)
    # After 400 delays in a step a transient counts as zero: the slowest one decays by exp(-2) or
    # more within a delay. Without a limit, a delay of zero would be a division by zero.
    periods = h / ca.fmax(delay, h / 400)
    poles, vectors = np.linalg.eig(A)
    modes = zip(poles.astype(complex), vectors.T, np.linalg.inv(vectors), strict=True)
    for pole, right, left in modes:
        mode: Any = np.outer(right, left)
        angle = abs(pole.imag) * periods
        sign = float(np.sign(pole.imag))
        wave = ca.cos(angle) * ca.DM(mode.real) - ca.sin(angle) * ca.DM(sign * mode.imag)
        transition += ca.exp(pole.real * periods) * wave

    # Without a transient, the states follow a ramp at a constant distance.
    lag = delay / h * ca.DM(np.linalg.inv(A))
    first = steady * u + lag @ steady * slope * h
    end = first + steady * slope * h + transition @ (x - first)
    # The distance of the states from rest, on average and in slope: moments of the differential
    # equation.
    behind = lag @ (end - x)
    rise = 6 * lag @ (x + end - 2 * behind - steady * (2 * u + slope * h))
    return end, u + behind[0] - rise[0] / 2, slope + rise[0] / h
