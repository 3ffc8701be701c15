"""One likelihood for fits of frequency responses by different criteria, for AIC and BIC."""

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
    name : str
        The likelihood, in words.
    fits : tuple of Fit
        Fits at the maximum of that likelihood next to the estimate; the original fit where its
        problem cannot be built again.
    costs : tuple of float
        Negative log-likelihoods, up to a constant of the data.
    nuisances : tuple of int
        Number of noise variances that every fit also estimates.
    at_maximum : tuple of bool
        False where the cost belongs to the original estimate, which is not a maximum.
    """

    name: str
    fits: tuple[Fit, ...]
    costs: tuple[float, ...]
    nuisances: tuple[int, ...]
    at_maximum: tuple[bool, ...]


def common_likelihood(fits: Sequence[Fit]) -> Likelihoods | None:
    """Return fits of responses on the scale of one likelihood; None for other data or weights."""
    weighted = any(part.weight != 1 for fit in fits for part in fit.parts)
    if weighted or not all(map(has_responses_alone, fits)):
        return None
    # Measured variances, where all data have them, say more than the assumption that errors are
    # proportional to the response.
    has_variances = all(part.data.variance is not None for part in fits[0].responses)
    criterion: Criterion = MaximumLikelihood() if has_variances else RelativeLikelihood()
    refits = [_at_maximum(fit, criterion) for fit in fits]
    pairs = list(zip(fits, refits, strict=True))
    return Likelihoods(
        name=f"{type(criterion).__name__} ({criterion.description})",
        fits=tuple(refit or fit for fit, refit in pairs),
        costs=tuple(refit.cost if refit else fit.costs[criterion.name] for fit, refit in pairs),
        nuisances=tuple(criterion.nuisances * len(fit.parts) for fit in fits),
        at_maximum=tuple(refit is not None for refit in refits),
    )


def has_responses_alone(fit: Fit) -> bool:
    """Tell whether all data of a fit are frequency responses."""
    return len(fit.responses) == len(fit.parts)


def _at_maximum(fit: Fit, criterion: Criterion) -> Fit | None:
    """Return the fit by this criterion, started at the estimate; None where it fails."""
    if all(part.criterion_class == criterion.class_path for part in fit.parts):
        return fit
    try:
        problem = problem_of(fit).with_(criterion=criterion)
    except (LookupError, ValueError):
        return None
    # One start at the estimate: another minimum would be another answer than the one compared.
    start = {name: fit.estimate[name] for name in fit.free}
    refit = fit_problem(problem, [start], profiles=False, progress=False)
    return refit if refit.converged and refit.cost <= fit.costs[criterion.name] else None
