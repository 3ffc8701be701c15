"""The misfit of all records, or of all responses."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.misfit.answer import EXACT, FALSE_ALARMS, LARGE, Cause, Misfit
from greybox.assessment.misfit.functions import missing_functions
from greybox.assessment.misfit.group import Group, candidates_of
from greybox.assessment.misfit.ranking import Tested, ranked
from greybox.assessment.misfit.response_tests import known_columns, p_values_of_responses
from greybox.assessment.misfit.shape import shape_of
from greybox.assessment.misfit.term import Family, RecordTerm
from greybox.data.files.arrays import Array, sum_of_squares, unit_length
from greybox.statistics.beta_share import TINY
from greybox.statistics.column_space import beside, column_basis, outside, triangle_of
from greybox.statistics.score_statistics import score_tests

TOGETHER = 5  # terms that together explain all of the misfit: more would fit noise
ALIKE = 0.95  # correlation of effects, beyond which data can hardly tell them apart
# Standard deviations of the squares of white residuals that a fitted filter predicts: with them, it
# is rare that the most colored of eleven outputs of 50 white samples looks colored.
BY_CHANCE = 3.0
KNOWN = 0.1  # share of the information, below which another group knows the values


def determined_values(groups: Sequence[Group]) -> list[Array]:
    """Return the combinations (d, k) of d parameters that each group may change.

    Combinations that the other group knows much better cannot excuse a misfit.
    """
    if len(groups) < 2:
        return [np.eye(group.fitted.shape[1]) for group in groups]

    rows = [
        group.white_fitted / (np.sqrt(np.mean(group.white_residuals**2)) + TINY) for group in groups
    ]
    # In directions that both determine equally well, whatever the units.
    unit = np.linalg.pinv(triangle_of(np.vstack(rows)))
    determined = []
    for each in rows:
        _, share, axes = np.linalg.svd(each @ unit, full_matrices=False)
        determined.append(unit @ axes[share**2 > KNOWN].T)
    return determined


def misfit_of_group(group: Group, determined: Array) -> Misfit:
    """Return the misfit of a group, whose fit can change the columns of `determined` (d, k)."""
    fitted = np.hstack([group.fitted @ determined, known_columns(group.parts)])
    group = replace(group, fitted=fitted)
    rows, columns = determined.shape
    candidates = candidates_of(group.parts, is_whole=rows == columns)
    tried, tested = ranked(group, candidates)
    numbers = np.array([_alternatives(tried, test) for test in tested], dtype=int)
    p_least = p_values = numbers * np.array([test.p_white for test in tested])
    p_common = 1.0
    if group.outputs:
        p_values = numbers * group.autoregressive_p_values([test.effects for test in tested])
        if min(p_values, default=1.0) > FALSE_ALARMS:
            missing, p_of_functions = missing_functions(group, candidates, tested)
            tested = missing + tested
            p_values = np.append(p_of_functions, p_values)
        p_least = p_values
    elif tested:
        p_of_terms, p_common = p_values_of_responses(group, determined, tested, numbers.tolist())
        p_values = numbers * np.array(p_of_terms)
        # Errors that are correlated may hide a term, or look like one.
        p_least = np.minimum(p_least, p_values)

    columns = np.hstack([group.residuals[:, :0], *[test.column for test in tested]])
    white = group.white(columns)
    shares, left, noise = _shares(group, tested, columns, white)
    causes = _causes(group, tested, white, np.array([shares, p_least, p_values]))
    return Misfit(
        left,
        noise,
        tried.total(),
        (*causes, *(cause for part in group.parts for cause in part.causes)),
        p_common,
        _drift(group),
        any(part.is_unstable for part in group.parts),
        shape_of(group, tested, causes),
        group.parts[0].level,
    )


def _alternatives(tried: Counter[Family], test: Tested) -> int:
    """Return how many terms such a one is the best of."""
    term, family = test.candidate.term, test.candidate.label.family
    # A bound is doubted more than what nobody thought of.
    if term.is_doubted:
        return tried[family]
    if isinstance(term, RecordTerm):
        return tried.total() * term.tries
    # Among responses, each family is as likely to be missing, whatever its number of terms.
    return len(tried) * tried[family]


def _causes(group: Group, tested: Sequence[Tested], white: Array, numbers: Array) -> list[Cause]:
    """Return the causes by tests, whose white columns are (M, c), with numbers (3, c).

    The numbers are the shares that they explain, and their probabilities without and with
    correlated errors.
    """
    described = [test.candidate.term.described(test.factor, test.error) for test in tested]
    alike = _alike(outside(white, group.basis), [text for text, _ in described])
    causes = []
    for k, test in enumerate(tested):
        (text, code), term = described[k], test.candidate.term
        share, p_value, p_correlated = np.minimum(numbers[:, k], 1).tolist()
        addition = term.addition if isinstance(term, RecordTerm) else None
        causes.append(
            Cause(
                text,
                code,
                test.factor,
                test.error,
                share,
                p_value,
                p_correlated,
                alike=alike[k],
                added=addition and (term.target, addition),
            )
        )
    return causes


def _drift(group: Group) -> float:
    """Return the largest share of the squares of an output that its earlier residuals predict.

    An output of too few samples is not tested.
    """
    shares = [0.0]
    for weights, stretches in zip(group.filters, group.outputs, strict=True):
        rows = np.concatenate(stretches)
        order = len(weights) - 1
        predicted = sum(max(len(places) - order, 0) for places in stretches)
        # A filter that was fitted to white residuals leaves less of these than of new ones.
        chance = order + BY_CHANCE * np.sqrt(2 * order)
        if predicted > 2 * chance:
            variance = predicted / (predicted - chance) / float(weights[0]) ** 2
            shares.append(1 - variance / (np.mean(group.residuals[rows] ** 2) + TINY))
    return float(max(shares))


def _shares(
    group: Group, tested: Sequence[Tested], columns: Array, white: Array
) -> tuple[Array, float, float]:
    """Return the shares of the misfit that terms explain, and those of the outputs that are left.

    They are what the model leaves of the squares of the outputs, and what noise would leave. The
    terms have columns (N, c), and white ones (M, c).
    """
    residuals = group.residuals
    without = sum_of_squares(beside(group.white_residuals, group.basis))
    likeliest = np.hstack([group.basis, white[:, :TOGETHER]])
    remainder = sum_of_squares(beside(group.white_residuals, likeliest))
    explained = len(white) * (1 - remainder / (without + TINY)) + TINY
    shares = np.array([test.decrease / explained for test in tested])

    measured = np.vstack([part.measured for part in group.parts])
    noise = beside(residuals, np.hstack([group.fitted, columns[:, :TOGETHER]]))
    # Perhaps only one of the outputs of a record follows a missing term.
    of_outputs = []
    for rows in [np.concatenate(stretches) for stretches in group.outputs] or [...]:
        squares = sum_of_squares(measured[rows]) + TINY
        left, least = (sum_of_squares(e[rows]) / squares for e in (residuals, noise))
        of_outputs.append((left, least))
    left, least = max(of_outputs, key=lambda pair: (pair[0] >= EXACT, pair[0] - pair[1]))
    if left > LARGE * least:
        # Residuals without noise are whitened by the spectrum of the misfit: slow parts count
        # little.
        basis = column_basis(group.fitted)
        alone = score_tests(residuals[:, 0], basis, columns)[0] / len(residuals)
        shares = np.maximum(shares, alone)
    return shares, left, least


def _alike(effects: Array, texts: Sequence[str]) -> list[tuple[str, ...]]:
    """Return for every term the texts of those whose effects (M, c) are nearly the same."""
    unit = unit_length(effects, 0)
    is_alike = np.abs(unit.T @ unit) > ALIKE
    # Terms of one name are one cause.
    return [
        tuple(
            [other for other, is_same in zip(texts, row, strict=True) if is_same and other != text]
        )
        for text, row in zip(texts, is_alike, strict=True)
    ]
