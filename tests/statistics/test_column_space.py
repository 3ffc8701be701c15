"""The space of columns against projections by least squares."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from greybox.statistics.column_space import beside, column_basis, pseudo_inverse


def test_the_basis_projects_as_least_squares_do():
    """Of columns of whatever lengths, one of them zero and one the sum of two others."""
    random = np.random.default_rng(0)
    columns = random.normal(size=(12, 3))
    every = np.column_stack(
        [
            1e9 * columns[:, 0],
            np.zeros(12),
            1e-9 * columns[:, 1],
            columns[:, 2],
            columns[:, :2].sum(1),
        ]
    )
    basis = column_basis(every)
    assert basis.shape == (12, 3)
    assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
    y = random.normal(size=12)
    assert_allclose(basis @ (basis.T @ y), columns @ np.linalg.lstsq(columns, y, rcond=None)[0])


@pytest.mark.parametrize(("apart", "rank"), [(4e-9, 2), (0.4e-9, 1)])
def test_columns_that_differ_by_rounding_are_one(apart, rank):
    """Of unit length and an angle apart, the singular values are √2 and the angle over √2."""
    assert column_basis(np.array([[1.0, 1.0], [0.0, apart], [0.0, 0.0]])).shape == (3, rank)


def test_without_columns_there_is_nothing():
    assert column_basis(np.zeros((4, 0))).shape == (4, 0)
    assert column_basis(np.zeros((4, 2))).shape == (4, 0)


def test_nothing_remains_of_columns_that_lie_in_the_space():
    time = np.linspace(0, 1, 200)
    lines = np.vander(time, 2)
    left = beside(np.column_stack([3e6 - 2 * time, 1e-9 * time, time**2]), lines)
    assert not left[:, :2].any()
    assert_allclose(lines.T @ left[:, 2], 0, atol=1e-12)
    assert np.linalg.norm(left[:, 2]) > 0.1


def test_directions_that_are_not_seen_have_no_inverse():
    random = np.random.default_rng(0)
    size = np.array([1e3, 1.0, 1e-4])
    J = random.normal(size=(6, 3)) * size
    assert_allclose(pseudo_inverse(J.T @ J, 1e-9), np.linalg.inv(J.T @ J), rtol=1e-9)
    J[:, 1] = 0
    found = pseudo_inverse(J.T @ J, 1e-9)
    assert np.all(found[1] == 0)
    seen = np.ix_([0, 2], [0, 2])
    assert_allclose(found[seen], np.linalg.inv((J.T @ J)[seen]), rtol=1e-9)
