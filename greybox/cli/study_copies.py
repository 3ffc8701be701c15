"""Copies of the files of a study in its folder, so that it resumes wherever the folder is moved.

``inputs/``            the files that were read with the study, in folders as they were.
``inputs/study.json``  the place of the study file in it, the option ``--starts``, and the mark of
                       this user on all of these.

A study file in Python, and the files with models that it names, read what they like: an audit hook
of Python sees each file that is opened, and those in the folder of the study file are copied. Those
elsewhere (``../flights``) are copied if greybox read them as data or as a model.

Resuming a study executes the Python files in the folder. Files without the mark of this user are
therefore refused.
"""

import json
import os
import shutil
import sys
from functools import cache
from pathlib import Path

from greybox.assessment.stored_values import require
from greybox.data.files.bounded_json import parsed
from greybox.data.files.safe_files import replacing, write_text
from greybox.workflows.study.ownership import mark_of_files

INPUTS = Path("inputs")
STATED = INPUTS / "study.json"

# Files that Python opened for reading, and files that greybox read as data or as a model.
_opened = set[Path]()
_read = set[Path]()


def note_opened_files() -> None:
    """Note every file that Python opens for reading from now on, and those that greybox reads."""
    _opened.clear()
    _read.clear()
    _listen()


# An audit hook cannot be removed, so it is added only once: a second one would note everything
# again.
@cache
def _listen() -> None:
    """Add the audit hook."""
    sys.addaudithook(_note)


def _note(event: str, arguments: tuple) -> None:
    """Note a file that is opened or read."""
    if event == "greybox.read":
        path = arguments[0]
        _read.add(Path(path).resolve())
    elif event == "open":
        path, mode, *_ = arguments
        # A file descriptor, a number, becomes a path that does not exist.
        if mode in ("r", "rb"):
            _opened.add(Path(str(path)))


def copy_inputs(study: Path, folder: Path, starts: int | None) -> None:
    """Copy the files of a study into its folder, and the option `starts`.

    Raises
    ------
    OSError
        If they cannot be written.
    """
    study = study.resolve()
    folder = folder.resolve()
    copies = folder / INPUTS
    # A study that resumes with its copies has nothing to copy.
    sources = set[Path]()
    parent = copies
    if not study.is_relative_to(copies):
        sources = _sources(study, folder)
        # Relative paths such as ../flights lead from the copy of the study to those of its data.
        parent = Path(os.path.commonpath([path.parent for path in sources]))
    for source in sources:
        copy = copies / source.relative_to(parent)
        copy.parent.mkdir(parents=True, exist_ok=True)
        # Through a link, files elsewhere would be replaced.
        if copy.parent.resolve() != copy.parent:
            raise ValueError(f"{copy.parent} is a link: no study has such a thing.")
        with replacing(copy) as temporary:
            shutil.copyfile(source, temporary)
    name = study.relative_to(parent).as_posix()
    _remove_bytecode(folder)
    write_text(folder / STATED, json.dumps([name, starts, _mark(folder, name, starts)]))


def _sources(study: Path, folder: Path) -> set[Path]:
    """Return the files of a study, whose answers are in a folder."""
    opened = set(_opened)
    for module in [*sys.modules.values()]:
        file = getattr(module, "__file__", None)
        if file:
            opened.add(Path(file))
    sources = {study}
    for path in opened:
        resolved = path.resolve()
        if resolved.is_relative_to(study.parent) and _is_input(resolved, folder):
            sources.add(resolved)
    for path in _read:
        if _is_input(path, folder):
            sources.add(path)
    return sources


def _is_input(path: Path, folder: Path) -> bool:
    """Return whether a file may belong to a study, and not to Python or to the folder itself."""
    is_of_python = path.suffix == ".pyc" or path.is_relative_to(sys.prefix)
    return path.is_file() and not is_of_python and not path.is_relative_to(folder)


def stated_inputs(folder: Path, *, trust: bool = False) -> tuple[str, int | None]:
    """Return the study file in a folder, and the starts.

    Raises
    ------
    FileNotFoundError
        If the folder has no study file, because a Python program began the study.
    ValueError
        If another user wrote its files, without `trust`.
    """
    path = folder / STATED
    if not path.exists():
        raise FileNotFoundError(
            f"{folder} has no study file: run the command or the program that began it again."
        )
    try:
        name, starts, stated_mark = parsed(path.read_bytes(), path.stat().st_size)
        study = (folder / INPUTS / name).resolve()
        require(study.is_relative_to((folder / INPUTS).resolve()), "it leads elsewhere")
        require(starts is None or isinstance(starts, int), "its starts are no number")
    except (ValueError, TypeError):
        raise ValueError(
            f"{path} is damaged: run the command that began the study again."
        ) from None
    _remove_bytecode(folder)
    if not trust and stated_mark != _mark(folder, name, starts):
        raise ValueError(
            f"{folder / INPUTS} has files that your greybox batch has not put there: read them, "
            "since to resume runs them, and give trust=True if you vouch for them."
        )
    return str(study), starts


def _mark(folder: Path, *others: str | int | None) -> str:
    """Return the mark of this user on the inputs in a folder, and on other values."""
    return mark_of_files(folder / INPUTS, *others, but=folder / STATED)


def _remove_bytecode(folder: Path) -> None:
    """Remove the compiled files of Python, which it would run instead of the files themselves."""
    for place in [*(folder / INPUTS).rglob("__pycache__")]:
        shutil.rmtree(place)
