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
    if likelihood:
        parts = [
            part.with_(criterion=RelativeLikelihood())
            if part.has_default_criterion and not part.criterion.is_likelihood
            else part
            for part in parts
        ]
    first = likelihood or parts[0]
    for part in parts:
        if not (part.criterion.is_likelihood if likelihood else part.criterion == first.criterion):
            raise ValueError(
                f"{part.name!r} has the criterion {part.criterion!r} and {first.name!r} "
                f"{first.criterion!r}: costs of different criteria add only where both are "
                "likelihoods, so leave out the criterion of the response, or give both the same "
                "criterion, or RelativeLikelihood(), or MaximumLikelihood() where variances are "
                "known."
            )

    return tuple(parts)
