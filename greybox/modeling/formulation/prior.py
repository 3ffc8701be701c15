"""A-priori knowledge of parameters: normal distributions, or an earlier fit."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import array_of
from greybox.data.files.wording import listed
from greybox.modeling.formulation.held_estimate import HeldEstimate, shared_parameters
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import require_known
from greybox.modeling.parameter import Parameters, normal_prior

Knowledge = tuple[float, float] | HeldEstimate
"""Mean and standard deviation of a parameter, or an earlier fit with estimate and covariance."""


@frozen
class Prior(TimeCriterion):
    """The negative logarithm of a normal density: it makes a likelihood a posterior."""

    rule = "a-priori knowledge"
    condition = "a-priori knowledge that is normal and independent of the errors of the data"
    known_noise = True
    is_prior = True

    @property
    def description(self) -> str:
        """The rule in words."""
        return self.rule


@frozen
class NormalPrior:
    """A normal density of some parameters.

    Attributes
    ----------
    names : tuple of str
        Outside names.
    mean, covariance : (k,) and (k, k) arrays
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    @property
    def stated(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation by name."""
        sigma = np.sqrt(np.diag(self.covariance))
        return dict(
            zip(self.names, zip(self.mean.tolist(), sigma.tolist(), strict=True), strict=True)
        )


def normal_priors(
    declared: Parameters,
    prior: Any,
    outside: Mapping[str, str],
) -> list[NormalPrior]:
    """Return the priors of free parameters: those of `prior`, else those of the model.

    `declared` are the model's parameters that are not tied, by names inside; `outside` maps these
    to names outside.

    Raises
    ------
    ValueError, TypeError
        For a parameter that is not free, a fit without the covariance of a parameter, or values
        that are not two numbers.
    """
    free = [name for name, parameter in declared.items() if not parameter.fixed]
    if isinstance(prior, HeldEstimate):
        knowledge = shared_parameters(prior, {name: outside[name] for name in free}, "prior")
    else:
        require_kind("prior", prior, Mapping, "{name: (mean, standard deviation)} or a Fit")
        knowledge = prior

    require_known(knowledge, free, "free parameter", "prior: the problem")

    # Parameters of one earlier fit are correlated, and form one density.
    densities: list[NormalPrior] = []
    sources: dict[int, tuple[HeldEstimate, list[str]]] = {}
    for name in free:
        value = knowledge.get(name, declared[name].prior)
        if value is None:
            continue
        if isinstance(value, HeldEstimate):
            sources.setdefault(id(value), (value, []))[1].append(outside[name])
            continue
        mean, sigma = normal_prior(value, f"the prior of {name}")
        densities.append(NormalPrior((outside[name],), np.array([mean]), np.array([[sigma**2]])))

    return densities + [_of_estimate(source, tuple(names)) for source, names in sources.values()]


def _of_estimate(source: HeldEstimate, names: tuple[str, ...]) -> NormalPrior:
    covariance = np.asarray(source.covariance_of(names), dtype=float)
    unknown = [
        name
        for name, v in zip(names, np.diag(covariance), strict=True)
        if not (np.isfinite(v) and v > 0)
    ]
    if unknown:
        raise ValueError(
            f"the Fit given as prior has no standard error of {listed(unknown)}: give "
            "prior={name: (mean, standard deviation)} for the others, or fix it in both."
        )

    return NormalPrior(names, array_of(source.estimate, names), covariance)
