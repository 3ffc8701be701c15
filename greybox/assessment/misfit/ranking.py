"""The best term of every family, by score tests."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from greybox.assessment.misfit.group import Candidate, Group
from greybox.assessment.misfit.term import Family
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.beta_share import TINY
from greybox.statistics.column_space import outside
from greybox.statistics.score_statistics import joint_test

# Terms that are tested together with the color of the errors.
BEST = 12
# Numbers in columns at once: with all 1059 terms of a chain of eight states in memory, a test takes
# a quarter more time and 370 MB.
AT_ONCE = 100_000


@frozen
class Tested:
    """A missing term after its test.

    Attributes
    ----------
    candidate : Candidate
    effects : (N, q) array
        What the term would add to the residuals, in columns that are tested together.
    column : (N, 1) array
        Their best combination.
    decrease, p_white, factor, error : float
        The decrease of the sum of squares, its probability if errors are white, and the factor on
        the column with its standard error, see `score_tests`.
    """

    candidate: Candidate
    effects: Array
    column: Array
    decrease: float
    p_white: float
    factor: float
    error: float


def ranked(group: Group, candidates: Sequence[Candidate]) -> tuple[Counter[Family], list[Tested]]:
    """Return the number of terms that are no functions by family, and the best of each."""
    best = dict[Family, Tested]()
    tried = Counter[Family]()
    plain = [candidate for candidate in candidates if not candidate.knots]
    size = AT_ONCE // (len(group.residuals) + 1) + 1
    for first in range(0, len(plain), size):
        chosen = plain[first : first + size]
        columns = group.columns(chosen)
        tests, end = group.score_tests(columns).tolist(), 0
        for candidate in chosen:
            begin, end = end, end + candidate.term.columns
            # The probability is NaN where nothing of a term is left.
            if not all(p_value <= 1 for _, p_value, _, _ in tests[begin:end]):
                continue
            family, decrease = candidate.label.family, sum(test[0] for test in tests[begin:end])
            tried[family] += candidate.term.columns * candidate.term.count
            # Of two records, either may have a value of its own: the first has, not rounding.
            if family not in best or decrease > best[family].decrease * (1 + 1e-9):
                effects, (_, *numbers) = columns[:, begin:end], tests[begin]
                best[family] = Tested(candidate, effects, effects, decrease, *numbers)

    tested = [
        tested_together(group, test.candidate, test.effects) if test.effects.shape[1] > 1 else test
        for test in best.values()
    ]
    return tried, sorted(tested, key=lambda test: -round(test.decrease, 9))[:BEST]


def tested_together(group: Group, candidate: Candidate, columns: Array) -> Tested:
    """Return the test of columns (N, c) together, and their best combination as one term.

    The factors of the columns in it have unit length, so that its factor is as large as theirs.
    """
    white = group.white(columns)
    p_value, directions = joint_test(group.white_residuals[:, 0], group.basis, white)
    factors = directions @ directions.T @ white.T @ outside(group.white_residuals, group.basis)
    column = columns @ factors / (np.linalg.norm(factors) + TINY)
    [(decrease, _, factor, error)] = group.score_tests(column).tolist()
    return Tested(candidate, columns @ directions, column, decrease, p_value, factor, error)
