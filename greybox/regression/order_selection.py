"""The choice of the orders of a rational function, as in the paper: lowered until no stable pole and zero cancel."""

from dataclasses import dataclass
from typing import Any

from greybox.data.frequency_response import FrequencyResponse
from greybox.files.text_table import counted, number, one_line, text_table
from greybox.regression.levy import RationalFit, levy
from greybox.regression.poles_and_zeros import NEAR, NearPair, near_pairs


@dataclass(frozen=True, eq=False)
class OrderPath:
    """The `steps` of `order_path`, why each was left or is the last, and the distance below which a pair counts."""

    steps: tuple[RationalFit, ...]
    reasons: tuple[str, ...]
    tolerance: float = NEAR

    @property
    def pairs(self) -> tuple[tuple[NearPair, ...], ...]:
        """The nearly cancelling pairs of every step, stable or not."""
        return tuple(near_pairs(step.zeros, step.poles, self.tolerance) for step in self.steps)

    @property
    def fit(self) -> RationalFit:
        """Where the path ends."""
        return self.steps[-1]

    @property
    def orders(self) -> tuple[tuple[int, int], ...]:
        """(n, m) of every step."""
        return tuple((step.n, step.m) for step in self.steps)

    def __repr__(self) -> str:
        return one_line(
            self, counted(len(self.steps), "step"), f"ends at (n, m) = {self.orders[-1]}"
        )

    def __str__(self) -> str:
        marks = [""] * (len(self.steps) - 1) + [f"<- ends here: {self.reasons[-1]}"]
        stable = [sum(pair.stable for pair in pairs) for pairs in self.pairs]
        pair_counts = [
            (str(k), str(len(pairs) - k)) for k, pairs in zip(stable, self.pairs, strict=True)
        ]
        rows = [
            (
                *map(str, (step.n, step.m)),
                number(step.cost),
                number(step.aic, 4),
                *counts,
                mark or reason,
            )
            for step, counts, reason, mark in zip(
                self.steps, pair_counts, self.reasons, marks, strict=True
            )
        ]
        header = ("n", "m", "cost (4.26)", "AIC", "stable pairs", "unstable", "lowered because of")
        return text_table(header, rows, left=(6,)) + f"\nP(s) = {self.fit.factored}"


def order_path(
    data: FrequencyResponse,
    n: int,
    m: int,
    integrator: bool = False,
    *,
    tolerance: float = NEAR,
    unstable: bool = False,
    **options: Any,
) -> OrderPath:
    """Lower the orders from `n` and `m` until no stable pole and zero obviously cancel, as the paper does (section 3).

    Fit at the given orders. If a stable zero and a stable pole are closer than `tolerance`, or the
    equations are rank deficient (orders too high for noise-free data, where the place of the
    superfluous pair is arbitrary), lower both orders by one and fit again; otherwise, or at m = 0,
    stop. So n - m stays the same. The paper does not say how close is obvious; cost and AIC play no
    role, the table shows them for comparison. On the tables of the paper the rule does not lead to
    the paper's (4, 1): try several orders to begin with.

    Parameters
    ----------
    data, n, m, integrator, **options
        As for `levy`, with its `weight` and `iterations`; the highest orders to begin with.
    tolerance : float
        Relative distance |zero - pole| / max(|zero|, |pole|) below which a pair obviously cancels,
        in (0, 1].
    unstable : bool
        Whether unstable pairs count as well. The paper names stable ones only, since cancelling an
        unstable pole hides it; but a pair that fits the noise falls to either side of the axis by
        chance.

    Raises
    ------
    ValueError
        As `levy`, and for a tolerance out of range.
    """
    if not 0 < tolerance <= 1:
        raise ValueError(
            f"tolerance is {tolerance}: it is a relative distance, give a number above 0 and at most 1."
        )
    steps = [levy(data, n, m, integrator, **options)]
    reasons: list[str] = []
    while reason := _superfluous(steps[-1], tolerance, unstable):
        if steps[-1].m == 0:
            reason += ", but m is 0"
            break
        reasons.append(reason)
        steps.append(levy(data, steps[-1].n - 1, steps[-1].m - 1, integrator, **options))
    end = f"no {'' if unstable else 'stable '}pair within {100 * tolerance:g} %"
    return OrderPath(tuple(steps), (*reasons, reason or end), tolerance)


def _superfluous(fit: RationalFit, tolerance: float, unstable: bool) -> str:
    """Say why the orders are obviously too high; empty when they are not."""
    if not fit.determined:
        return "rank deficient"
    return next(
        (str(p) for p in near_pairs(fit.zeros, fit.poles, tolerance) if p.stable or unstable), ""
    )
