"""The answer of a member as it is stored: its fields, and their check when a study is read.

A study may come from a stranger. Everything that prints, compares or draws a study relies on the
kinds that are declared here, and on nothing else.
"""

import math
import types
from collections.abc import Mapping
from functools import cache
from typing import (
    Any,
    Literal,
    NotRequired,
    TypedDict,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from greybox.assessment.verdict import Grade
from greybox.data.files.control_characters import printable

PROSE = ("error", "warnings", "notes", "sentences")  # may have several lines, as names may not
LONGEST = 10_000  # characters of a text: a table pads every cell of a column to the longest

Numbers = dict[str, float | None]
Intervals = dict[str, tuple[float | None, float | None]]


class Verdict(TypedDict):
    """`greybox.assessment.verdict.Verdict`."""

    grade: Grade
    sentences: NotRequired[list[str]]


class Misfit(TypedDict, total=False):
    """What of a misfit the tables show."""

    explains: bool | None
    is_conditional: bool
    p_value: float | None


class Covariance(TypedDict):
    """Names and rows of a covariance matrix."""

    names: list[str]
    values: list[list[float | None]]


class Profile(TypedDict):
    """An interval by profile likelihood; None for an open side."""

    low: float | None
    high: float | None
    text: str


class Prior(TypedDict):
    """A prior, and its share in the information."""

    mean: float | None
    standard_deviation: float | None
    share: float | None


class Output(TypedDict):
    """How well an output of a record or of a manoeuvre is reproduced."""

    part: str
    output: str
    unit: str
    fit_percent: float | None
    noise: float | None


class Gap(TypedDict):
    """What the long steps of a record are taken for."""

    part: str
    text: str
    stretches: int
    unused: int


class Response(TypedDict):
    """How well a response is reproduced."""

    part: str
    magnitude_phase_cost: float | None


class Estimated(TypedDict):
    """What the tables of a study need of a member with an estimate."""

    model: list[str]
    data: list[str]
    criterion: str
    rule: str
    checksum: str
    verdict: Verdict
    starts: int
    converged: int
    agreeing: int
    minima: int
    cost: float | None
    warnings: list[str]
    estimate: Numbers
    derived: Numbers
    standard_error: Numbers


class Answer(Estimated, total=False):
    """All fields of `greybox.assessment.printed.summary`, and those that a batch adds."""

    problem: str
    delay: str
    seed: int | None
    costs: Numbers
    status: str
    best_effort: Numbers | None
    dof: float | None
    notes: list[str]
    seconds: float | None
    versions: dict[str, str]
    screened: int
    misfit: Misfit | None
    level: float | None
    interval: Intervals
    profiles: dict[str, Profile]
    covariance: Covariance
    bounds: Intervals
    starts_box: Intervals
    unit: dict[str, str]
    fixed: Numbers
    tied: list[str]
    at: Numbers
    prior: dict[str, Prior]
    outputs: list[Output]
    gaps: list[Gap]
    responses: list[Response]
    at_bound: list[str]
    fingerprint: str
    stated: str
    asked: str
    finished: float
    held_out: float | str | None
    error: str


def checked_answer(values: Any) -> dict[str, Any]:
    """Return the declared fields of an answer, with printable texts.

    Raises
    ------
    ValueError
        If a field has another kind of value, or one is missing that an estimate has.
    """
    answer = _checked(values, Answer, "it")
    # A failed member has what is known before a fit.
    if answer and not answer.get("error"):
        for name in Estimated.__required_keys__:
            _require(name in answer, name, "is missing")
        known = answer["estimate"].keys() | answer["derived"].keys()
        _require(answer["standard_error"].keys() <= known, "standard_error", "has other names")
        for name in ("model", "data"):
            _require(any(answer[name]), name, "is empty")
    return answer


_hints = cache(get_type_hints)


def _require(condition: bool, place: str, problem: str) -> None:
    if not condition:
        raise ValueError(f"{printable(place):.80} {problem}")


def _checked(value: Any, kind: Any, place: str) -> Any:
    """Return a value of JSON that has this kind; `place` names it in messages."""
    if is_typeddict(kind):
        _require(isinstance(value, dict), place, "has no names")
        hints = _hints(kind)
        required = () if kind is Answer else kind.__required_keys__
        _require({*required} <= value.keys(), place, "lacks a field")
        # Other fields are not for this version, and are left out.
        return {name: _checked(value[name], hints[name], name) for name in hints if name in value}

    origin, items = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        alike = [item for item in items if _is_of(value, item)]
        _require(bool(alike), place, f"is not allowed to be {value!r:.40}")
        return _checked(value, alike[0], place)
    _require(_is_of(value, kind), place, f"is not allowed to be {value!r:.40}")
    if origin is list:
        return [_checked(item, items[0], place) for item in value]
    if origin is tuple:
        _require(len(value) == len(items), place, "has another length")
        return [_checked(*pair, place) for pair in zip(value, items, strict=True)]
    if origin is dict:
        _require(all(value), place, "has an empty name")
        return {
            _text(name, place): _checked(x, items[1], f"{place} of {name}")
            for name, x in value.items()
        }
    return _text(value, place) if kind is str else value


def _text(value: str, place: str) -> str:
    _require(len(value) <= LONGEST, place, f"has more than {LONGEST} characters")
    return printable(value, "\n\t" if place in PROSE else "")


def _is_of(value: Any, kind: Any) -> bool:
    """Return whether a value of JSON is of a kind, whatever it contains."""
    origin = get_origin(kind) or kind
    if origin is Literal:
        return isinstance(value, str) and value in get_args(kind)
    if origin is float:
        # Whole numbers of Python are unlimited, those of NumPy are not.
        is_real = isinstance(value, int | float) and not isinstance(value, bool)
        return is_real and abs(value) < 1e308 * 1.7 and math.isfinite(value)
    if origin is int:
        return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63
    if origin in (list, tuple):
        return isinstance(value, list)
    if origin is dict or is_typeddict(origin):
        return isinstance(value, Mapping)
    return isinstance(value, origin)
