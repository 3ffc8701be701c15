"""Standard output and standard error: other encodings, closed streams, full disks."""

import contextlib
import os
import sys
from typing import TextIO

from greybox.data.files.escapes import terminal_text


def make_writable() -> None:
    """Let standard output and error accept any text, whatever their encoding."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            # A terminal that has no ± must still show the answer.
            reconfigure(errors="backslashreplace")


def write(text: str, stream: TextIO | None) -> str:
    """Write text and a line end; return the reason if that was not possible, else nothing.

    Everything that a command prints passes through here: names from files command no terminal.

    A reader that stops early, as in `greybox list | head`, is not a reason.
    """
    if stream is None:  # closed by the shell, >&-
        return ""
    try:
        stream.write(terminal_text(text) + "\n")
        stream.flush()
    except BrokenPipeError:
        _discard(stream)
    except OSError as error:
        _discard(stream)
        return error.strerror or str(error)

    return ""


def _discard(stream: TextIO) -> None:
    """Discard the rest of the output."""
    # Python flushes the stream once more when it ends, and would print a traceback about it.
    with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())
