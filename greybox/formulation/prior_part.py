"""A-priori knowledge as one more part of a sum: a measurement of the parameters themselves, with its own errors."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.record import Record
from greybox.formulation.prior import NormalPrior, Prior
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace

NAME = "a-priori knowledge"


def with_priors(problem: Problem | Sum[Problem]) -> Problem | Sum[Problem]:
    """Return the problem with the a-priori knowledge that its parts state, as a part of its own; itself without any.

    Raises
    ------
    ValueError
        If two parts state different knowledge of one parameter.
    """
    if any(isinstance(part.criterion, Prior) for part in problem.parts):
        return problem
    found = stated_priors(problem)
    if not found:
        return problem
    parts = problem.as_added if isinstance(problem, Sum) else (problem,)
    return Sum((*parts, _part(found, problem.parameters)), problem.name)


def stated_priors(problem: Problem | Sum[Problem]) -> list[NormalPrior]:
    """Return the a-priori knowledge that the parts of a problem state, each once."""
    found: list[NormalPrior] = []
    for part in problem.parts:
        for each in part.priors:
            if any(each.same_as(other) for other in found):
                continue
            twice = [name for other in found for name in each.names if name in other.names]
            if twice:
                raise ValueError(
                    f"two parts state different a-priori knowledge of {twice[0]!r}: state it in one of them, or give "
                    f"one another name, rename={{{twice[0]!r}: ...}}."
                )
            found.append(each)
    return found


def _part(found: list[NormalPrior], parameters: Mapping[str, Parameter]) -> Problem:
    """Return the part that measures the parameters, in the directions in which their errors are independent."""
    roots = [np.linalg.inv(np.linalg.cholesky(each.covariance)) for each in found]
    rows = [
        (each.names, row, float(row @ each.mean))
        for each, root in zip(found, roots, strict=True)
        for row in root
    ]
    names = tuple(f"prior_{k + 1}" for k in range(len(rows)))

    def output(self: Any, x: Any, u: Any, p: Any) -> tuple[Any, ...]:
        return tuple(
            sum(c * p[name] for c, name in zip(row, of, strict=True) if c) for of, row, _ in rows
        )

    declared = {
        name: replace(parameters[name], prior=None) for each in found for name in each.names
    }
    body = {
        "__doc__": "A-priori knowledge of the parameters.",
        "states": (),
        "inputs": (),
        "outputs": names,
    }
    model = type("Prior", (StateSpace,), {**body, **declared, "output": output})
    measured = {name: np.array([value]) for name, (_, _, value) in zip(names, rows, strict=True)}
    record = Record(np.zeros(1), measured, name=NAME, has_time=False)
    return Problem(model(), record, Prior(noise=dict.fromkeys(names, 1.0)), name=NAME)
