"""Options for single parameters: fixed, free, bounds, starts and priors, by their names in the answer."""

import argparse
from collections.abc import Mapping
from typing import Any

from greybox.cli.options import UsageError, assignments, intervals, uncertain_values
from greybox.compiled.compiled_problem import AnyProblem
from greybox.files.text_table import alternatives
from greybox.formulation.problem import Problem


def add_value_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options for values and bounds."""
    add = parser.add_argument
    add("--fix", nargs="+", default=[], metavar="NAME=VALUE", help="fix parameters at these values")
    add(
        "--free",
        nargs="+",
        default=[],
        metavar="NAME",
        help="estimate parameters that the model declares fixed",
    )
    add(
        "--bounds",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="bounds in place of the declared ones, a1=-10:10; leave an end open with T=0:",
    )
    add(
        "--start",
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help="start values in place of the declared ones",
    )


def add_parameter_options(parser: argparse.ArgumentParser) -> None:
    """Declare all options."""
    add_value_options(parser)
    add = parser.add_argument
    add(
        "--starts-box",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="range of drawn starts, in place of the bounds",
    )
    add(
        "--prior",
        nargs="+",
        default=[],
        metavar="NAME=VALUE+-SIGMA",
        help="normal prior with its standard deviation; the criterion must be a likelihood",
    )


def with_parameter_options(problem: AnyProblem, options: argparse.Namespace) -> AnyProblem:
    """Return the problem with the options applied to every part that has the parameters.

    Raises
    ------
    UsageError, ValueError
        For words that are no assignments, and unknown names.
    """
    changes: dict[str, Mapping[str, Any]] = {
        "fixed": assignments(options.fix, "--fix"),
        "free": dict.fromkeys(options.free),
        "bounds": intervals(options.bounds, "--bounds"),
        "start": assignments(options.start, "--start"),
        "starts": intervals(options.starts_box, "--starts-box"),
        "prior": uncertain_values(options.prior, "--prior"),
    }
    for name in (name for names in changes.values() for name in names):
        if name not in problem.parameters:
            known = alternatives(name, problem.parameters)
            raise ValueError(f"{problem.name} has no parameter {name!r}; it has {known}")
    if not any(changes.values()):
        return problem
    return problem.with_parts([_restated(part, changes) for part in problem.parts])


def _restated(part: Problem, changes: Mapping[str, Mapping[str, Any]]) -> Problem:
    inside = {part.outside(name): name for name in part.declared if name not in part.tied}
    own = {
        what: {inside[name]: value for name, value in values.items() if name in inside}
        for what, values in changes.items()
    }
    if own["prior"] and not isinstance(part.prior, Mapping):
        raise UsageError(
            f"--prior goes with parameters, and {part.name} has an earlier fit as prior: leave it out."
        )
    held = {name: value for name, value in part.fixed_values.items() if name not in own["free"]}
    kept = [name for name in part.free if name not in own["fixed"]]
    return part.with_(
        fixed={**held, **own["fixed"]},
        free=tuple(dict.fromkeys([*kept, *own["free"]])),
        **{
            what: {**getattr(part, what), **own[what]}
            for what in ("bounds", "start", "starts", "prior")
            if own[what]
        },
    )
