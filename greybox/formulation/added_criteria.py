"""Criteria of a sum: likelihoods add, and so do costs of the same criterion."""

from collections.abc import Sequence
from typing import Any

from greybox.formulation.frequency_criteria import RelativeLikelihood


def with_costs_that_add(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Return the parts with criteria whose costs may be added.

    Negative log-likelihoods add for all data. If one criterion is a likelihood, as that of every
    record, a response without a criterion of its own gets `RelativeLikelihood` instead of
    `RelativeError`. Other costs have different scales: they add only if criterion and settings are
    the same.

    Raises
    ------
    ValueError
        If one criterion is a likelihood and another is not, or if two others differ.
    """
    # One likelihood makes the sum one: all others must be likelihoods too.
    likelihood = next((part for part in parts if part.criterion.is_likelihood), None)
    if likelihood is None:
        first = parts[0]
        second = next((part for part in parts if part.criterion != first.criterion), None)
        if second is not None:
            raise ValueError(
                f"{first.name!r} has the criterion {first.criterion!r} and {second.name!r} "
                f"{second.criterion!r}: costs of different criteria add only where both are "
                "likelihoods, so give both the same criterion, or RelativeLikelihood(), or "
                "MaximumLikelihood() where variances are known."
            )
        return tuple(parts)

    result = []
    for part in parts:
        if not (part.criterion.is_likelihood or part.has_default_criterion):
            raise ValueError(
                f"{part.name!r} has the criterion {type(part.criterion).__name__} and "
                f"{likelihood.name!r} {type(likelihood.criterion).__name__}: the cost of a "
                "likelihood adds to that of another likelihood alone, so leave the criterion of "
                "the response out, or give RelativeLikelihood(), or MaximumLikelihood() where "
                "variances are known."
            )
        result.append(
            part if part.criterion.is_likelihood else part.with_(criterion=RelativeLikelihood())
        )

    return tuple(result)
