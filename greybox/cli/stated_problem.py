"""The problem that the options of `greybox fit` describe."""

import argparse
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from greybox.cli.catalog import find_model, find_problem, shipped
from greybox.cli.data_file import read_data
from greybox.cli.options import UsageError
from greybox.compiled.compiled_problem import AnyProblem
from greybox.compiled.transcription.collocation import Collocation
from greybox.compiled.transcription.multiple_shooting import MultipleShooting
from greybox.compiled.transcription.single_shooting import SingleShooting
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.text_table import alternatives
from greybox.formulation.frequency_criteria import Criterion
from greybox.formulation.included_criteria import CRITERIA, SPECTRUM_CRITERIA, TIME_CRITERIA
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.formulation.time_criteria import TimeCriterion
from greybox.identification.identify import filter_model
from greybox.logs.known_filters import from_text
from greybox.modeling.model import Model
from greybox.modeling.transfer_function import TransferFunction

METHODS = {
    "multiple-shooting": MultipleShooting,
    "single-shooting": SingleShooting,
    "collocation": Collocation,
}
FILTER_NAMES = ("-filter", "-notch")  # ends of the names of filters in responses
# Kinds of data, and their criteria.
KINDS = {
    "frequency responses": (FrequencyResponse, CRITERIA),
    "records": (Record, TIME_CRITERIA),
    "manoeuvres": (TransientSpectrum, SPECTRUM_CRITERIA),
}
CRITERIA_BY_NAME: dict[str, Criterion | TimeCriterion] = {
    criterion.name: criterion for _, criteria in KINDS.values() for criterion in criteria
}
PROBLEM_OPTIONS = f"""
problem [PROBLEM]
    an included problem, or my.py, or my.py:name
--model MODEL
    instead of PROBLEM: tilt:Tilt, 'polynomial:Polynomial(4, 1)' or my.py:Class
--data FILE...
    with --model: a frequency response (columns omega_rad_s, alpha, beta [, coherence, variance,
    dof]), the spectrum of a manoeuvre (greybox response --manoeuvre), or a record (columns time
    and, in SI units, the inputs and outputs of the model; without a time, rows for a static model);
    several are fitted together; for a flight log write a problem file
--through FILTER...
    with --model: filters between the output and its log: 'filters:LowPass(20, 0.71)', or by their
    names in the response, gyro-filter, gyro-notch ...
--input NAME
    input of a frequency response, if the model or the file has several
--output NAME
    output of a frequency response, if the model or the file has several
--at NAME=VALUE...
    with --model: operating point at which an ODE is linearized
--columns NAME=COLUMN[:UNIT]...
    with --data: the columns of a table with other names. For a response frequency=f:Hz
    magnitude=mag:dB phase=ph:deg coherence=coh, or alpha and beta; for a record time=t:ms and the
    signals of the model, theta=pitch:deg
--rate
--fix
--free
--bounds
--start
--starts-box NAME=LOW:HIGH...
    range of drawn starts, in place of the bounds
--prior NAME=VALUE+-SIGMA...
    normal prior with its standard deviation; the criterion must be a likelihood
--delay DELAY
    exact or pade:n (default: the problem's)
--criterion CRITERION
    {", ".join(CRITERIA_BY_NAME)} (default: the problem's)
--method {{{",".join(METHODS)}}}
    how records are transcribed and solved (default: the problem's)
"""


def stated_problem(options: argparse.Namespace) -> tuple[AnyProblem, dict[str, Any]]:
    """Return the problem of the options, and its settings: starts and seed, if it has them.

    Raises
    ------
    UsageError, ValueError, FileNotFoundError
        For options that exclude each other, and for unknown names and files.
    """
    if bool(options.problem) == bool(options.model):
        raise UsageError(
            "give either a PROBLEM or --model with --data; `greybox list` shows the included "
            "problems."
        )

    settings: dict[str, Any] = {}
    if options.problem:
        # A problem has its data: these options would be ignored without a word.
        for name in ("data", "columns", "rate", "through", "input", "output", "at"):
            if getattr(options, name):
                raise UsageError(f"--{name} goes with --model, not with a PROBLEM.")
        _require_problem(options.problem)
        problem, settings = find_problem(options.problem)
    else:
        problem = _problem_of_model(options)

    # Options of the whole problem first; those of single parameters need its final names.
    if options.delay:
        problem = problem.with_(delay=options.delay)
    if options.criterion:
        problem = _with_criterion(problem, options.criterion)
    if options.method:
        if not any(isinstance(part.data, Record) for part in problem.parts):
            raise UsageError(f"--method is for records and {problem.name} has none: leave it out.")
        settings["method"] = METHODS[options.method]()

    return with_parameter_options(problem, options), settings


def _problem_of_model(options: argparse.Namespace) -> AnyProblem:
    if not options.data:
        raise UsageError("--model needs --data FILE, a frequency response or a record.")
    model = find_model(options.model)
    names = options.input, options.output
    data = [read_data(path, model, *names, options.columns, options.rate) for path in options.data]
    # All responses of one plant have passed the filters that the first one names.
    for word in options.through:
        for known_filter in filters_of(word, data[0]):
            model = through(model, known_filter)

    for path, values in zip(options.data, data, strict=True):
        for name in ("input", "output", "at"):
            if getattr(options, name) and not isinstance(values, FrequencyResponse):
                raise UsageError(
                    f"--{name} is for a frequency response, and {path} is something else: leave "
                    "it out."
                )
        if options.rate and not isinstance(values, Record):
            raise UsageError(f"--rate is for a table of signals, and {path} is something else.")

    # Several files are one joint fit: all parameters are shared.
    parts = tuple(Problem(model, values, at=options.at) for values in data)
    return parts[0] if len(parts) == 1 else Sum(parts)


