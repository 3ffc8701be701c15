"""A study on disk: one folder, in which only one process writes at a time and from which all may read.

Layout, version 1
-----------------
``study.json``          ``format`` ("greybox study"), ``layout``, and ``members``: name and folder of each, in order.
``lock``                locked by the process that writes.
``members/001-NAME/``   a member's ``runs-...h5`` (`greybox.study.run_files`), and once it is done ``fit.h5`` (as
    `greybox.save` writes it) and ``answer.json``: the numbers of the fit, or ``error``, with
    ``fingerprint``, ``rule`` of the starts.

Every file is written under a temporary name and renamed. What is in a folder may come from anyone:
nothing in it is executed.
"""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from greybox.files.safe_files import write_text
from greybox.files.text_table import printable

FORMAT = "greybox study"
LAYOUT = 1
INDEX = "study.json"
LOCK = "lock"
ANSWER = "answer.json"
FIT = "fit.h5"
# Seconds that a lock is waited for: a worker that was being started when its parent was killed
# still holds the parent's files until its own program runs.
PATIENCE = 2.0


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make the folder if there is none, and keep other processes from writing to it.

    Raises
    ------
    OSError
        If the folder cannot be written, or another process writes to it.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415  (6 ms of the import of greybox)

    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK, timeout=PATIENCE)
        lock.acquire()
    except Timeout:
        raise BlockingIOError(
            f"another process is at work in {folder}: wait for its end, or give another name."
        ) from None
    except OSError as error:
        reason = error.strerror or str(error).rstrip(".")
        raise type(error)(
            f"{folder} cannot be written ({reason}): choose another folder."
        ) from error
    try:
        yield
    finally:
        lock.release()


def is_study(folder: Path) -> bool:
    """Tell whether a study was begun in a folder."""
    return (folder / INDEX).is_file()


def read_index(folder: Path) -> dict[str, str]:
    """Return the folders of the members by their names.

    Raises
    ------
    FileNotFoundError
        If there is no study in the folder.
    ValueError
        If its index is damaged, or of a later version.
    """
    if not is_study(folder):
        raise FileNotFoundError(f"{folder} is no study: there is no {INDEX} in it.")
    index = read_json(folder / INDEX)
    if index.get("format") != FORMAT or not isinstance(index.get("layout"), int):
        raise ValueError(
            f"{folder / INDEX} is not the index of a study: give a folder that greybox batch wrote."
        )
    if index["layout"] > LAYOUT:
        raise ValueError(
            f"{folder} has layout {index['layout']} and this version reads up to {LAYOUT}: update greybox."
        )
    members = index.get("members")
    if not isinstance(members, list) or not all(_is_member(member) for member in members):
        raise ValueError(f"{folder / INDEX} is damaged: restore it, or begin another study.")
    return {member["name"]: member["folder"] for member in members}


def write_index(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """Write the index of a study that has these members besides those that it has, and return their folders."""
    members = read_index(folder) if is_study(folder) else {}
    for name in names:
        if name not in members:
            short = re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.")[:60]
            members[name] = f"{len(members) + 1:03d}-{short}"
    listed = [{"name": name, "folder": own} for name, own in members.items()]
    write_json(folder / INDEX, {"format": FORMAT, "layout": LAYOUT, "members": listed})
    for own in members.values():
        member_folder(folder, own).mkdir(parents=True, exist_ok=True)
    return members


def member_folder(folder: Path, own: str) -> Path:
    """Return the folder of a member."""
    return folder / "members" / own


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises
    ------
    ValueError
        If there is none.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise ValueError(f"{path} is damaged: delete it to have it made again.")
    return found


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a JSON file, whole or not at all."""
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")


def _is_member(member: Any) -> bool:
    if not isinstance(member, dict):
        return False
    name, own = member.get("name"), member.get("folder")
    is_name = isinstance(name, str) and name == printable(name)
    return (
        is_name
        and isinstance(own, str)
        and re.fullmatch(r"\d{3,}-[A-Za-z0-9_.-]*", own) is not None
    )
