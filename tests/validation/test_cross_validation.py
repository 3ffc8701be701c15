"""What is said of the errors at points that were left out."""

import numpy as np

from greybox.validation.cross_validation import FREQUENCIES, _verdicts


def test_of_few_frequencies_sizes_are_told_of_every_pair_once():
    """Too few for a test of Student's t."""
    omega, labels = np.array([1.0, 2.0, 3.0]), ("a", "b", "c")
    said = _verdicts([np.full(3, size) for size in (0.1, 0.2, 0.3)], labels, omega, FREQUENCIES)
    assert said == [
        "a and b predict left-out frequencies to 10 % and 20 % rms.",
        "a and c predict left-out frequencies to 10 % and 30 % rms.",
        "b and c predict left-out frequencies to 20 % and 30 % rms.",
    ]
