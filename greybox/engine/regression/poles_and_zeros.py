"""Poles and zeros: how they are written, and pairs that nearly cancel."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from greybox.data.files.numbers_in_text import number
from greybox.modeling.factored_form import upper_half


@dataclass(frozen=True)
class NearPair:
    """A zero and a pole, rad/s, and their `distance` |zero - pole| / max(|zero|, |pole|)."""

    zero: complex
    pole: complex
    distance: float

    @property
    def stable(self) -> bool:
        """Whether both are in the open left half plane; only then may they be canceled."""
        return self.zero.real < 0 and self.pole.real < 0

    def __str__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        pair = f"zero {root_text(self.zero)} and pole {root_text(self.pole)}"
        return f"{kind} {pair}, {100 * self.distance:.2g} % apart"


def near_pairs(zeros: ArrayLike, poles: ArrayLike) -> tuple[NearPair, ...]:
    """Match zeros and poles closer than a tenth of their size, each used once, the closest first.

    Complex ones are matched in the upper half plane, one `NearPair` for a conjugate pair. Since the
    distance is relative, a zero near the origin does not cancel an integrator unless it is zero
    itself.
    """
    free_zeros = upper_half(zeros)
    free_poles = upper_half(poles)
    # A zero and an integrator are 0 apart.
    candidates = [
        NearPair(z, p, abs(z - p) / max(abs(z), abs(p), 1e-300))
        for z in free_zeros
        for p in free_poles
    ]
    matched: list[NearPair] = []
    # The closest pair first: a zero between two poles cancels the nearer one.
    for pair in sorted(candidates, key=lambda pair: pair.distance):
        # Then a pole and a zero nearly cancel. A real pair (s + z) / (s + p) at this distance
        # changes the response by at most about 10 % at any frequency. The paper gives no number.
        if pair.distance < 0.1 and pair.zero in free_zeros and pair.pole in free_poles:
            matched.append(pair)
            free_zeros.remove(pair.zero)
            free_poles.remove(pair.pole)
    return tuple(matched)


def root_text(root: complex) -> str:
    """Write a root, for a complex pair as ``-1 ± 2j``."""
    return number(root.real, 4) + (f" ± {number(root.imag, 4)}j" if root.imag else "")
