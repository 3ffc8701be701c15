"""Copies of the files of a study in its folder, so that it resumes wherever the folder is moved.

``inputs/``            the files beside and below the study file that were read with it.
``inputs/study.json``  the name of the study file, and the option ``--starts``.

A study file in Python, and the files with models that it names, read what they like. An audit hook
of Python sees each file that is opened. Those elsewhere (``../flights``) are not copied.
"""

import json
import shutil
import sys
from pathlib import Path

from greybox.files.safe_files import replacing, write_text

INPUTS = Path("inputs")
STATED = INPUTS / "study.json"

_opened = set[str]()


def note_opened_files() -> None:
    """Note every file that Python opens for reading from now on."""
    sys.addaudithook(
        lambda event, its: event == "open" and its[1] in ("r", "rb") and _opened.add(str(its[0]))
    )


def copy_inputs(study: Path, folder: Path, starts: int | None) -> None:
    """Copy the files of a study into its folder, and the option `starts`.

    Raises
    ------
    OSError
        If they cannot be written.
    """
    base, folder = study.parent.resolve(), folder.resolve()
    (folder / INPUTS).mkdir(parents=True, exist_ok=True)
    write_text(folder / STATED, json.dumps([study.name, starts]))
    modules = {getattr(module, "__file__", None) or "/" for module in [*sys.modules.values()]}
    for source in {Path(name).resolve() for name in _opened | modules}:
        # Files of Python and of the folder itself are not part of the study.
        is_other = any(map(source.is_relative_to, (sys.prefix, folder)))
        is_file = source.is_file() and source.suffix != ".pyc"
        if is_file and not is_other and source.is_relative_to(base):
            place = folder / INPUTS / source.relative_to(base)
            place.parent.mkdir(parents=True, exist_ok=True)
            with replacing(place) as temporary:
                shutil.copyfile(source, temporary)


def stated_inputs(folder: Path):
    """Return the study file in a folder, and the starts.

    Raises
    ------
    ValueError, OSError
        If the folder has none.
    """
    name, starts = json.loads((folder / STATED).read_text())
    return str((folder / STATED).with_name(name)), starts
