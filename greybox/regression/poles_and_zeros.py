"""Poles and zeros: the factored form of (3.18), and pairs that nearly cancel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from greybox.files.text_table import number

# Relative distance below which a pole and a zero nearly cancel. A real pair (s + z) / (s + p) at
# this distance changes the response by at most about 10 % at any frequency. The paper gives no
# number.
NEAR = 0.1


@dataclass(frozen=True)
class NearPair:
    """A zero and a pole, rad/s, and their `distance` |zero - pole| / max(|zero|, |pole|)."""

    zero: complex
    pole: complex
    distance: float

    @property
    def stable(self) -> bool:
        """Whether both are in the open left half plane; only then may they be cancelled."""
        return self.zero.real < 0 and self.pole.real < 0

    def __str__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        pair = f"zero {root_text(self.zero)} and pole {root_text(self.pole)}"
        return f"{kind} {pair}, {100 * self.distance:.2g} % apart"


def near_pairs(zeros: ArrayLike, poles: ArrayLike) -> tuple[NearPair, ...]:
    """Match zeros and poles that are closer than `NEAR`, each used once, the closest first.

    Complex ones are matched in the upper half plane, one `NearPair` for a conjugate pair. Since the
    distance is relative, a zero near the origin does not cancel an integrator unless it is zero
    itself.
    """
    free_zeros = upper_half(zeros)
    free_poles = upper_half(poles)
    sizes = [(z, p, max(abs(z), abs(p))) for z in free_zeros for p in free_poles]
    candidates = [NearPair(z, p, abs(z - p) / size if size else 0.0) for z, p, size in sizes]
    matched: list[NearPair] = []
    # The closest pair first: a zero between two poles cancels the nearer one.
    for pair in sorted(candidates, key=lambda pair: pair.distance):
        if pair.distance < NEAR and pair.zero in free_zeros and pair.pole in free_poles:
            matched.append(pair)
            free_zeros.remove(pair.zero)
            free_poles.remove(pair.pole)
    return tuple(matched)


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


def root_text(root: complex) -> str:
    """Write a root, for a complex pair as ``-1 ± 2j``."""
    return number(root.real, 4) + (f" ± {number(root.imag, 4)}j" if root.imag else "")
