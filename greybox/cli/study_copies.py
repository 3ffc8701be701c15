"""Copies of the files of a study in its folder, so that it resumes wherever the folder is moved.

``inputs/``            the files that were read with the study, in folders as they were.
``inputs/study.json``  the place of the study file in it, the option ``--starts``, and the mark of
                       this user on all of these.

A study file in Python, and the files with models that it names, read what they like: an audit hook
of Python sees each file that is opened, and those in the folder of the study file are copied. Those
elsewhere (``../flights``) are copied if greybox read them as data or as a model.

To resume runs the Python files in the folder. Those of a stranger have no mark of this user.
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

_opened = set[Path]()
_read = set[Path]()  # by greybox


def note_opened_files() -> None:
    """Note every file that Python opens for reading from now on, and those that greybox reads."""
    _opened.clear()
    _read.clear()
    _listen(_note)


# An audit hook cannot be removed: a second one would note everything again.
_listen = cache(sys.addaudithook)


def _note(event: str, arguments: tuple) -> None:
    if event == "greybox.read":
        _read.add(Path(arguments[0]).resolve())
    elif event == "open" and arguments[1] in ("r", "rb"):
        _opened.add(Path(str(arguments[0])))


def copy_inputs(study: Path, folder: Path, starts: int | None) -> None:
    """Copy the files of a study into its folder, and the option `starts`.

    Raises
    ------
    OSError
        If they cannot be written.
    """
    study, folder = study.resolve(), folder.resolve()
    base = folder / INPUTS
    sources = set[Path]()
    if not study.is_relative_to(base):  # otherwise the study resumes with its copies
        modules = {getattr(module, "__file__", None) or "/" for module in [*sys.modules.values()]}
        opened = map(Path.resolve, {*_opened, *map(Path, modules)})
        beside = {path for path in opened if path.is_relative_to(study.parent)}
        # Files of Python and of the folder itself are not part of the study.
        sources = {study} | {
            path
            for path in beside | _read
            if path.is_file()
            and path.suffix != ".pyc"
            and not any(map(path.is_relative_to, (sys.prefix, folder)))
        }
        # Relative paths such as ../flights lead from the copy of the study to those of its data.
        base = Path(os.path.commonpath([path.parent for path in sources]))
    for source in sources:
        place = folder / INPUTS / source.relative_to(base)
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.parent.resolve() != place.parent:  # files elsewhere would be replaced
            raise ValueError(f"{place.parent} is a link: no study has such a thing.")
        with replacing(place) as temporary:
            shutil.copyfile(source, temporary)
    name = study.relative_to(base).as_posix()
    _remove_bytecode(folder)
    write_text(folder / STATED, json.dumps([name, starts, _mark(folder, name, starts)]))


def stated_inputs(folder: Path, *, trust: bool = False) -> tuple[str, int | None]:
    """Return the study file in a folder, and the starts.

    Raises
    ------
    FileNotFoundError
        If the folder has none, as that of a program.
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
    return mark_of_files(folder / INPUTS, *others, but=folder / STATED)


def _remove_bytecode(folder: Path) -> None:
    """Remove the compiled files of Python, which it would run instead of the files themselves."""
    for place in [*(folder / INPUTS).rglob("__pycache__")]:
        shutil.rmtree(place)
