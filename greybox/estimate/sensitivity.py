"""Which part of the data tells of each parameter: the band of frequencies, or the time of a flight."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.files.arrays import Array
from greybox.files.text_table import counted, number, one_line, text_table

INNER = 0.8  # of what is told of a parameter: the smallest stretch that holds it is named


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What each point of one part of a fit tells of each free parameter. Printing it gives the band that tells most.

    Shares are those of all data of the fit, for independent errors: with J the Jacobian of its
    weighted residuals and (JᵀJ)⁻¹ = [c₁ c₂ ...], point i has the share |Jᵢ cⱼ|² / Σ |J cⱼ|² in what
    is told of parameter j with the others estimated along, and |Jᵢⱼ|² / Σ |Jⱼ|² with the others
    known.

    Attributes
    ----------
    names : tuple of str
        The free parameters.
    outputs : tuple of str
        Of a record those that were compared, of a response the one.
    unit : str
        Of `at`: "rad/s", "s", or "row" of rows without a time.
    at : (m,) array
        The frequencies, sorted; of a record the middle of equal parts of it.
    shares, alone : (p, outputs, m) arrays
        With the others estimated along, and known. NaN for a parameter that the data do not
        determine, or at a bound.
    """

    names: tuple[str, ...]
    outputs: tuple[str, ...]
    unit: str
    at: Array
    shares: Array
    alone: Array

    def band(self, name: str, share: float = INNER) -> tuple[float, float]:
        """Return the narrowest stretch of `at` that holds this share of what this part tells of a parameter."""
        along = self.shares[self.names.index(name)].sum(axis=0)
        total = along.sum()
        if not total > 0:
            return np.nan, np.nan
        reached = np.concatenate([[0.0], np.cumsum(along)]) / total
        ends = np.searchsorted(reached, reached[:-1] + share * (1 - 1e-9))
        starts = np.flatnonzero(ends < len(reached))
        scale = np.log(self.at) if self.unit == "rad/s" else self.at
        first = starts[np.argmin(scale[ends[starts] - 1] - scale[starts])]
        return float(self.at[first]), float(self.at[ends[first] - 1])

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.names), "parameter"), counted(len(self.at), "point"))

    def __str__(self) -> str:
        rows = []
        for name, shares in zip(self.names, self.shares, strict=True):
            low, high = self.band(name)
            by_output = [
                f"{output} {number(100 * part, 2)} %"
                for output, part in zip(self.outputs, shares.sum(axis=1), strict=True)
            ]
            band = (
                "not determined"
                if np.isnan(low)
                else f"{number(low, 3)} to {number(high, 3)} {self.unit}"
            )
            rows.append([name, band, ", ".join(by_output)])
        head = ["parameter", f"{100 * INNER:.0f} % of it within", "share of all that is told"]
        return text_table(head, rows, left=(0, 1, 2))


def sensitivity(
    names: Sequence[str],
    outputs: Sequence[str],
    unit: str,
    at: Array,
    information: Array,
    alone: Array,
) -> Sensitivity:
    """Return the sensitivity from shares (p, outputs x m), points in the order of `at` (m,)."""
    order = np.argsort(at, kind="stable")
    shares, apart = (
        values.reshape(len(names), len(outputs), len(at))[:, :, order]
        for values in (information, alone)
    )
    return Sensitivity(tuple(names), tuple(outputs), unit, at[order], shares, apart)
