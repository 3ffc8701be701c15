"""The probabilities of terms of responses, whose errors may be correlated along frequency."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from greybox.assessment.misfit.group import Candidate, Group
from greybox.assessment.misfit.ranking import Tested
from greybox.assessment.misfit.regression import Regression
from greybox.assessment.misfit.response_regression import STEP
from greybox.assessment.misfit.term import ResponseTerm, Wording
from greybox.data.files.arrays import Array
from greybox.statistics.restricted_likelihoods import Block, correlated_fits, p_values_of_fits

NO_TERM = ResponseTerm(Wording(""), values=np.zeros(1, dtype=complex))
# A step or two suffice where values are near the common ones; of resonances a factor of 20 apart, p
# falls from 0.4 without a step to 1e-38 with five. Frequency and damping of a term take ten.
STEPS = 10
ENOUGH = 0.3  # change of the log likelihood at the end, far below what is significant


def p_values_of_responses(
    group: Group, determined: Array, tested: Sequence[Tested], numbers: Sequence[int]
) -> tuple[list[float], float]:
    """Return the probabilities of terms, and of values common to all parts.

    Terms that may be significant, allowing for the numbers of terms that are tried, are fitted
    unless they are to first order. The fit can change the parameters in the directions `determined`
    (d, k).
    """
    parts = group.parts
    block = Block(group.residuals, group.fitted, _lengths(parts))
    fits = correlated_fits([block], *[test.column for test in tested])
    p_values, p_common = p_values_of_fits(fits, fits)[1:], 1.0
    whole = np.eye(len(determined))
    if len(parts) > 1 or determined.shape != whole.shape:
        # Other values may be far from the common ones: each part is fitted by itself.
        apart = correlated_fits([_refitted([part], whole) for part in parts if part.again])
        [p_common] = p_values_of_fits(fits, apart)

    for k, test in enumerate(tested):
        if parts[0].level < numbers[k] * p_values[k] < 1:
            again = _refitted(parts, determined, test.candidate)
            [p_value] = p_values_of_fits(fits, correlated_fits([again]))
            # A fit of q numbers counts as q terms.
            q = again.fitted.shape[1] - group.fitted.shape[1]
            p_values[k] = min(p_values[k], p_value / q)
    return p_values, p_common


def _refitted(
    parts: Sequence[Regression], determined: Array, candidate: Candidate | None = None
) -> Block:
    """Return responses that are fitted again, with a term.

    The levels of the term are fitted, too: a mode has its own frequency and damping.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    by_part = candidate.by_part if candidate else [None] * len(parts)
    fits = [
        (part.again, term if isinstance(term, ResponseTerm) else NO_TERM)
        for part, term in zip(parts, by_part, strict=True)
        if part.again
    ]
    (d, k), start, lengths = determined.shape, fits[0][1].start, _lengths(parts)

    @lru_cache(1)
    def table(*values: float) -> Array:
        # The numbers of the term, and the next ones.
        numbers = np.array(values[k:]) + STEP * np.eye(start.size + 1, start.size, -1)
        blocks = []
        for again, term in fits:
            factors = np.array([term.factor(row) for row in numbers])
            blocks.append(again(determined @ values[:k], factors))
        rows = np.vstack(blocks)
        return np.hstack([rows[:, :1], rows[:, 1 : d + 1] @ determined, rows[:, d + 1 :]])

    # The method of Levenberg and Marquardt, which needs as many rows as unknowns, may begin with
    # long steps.
    fit = least_squares(
        lambda values: table(*values)[:, 0],
        np.append(np.zeros(k), start),
        lambda values: table(*values)[:, 1:],  # pyright: ignore[reportArgumentType]
        method="lm" if k + start.size <= sum(lengths) else "trf",
        x_scale="jac",
        max_nfev=STEPS,
        ftol=ENOUGH / sum(lengths),
    )
    return Block(fit.fun[:, None], np.hstack([fit.jac, known_columns(parts)]), lengths)


def known_columns(parts: Sequence[Regression]) -> Array:
    """Return the columns (N, e) of all parts that no other part has."""
    from scipy.linalg import block_diag  # noqa: PLC0415  (slow to import)

    known = [part.residuals[:, :0] if part.known is None else part.known for part in parts]
    return np.asarray(block_diag(*known), float)


def _lengths(parts: Sequence[Regression]) -> list[int]:
    """Return the numbers of rows of all pieces in which neighbors may be correlated."""
    lengths = []
    for part in parts:
        if len(part.residuals):
            lengths += [len(part.residuals) // part.pieces] * part.pieces
    return lengths
