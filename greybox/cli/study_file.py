"""Study files: the members of a batch, in TOML or in Python."""

import importlib
import tomllib
from dataclasses import replace
from pathlib import Path

from greybox.cli.options import UsageError
from greybox.data.files.safe_files import require_file
from greybox.modeling.model_file import module_from_file
from greybox.workflows.study.batch import Member, require_distinct
from greybox.workflows.study.grid import members_of


def find_study(text: str) -> Path:
    """Return the study file of an included name, or the path that `text` is."""
    # A file of the user takes precedence over an included study of the same name.
    path = Path(text)
    if text == "paper" and not path.is_file():
        return Path(str(importlib.import_module("greybox.problems._paper_study").__file__))
    return path


def read_study_file(path: Path, starts: int | None = None) -> list[Member]:
    """Return the members of a study file; `starts`, if given, replaces those of every member.

    In TOML the file has a ``problem`` (an included one, or a file beside the study file, as of
    ``greybox fit``) or a ``model`` with ``data``, and other options of ``greybox fit`` as keys. A
    list of values multiplies, as in `greybox.workflows.study.grid`. Every ``[[member]]`` is a grid
    of its own, for which the keys above it apply too. In Python ``members()`` returns a list of
    `greybox.study.Member`.

    Raises
    ------
    UsageError, ValueError, OSError
        For mistakes in the file, in one sentence.
    """
    require_file(path)
    if path.suffix == ".py":
        members = _stated_in_python(path)
    elif path.suffix == ".toml":
        members = _stated_in_toml(path)
    else:
        raise UsageError(
            f"{path} is not a known kind of study file: write study.toml, or study.py with "
            "members()."
        )

    require_distinct(members)
    if starts is None:
        return members
    return [replace(member, starts=starts) for member in members]


def _stated_in_python(path: Path) -> list[Member]:
    module = module_from_file(path)
    members = module.members() if hasattr(module, "members") else None
    if not isinstance(members, list | tuple) or not all(isinstance(m, Member) for m in members):
        raise UsageError(
            f"members() in {path} is missing or returns {members!r:.60}: define it, and return a "
            "list of gb.study.Member."
        )

    return list(members)


def _stated_in_toml(path: Path) -> list[Member]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is not TOML ({error}): texts need quotes, lists [].") from None

    entries = content.pop("member", [{}])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise UsageError(f"member in {path} is {entries!r:.60}: write [[member]] on its own line.")
    try:
        # The member's own settings come first in its name.
        return [
            member
            for entry in entries
            for member in members_of(entry | {**content, **entry}, path.parent)
        ]
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from None
