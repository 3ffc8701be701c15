"""Study files: the members of a batch, stated in TOML or in Python."""

import argparse
import importlib
import itertools
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from greybox.cli.options import UsageError
from greybox.cli.stated_problem import METHODS, stated_problem
from greybox.files.safe_files import require_file, write_text
from greybox.files.text_table import alternatives
from greybox.modeling.model_file import module_from_file
from greybox.solve.multistart import BATCHED
from greybox.study.batch import Member, require_distinct

# What a [[member]] states: in a list, one value for each of several members.
GRID = ("problem", "criterion", "delay", "fix", "seed", "search")
SINGLE = (
    *(
        "name",
        "model",
        "through",
        "data",
        "input",
        "output",
        "at",
        "free",
        "bounds",
        "start",
        "starts_box",
        "prior",
    ),
    *("columns", "method", "starts"),
)
SETTINGS = ("starts", "seed")  # of the whole file


INCLUDED = ("paper",)  # by name, each in a file of greybox.problems


def find_study(text: str) -> Path:
    """Return the study file of an included name, or the path that `text` is.

    Raises
    ------
    UsageError
        If it is neither.
    """
    path = Path(text)
    if text in INCLUDED and not path.is_file():
        return Path(str(importlib.import_module(f"greybox.problems._{text}_study").__file__))
    if not path.suffix and not path.exists():
        raise UsageError(
            f"there is no included study {text!r}, there is {', '.join(INCLUDED)}: or give study.toml."
        )
    return path


