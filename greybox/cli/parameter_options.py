"""Options for single parameters, by their names in the answer: fixed, bounds, starts, priors."""

import argparse
from collections.abc import Mapping
from typing import Any

from greybox.cli.options import UsageError
from greybox.compiled.compiled_problem import AnyProblem
from greybox.files.text_table import alternatives
from greybox.formulation.problem import Problem


def stated_values(options: argparse.Namespace) -> dict[str, Mapping[str, Any]]:
    """Return fixed values, bounds and starts by name, as arguments of a problem."""
    return {"fixed": options.fix, "bounds": options.bounds, "start": options.start}


def with_parameter_options(problem: AnyProblem, options: argparse.Namespace) -> AnyProblem:
    """Return the problem with the options applied to every part that has the parameters.

    Raises
    ------
    UsageError, ValueError
        For words of another form, and unknown names.
    """
    changes: dict[str, Mapping[str, Any]] = {
        **stated_values(options),
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
