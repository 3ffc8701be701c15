"""The options of commands: how they are stated, read, and named in messages."""

import argparse
import contextlib
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from greybox.data.files.arrays import Interval
from greybox.data.files.folded_text import WIDTH

# Options that several commands have in common, in the form that `declare` reads.
SHARED = """
--force
    overwrite files that exist
--json
    print one JSON object on standard output and nothing else
--quiet
    print only errors: no answer as text, no progress
--details
    also print what the answer rests on: every step, table and structure
--debug
    show the traceback of an error
--hz
    draw frequencies in Hz instead of rad/s
--level P
    confidence level of the intervals (default: 0.95)
--trust
    continue with runs, and with --resume the Python files, that another user or machine left
--workers N
    make the runs in N processes on this machine
--scheduler ADDRESS
    make the runs on Dask's workers: 127.0.0.1:8786
--fix NAME=VALUE...
    fix parameters at these values
--free NAME...
    estimate parameters that the model declares fixed
--bounds NAME=LOW:HIGH...
    bounds in place of the declared ones, a1=-10:10; leave an end open with T=0:
--start NAME=VALUE...
    start values in place of the declared ones
--announced MESSAGE
    message that announces sine tests, e.g. SINE
--fields WHAT=FIELD...
    fields of that message, e.g. omega=W amplitude=Eta axis=Ax
--setpoint SIGNAL
    setpoint in which to look for tests, e.g. ATT.DesPitch
--columns NAME=COLUMN[:UNIT]...
    the columns of a table with other names, time=t:ms theta=pitch:deg; or their numbers if the
    table has no header line: time=1 u=2 theta=3:deg; for files of unlike headers, the names that a
    column has in them: theta=pitch:deg,Theta:rad
--rate HZ
    sampling rate of a table without a time
--gaps {bridge,cut}
    what long steps of the clock are: bridge where inputs are known across them, as in a schedule;
    cut where rows are lost (without the option, as the clock and the inputs show)
--problem PROBLEM
    the fitted problem, if it has ties or constraints
--model FILE
    a Python file with models of your own (repeatable)
"""
COMMON = "\n--json\n--quiet\n--debug"  # of every command


class UsageError(Exception):
    """A mistake on the command line, in one sentence."""


# How a help shows that a value may be absent or repeated.
FORMS: dict[Any, str] = {"?": "[{}]", "*": "[{}]...", "+": "{}..."}


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Shows several values as ``NAME=VALUE...``, and examples as they are written."""

    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        if action.nargs in FORMS:
            return FORMS[action.nargs].format(action.metavar or default_metavar)
        return super()._format_args(action, default_metavar)


# Help has the meaning next to most options.
HelpFormatter = partial(_Formatter, max_help_position=26, width=WIDTH)


# --- how options are stated


def declare(parser: argparse.ArgumentParser, text: str, used: Collection[str] = ()) -> None:
    """Declare the options of a text, which states them as the help shows them.

    The first line of an option has its name and what follows it: ``--level P`` a value,
    ``--between START END`` two, ``--data FILE...`` at least one, ``names [NAME]...`` any number,
    ``--search {batched,multistart}`` one of these words, ``--force`` nothing. `KINDS` has the types
    by these words; words such as ``NAME=VALUE`` give values by name. Indented lines are the help:
    its ``(default: 0.95)`` sets the default, ``(required)`` makes the option required, and
    ``(repeatable)`` collects the values of its repetitions. An option without help is one of
    `SHARED`. Where the names of the options that people use are given, the others stand below them.
    """
    shared = {block.split()[0]: block for block in _blocks(SHARED)}
    others = parser.add_argument_group("more options") if used else parser
    for block in _blocks(text):
        syntax, _, about = (block if "\n" in block else shared[block]).partition("\n")
        name, *words = syntax.split()
        about = " ".join(about.split())
        group = parser if name in used or not name.startswith("-") else others
        settings = _settings(words, about)
        if "(required)" in about:
            settings["required"] = True
        if "(repeatable)" in about:
            settings |= {"action": "append", "default": []}
        group.add_argument(name, help=about, **settings)


def _blocks(text: str) -> list[str]:
    return re.split(r"\n+(?! )", text.strip())


def _settings(words: Sequence[str], about: str) -> dict[str, Any]:
    """Return the arguments of argparse for an option with these words behind its name."""
    if not words:
        return {"action": "store_true"}
    word = words[0].removesuffix("...")
    if word.startswith("{"):
        settings = {"choices": word[1:-1].split(","), "default": ""}
    elif len(words) > 1:
        settings = {"nargs": len(words), "metavar": tuple(words), "type": KINDS.get(word, str)}
    else:
        is_optional = word[0] + word[-1] == "[]"
        word = word[1:-1] if is_optional else word
        kind = KINDS.get(word, str)
        settings = {"metavar": word, "type": kind, "default": "" if kind is str else None}
        if words[0].endswith("..."):
            settings |= {"nargs": "+", "default": [], "action": "extend"}
            if is_optional:
                settings |= {"nargs": "*", "default": None}
            elif re.match(r"\w+\[?=", word):
                settings |= {"default": {}, "type": str, "action": _ByName}
        elif is_optional:
            settings["nargs"] = "?"

    default = re.search(r"\(default: (\S+)\)", about)
    return settings | ({"default": default[1]} if default else {})


class _ByName(argparse.Action):
    """Stores words such as ``a5=0.16`` as values by name."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        stated = by_name(values, option_string, str(self.metavar))
        setattr(namespace, self.dest, getattr(namespace, self.dest) | stated)


