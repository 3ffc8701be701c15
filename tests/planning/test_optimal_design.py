"""Shares of a test's time, against what can be worked out by hand and by trying."""

import numpy as np
import pytest

from greybox.planning.optimal_design import shares, time_needed


def test_two_frequencies_that_tell_of_one_parameter_each():
    informations = np.array([np.diag([1.0, 0.0]), np.diag([0.0, 4.0])])
    found = shares(informations, np.ones(2))
    assert found == pytest.approx([0.8, 0.2], abs=1e-4)  # 1 / w = 1 / (4 (1 - w))
    assert time_needed(np.tensordot(found, informations, 1), np.ones(2)) == pytest.approx(1.25, rel=1e-4)


@pytest.mark.parametrize("matters", [3, 2])
def test_no_other_shares_are_better(matters):
    random = np.random.default_rng(0)
    slopes = random.normal(size=(8, 2, 3))
    informations = np.einsum("kai,kaj->kij", slopes, slopes)
    wanted = np.where(np.arange(3) < matters, [0.5, 1.0, 2.0], np.inf)
    found = shares(informations, wanted)
    best = time_needed(np.tensordot(found, informations, 1), wanted)
    others = random.dirichlet(np.full(8, 0.3), size=3000)
    near = 0.98 * found + 0.02 * others
    for tried in (*others, *near):
        assert time_needed(np.tensordot(tried, informations, 1), wanted) > best * (1 - 1e-5)
