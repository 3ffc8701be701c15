"""Shares of a test's time, against what can be worked out by hand and by trying."""

import numpy as np
import pytest

from greybox.workflows.experiment.optimal_design import require_determined, shares, time_needed


@pytest.mark.parametrize("ratio", [0.3, 4.0, 9.0, 100.0])
def test_two_frequencies_that_tell_of_one_parameter_each(ratio):
    informations = np.array([np.diag([1.0, 0.0]), np.diag([0.0, ratio])])
    both = np.array([True, True])
    found = shares(informations, both)
    best = ratio / (1 + ratio)  # 1 / w = 1 / (ratio (1 - w))
    assert found == pytest.approx([best, 1 - best], abs=1e-4)
    needed = time_needed(np.tensordot(found, informations, 1), both)
    assert needed == pytest.approx(1 / best, rel=1e-4)


@pytest.mark.parametrize("wanted", [3, 2])
def test_no_other_shares_are_better(wanted):
    random = np.random.default_rng(0)
    slopes = random.normal(size=(8, 2, 3))
    informations = np.einsum("kai,kaj->kij", slopes, slopes) * np.outer([0.5, 1, 2], [0.5, 1, 2])
    matters = np.arange(3) < wanted
    found = shares(informations, matters)
    best = time_needed(np.tensordot(found, informations, 1), matters)
    others = random.dirichlet(np.full(8, 0.3), size=3000)
    near = 0.98 * found + 0.02 * others
    for tried in (*others, *near):
        assert time_needed(np.tensordot(tried, informations, 1), matters) > best * (1 - 1e-5)


def test_the_time_is_that_of_the_parameters_that_matter():
    information = np.array([[4.0, 1.0], [1.0, 2.0]])
    variance = np.diag(np.linalg.inv(information))
    for matters, needed in (([True, False], variance[0]), ([True, True], max(variance))):
        assert time_needed(information, np.array(matters)) == pytest.approx(needed)


@pytest.mark.parametrize(("apart", "told"), [(4e-10, True), (0.5e-10, False)])
def test_parameters_that_differ_by_rounding_are_not_told_apart(apart, told):
    """With unit diagonal the smallest eigenvalue is the difference; sizes of the parameters do not matter."""
    size = np.outer([1e4, 1e-3, 7.0], [1e4, 1e-3, 7.0])
    information = np.array([[1.0, 1 - apart, 0.0], [1 - apart, 1.0, 0.0], [0.0, 0.0, 1.0]]) * size
    if told:
        require_determined(information, ["a", "b", "c"])
    else:
        with pytest.raises(
            ValueError,
            match=r"^no sine in this band separates a, b: fix one of them, or choose another band\.$",
        ):
            require_determined(information, ["a", "b", "c"])


def test_a_silent_parameter_is_named():
    with pytest.raises(
        ValueError,
        match=r"^no sine in this band has information on b: fix it, or choose another band\.$",
    ):
        require_determined(np.diag([1.0, 0.0]), ["a", "b"])
