"""A prior as one more part of a sum: a measurement of the parameters, with its own errors."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.record import Record
from greybox.modeling.formulation.prior import NormalPrior, Prior
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.parameter import Parameters
from greybox.modeling.state_space import StateSpace

NAME = "a-priori knowledge"


class _Combination(NamedTuple):
    """A linear combination of parameters that a prior determines with a standard deviation of 1."""

    names: tuple[str, ...]
    weights: Array  # (names,)
    mean: float

    def value(self, p: Any) -> Any:
        """Return the combination of the parameters p, a mapping of name to number or symbol."""
        # Parameters of weight zero are left out, so that they do not enter the formula.
        return sum(
            weight * p[name]
            for weight, name in zip(self.weights, self.names, strict=True)
            if weight
        )


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
    priors: list[NormalPrior] = []
    for part in problem.parts:
        for prior in part.priors:
            if not any(_are_equal(prior, other) for other in priors):
                priors.append(prior)

    names: list[str] = []
    for prior in priors:
        names += prior.names
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        name = repeated[0]
        raise ValueError(
            f"two parts have different priors of {name!r}: give it in one of them, or give one "
            f"parameter another name, rename={{{name!r}: ...}}."
        )
    return priors


def _are_equal(prior: NormalPrior, other: NormalPrior) -> bool:
    """Return whether two priors have the same names and numbers."""
    return (
        prior.names == other.names
        and np.array_equal(prior.mean, other.mean)
        and np.array_equal(prior.covariance, other.covariance)
    )


def _part(priors: list[NormalPrior], parameters: Parameters) -> Problem:
    """Return the part that measures linear combinations of parameters with independent errors."""
    combinations = []
    for prior in priors:
        # Multiplied by this matrix, the errors of a correlated prior are independent.
        whitening = np.linalg.inv(np.linalg.cholesky(prior.covariance))
        for weights in whitening:
            mean = float(weights @ prior.mean)
            combinations.append(_Combination(prior.names, weights, mean))
    names = tuple(f"prior_{k + 1}" for k in range(len(combinations)))

    def output(self: Any, x: Any, u: Any, p: Any) -> tuple[Any, ...]:
        return tuple(combination.value(p) for combination in combinations)

    body: dict[str, Any] = {
        "__doc__": "A-priori knowledge of the parameters.",
        "states": (),
        "inputs": (),
        "outputs": names,
        "output": output,
    }
    for prior in priors:
        for name in prior.names:
            body[name] = replace(parameters[name], prior=None)
    # The prior becomes a static model whose outputs are the combinations. Solvers and statistics
    # then need no code for priors.
    model = type("Prior", (StateSpace,), body)
    measured = {}
    for name, combination in zip(names, combinations, strict=True):
        measured[name] = np.array([combination.mean])
    record = Record(np.zeros(1), measured, name=NAME, has_time=False)

    return Problem(model(), record, Prior(noise=dict.fromkeys(names, 1.0)), name=NAME)
