"""A prior as one more part of a sum: a measurement of the parameters, with its own errors."""

from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.record import Record
from greybox.modeling.formulation.prior import NormalPrior, Prior
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.parameter import Parameters
from greybox.modeling.state_space import StateSpace

NAME = "a-priori knowledge"


def with_priors(problem: Problem | Sum[Problem]) -> Problem | Sum[Problem]:
    """Return the problem with its priors as one more part; the problem itself without priors.

    Raises
    ------
    ValueError
        If two parts have different priors of one parameter.
    """
    priors = stated_priors(problem)
    if not priors:
        return problem
    return Sum((*problem.as_added, _part(priors, problem.parameters)), problem.name)


def stated_priors(problem: Problem | Sum[Problem]) -> list[NormalPrior]:
    """Return the priors of the parts of a problem, each once."""
    priors = {
        (prior.names, prior.mean.tobytes(), prior.covariance.tobytes()): prior
        for part in problem.parts
        for prior in part.priors
    }
    names = [name for prior in priors.values() for name in prior.names]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(
            f"two parts have different priors of {twice[0]!r}: give it in one of them, or give one "
            f"parameter another name, rename={{{twice[0]!r}: ...}}."
        )
    return [*priors.values()]


def _part(priors: list[NormalPrior], parameters: Parameters) -> Problem:
    """Return the part that measures the parameters along directions with independent errors."""
    # Multiplied by these roots, the errors of a correlated prior are independent.
    roots = [np.linalg.inv(np.linalg.cholesky(prior.covariance)) for prior in priors]
    rows = [
        (prior.names, row, float(row @ prior.mean))
        for prior, root in zip(priors, roots, strict=True)
        for row in root
    ]
    names = tuple(f"prior_{k + 1}" for k in range(len(rows)))

    def output(self: Any, x: Any, u: Any, p: Any) -> tuple[Any, ...]:
        return tuple(
            sum(c * p[name] for c, name in zip(row, of, strict=True) if c) for of, row, _ in rows
        )

    declared = {
        name: replace(parameters[name], prior=None) for prior in priors for name in prior.names
    }
    body = {
        "__doc__": "A-priori knowledge of the parameters.",
        "states": (),
        "inputs": (),
        "outputs": names,
    }
    # As a static model with these combinations as outputs, a prior needs no code of its own in
    # solvers and statistics.
    model = type("Prior", (StateSpace,), {**body, **declared, "output": output})
    measured = {name: np.array([value]) for name, (_, _, value) in zip(names, rows, strict=True)}
    record = Record(np.zeros(1), measured, name=NAME, has_time=False)

    return Problem(model(), record, Prior(noise=dict.fromkeys(names, 1.0)), name=NAME)
