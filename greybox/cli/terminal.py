"""Standard output and standard error: colors, other encodings, closed streams, full disks."""

import contextlib
import os
import re
import sys
from typing import Any, TextIO

# What is colored: why there is no answer, and what to know before believing one.
RED, YELLOW, PLAIN = "\033[1;31m", "\033[33m", "\033[0m"
STANDS_OUT = re.compile(
    r"^(?P<red>greybox:|[ ]*FAILED:)|(?P<yellow>^[ ]*warning:|\bAT BOUND\b)", re.MULTILINE
)


def colored(text: str, stream: TextIO | None) -> str:
    """Return the text with colors if the stream is a terminal with colors and NO_COLOR is not set.

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
    """A stream that claims not to be a terminal, so that nothing draws progress bars on it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def isatty(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def no_terminal(stream: TextIO | None) -> Any:
    """Return a stream that claims not to be a terminal."""
    return stream if stream is None else _NoTerminal(stream)


def make_writable() -> None:
    """Let standard output and error accept any text, whatever their encoding."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def write(text: str, stream: TextIO | None) -> str:
    """Write text and a line end; return the reason if that was not possible, else nothing.

    A reader that stops early, as in `greybox list | head`, is not a reason.
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


def _discard(stream: TextIO) -> None:
    """Discard what is still to be written: Python would complain about it again when it ends."""
    with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())