def by_name(words: Sequence[str], flag: str, form: str) -> dict[str, Any]:
    """Return values by name from words of a form such as ``NAME=VALUE``.

    A name alone has the value None where the form allows it: ``NAME[=VALUE]``.

    Raises
    ------
    UsageError
        For a word of another form, or a repeated name.
    """
    result: dict[str, Any] = {}
    for word in words:
        name, sign, text = word.partition("=")
        is_bare = not sign and "[=" in form
        try:
            if not (name and (text or is_bare)):
                raise ValueError(word)
            value = None if is_bare else KINDS.get(form, str)(text)
        except ValueError:
            # Shells cut a text at its blanks, as in V=volt:V held.
            quotes = "" if form in KINDS else ", in quotes if it has blanks"
            raise UsageError(f"{flag} {word!r} is not understood: write {form}{quotes}.") from None

        # argparse would silently take the last word, but a repeated name is more likely a slip.
        if name in result:
            raise UsageError(f"{flag} names {name} twice: {result[name]} and {value}.")
        result[name] = value

    return result


# --- how options are written, and how messages name them


def option_words(values: Mapping[str, str | Mapping[str, str]]) -> list[str]:
    """Return the words that state texts, or texts by name; empty ones are left out."""
    words: list[str] = []
    for name, value in values.items():
        texts = [value] if isinstance(value, str) else [f"{k}={text}" for k, text in value.items()]
        words += [f"--{name}", *texts] if value else []

    return words


def as_options(text: str, options: argparse.Namespace) -> str:
    """Return a text with arguments as options: ``settle=-1`` becomes ``--settle -1``."""
    # The library's messages name arguments. Only names of this command's options are translated:
    # x=3 in a formula stays as it is.
    text = text.replace("fixed={", "fix={").replace("records=[...]", "held_out=...")
    text = text.replace("gb.load(path, models=[...])", "--model my.py")
    names = "|".join(name for name in vars(options) if name.isidentifier())

    # "open_loop=True" and "name=..." have no value on the command line.
    def option(match: re.Match[str]) -> str:
        flag = f"--{match[1].replace('_', '-')}"
        return flag if match[2] else f"{flag} "

    text = re.sub(rf"\b({names})=(\.\.\.|True\b|(?=\S))", option, text)
    # A dict and a list of names are several words on the command line.
    text = re.sub(r"\{'([^']+)': \.\.\.\}", r"\1=...", text)
    text = re.sub(r"\{'([^']+)': \(([^,]+), ([^)]+)\)\}", r"\1=\2:\3", text)
    text = re.sub(r"(?<= )[(\[]'([^']+)',?[)\]]", r"\1", text)
    # Criteria have the names of classes in Python: MaximumLikelihood() is maximum-likelihood.
    return re.sub(r"\b([A-Z][a-z]+)([A-Z][a-z]+)\(\)", lambda m: f"{m[1]}-{m[2]}".lower(), text)


# --- types of values


def _integer(text: str, least: int) -> int:
    # isdigit() alone would accept ², and int() 1_000: neither is what a script means.
    if not text.isascii() or not text.isdigit() or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer of at least {least}")
    return int(text)


def _between(text: str, limit: float, kind: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < float(text) < limit:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not {kind}")


def _interval(text: str) -> Interval:
    """Return the ends of ``-10:10``; ``0:`` has no upper end."""
    low, high = text.split(":")
    return float(low or -math.inf), float(high or math.inf)


def _corner(text: str) -> tuple[float, float]:
    """Return delay and bandwidth of ``0.1:3``."""
    with contextlib.suppress(ValueError):
        delay, bandwidth = map(float, text.split(":"))
        return delay, bandwidth
    raise argparse.ArgumentTypeError(f"{text!r} is not a corner such as 0.1:3")


def _uncertain(text: str) -> tuple[float, float]:
    """Return value and standard deviation of ``3.2+-0.1``, or with ±."""
    mean, sigma = text.replace("±", "+-").split("+-")
    return float(mean), float(sigma)


KINDS: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(("FILE", "DIR", "RESULT", "RESPONSE"), Path),
    **dict.fromkeys(
        ("HZ", "S", "DEGREES", "DB", "FACTOR"),
        partial(_between, limit=math.inf, kind="a number above 0"),
    ),
    **dict.fromkeys(("SECONDS", "START", "END", "NAME=VALUE", "NAME[=VALUE]"), float),
    "N": partial(_integer, least=1),
    "K": partial(_integer, least=0),
    "P": partial(_between, limit=1.0, kind="a probability between 0 and 1"),
    **dict.fromkeys(("NAME=LOW:HIGH", "NAME[=LOW:HIGH]"), _interval),
    "DELAY:BANDWIDTH": _corner,
    "NAME=VALUE+-SIGMA": _uncertain,
}
"""Types of values by the words in the help; other words are text."""
