"""Study files: the members of a batch, in TOML or in Python."""

import importlib
import itertools
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from greybox.cli.main import parser_of
from greybox.cli.options import UsageError
from greybox.cli.stated_problem import stated_problem
from greybox.files.safe_files import require_file
from greybox.files.text_table import alternatives
from greybox.modeling.model_file import module_from_file
from greybox.study.batch import Member, require_distinct

# Keys of a [[member]]: with a list, those of the grid make one member for each value.
GRID = ("problem", "criterion", "delay", "fix", "seed", "search")
SINGLE = (
    *("name", "model", "through", "data", "input", "output", "at", "free", "bounds", "start"),
    *("starts_box", "prior", "columns", "method", "starts"),
)
SETTINGS = ("starts", "seed")  # of the whole file
INCLUDED = ("paper",)  # studies by name, each in a file of greybox.problems


def find_study(text: str) -> Path:
    """Return the study file of an included name, or the path that `text` is.

    Raises
    ------
    UsageError
        If it is neither.
    """
    # A file of the user goes before an included study of the same name.
    path = Path(text)
    if text in INCLUDED and not path.is_file():
        return Path(str(importlib.import_module(f"greybox.problems._{text}_study").__file__))
    if not path.suffix and not path.exists():
        raise UsageError(
            f"there is no included study {text!r}: the included one is {', '.join(INCLUDED)}; "
            "or give study.toml."
        )

    return path


def read_study_file(path: Path, starts: int | None = None) -> list[Member]:
    """Return the members of a study file; `starts`, if given, replaces those of every member.

    In TOML every ``[[member]]`` has a ``problem`` (an included one, or a file beside the study
    file, as of ``greybox fit``) or a ``model`` with ``data``, and ``criterion, delay, fix, free,
    bounds, start, starts_box, prior, at, input, output, columns, method, starts, seed, search,
    name``, as the options of ``greybox fit``. Lists of ``problem, criterion, delay, fix, seed,
    search`` make a grid. In Python ``members()`` returns a list of `greybox.study.Member`.

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
    module: Any = module_from_file(path)
    function = getattr(module, "members", None)
    if not callable(function):
        raise UsageError(
            f"{path} has no function members(): define it, and return a list of gb.study.Member."
        )

    members: Any = function()
    is_list = isinstance(members, list | tuple)
    if not is_list or not all(isinstance(member, Member) for member in members):
        raise UsageError(
            f"members() in {path} returns {members!r:.60}: return a list of gb.study.Member."
        )

    return list(members)


def _stated_in_toml(path: Path) -> list[Member]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is not read: {str(error).rstrip('.')}.") from None

    entries = content.pop("member", None)
    for name in content:
        if name not in SETTINGS:
            raise UsageError(
                f"{path} states {name!r}, which is not known; there are member, "
                f"{alternatives(name, SETTINGS)}"
            )

    is_list = isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)
    if not entries or not is_list:
        raise UsageError(
            f"{path} has no members: write [[member]] and below it problem = 'rotors', say."
        )

    return [member for entry in entries for member in _members({**content, **entry}, path)]


def _members(entry: Mapping[str, Any], path: Path) -> list[Member]:
    """Return the members of one entry, named by the problem and by the values that differ."""
    keys = (*GRID, *SINGLE)
    for name in entry:
        if name not in keys:
            raise UsageError(
                f"a member in {path} has {name!r}, which is not known; use "
                f"{alternatives(name, keys)}"
            )

    grid = {name: entry[name] for name in GRID if isinstance(entry.get(name), list)}
    # Members have unique names: each contains the values in which it differs from the others.
    varied = [name for name, values in grid.items() if len(values) > 1 and name != "problem"]
    members = []
    for values in itertools.product(*grid.values()):
        keys = {**entry, **dict(zip(grid, values, strict=True))}
        member = _member(keys, path)
        differences = ", ".join(_difference(name, keys[name]) for name in varied)
        name = f"{member.name}: {differences}" if differences else member.name
        members.append(replace(member, name=name))

    return members


def _member(entry: Mapping[str, Any], path: Path) -> Member:
    """Return a member, whose keys are read as the options of ``greybox fit``."""
    words = []
    # Written as words for the parser of `greybox fit`, values obey the same rules and have the same
    # messages.
    for key, value in entry.items():
        if key == "name":
            continue
        values = [_beside(word, path.parent) for word in _words(key, value)]
        if values:
            words += values if key == "problem" else [f"--{key.replace('_', '-')}", *values]

    try:
        options = parser_of(["fit"]).parse_args(["fit", *words])
    except UsageError as error:
        raise UsageError(f"a member in {path} is not understood: {error}") from None

    problem, settings = stated_problem(options)
    return Member(
        problem,
        settings.get("starts") if options.starts is None else options.starts,
        settings.get("seed") if options.seed is None else options.seed,
        settings.get("method"),
        search=options.search,
        name=str(entry.get("name", problem.name)),
    )


def _words(key: str, value: Any) -> list[str]:
    """Return the words that an option has for a value of TOML."""
    if isinstance(value, list):
        return [word for item in value for word in _words(key, item)]
    if not isinstance(value, dict):
        return [str(value)]
    # An interval is a list of two numbers in TOML and LOW:HIGH on the command line.
    between = "+-" if key == "prior" else ":"
    ends = {n: v if isinstance(v, list) else [v] for n, v in value.items()}
    return [f"{name}={between.join(map(str, numbers))}" for name, numbers in ends.items()]


def _difference(key: str, value: Any) -> str:
    # Names of members are read in a table: short, and without the key where the value is telling.
    if key == "fix":
        return " ".join(f"{name}={number:g}" for name, number in value.items()) or "nothing fixed"
    return f"seed {value}" if key == "seed" else str(value)


def _beside(word: str, folder: Path) -> str:
    """Return the name of a file as a path from the study file, and any other word as it is."""
    # A study must not depend on the folder in which the command runs.
    is_file = re.match(r".+\.py(?:$|:)", word) or (folder / word).is_file()
    return str(folder / word) if is_file else word
