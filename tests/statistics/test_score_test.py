"""Scores of parts with columns of their own, against all columns in one block-diagonal matrix."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from greybox.statistics.score_test import correlated_score


def test_parts_with_columns_of_their_own_are_one_block_diagonal_matrix():
    random = np.random.default_rng(0)
    blocks = []
    for rows, columns in ((20, 3), (30, 5), (16, 2)):
        residuals = np.cumsum(random.normal(size=(2 * rows, 1)), axis=0)
        blocks.append((residuals, random.normal(size=(2 * rows, columns)), (rows, rows)))
    whole = (
        np.vstack([residuals for residuals, *_ in blocks]),
        block_diag(*(columns for _, columns, _ in blocks)),
        sum((lengths for *_, lengths in blocks), ()),
    )
    # Errors that are larger beyond a row do so in each run of neighbors, in both forms.
    assert correlated_score(blocks) == pytest.approx(correlated_score([whole]), rel=1e-9)
    assert correlated_score(blocks)[1] == 10
