"""Grids of members: every combination of lists of models, of data and of settings.

Begin with `grid`.
"""

import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from glob import escape, glob
from pathlib import Path
from typing import Any

from greybox.data.files.named_values import selected
from greybox.data.files.public import public
from greybox.modeling.model import require_known
from greybox.workflows.study.batch import Member
from greybox.workflows.study.data_file import UnreadableError, reading_once
from greybox.workflows.study.stated_problem import OF_DATA, OF_PARAMETERS, stated_problem

# Keys whose single value is a list: only a list of lists multiplies.
SEQUENCES = ("free", "through", "band")
# Keys that are arguments of a `Member`, not of its problem.
OF_MEMBER = ("name", "starts", "seed", "search", "solver_options")
KEYS = (
    "problem",
    "model",
    "joint",
    "held",
    *OF_DATA,
    "band",
    "criterion",
    "delay",
    "method",
    "free",
    *OF_PARAMETERS,
    *OF_MEMBER,
)


@public
def grid(models: Any = None, data: Any = None, **settings: Any) -> list[Member]:
    """Return a member of a study for every combination of models, data and settings.

    ``gb.study.grid([Linear(), Quadratic()], "flights/*.csv", seed=[0, 1], starts=5)`` has four
    members for every file. A list of values multiplies; anything else applies to all members.

    Parameters
    ----------
    models : Model, ``"my.py:Linear"``, or list of them
    data : file, pattern of files, data, or list of them
        ``"flights/*.csv"`` is a member for every file. A list within the list is one joint fit,
        with all parameters in common.
    **settings
        The other keys of a study file, named like the options of `greybox fit`: criterion, delay,
        method, at, fix, free, bounds, start, starts_box, prior, starts, seed, search; for files
        columns, rate, gaps, input, output, and prepare, the arguments of `gb.prepare`;
        ``joint=[...]``, the data of one joint fit; ``held="flights/f9.csv"``, data that are left
        out, and by which the structures are compared;
        ``band=(0.5, 20)``, the frequencies of responses that are fitted, in rad/s; problem, a
        Problem instead of models and data; solver_options.

    Raises
    ------
    ValueError
        For keys that do not exist, and values that do not fit together.
    """
    choices = {"model": models, "data": data, **settings}
    stated = {key: choice for key, choice in choices.items() if choice is not None}
    return members_of(stated, Path())


def members_of(choices: Mapping[str, Any], folder: Path) -> list[Member]:
    """Return the members of a grid, whose files are in a folder.

    A member whose data cannot be read has the reason as its error, and fails alone.

    Raises
    ------
    ValueError
        For a key that does not exist, or a value that does not fit.
    """
    require_known(choices, KEYS, "key", "a member of a study")
    read = reading_once()
    members = []
    for values in combined(choices, folder):
        of_member = selected(values, OF_MEMBER)
        try:
            problem, settings = stated_problem(values, read)
            # Held-out data are read and cut to the band like the data.
            if values["held"]:
                held, _ = stated_problem({**values, "data": values["held"]}, read)
                of_member["held"] = [part.data for part in held.parts]
            members.append(Member(problem, **{**settings, **of_member}))
        except UnreadableError as error:
            members.append(Member(error, **of_member))
        except (ValueError, TypeError, LookupError, OSError) as error:
            # The sentence is the last argument of these errors: an OSError has its number first.
            raise ValueError(f"member {of_member['name']!r}: {error.args[-1]}") from error
    return members


def combined(choices: Mapping[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    """Yield all combinations of the values of keys.

    Each is named by its first key and by the values that vary. Its data are a list of file paths,
    from the folder, and of data objects.
    """
    axes = {key: _values(key, value, folder) for key, value in choices.items()}
    held = _files(axes.pop("held", []), folder)
    data = axes.pop("data", [])
    if "joint" in axes:
        data = [*data, axes.pop("joint")]
    data_lists = _data_lists(data, folder, held)
    if data:
        axes = {"data": data_lists, **axes}
    for key, values in axes.items():
        if not values:
            raise ValueError(f"{key} is empty: give at least one value besides those of held.")

    # Names contain the parts of file paths that differ.
    parents = []
    for files in data_lists:
        parents += [Path(file).parent for file in files if isinstance(file, str)]
    place = os.path.commonpath(parents) if parents else ""
    heading = next((key for key in ("name", "problem", "data") if key in axes), "model")
    varied = [key for key in axes if len(axes[key]) > 1 and key != heading]
    for values in itertools.product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        name = _label(heading, chosen.get(heading, ""), place)
        if varied:
            name += ": " + ", ".join(_label(key, chosen[key], place) for key in varied)
        yield {**chosen, "name": name, "held": held}


def _data_lists(data: Sequence[Any], folder: Path, held: Sequence[Any]) -> list[list[Any]]:
    """Return the data of every member: one of the files, or all files of a list within `data`."""
    data_lists: list[list[Any]] = []
    for item in data:
        is_joint = isinstance(item, list | tuple)
        files = [file for file in _files(item if is_joint else [item], folder) if file not in held]
        if is_joint:
            data_lists.append(files)
        else:
            data_lists += [[file] for file in files]
    return data_lists


def _values(key: str, value: Any, folder: Path) -> list[Any]:
    """Return the values of a key: those of a list, or the only one."""
    is_many = isinstance(value, list)
    if key in SEQUENCES:
        is_many = is_many and all(isinstance(item, list | tuple) for item in value)
    values = []
    for item in value if is_many else [value]:
        # A study must not depend on the folder in which the command runs.
        is_python_file = isinstance(item, str) and re.match(r".+\.py(:|$)", item)
        values.append(str(folder / item) if is_python_file else item)
    return values


def _files(items: Sequence[Any], folder: Path) -> list[Any]:
    """Return the items, with the files that patterns match.

    Raises
    ------
    ValueError
        For a pattern without a file.
    """
    files: list[Any] = []
    for item in items:
        if not isinstance(item, str | Path):
            files.append(item)
            continue
        path = str(folder / item)
        # The name of a file may have brackets, as a pattern does.
        matches = sorted(glob(path, recursive=True)) or glob(escape(path))
        if not matches:
            raise ValueError(f"{str(item)!r} matches no file in {folder.absolute()}.")
        files += matches
    return files


def _label(key: str, value: Any, place: str) -> str:
    """Return a short text for a value; files are named by their paths from a place."""
    if isinstance(value, Mapping):
        return " ".join(f"{name}={x}" for name, x in value.items()) or "nothing fixed"
    if isinstance(value, list) and key == "data":
        words = [_label(key, item, place) for item in value]
        return "+".join(words) if len(words) < 4 else f"{words[0]}..{words[-1]}"
    if isinstance(value, str):
        if key == "data":
            return str(Path(value).relative_to(place).with_suffix(""))
        # my.py:Linear goes by the name Linear, and a problem my.py:pitch by my:pitch.
        name = Path(value).name.replace(".py", "")
        return name.rpartition(":")[2] if key == "model" else name
    if isinstance(value, list | tuple):
        return f"{key} {' '.join(map(str, value)) or 'nothing'}"
    return getattr(value, "name", "") or getattr(value, "label", "") or f"{key} {value}"
