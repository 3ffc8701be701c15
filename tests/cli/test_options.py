"""Numbers and assignments on the command line."""

import argparse

import pytest

from greybox.cli.options import (
    KINDS,
    SHARED,
    UsageError,
    as_options,
    declare,
    option_words,
)


def test_integers():
    assert (KINDS["N"]("20"), KINDS["K"]("0")) == (20, 0)
    for text in ("0", "-3", "1.5", "many", "", "²"):
        with pytest.raises(argparse.ArgumentTypeError, match="not an integer of at least 1"):
            KINDS["N"](text)
    for text in ("-1", "x", "٣"):
        with pytest.raises(argparse.ArgumentTypeError, match="not an integer of at least 0"):
            KINDS["K"](text)


def parsed(words, text=SHARED):
    parser = argparse.ArgumentParser()
    declare(parser, text)
    return parser.parse_args(words.split())


def test_values_by_name():
    assert parsed("--fix a5=0.16 T=-1e-3").fix == {"a5": 0.16, "T": -1e-3}
    assert parsed("--bounds a=-10:1e3 b=0: c=:-2").bounds == {
        "a": (-10.0, 1000.0),
        "b": (0.0, float("inf")),
        "c": (-float("inf"), -2.0),
    }
    prior = "--prior NAME=VALUE+-SIGMA...\n    about"
    assert parsed("--prior a=-3.2+-0.1 b=1e3±20", prior).prior == {
        "a": (-3.2, 0.1),
        "b": (1000.0, 20.0),
    }
    for word in ("a5", "a5=", "a5=x", "=", "a5:3"):
        with pytest.raises(UsageError, match=r"--fix .* is not understood: write NAME=VALUE"):
            parsed(f"--fix {word}")
    for word in ("a", "a=1", "=1:2", "a=x:1", "a=1:2:3"):
        with pytest.raises(UsageError, match=r"--bounds .* is not understood: write NAME=LOW:HIGH"):
            parsed(f"--bounds {word}")
    for word in ("a", "a=1", "a=1+-", "a=1+-2+-3"):
        with pytest.raises(UsageError, match=r"understood: write NAME=VALUE\+-SIGMA"):
            parsed(f"--prior {word}", prior)
    with pytest.raises(UsageError, match="NAME=COLUMN, in quotes if it has blanks"):
        parsed("--columns u=stick held", "--columns NAME=COLUMN...\n    about")
    with pytest.raises(UsageError, match=r"--fix names a twice: 1\.0 and 2\.0"):
        parsed("--fix a=1 a=2")


def test_an_option_that_is_repeated_adds_its_values():
    options = parsed("--fix a=1 --free b c --model my.py --fix d=2 --free e --model other.py")
    assert options.fix == {"a": 1.0, "d": 2.0}
    assert options.free == ["b", "c", "e"]
    assert [path.name for path in options.model] == ["my.py", "other.py"]


def test_options_are_declared_as_the_help_shows_them():
    text = """
place PLACE
    where (default: here)
names [NAME]...
    any
--count N
    how many (default: 3)
--between START END
    from, to
--kind {soft,hard}
    of what
--force
"""
    options = parsed("there a b --between 1 2.5 --kind hard --force", text)
    assert (options.place, options.names) == ("there", ["a", "b"])
    assert (options.count, options.between, options.kind) == (3, [1.0, 2.5], "hard")
    assert options.force
    assert parsed("there", text).names == []
    assert parsed("there", text).between is None
    with pytest.raises(SystemExit):
        parsed("there --kind brittle", text)


def test_probabilities_and_times():
    assert (KINDS["P"]("0.25"), KINDS["HZ"]("1e-9"), KINDS["HZ"]("90")) == (
        0.25,
        1e-9,
        90.0,
    )
    for text in ("0", "1", "-0.1", "nan", "x"):
        with pytest.raises(
            argparse.ArgumentTypeError, match="is not a probability between 0 and 1"
        ):
            KINDS["P"](text)
    for text in ("0", "-1", "inf", "nan", "x"):
        with pytest.raises(argparse.ArgumentTypeError, match="is not a number above 0"):
            KINDS["HZ"](text)


@pytest.mark.parametrize(
    ("text", "option"),
    [
        ("settle=-1 must be", "--settle -1 must be"),
        ("give open_loop=True.", "give --open-loop."),
        ("band=... chooses another", "--band chooses another"),
        ("give input=u=MESSAGE.Field.", "give --input u=MESSAGE.Field."),
        ("K=2 and settled=3", "K=2 and settled=3"),
        ("settle = 2 s", "settle = 2 s"),
        ("give fixed={'T': ...}.", "give --fix T=...."),
        ("judge on others, records=[...].", "judge on others, --held-out."),
        ("use OutputError(), not Tilt()", "use output-error, not Tilt()"),
        (
            "give band=['a', 1], input=('a',) or input=['a'].",
            "give --band ['a', 1], --input a or --input a.",
        ),
    ],
)
def test_arguments_become_options(text, option):
    options = argparse.Namespace(
        settle=2.0, open_loop=False, band=[], input="", fix={}, held_out=[]
    )
    assert as_options(text, options) == option


def test_the_words_of_options_are_read_as_they_were():
    shared = "--announced SINE --fields omega=W axis=Ax --columns time=1"
    read = parsed(shared)
    stated = {name: vars(read)[name] for name in ("announced", "fields", "columns", "setpoint")}
    assert parsed(" ".join(option_words(stated))) == read
    assert option_words({"axis": "", "fields": {}}) == []