def read_study_file(path: Path, starts: int | None = None) -> list[Member]:
    """Return the members that a study file states; `starts`, if given, are those of every member.

    In TOML every ``[[member]]`` has a ``problem`` (an included one, or a file beside the study
    file, as of ``greybox fit``) or a ``model`` with ``data``, and ``criterion, delay, fix, free,
    bounds, start, starts_box, prior, at, input, output, columns, method, starts, seed, search,
    name``, as the options of ``greybox fit``. Lists of ``problem, criterion, delay, fix, seed,
    search`` make a grid. In Python ``members()`` returns a list of `greybox.study.Member`.

    Raises
    ------
    UsageError, ValueError, OSError
        For what is not understood, in one sentence.
    """
    require_file(path)
    if path.suffix == ".py":
        members = _stated_in_python(path)
    elif path.suffix == ".toml":
        members = _stated_in_toml(path)
    else:
        raise UsageError(
            f"{path} is not a known kind of study file: write study.toml, or study.py with members()."
        )
    require_distinct(members)
    if starts is None:
        return members
    return [replace(member, starts=starts) for member in members]


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises
    ------
    ValueError
        If the file has none.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise ValueError(f"{path} is damaged: it has no JSON object.")
    return values


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a JSON file, whole or not at all."""
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")


def _stated_in_python(path: Path) -> list[Member]:
    included = [name for name in INCLUDED if find_study(name) == path]
    module: Any = (
        importlib.import_module(f"greybox.problems._{included[0]}_study")
        if included
        else module_from_file(path)
    )
    function = getattr(module, "members", None)
    if not callable(function):
        raise UsageError(
            f"{path} has no function members(): define it, and return a list of gb.study.Member."
        )
    found: Any = function()
    if not isinstance(found, list | tuple) or not all(
        isinstance(member, Member) for member in found
    ):
        raise UsageError(
            f"members() in {path} returns {found!r:.60}: return a list of gb.study.Member."
        )
    return list(found)


def _stated_in_toml(path: Path) -> list[Member]:
    try:
        stated = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is not read: {str(error).rstrip('.')}.") from None
    entries = stated.pop("member", None)
    for name in stated:
        if name not in SETTINGS:
            raise UsageError(
                f"{path} states {name!r}, which is not known; there are member, {alternatives(name, SETTINGS)}"
            )
    if (
        not isinstance(entries, list)
        or not entries
        or not all(isinstance(entry, dict) for entry in entries)
    ):
        raise UsageError(
            f"{path} has no members: write [[member]] and below it problem = 'rotors', say."
        )
    members = [member for entry in entries for member in _members({**stated, **entry}, path)]
    return _named_apart(members)


def _members(entry: Mapping[str, Any], path: Path) -> list[tuple[str, str, Member]]:
    """Return the members of one entry, each with the name of its problem and what tells it from the others."""
    for name in entry:
        if name not in (*GRID, *SINGLE):
            raise UsageError(
                f"a member in {path} has {name!r}, which is not known; use {alternatives(name, (*GRID, *SINGLE))}"
            )
    lists = {name: _values(entry, name) for name in GRID if name in entry}
    single = {name: entry[name] for name in SINGLE if name in entry}
    return [
        _member(
            {**single, **dict(zip(lists, values, strict=True))},
            [n for n in lists if len(lists[n]) > 1],
            path,
        )
        for values in itertools.product(*lists.values())
    ]


def _values(entry: Mapping[str, Any], name: str) -> list[Any]:
    """Return the values of one key: several for a list."""
    values = entry[name] if isinstance(entry[name], list) else [entry[name]]
    kind = {"fix": dict, "seed": int}.get(name, str)
    for value in values:
        if not isinstance(value, kind) or isinstance(value, bool):
            wanted = {"fix": "a table {name = value}", "seed": "a whole number"}.get(name, "text")
            raise UsageError(
                f"{name} = {value!r:.40} is not understood: give {wanted}, or a list of such."
            )
    return values


def _member(stated: Mapping[str, Any], varied: list[str], path: Path) -> tuple[str, str, Member]:
    folder = path.parent
    options = argparse.Namespace(
        problem=_beside(_text(stated, "problem"), folder),
        model=_beside(_text(stated, "model"), folder),
        data=[folder / name for name in _data(stated)] or None,
        through=[filtered] if (filtered := _text(stated, "through")) else [],
        input=_text(stated, "input") or "",
        output=_text(stated, "output") or "",
        at=_assigned(stated, "at"),
        fix=_assigned(stated, "fix"),
        free=_list(stated, "free"),
        bounds=[
            f"{name}={low!r}:{high!r}" for name, (low, high) in _pairs(stated, "bounds").items()
        ],
        start=_assigned(stated, "start"),
        starts_box=[
            f"{name}={low!r}:{high!r}" for name, (low, high) in _pairs(stated, "starts_box").items()
        ],
        prior=[
            f"{name}={mean!r}+-{sigma!r}"
            for name, (mean, sigma) in _pairs(stated, "prior", "mean, sigma").items()
        ],
        columns=_list(stated, "columns"),
        method=_method(stated),
        delay=_text(stated, "delay"),
        criterion=_text(stated, "criterion"),
    )
    problem, settings = stated_problem(options)
    starts = stated.get("starts", settings.get("starts"))
    if not isinstance(starts, int | None) or isinstance(starts, bool):
        raise UsageError(f"starts = {starts!r:.40} is not understood: give a whole number.")
    name = _text(stated, "name") or problem.name
    differs = ", ".join(_said(key, stated[key]) for key in varied if key != "problem")
    seed = stated.get("seed", settings.get("seed"))
    search = _text(stated, "search") or BATCHED
    member = Member(problem, starts, seed, settings.get("method"), search=search)
    return name, differs, member


def _named_apart(members: list[tuple[str, str, Member]]) -> list[Member]:
    """Name every member by its problem and by what tells it from the others of its entry."""
    named = []
    for name, differs, member in members:
        full = f"{name}: {differs}" if differs else name
        named.append(replace(member, name=full))
    return named


def _said(key: str, value: Any) -> str:
    if key == "fix":
        return " ".join(f"{name}={number:g}" for name, number in value.items()) or "nothing fixed"
    return f"seed {value}" if key == "seed" else str(value)


def _beside(text: str | None, folder: Path) -> str | None:
    """Return the name of an included thing as it is, that of a file as a path from the study file."""
    is_file = text is not None and re.match(r".+\.py(?:$|:)", text)
    return str(folder / text) if text is not None and is_file else text


def _text(stated: Mapping[str, Any], name: str) -> str | None:
    value = stated.get(name)
    if value is not None and not isinstance(value, str):
        raise UsageError(f"{name} = {value!r:.40} is not understood: give text.")
    return value


def _list(stated: Mapping[str, Any], name: str) -> list[str]:
    value = stated.get(name, [])
    if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
        raise UsageError(f"{name} = {value!r:.40} is not understood: give a list of names.")
    return value


def _assigned(stated: Mapping[str, Any], name: str) -> list[str]:
    """Return what the command line would have after ``--fix``, ``--start`` or ``--at``."""
    value = stated.get(name, {})
    if not isinstance(value, dict) or not all(
        type(number) in (int, float) for number in value.values()
    ):
        raise UsageError(
            f"{name} = {value!r:.40} is not understood: give a table {{name = number}}."
        )
    return [f"{key}={number!r}" for key, number in value.items()]


def _data(stated: Mapping[str, Any]) -> list[str]:
    return [stated["data"]] if isinstance(stated.get("data"), str) else _list(stated, "data")


def _method(stated: Mapping[str, Any]) -> str | None:
    name = _text(stated, "method")
    if name is not None and name not in METHODS:
        raise UsageError(f"method {name!r:.40} is not known; use {alternatives(name, METHODS)}")
    return name


def _pairs(stated: Mapping[str, Any], name: str, ends: str = "low, high") -> dict[str, list[float]]:
    """Return pairs of numbers by the names of parameters."""
    value = stated.get(name, {})
    pairs = value.values() if isinstance(value, dict) else [None]
    if not all(
        isinstance(pair, list) and [type(end) in (int, float) for end in pair] == [True, True]
        for pair in pairs
    ):
        raise UsageError(
            f"{name} = {value!r:.40} is not understood: give a table {{name = [{ends}]}}."
        )
    return value
