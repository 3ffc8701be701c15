"""What several commands share: common options, numbers, assignments, and mistakes in them."""

import argparse
import contextlib
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

Value = TypeVar("Value")

RESPONSE_OR_RECORD = (
    "with --data: the columns of a table with other names. For a response frequency=f:Hz "
    "magnitude=mag:dB phase=ph:deg coherence=coh, or alpha and beta; for a record time=t:ms and "
    "the signals of the model, theta=pitch:deg"
)
RECORD = (
    "the columns of a table with other names, time=t:ms theta=pitch:deg; or their numbers if the "
    "table has no header line: time=1 u=2 theta=3:deg"
)


class UsageError(Exception):
    """A mistake on the command line, in one sentence."""


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Help with the meaning beside most options, and examples as they are written."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26)

    def format_help(self) -> str:
        """Return the help."""
        # argparse does not count the indentation of commands, and breaks the line of the longest
        # one.
        self._action_max_length += 2
        return super().format_help()


def add_common_options(
    parser: argparse.ArgumentParser, figure: str = "", *, writes: bool = False
) -> None:
    """Add the options of every command, `--plot` for a `figure`, `--force` if it `writes` files."""
    if figure:
        parser.add_argument(
            "--plot",
            type=Path,
            metavar="FILE",
            help=f"draw {figure} into this png, pdf or svg file",
        )
    if figure or writes:
        parser.add_argument("--force", action="store_true", help="overwrite files that exist")
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object on standard output and nothing else",
    )
    parser.add_argument(
        "--quiet", action="store_true", help="print errors alone: no answer as text, no progress"
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")


def add_words(parser: argparse.ArgumentParser, flag: str, metavar: str, about: str) -> None:
    """Add an option with several words; by default there are none."""
    parser.add_argument(flag, nargs="+", default=[], metavar=metavar, help=about)


def add_level_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the confidence level of intervals."""
    parser.add_argument(
        "--level",
        type=probability,
        default=0.95,
        help="confidence level of the intervals (default: 0.95)",
    )


def add_columns_option(parser: argparse.ArgumentParser, about: str = RESPONSE_OR_RECORD) -> None:
    """Declare the option; `about` is its help."""
    add_words(parser, "--columns", "NAME=COLUMN[:UNIT]", about)


def add_rate_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option."""
    about = "sampling rate of a table without a time"
    parser.add_argument("--rate", type=positive_number, metavar="HZ", help=about)


def as_options(text: str, options: argparse.Namespace) -> str:
    """Return a text with arguments as options: ``settle=-1`` becomes ``--settle -1``."""
    # The library speaks of arguments. Only names of this command's options are translated: x=3 in a
    # formula stays as it is.
    names = "|".join(name for name in vars(options) if name.isidentifier())

    # "open_loop=True" and "name=..." have no value on the command line.
    def option(match: re.Match[str]) -> str:
        flag = f"--{match[1].replace('_', '-')}"
        return flag if match[2] else f"{flag} "

    text = re.sub(rf"\b({names})=(\.\.\.|True\b|(?=\S))", option, text)
    # A dict of bounds and a tuple of names are several words on the command line.
    text = re.sub(r"\{'([^']+)': \(([^,]+), ([^)]+)\)\}", r"\1=\2:\3", text)
    return re.sub(r"\('([^']+)',\)", r"\1", text)


def positive(text: str) -> int:
    """Return an integer of at least 1."""
    return _integer(text, 1)


def nonnegative(text: str) -> int:
    """Return an integer of at least 0."""
    return _integer(text, 0)


def _integer(text: str, least: int) -> int:
    # isdigit() alone would accept ², and int() 1_000: neither is what a script means.
    if not text.isascii() or not text.isdigit() or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer of at least {least}")
    return int(text)


def probability(text: str) -> float:
    """Return a number between 0 and 1."""
    return _between(text, 1.0, "a probability between 0 and 1")


def positive_number(text: str) -> float:
    """Return a finite number above zero."""
    return _between(text, math.inf, "a number above 0")


def _between(text: str, limit: float, kind: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < float(text) < limit:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not {kind}")


def assignments(words: Sequence[str], flag: str) -> dict[str, float]:
    """Return numbers by name from words such as ``a5=0.16``.

    Raises
    ------
    UsageError
        For a word of another form.
    """
    return _by_name(words, flag, "NAME=VALUE, e.g. a5=0.16", float)


def uncertain_values(words: Sequence[str], flag: str) -> dict[str, tuple[float, float]]:
    """Return values with standard deviations by name from words such as ``a1=3.2+-0.1`` (or ±).

    Raises
    ------
    UsageError
        For a word of another form.
    """

    def uncertain(text: str) -> tuple[float, float]:
        mean, sigma = text.replace("±", "+-").split("+-")
        return float(mean), float(sigma)

    return _by_name(words, flag, "NAME=VALUE+-SIGMA, a1=3.2+-0.1", uncertain)


def intervals(words: Sequence[str], flag: str) -> dict[str, tuple[float, float]]:
    """Return intervals by name from words such as ``a1=-10:10``; ``T=0:`` has no upper end.

    Raises
    ------
    UsageError
        For a word of another form.
    """

    def interval(text: str) -> tuple[float, float]:
        low, high = text.split(":")
        return float(low or -math.inf), float(high or math.inf)

    return _by_name(words, flag, "NAME=LOW:HIGH, e.g. a1=-10:10", interval)


def texts(words: Sequence[str], flag: str, form: str) -> dict[str, str]:
    """Return texts by name from words of this form, such as ``NAME=COLUMN``.

    Raises
    ------
    UsageError
        For a word of another form.
    """
    return _by_name(words, flag, form, str)


def stated_columns(options: argparse.Namespace) -> dict[str, str]:
    """Return the column of each name, with its unit behind a colon.

    Raises
    ------
    UsageError
        For a word of another form, or a repeated name.
    """
    form = "NAME=COLUMN:UNIT, e.g. frequency=f:Hz"
    return texts(options.columns, "--columns", form)


def _by_name(
    words: Sequence[str], flag: str, form: str, read: Callable[[str], Value]
) -> dict[str, Value]:
    result: dict[str, Value] = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            if not (name and text):
                raise ValueError(word)
            value = read(text)
        except ValueError:
            raise UsageError(f"{flag} {word!r} is not understood: write {form}.") from None

        # The last word would win in silence: more likely it is a slip.
        if name in result:
            raise UsageError(f"{flag} names {name} twice: {result[name]} and {value}.")
        result[name] = value

    return result