def filters_of(
    word: str, data: FrequencyResponse | Record | TransientSpectrum
) -> list[TransferFunction]:
    """Return the filters that a word of --through names: a model, or filters in the response."""
    # Names in a response have hyphens, gyro-filter; files and classes cannot have them.
    if not re.fullmatch(r"\w+(-\w+)+", word):
        model = find_model(word)
        if not isinstance(model, TransferFunction):
            raise UsageError(f"--through {word} is an ODE: give the filter as a transfer function.")
        return [model]

    about = data.about if isinstance(data, FrequencyResponse) else {}
    if word not in about:
        filters = ", ".join(name for name in about if name.endswith(FILTER_NAMES))
        raise UsageError(
            f"--through {word} is not a filter of the data: they have {filters or 'none'}."
        )

    return [filter_model(known_filter) for known_filter in from_text(about[word])]


def through(model: Model, known_filter: TransferFunction) -> Model:
    """Return a transfer function behind a filter, whose output keeps its name and unit.

    Raises
    ------
    UsageError
        If the model is not a transfer function.
    """
    if not isinstance(model, TransferFunction):
        raise UsageError(
            f"--through needs a transfer function, and {model.label} is an ODE: write a model of "
            "your own with the filter in it."
        )
    return model.through(known_filter)


def _require_problem(name: str) -> None:
    """Explain what to write if the name belongs to a data file or to a model."""
    if not name.endswith(".py") and Path(name).is_file():
        raise UsageError(
            f"{name} is a data file, not a problem: give it a model, --model tilt:Tilt --data "
            f"{name}, or a problem file, my.py with a function problem()."
        )

    place = name.partition(":")[0]
    if place in shipped("models") and place not in shipped("problems"):
        cure = name if ":" in name else f"{name}:CLASS"
        raise UsageError(f"{name} names a model, not a problem: write --model {cure} --data FILE.")


def _with_criterion(problem: AnyProblem, name: str) -> AnyProblem:
    """Give a criterion to the parts with its kind of data."""
    if name not in CRITERIA_BY_NAME:
        names = alternatives(name, CRITERIA_BY_NAME)
        raise UsageError(f"there is no criterion {name!r}; there are {names}")

    criterion = CRITERIA_BY_NAME[name]
    served = {noun: kind for noun, (kind, criteria) in KINDS.items() if criterion in criteria}
    kinds = tuple(served.values())
    if not any(isinstance(part.data, kinds) for part in problem.parts):
        suitable = [
            suitable.name
            for kind, criteria in KINDS.values()
            if any(isinstance(part.data, kind) for part in problem.parts)
            for suitable in criteria
        ]
        raise UsageError(
            f"--criterion {name} is for {' and '.join(served)} and {problem.name} has none: use "
            f"{', '.join(dict.fromkeys(suitable))}, or leave it out."
        )

    return problem.with_parts(
        [
            part.with_(criterion=_like(criterion, part.criterion))
            if isinstance(part.data, kinds)
            else part
            for part in problem.parts
        ]
    )


def _like(criterion: Criterion | TimeCriterion, previous: Any) -> Criterion | TimeCriterion:
    """Return a criterion with the settings that all criteria for records have."""
    # Biases, noise and known initial states describe the data, whatever the criterion.
    if not (isinstance(criterion, TimeCriterion) and isinstance(previous, TimeCriterion)):
        return criterion
    shared = {field.name: getattr(previous, field.name) for field in fields(TimeCriterion)}
    return replace(criterion, **shared)


def with_parameter_options(problem: AnyProblem, options: argparse.Namespace) -> AnyProblem:
    """Return the problem with the options applied to every part that has the parameters."""
    changes: dict[str, Mapping[str, Any]] = {
        "fixed": options.fix,
        "bounds": options.bounds,
        "start": options.start,
        "free": dict.fromkeys(options.free),
        "starts": options.starts_box,
        "prior": options.prior,
    }
    # Checked against the whole problem: every part has only some of the parameters.
    for name in (name for names in changes.values() for name in names):
        if name not in problem.parameters:
            names = alternatives(name, problem.parameters)
            raise ValueError(f"{problem.name} has no parameter {name!r}; it has {names}")

    if not any(changes.values()):
        return problem
    return problem.with_parts([_restated(part, changes) for part in problem.parts])


def _restated(part: Problem, changes: Mapping[str, Mapping[str, Any]]) -> Problem:
    """Return a part with the changes of its parameters, which it may name differently."""
    # Options speak of names in the answer. A tied parameter has no value of its own to change.
    inside = {part.outside(name): name for name in part.declared if name not in part.tied}
    changed = {
        what: {inside[name]: value for name, value in values.items() if name in inside}
        for what, values in changes.items()
    }
    if changed["prior"] and not isinstance(part.prior, Mapping):
        raise UsageError(
            f"--prior is for single parameters, and the prior of {part.name} is an earlier fit: "
            "leave it out."
        )

    # A parameter is either fixed or free: each option undoes what the problem says.
    fixed = {name: x for name, x in part.fixed_values.items() if name not in changed["free"]}
    free = [name for name in part.free if name not in changed["fixed"]]
    return part.with_(
        fixed={**fixed, **changed["fixed"]},
        free=tuple(dict.fromkeys([*free, *changed["free"]])),
        **{
            what: {**getattr(part, what), **changed[what]}
            for what in ("bounds", "start", "starts", "prior")
            if changed[what]
        },
    )
