r"""Names and texts from files, escaped where they are written: one function for each destination.

======================= ==========================================================
`terminal_text`         lines that a terminal shows: results as text, messages
`csv_cell`              a cell of a table that a spreadsheet may open
`latex_text`            a text, or a comment, in LaTeX
`html_text`             a text or an attribute of a page, before its markup is escaped
`sentence`              the message of an exception
======================= ==========================================================
"""

from collections.abc import Callable
from functools import wraps
from numbers import Number
from typing import Any, ParamSpec, TypeVar

from greybox.data.files.control_characters import printable
from greybox.data.files.numbers_in_text import is_number

# A spreadsheet takes a text that begins so for a formula: OWASP, CSV injection.
FORMULAS = ("=", "+", "-", "@", "\t", "\r")

SPECIAL = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}

LONGEST_SENTENCE = 2000  # characters of a message: more than a person reads

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def terminal_text(text: str) -> str:
    """Return lines of text that command no terminal."""
    return printable(text, keep="\n\t")


def html_text(text: str) -> str:
    """Return text without the control characters that HTML does not allow.

    Its markup is escaped by whoever writes the page: the tree of elements, or `html.escape`.
    """
    return printable(text, keep="\n\t")


def csv_cell(value: Any) -> Any:
    """Return a cell of a table; a text that a spreadsheet would compute begins with an apostrophe.

    Numbers stay numbers, also those in a text.
    """
    if value is None or isinstance(value, Number):
        return value
    whole = str(value)
    text = printable(whole)
    return f"'{text}" if whole.startswith(FORMULAS) and not is_number(text) else text


def latex_text(text: str) -> str:
    """Return text that LaTeX prints as it is, in one line: a comment ends with its line."""
    line = printable(" ".join(text.split()))
    return "".join(SPECIAL.get(character, character) for character in line)


def sentence(text: str) -> str:
    """Return the message of an exception, without control characters and cut where it is long."""
    shown = printable(text, keep="\n")
    if len(shown) <= LONGEST_SENTENCE:
        return shown
    # The reason is mostly at the beginning, and the cure at the end.
    half = LONGEST_SENTENCE // 2
    return f"{shown[:half]} ... {shown[-half:]}"


def in_sentences(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a function that reads a file, whose errors quote it as `sentence` writes them."""

    @wraps(function)
    def reading(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except Exception as error:
            # Python prints causes, too.
            cause: BaseException | None = error
            while cause is not None:
                cause.args = tuple(sentence(x) if isinstance(x, str) else x for x in cause.args)
                cause = cause.__cause__ or cause.__context__
            raise

    return reading
