"""The factored form of (3.18): gain, zeros, time constants and quadratics of a ratio."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.numbers_in_text import number


def factored(numerator: ArrayLike, denominator: ArrayLike) -> str:
    """Write a ratio of real polynomials, highest power of s first, in the form of (3.18).

    Stable real poles are factors (T s + 1), smallest T first; all other factors are monic.
    """
    # A numerator of lower order than assumed may begin with zeros, which have no roots.
    above = np.trim_zeros(np.asarray(numerator, float), "f")
    below = np.asarray(denominator, float)
    poles = upper_half(np.roots(below))
    lags = [-1 / p.real for p in reversed(poles) if p.imag == 0 and p.real < 0]
    gain = float(above[0] / below[0]) * math.prod(lags) if above.size else 0.0
    others = [p for p in poles if p.imag or p.real >= 0]
    integrators = ["s"] * others.count(0)
    factors = [f"({number(T, 4)} s + 1)" for T in lags]
    factors = [*integrators, *factors, *_monic([p for p in others if p])]
    text = " ".join([number(gain, 4), *_monic(upper_half(np.roots(above)))])
    return f"{text} / [{' '.join(factors)}]" if factors else text


def _monic(roots: Sequence[complex]) -> list[str]:
    """Return (s + c) of every real root, then (s² + c1 s + c0) of every complex pair."""
    pairs = [_factor(-2 * r.real, abs(r) ** 2) for r in roots if r.imag]
    return [*(_factor(-r.real) for r in roots if not r.imag), *pairs]


def upper_half(roots: ArrayLike) -> list[complex]:
    """Return roots without the lower one of each conjugate pair, smallest first."""
    return sorted((complex(r) for r in np.atleast_1d(np.asarray(roots)) if r.imag >= 0), key=abs)


def _factor(*coefficients: float) -> str:
    """Write s + c, or s² + c1 s + c0, in brackets."""
    powers = ("",) if len(coefficients) == 1 else (" s", "")
    terms = [
        f" {'-' if c < 0 else '+'} {number(abs(c), 4)}{s}"
        for c, s in zip(coefficients, powers, strict=True)
        if c
    ]
    text = ("s", "s²")[len(coefficients) - 1] + "".join(terms)
    return f"({text})" if terms else text
