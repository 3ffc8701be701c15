"""Numbers and assignments on the command line."""

import argparse

import pytest

from greybox.cli.options import UsageError, assignments, nonnegative, positive


def test_integers():
    assert (positive("20"), nonnegative("0")) == (20, 0)
    for text in ("0", "-3", "1.5", "many", "", "²"):
        with pytest.raises(argparse.ArgumentTypeError, match="not an integer of at least 1"):
            positive(text)
    for text in ("-1", "x", "٣"):
        with pytest.raises(argparse.ArgumentTypeError, match="not an integer of at least 0"):
            nonnegative(text)


def test_assignments():
    assert assignments(["a5=0.16", "T=-1e-3"], "--fix") == {"a5": 0.16, "T": -1e-3}
    for word in ("a5", "a5=", "a5=x", "=", "a5:3"):
        with pytest.raises(UsageError, match=r"--fix .* is not understood: write NAME=VALUE"):
            assignments([word], "--fix")
