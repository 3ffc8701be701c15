"""The answer of a command as JSON and as text, its exit status, files and figures."""

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from greybox.cli.options import UsageError
from greybox.cli.terminal import write
from greybox.data.files.folded_text import folded
from greybox.data.files.json_numbers import plain
from greybox.data.files.safe_files import replacing

Answer = tuple[Any, ...]
"""The JSON object of a command, then the lines of its text for a person."""

USABLE = 0  # a usable answer
FAILED = 1  # a run that failed
BAD_INPUT = 2  # bad usage or bad input
INTERRUPTED = 130  # what a shell reports of a program that Ctrl-C ended


def write_answer(result: dict[str, Any], text: str, as_json: bool, status: int = USABLE) -> int:
    """Write an answer to standard output, its error to standard error; return the exit status.

    By default the status follows from the error.
    """
    if error := result.get("error"):
        status = status or (INTERRUPTED if error.startswith("interrupted") else FAILED)
        write(f"greybox: {error}", sys.stderr)

    text = folded(text)
    if as_json and result:
        # JSON leaves this control character as it is.
        text = json.dumps(plain(result), allow_nan=False).replace("\x7f", "\\u007f")
    trouble = write(text, sys.stdout) if text else ""
    if trouble:
        write(f"greybox: cannot write to standard output: {trouble}.", sys.stderr)
    return FAILED if trouble and status == USABLE else status


def require_writable(
    path: Path | None, force: bool, endings: Sequence[str] = (), kind: str = ""
) -> None:
    """Check that a file can be written and has one of these endings; None means no file.

    Raises
    ------
    UsageError
        If the file exists, without `force`, cannot be written, or has another ending.
    """
    if path is None:
        return
    if path.is_dir() or not path.name:
        raise UsageError(f"{path} is a folder: give the name of a file.")
    # Commands call this before they begin: an hour of fitting must not end in "no such folder".
    if path.exists() and not force:
        raise UsageError(f"{path} exists: give another name, or --force to overwrite it.")
    if not path.parent.is_dir():
        raise UsageError(f"the folder of {path} does not exist: create it first.")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"the folder of {path} cannot be written: give another one.")
    if endings and path.suffix.lower() not in endings:
        raise UsageError(f"{path} is not a known kind of {kind}: end it in {', '.join(endings)}.")


def require_figure(path: Path | None, force: bool) -> None:
    """Check that a figure can be written."""
    require_writable(path, force, (".png", ".pdf", ".svg"), "figure")


def save_figure(path: Path | None, name: str, *items: Any, **look: Any) -> list[str]:
    """Draw items by this function of `greybox.plotting`, and return a line about the file.

    Without a path it does nothing.
    """
    if path is None:
        return []
    from greybox import plotting  # noqa: PLC0415  (imports matplotlib)

    # A figure that cannot be drawn must not destroy an existing one.
    with replacing(path) as temporary:
        drawn = getattr(plotting, name)(*items, **look)  # a figure, axes, or an array of axes
        figure = getattr(drawn, "figure", None) or drawn[0].figure
        figure.savefig(temporary, format=path.suffix[1:].lower(), dpi=150)
    return [f"drew {path}"]
