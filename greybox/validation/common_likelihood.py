"""One likelihood for fits of frequency responses whatever they minimized, so that AIC and BIC can be compared."""

from collections.abc import Sequence
from dataclasses import dataclass

from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.result import Fit
from greybox.formulation.frequency_criteria import Criterion, MaximumLikelihood, RelativeLikelihood


@dataclass(frozen=True, eq=False)
class Likelihoods:
    """The fits of a comparison on the scale of one likelihood.

    Attributes
    ----------
    said : str
        Which likelihood, in words.
    fits : tuple of Fit
        At the maximum of that likelihood next to the estimate; the fit itself where it is one of
        that likelihood, or where its problem cannot be stated again.
    costs : tuple of float
        Negative log-likelihoods, up to a constant of the data.
    nuisances : tuple of int
        Variances of the noise that were estimated along, of every fit.
    at_maximum : tuple of bool
        False where the cost is that at the estimate, which is no maximum of this likelihood.
    """

    said: str
    fits: tuple[Fit, ...]
    costs: tuple[float, ...]
    nuisances: tuple[int, ...]
    at_maximum: tuple[bool, ...]


def common_likelihood(fits: Sequence[Fit]) -> Likelihoods | None:
    """Return the fits, which have the same responses, on the scale of one likelihood; else None.

    That of the given variances where all data have them, otherwise that of errors of one relative
    variance. There is none for other data and for weights.
    """
    if any(part.weight != 1 for fit in fits for part in fit.parts) or not all(
        map(has_responses_alone, fits)
    ):
        return None
    has_variances = all(part.data.variance is not None for part in fits[0].responses)
    criterion: Criterion = MaximumLikelihood() if has_variances else RelativeLikelihood()
    restated = [_at_maximum(fit, criterion) for fit in fits]
    return Likelihoods(
        said=f"{type(criterion).__name__} ({criterion.description})",
        fits=tuple(
            fit if found is None else found for fit, found in zip(fits, restated, strict=True)
        ),
        costs=tuple(
            fit.costs[criterion.name] if found is None else found.cost
            for fit, found in zip(fits, restated, strict=True)
        ),
        nuisances=tuple(criterion.nuisances * len(fit.parts) for fit in fits),
        at_maximum=tuple(found is not None for found in restated),
    )


def has_responses_alone(fit: Fit) -> bool:
    """Tell whether all data of a fit are frequency responses."""
    return len(fit.responses) == len(fit.parts)


def _at_maximum(fit: Fit, criterion: Criterion) -> Fit | None:
    """Return the fit by this criterion from the estimate; None where its problem cannot be stated again."""
    if all(part.criterion_class == criterion.class_path for part in fit.parts):
        return fit
    try:
        problem = problem_of(fit).with_(criterion=criterion)
    except (LookupError, ValueError):
        return None
    found = fit_problem(
        problem, [{name: fit.estimate[name] for name in fit.free}], profiles=False, progress=False
    )
    return found if found.converged and found.cost <= fit.costs[criterion.name] else None
