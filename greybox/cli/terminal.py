"""Standard output and standard error, whatever they are: not UTF-8, closed, or on a full disk."""

import codecs
import contextlib
import os
import re
import sys
import unicodedata
from typing import Any, TextIO

# What is written for a character that the encoding of a terminal or file does not have. Letters
# with accents lose them, Greek letters are named, and the rest is written as Python's escapes.
SPELLED = str.maketrans(
    {
        "±": "+-",
        "·": "*",
        "×": "x",
        "−": "-",
        "–": "-",
        "→": "->",
        "≤": "<=",
        "≥": ">=",
        "√": "sqrt",
        "∞": "inf",
        "°": " deg",
        "µ": "u",
    }
    | {superscript: f"^{digit}" for digit, superscript in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}
    | {"⁻": "^-", "ᵀ": "^T"}
)


# What stands out where there are colors: why there is no answer, and what to know before believing
# one.
RED, YELLOW, PLAIN = "\033[1;31m", "\033[33m", "\033[0m"
STANDS_OUT = re.compile(
    r"^(?P<red>greybox:|[ ]*FAILED:)|(?P<yellow>^[ ]*warning:|\bAT BOUND\b)", re.MULTILINE
)


def colored(text: str, stream: TextIO | None) -> str:
    """Return the text with colors if the stream is a terminal that has them, and nobody set NO_COLOR.

    See https://no-color.org.
    """
    plain = (
        os.environ.get("NO_COLOR")
        or os.environ.get("TERM", "" if os.name == "nt" else "dumb") == "dumb"
    )
    if stream is None or plain or not stream.isatty():
        return text
    return STANDS_OUT.sub(lambda found: f"{RED if found['red'] else YELLOW}{found[0]}{PLAIN}", text)


class _NoTerminal:
    """A stream that is used as one to no terminal, so that nothing draws bars on it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def isatty(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def no_terminal(stream: TextIO | None) -> Any:
    """Return a stream that says to be no terminal."""
    return stream if stream is None else _NoTerminal(stream)


def make_writable() -> None:
    """Let standard output and error accept any text: what their encoding does not have is spelled."""
    codecs.register_error("spelled", _spelled)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="spelled")


def write(text: str, stream: TextIO | None) -> str:
    """Write text and a line end, and return why that was not possible, or nothing.

    Who reads no further, as `greybox list | head`, has what was wanted: that is no reason.
    """
    if stream is None:  # closed by the shell, >&-
        return ""
    try:
        stream.write(text + "\n")
        stream.flush()
    except BrokenPipeError:
        _discard(stream)
    except OSError as error:
        _discard(stream)
        return error.strerror or str(error)
    return ""


def has_all_characters(stream: TextIO | None) -> bool:
    """Tell whether a stream's encoding has every character."""
    return (getattr(stream, "encoding", None) or "").lower().replace("-", "").startswith("utf")


def _discard(stream: TextIO) -> None:
    """Lead what is still to be written nowhere: Python would complain of it once more when it ends."""
    with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


def _spelled(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_spell, error.object[error.start : error.end])), error.end


def _spell(character: str) -> str:
    spelled = character.translate(SPELLED)
    if spelled == character:
        words = unicodedata.name(character, "").lower().split()
        spelled = (
            words[-1] if words[:1] == ["greek"] and len(words) == 4 else _without_accent(character)
        )
    return spelled


def _without_accent(character: str) -> str:
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return plain or character.encode("ascii", "backslashreplace").decode()
