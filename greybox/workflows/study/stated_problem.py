"""The problem that named options describe: those of `greybox fit`, or the keys of a study file.

Begin with `stated_problem`.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from greybox.data.files.grouping import unique
from greybox.data.files.named_values import selected, without
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.logs.known_filters import from_text
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.engine.compiled.transcription.collocation import Collocation
from greybox.engine.compiled.transcription.multiple_shooting import MultipleShooting
from greybox.engine.compiled.transcription.single_shooting import SingleShooting
from greybox.modeling.formulation.data_kinds import DATA_KINDS
from greybox.modeling.formulation.frequency_criteria import Criterion
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.several_responses import responses_in
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model, require_known
from greybox.modeling.transfer_function import TransferFunction
from greybox.workflows.identification.identify import filter_model
from greybox.workflows.study.catalog import find_model, find_problem, shipped
from greybox.workflows.study.data_file import read_data

# Options for reading data files.
OF_FILES = ("input", "output", "columns", "rate", "gaps", "prepare")
# Options with values by name of a parameter, and the fields of a problem that they change.
OF_PARAMETERS = {
    "fix": "fixed",
    "bounds": "bounds",
    "start": "start",
    "starts_box": "starts",
    "prior": "prior",
}
# Options that go with a model, not with a problem, which has its data.
OF_DATA = ("data", "through", "at", *OF_FILES)
METHODS = {
    "multiple-shooting": MultipleShooting,
    "single-shooting": SingleShooting,
    "collocation": Collocation,
}
# Ends of the names of filters in responses.
FILTER_NAMES = ("-filter", "-notch")
CRITERIA_BY_NAME: dict[str, Any] = {}
for data_kind in DATA_KINDS:
    CRITERIA_BY_NAME |= {criterion.name: criterion for criterion in data_kind.criteria}


def stated_problem(
    stated: Mapping[str, Any], read: Callable[..., Any] = read_data
) -> tuple[AnyProblem, dict[str, Any]]:
    """Return the problem of options by name, and its settings: starts, seed and method, if any.

    Problems, models, criteria, methods and data are names, as for `greybox fit`, or values. `read`
    reads the data files.

    Raises
    ------
    ValueError, TypeError, FileNotFoundError
        For options that exclude each other, and for unknown names and files.
    """
    options = {name: value for name, value in stated.items() if value not in (None, "", [], {})}
    problem: Any = options.get("problem")
    if ("problem" in options) == ("model" in options):
        raise ValueError(
            "give either a problem or model=... with data=...; `greybox list` shows the included "
            "problems."
        )

    settings: dict[str, Any] = {}
    if "model" in options:
        problem = _problem_of_model(options, read)
    else:
        # A problem has its data: these options would be ignored without a word.
        for name in OF_DATA:
            if name in options:
                raise ValueError(f"{name}=... goes with model=..., not with a problem.")
        if isinstance(problem, str):
            _require_problem(problem)
            problem, settings = find_problem(problem)

    # Options of the whole problem come first; those of single parameters need its final names.
    problem = in_band(problem, options.get("band"))
    if "delay" in options:
        problem = problem.with_(delay=options["delay"])
    if "criterion" in options:
        problem = _with_criterion(problem, options["criterion"])
    if "method" in options:
        settings["method"] = _method(options["method"])
        if not problem.parts_with(Record):
            raise ValueError(
                f"method=... is for records and {problem.name} has none: leave it out."
            )

    return with_parameter_options(problem, options), settings


def _method(method: Any) -> Any:
    """Return a transcription, or the one of a name."""
    if not isinstance(method, str):
        return method
    require_known([method], METHODS, "method", "greybox")
    return METHODS[method]()


def _problem_of_model(options: Mapping[str, Any], read: Callable[..., Any]) -> AnyProblem:
    """Return the problem of the options `model`, `data` and those that go with them."""
    if "data" not in options:
        raise ValueError("model=... needs data=..., a frequency response or a record.")
    model = options["model"]
    model = find_model(model) if isinstance(model, str) else model
    file_options = selected(options, OF_FILES)
    data: list[Any] = []
    for item in options["data"]:
        values = read(item, model, **file_options) if isinstance(item, str | Path) else item
        # A file may have the responses of several pairs.
        data += responses_in(values) or (values,)
    # All responses of one plant have passed the filters that the first one names.
    for word in options.get("through", ()):
        for known_filter in filters_of(word, data[0]):
            model = through(model, known_filter)

    # Several files are one joint fit: all parameters are shared.
    parts = tuple(Problem(model, values, at=options.get("at", {})) for values in data)
    return parts[0] if len(parts) == 1 else Sum(parts)


def in_band(problem: AnyProblem, band: Any) -> AnyProblem:
    """Return the problem with its frequency responses limited to a band, rad/s, if one is given.

    Raises
    ------
    ValueError
        If a part has no frequency in it.
    """
    if band is None:
        return problem
    low, high = band
    parts = []
    for part in problem.parts:
        if not isinstance(part.data, FrequencyResponse):
            raise ValueError(f"band=... is for frequency responses, and {part.name} is not one.")
        parts.append(part.with_(data=part.data.between(low, high)))
    return problem.with_parts(parts)


def filters_of(
    word: str, data: FrequencyResponse | Record | TransientSpectrum
) -> list[TransferFunction]:
    """Return the filters that a word of `through` names: a model, or filters in the response."""
    # Names in a response have hyphens, gyro-filter; files and classes cannot have them.
    if not re.fullmatch(r"\w+(-\w+)+", word):
        model = find_model(word)
        if not isinstance(model, TransferFunction):
            raise ValueError(f"through={word} is an ODE: give the filter as a transfer function.")
        return [model]

    about = data.about if isinstance(data, FrequencyResponse) else {}
    filters = [name for name in about if name.endswith(FILTER_NAMES)]
    require_known([word], filters, "filter", "the response")
    return [filter_model(known_filter) for known_filter in from_text(about[word])]


def through(model: Model, known_filter: TransferFunction) -> Model:
    """Return a transfer function behind a filter, whose output keeps its name and unit.

    Raises
    ------
    ValueError
        If the model is not a transfer function.
    """
    if not isinstance(model, TransferFunction):
        raise ValueError(
            f"through=... needs a transfer function, and {model.label} is an ODE: write a model of "
            "your own with the filter in it."
        )
    return model.through(known_filter)


def _require_problem(name: str) -> None:
    """Explain what to write if the name belongs to a data file or to a model."""
    if not name.endswith(".py") and Path(name).is_file():
        raise ValueError(
            f"{name} is a data file, not a problem: give it a model, model=tilt:Tilt data="
            f"{name}, or a problem file, my.py with a function problem()."
        )

    place = name.partition(":")[0]
    if place in shipped("models") and place not in shipped("problems"):
        cure = name if ":" in name else f"{name}:CLASS"
        raise ValueError(f"{name} names a model, not a problem: write model={cure} data=FILE.")


def _with_criterion(problem: AnyProblem, name: Any) -> AnyProblem:
    """Give a criterion, or the one of a name, to the parts with its kind of data."""
    if not isinstance(name, str):
        return problem.with_(criterion=name)
    require_known([name], CRITERIA_BY_NAME, "criterion", "greybox")
    criterion = CRITERIA_BY_NAME[name]
    kinds = [kind for kind in DATA_KINDS if criterion in kind.criteria]
    usable = unique(usual.name for part in problem.parts for usual in part.kind.criteria)
    if name not in usable:
        raise ValueError(
            f"criterion={name} is for {' and '.join(kind.plural for kind in kinds)} and "
            f"{problem.name} has none: use one of {', '.join(usable)}, or leave it out."
        )

    parts = []
    for part in problem.parts:
        if part.kind in kinds:
            settings = _with_settings_of(criterion, part.criterion)
            parts.append(part.with_(criterion=settings))
        else:
            parts.append(part)
    return problem.with_parts(parts)


def _with_settings_of(
    criterion: Criterion | TimeCriterion, previous: Any
) -> Criterion | TimeCriterion:
    """Return a criterion with those settings of the previous one that all criteria have."""
    # Biases, noise and known initial states describe the data, whatever the criterion.
    if not (isinstance(criterion, TimeCriterion) and isinstance(previous, TimeCriterion)):
        return criterion
    shared = {field.name: getattr(previous, field.name) for field in fields(TimeCriterion)}
    return replace(criterion, **shared)


def with_parameter_options(problem: AnyProblem, options: Mapping[str, Any]) -> AnyProblem:
    """Return the problem with the options applied to every part that has the parameters."""
    changes: dict[str, dict[str, Any]] = {}
    for name, field in OF_PARAMETERS.items():
        values = options.get(name, {})
        if not isinstance(values, Mapping):
            raise ValueError(f"{name}={values!r:.40} is not understood: give values by name.")
        changes[field] = {}
        for parameter, value in values.items():
            # An interval is a list of two numbers in TOML.
            changes[field][parameter] = tuple(value) if isinstance(value, list) else value
    changes["free"] = dict.fromkeys(options.get("free", ()))
    # The names are those of the whole problem: every part has only some of the parameters.
    for names in changes.values():
        require_known(names, problem.parameters, "parameter", problem.name)

    if not any(changes.values()):
        return problem
    return problem.with_parts([_restated(part, changes) for part in problem.parts])


def _restated(part: Problem, changes: Mapping[str, Mapping[str, Any]]) -> Problem:
    """Return a part with the changes of its parameters, which it may name differently."""
    # Options use the names of the answer. A tied parameter has no value of its own to change.
    inside = {part.outside(name): name for name in part.declared if name not in part.tied}
    changed: dict[str, dict[str, Any]] = {}
    for field, values in changes.items():
        changed[field] = {inside[name]: value for name, value in values.items() if name in inside}
    if changed["prior"] and not isinstance(part.prior, Mapping):
        raise ValueError(
            f"prior=... is for single parameters, and the prior of {part.name} is an earlier fit: "
            "leave it out."
        )

    # A parameter is either fixed or free: each option undoes what the problem says.
    fixed = without(part.fixed_values, changed["free"])
    free = [name for name in part.free if name not in changed["fixed"]]
    others = {}
    for field in ("bounds", "start", "starts", "prior"):
        if changed[field]:
            others[field] = {**getattr(part, field), **changed[field]}
    return part.with_(
        fixed={**fixed, **changed["fixed"]},
        free=unique([*free, *changed["free"]]),
        **others,
    )
