"""Fits beside errors of several kinds, against weighted least squares and simulated errors."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import f

from greybox.statistics.beta_share import chance
from greybox.statistics.restricted_likelihoods import (
    Block,
    Remainder,
    correlated_fits,
    p_values_of_fits,
)
from greybox.statistics.score_statistics import score_tests


def blocks():
    """Yield the residuals, the columns, and the numbers of neighboring rows of three parts."""
    random = np.random.default_rng(0)
    for rows, columns in ((20, 3), (30, 5), (16, 2)):
        residuals = np.cumsum(random.normal(size=(2 * rows, 1)), axis=0)
        yield Block(residuals, random.normal(size=(2 * rows, columns)), (rows, rows))


def test_a_term_beside_what_a_fit_absorbs_is_judged_as_by_least_squares_in_any_unit():
    random = np.random.default_rng(0)
    columns, terms = random.normal(size=(60, 4)), random.normal(size=(60, 5))
    # Of the last one, the fit can absorb all but 0.5 %.
    terms[:, 4] = columns.sum(axis=1) + 0.005 * terms[:, 4]
    y = random.normal(size=60) + 0.3 * terms[:, 0]
    basis = np.linalg.qr(columns)[0]
    y = y - basis @ (basis.T @ y)
    for unit in (1e-9, 1.0, 1e9):
        decrease, p_value, factor, _ = score_tests(y, basis, unit * terms)
        assert np.isnan(p_value).tolist() == [False] * 4 + [True]
        for k in range(4):
            both = np.column_stack([columns, unit * terms[:, k]])
            found = np.linalg.lstsq(both, y)[0]
            left, squares = np.sum((y - both @ found) ** 2), y @ y
            assert factor[k] == pytest.approx(found[-1], rel=1e-6)
            assert decrease[k] == pytest.approx(60 * (1 - left / squares), rel=1e-6)
            assert p_value[k] == pytest.approx(f.sf((squares / left - 1) * 55, 1, 55), rel=1e-6)


def test_parts_with_columns_of_their_own_are_one_block_diagonal_matrix():
    parts = [*blocks()]
    whole = Block(
        np.vstack([part.residuals for part in parts]),
        block_diag(*[part.fitted for part in parts]),
        sum([part.lengths for part in parts], ()),
    )
    # Errors that are larger in a band are so in each run of neighbors, in both forms.
    fits = correlated_fits(parts)
    assert fits.squares == pytest.approx(correlated_fits([whole]).squares, rel=1e-9)
    assert fits.numbers == 132 - 10
    assert p_values_of_fits(fits, fits) == pytest.approx([1.0])


def test_white_errors_and_larger_ones_at_the_end_are_weighted_least_squares():
    block = next(blocks())
    residuals, columns = block.residuals, block.fitted
    term = np.random.default_rng(1).normal(size=(40, 1))
    fits = correlated_fits([block], term)
    logs = []
    for kind, size in ((0, np.ones(40)), (-1, np.where(np.arange(40) % 20 < 18, 1.0, 50**0.5))):
        basis = np.linalg.qr(columns)[0]
        weighted = np.hstack([basis, term]) / size[:, None]
        y = residuals[:, 0] / size
        left = y - weighted @ np.linalg.lstsq(weighted, y)[0]
        assert fits.squares[kind, 1] == pytest.approx(left @ left, rel=1e-9)
        information = np.linalg.slogdet(weighted.T @ weighted)[1] + 2 * np.sum(np.log(size))
        logs.append(information + 36 * np.log(left @ left))
    assert fits.numbers.tolist() == [37, 36]
    assert fits.scores[0, 1] - fits.scores[-1, 1] == pytest.approx(logs[0] - logs[1], rel=1e-9)


def test_each_of_several_terms_is_judged_as_if_it_were_the_only_one():
    block = next(blocks())
    terms = np.random.default_rng(1).normal(size=(40, 3))
    together = correlated_fits([block], terms)
    for k in range(3):
        alone = correlated_fits([block], terms[:, [k]])
        for name in ("squares", "scores", "numbers"):
            value, expected = getattr(together, name), getattr(alone, name)
            assert value[..., [0, 1 + k]] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("walks", "size", "is_likely"), [(0, 2, False), (0, 0, True), (1, 0, True)]
)
def test_a_term_explains_what_errors_that_walk_do_not(walks, size, is_likely):
    random, rows = np.random.default_rng(2), np.linspace(-1, 1, 24)
    term, ones = np.tile(rows**2, 2)[:, None], np.ones((48, 1))
    likely = 0
    for _ in range(20):
        errors = random.normal(size=(2, 24))
        errors = (np.cumsum(errors, axis=1) if walks else errors).reshape(-1, 1)
        fits = correlated_fits([Block(errors + 2 * size * term, ones, (24, 24))], term)
        likely += p_values_of_fits(fits, fits)[1] > 0.01
    assert likely >= 18 if is_likely else likely <= 2


def test_white_errors_are_as_likely_as_all_other_kinds_before_the_data():
    """With equal likelihoods, half of the mean is the probability in white errors."""
    before = Remainder(np.ones((3, 1)), np.zeros((3, 1)), np.array([20.0]))
    left = np.array([[0.4], [1.0], [1.0]])
    beside = Remainder(left, np.zeros((3, 1)), np.array([19.0]))
    white = chance(0.4, 19.0)
    assert p_values_of_fits(before, beside) == pytest.approx([(white + 1) / 2])
