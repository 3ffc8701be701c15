"""Copies of the files of a study in its folder, so that it resumes wherever the folder is moved.

``inputs/``            the files that were read with the study, in folders as they were.
``inputs/study.json``  the place of the study file in it, and the option ``--starts``.

A study file in Python, and the files with models that it names, read what they like: an audit hook
of Python sees each file that is opened, and those in the folder of the study file are copied. Those
elsewhere (``../flights``) are copied if greybox read them as data or as a model.
"""

import json
import os
import shutil
import sys
from functools import cache
from pathlib import Path

from greybox.files.safe_files import replacing, write_text

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
        with replacing(place) as temporary:
            shutil.copyfile(source, temporary)
    write_text(folder / STATED, json.dumps([str(study.relative_to(base)), starts]))


def stated_inputs(folder: Path):
    """Return the study file in a folder, and the starts.

    Raises
    ------
    FileNotFoundError
        If the folder has none, as that of a program.
    """
    if not (folder / STATED).exists():
        raise FileNotFoundError(
            f"{folder} has no study file: run the command or the program that began it again."
        )
    name, starts = json.loads((folder / STATED).read_text())
    return str(folder / INPUTS / name), starts
