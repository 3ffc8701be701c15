"""One likelihood for fits of frequency responses by different criteria, for AIC and BIC."""

from collections.abc import Sequence
from dataclasses import dataclass

from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.result import Fit
from greybox.formulation.frequency_criteria import Criterion, MaximumLikelihood, RelativeLikelihood


@dataclass(frozen=True, eq=False)
class Likelihoods:
    """The fits of a comparison on the scale of one likelihood.

    Attributes
    ----------
    criterion : Criterion
        The likelihood.
    fits : tuple of Fit
        Fits at the maximum of that likelihood next to the estimate; the original fit where its
        problem cannot be built again.
    """

    criterion: Criterion
    fits: tuple[Fit, ...]

    @property
    def at_maximum(self) -> list[bool]:
        """Whether each fit is at the maximum, not an original fit by another criterion."""
        return [_has_criterion(fit, self.criterion) for fit in self.fits]

    @property
    def costs(self) -> list[float]:
        """Negative log-likelihoods, up to a constant of the data."""
        pairs = zip(self.fits, self.at_maximum, strict=True)
        return [fit.cost if at else fit.costs[self.criterion.name] for fit, at in pairs]

    @property
    def unknowns(self) -> list[int]:
        """Numbers of free parameters and noise variances."""
        return [len(fit.free) + self.criterion.nuisances * len(fit.parts) for fit in self.fits]


def common_likelihood(fits: Sequence[Fit]) -> Likelihoods | None:
    """Return fits of responses on the scale of one likelihood; None for other data or weights."""
    parts = [part for fit in fits for part in fit.parts]
    if not all(isinstance(part, FittedResponse) and part.weight == 1 for part in parts):
        return None
    # Measured variances, where all data have them, say more than the assumption that errors are
    # proportional to the response.
    has_variances = all(part.data.variance is not None for part in fits[0].responses)
    criterion: Criterion = MaximumLikelihood() if has_variances else RelativeLikelihood()
    return Likelihoods(criterion, tuple(_at_maximum(fit, criterion) for fit in fits))


def _has_criterion(fit: Fit, criterion: Criterion) -> bool:
    return all(part.criterion_class == criterion.class_path for part in fit.parts)


def _at_maximum(fit: Fit, criterion: Criterion) -> Fit:
    """Return the fit by this criterion, started at the estimate; the same fit where it fails."""
    if _has_criterion(fit, criterion):
        return fit
    try:
        problem = problem_of(fit).with_(criterion=criterion)
    except (LookupError, ValueError):
        return fit
    # One start at the estimate: another minimum would be another answer than the one compared.
    start = {name: fit.estimate[name] for name in fit.free}
    refit = fit_problem(problem, [start], profiles=False, progress=False)
    return refit if refit.converged and refit.cost <= fit.costs[criterion.name] else fit
