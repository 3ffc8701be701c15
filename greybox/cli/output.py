"""What a command gives: the answer as JSON and as text, the exit status, files and figures."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from greybox.cli.options import UsageError
from greybox.files.safe_files import replacing

Answer = tuple[dict[str, Any], str, int]
"""The JSON object, the text for a person, and the exit status."""

USABLE = 0  # a usable answer
FAILED = 1  # a run that failed
BAD_INPUT = 2  # bad usage or bad input

FIGURES = (".png", ".pdf", ".svg")

NO_WORKING_DIRECTORY = "the working directory was removed: change to one that exists."


def has_working_directory() -> bool:
    """Tell whether the folder that relative paths begin in still exists."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def require_writable(
    path: Path | None, force: bool, endings: Sequence[str] = (), kind: str = ""
) -> None:
    """Refuse a file that exists, without `force`, that cannot be written, or that ends otherwise. None is no file.

    Raises
    ------
    UsageError
        One sentence with the cure.
    """
    if path is None:
        return
    if path.is_dir() or not path.name:
        raise UsageError(f"{path} is a folder: give the name of a file.")
    if path.exists() and not force:
        raise UsageError(f"{path} exists: give another name, or --force to overwrite it.")
    if not has_working_directory() and not path.is_absolute():
        raise UsageError(NO_WORKING_DIRECTORY)
    if not path.parent.is_dir():
        raise UsageError(f"the folder of {path} does not exist: create it first.")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"the folder of {path} cannot be written: give another one.")
    if endings and path.suffix.lower() not in endings:
        raise UsageError(f"{path} is not a known kind of {kind}: end it in {', '.join(endings)}.")


def require_figure(path: Path | None, force: bool) -> None:
    """Refuse what `require_writable` refuses, and files that are no figures.

    Raises
    ------
    UsageError
        One sentence with the cure.
    """
    require_writable(path, force, FIGURES, "figure")


def save_figure(path: Path | None, draw: Callable[[], Any]) -> list[str]:
    """Save the figure that `draw` returns, and return a line that says so; without a path, nothing.

    Figures are drawn by a function, since matplotlib takes longer to import than everything else.
    """
    if path is None:
        return []
    with replacing(path) as temporary:
        draw().savefig(temporary, format=path.suffix[1:].lower(), dpi=150)
    return [f"drew {path}"]
