"""Numbers and assignments on the command line."""

import argparse

import pytest

from greybox.cli.options import (
    UsageError,
    as_options,
    assignments,
    intervals,
    nonnegative,
    positive,
    positive_number,
    probability,
    uncertain_values,
)


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


def test_probabilities_and_times():
    assert (probability("0.25"), positive_number("1e-9"), positive_number("90")) == (
        0.25,
        1e-9,
        90.0,
    )
    for text in ("0", "1", "-0.1", "nan", "x"):
        with pytest.raises(
            argparse.ArgumentTypeError, match="is not a probability between 0 and 1"
        ):
            probability(text)
    for text in ("0", "-1", "inf", "nan", "x"):
        with pytest.raises(argparse.ArgumentTypeError, match="is not a number above 0"):
            positive_number(text)


def test_intervals_and_uncertain_values():
    assert intervals(["a=-10:1e3", "b=0:", "c=:-2"], "--bounds") == {
        "a": (-10.0, 1000.0),
        "b": (0.0, float("inf")),
        "c": (-float("inf"), -2.0),
    }
    assert uncertain_values(["a=-3.2+-0.1", "b=1e3±20"], "--prior") == {
        "a": (-3.2, 0.1),
        "b": (1000.0, 20.0),
    }
    for word in ("a", "a=1", "=1:2", "a=x:1", "a=1:2:3"):
        with pytest.raises(
            UsageError,
            match=r"--bounds .* is not understood: write NAME=LOW:HIGH, e\.g\. a1=-10:10",
        ):
            intervals([word], "--bounds")
    for word in ("a", "a=1", "a=1+-", "a=1+-2+-3"):
        with pytest.raises(
            UsageError, match=r"--prior .* is not understood: write NAME=VALUE\+-SIGMA"
        ):
            uncertain_values([word], "--prior")


@pytest.mark.parametrize(
    ("text", "option"),
    [
        ("settle=-1 must be", "--settle -1 must be"),
        ("give open_loop=True.", "give --open-loop."),
        ("band=... chooses another", "--band chooses another"),
        ("give input=u=MESSAGE.Field.", "give --input u=MESSAGE.Field."),
        ("K=2 and settled=3", "K=2 and settled=3"),
        ("settle = 2 s", "settle = 2 s"),
    ],
)
def test_arguments_become_options(text, option):
    options = argparse.Namespace(settle=2.0, open_loop=False, band=[], input="")
    assert as_options(text, options) == option
