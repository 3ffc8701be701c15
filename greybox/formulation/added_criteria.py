"""The criteria of problems that are added: a likelihood adds to likelihoods alone."""

from collections.abc import Sequence

from greybox.formulation.frequency_criteria import RelativeLikelihood
from greybox.formulation.summand import Part


def with_costs_that_add(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Return the parts with criteria whose costs may be added.

    Negative log-likelihoods add, whatever the data. Where one of the criteria is a likelihood, as that of every record
    is, a response that was given none gets `RelativeLikelihood` in place of `RelativeError`.

    Raises
    ------
    ValueError
        If a criterion that was asked for is a likelihood and another one is not.
    """
    likelihood = next((part for part in parts if part.criterion.is_likelihood), None)
    if likelihood is None:
        return tuple(parts)

    result = []
    for part in parts:
        if not (part.criterion.is_likelihood or part.has_default_criterion):
            raise ValueError(
                f"{part.name!r} has the criterion {type(part.criterion).__name__} and {likelihood.name!r} "
                f"{type(likelihood.criterion).__name__}: the cost of a likelihood adds to that of another likelihood "
                "alone, so leave the criterion of the response out, or give RelativeLikelihood(), or "
                "MaximumLikelihood() where variances are known."
            )
        result.append(part if part.criterion.is_likelihood else part.with_(criterion=RelativeLikelihood()))
    return tuple(result)
