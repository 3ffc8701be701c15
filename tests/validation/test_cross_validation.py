"""What is said of the errors at points that were left out."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from greybox.validation.comparison import p_text
from greybox.validation.cross_validation import FREQUENCIES, PARTS, _verdicts


def test_of_few_frequencies_sizes_are_told_of_every_pair_once():
    """Too few for a test of Student's t."""
    omega, labels = np.array([1.0, 2.0, 3.0]), ("a", "b", "c")
    said = _verdicts([np.full(3, size) for size in (0.1, 0.2, 0.3)], labels, omega, FREQUENCIES)
    assert said == [
        "a and b predict left-out frequencies to 10 % and 20 % rms.",
        "a and c predict left-out frequencies to 10 % and 30 % rms.",
        "b and c predict left-out frequencies to 20 % and 30 % rms.",
    ]


@pytest.mark.parametrize("swapped", [False, True])
def test_more_frequencies_are_tested_by_students_t_of_their_means(swapped):
    """Two points at every frequency, of which the mean counts once."""
    random = np.random.default_rng(0)
    omega = np.tile(np.arange(1.0, 9.0), 2)
    good, bad = 0.05 * random.uniform(0.5, 1, 16), 0.05 * random.uniform(1.2, 2, 16)
    bad[[0, 8]] = 0.01
    errors, labels = ([bad, good], ("b", "g")) if swapped else ([good, bad], ("g", "b"))
    (said,) = _verdicts(errors, labels, omega, FREQUENCIES)
    difference = (bad - good).reshape(2, 8).mean(axis=0)
    p = ttest_1samp(difference, 0).pvalue
    assert p < 0.05
    sizes = [f"{100 * np.sqrt(np.mean(e**2)):.3g} %" for e in (good, bad)]
    assert said == (
        f"g predicts left-out frequencies better than b, to {sizes[0]} rms against {sizes[1]}, at "
        f"{np.sum(difference > 0)} of 8 frequencies ({p_text(p)})."
    )


def test_no_difference_and_failed_fits_are_told():
    random = np.random.default_rng(1)
    omega = np.arange(1.0, 6.0)
    one, other = random.uniform(0.1, 0.2, (2, 5))
    p = ttest_1samp(other - one, 0).pvalue
    assert p > 0.05
    sizes = [f"{100 * np.sqrt(np.mean(e**2)):.3g} %" for e in (one, other)]
    failed = np.full(5, np.nan)
    assert _verdicts([one, other, failed], ("a", "b", "c"), omega, PARTS) == [
        "It cannot be told which of a and b predicts responses that were left out better: "
        f"{sizes[0]} and {sizes[1]} rms ({p_text(p)}).",
        "c could not be fitted without some of the points.",
        "c could not be fitted without some of the points.",
    ]
