"""One likelihood for fits of frequency responses by different criteria, for AIC and BIC."""

import numpy as np

from greybox.estimate.fit import SolverChoice
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.result import Fit, Fits
from greybox.files.arrays import frozen
from greybox.formulation.frequency_criteria import Criterion, MaximumLikelihood, RelativeLikelihood
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.multistart import multistart


@frozen
class Likelihoods:
    """The fits of a comparison on the scale of one likelihood.

    Attributes
    ----------
    criterion : Criterion
        The likelihood.
    originals : tuple of Fit
        By any criterion.
    least : tuple of float or None
        Its minima next to the estimates; None where that is not known.
    """

    criterion: Criterion
    originals: tuple[Fit, ...]
    least: tuple[float | None, ...]

    @property
    def costs(self) -> list[float]:
        """Negative log-likelihoods, up to a constant of the data."""
        pairs = zip(self.least, self.originals, strict=True)
        name = self.criterion.name
        return [fit.costs[name] if cost is None else cost for cost, fit in pairs]

    @property
    def unknowns(self) -> list[int]:
        """Numbers of free parameters and noise variances."""
        return [len(fit.free) + self.criterion.nuisances * len(fit.parts) for fit in self.originals]


def common_likelihood(fits: Fits) -> Likelihoods | None:
    """Return fits of responses on the scale of one likelihood; None for other data or weights."""
    parts = [part for fit in fits for part in fit.parts]
    if not all(isinstance(part, FittedResponse) and part.weight == 1 for part in parts):
        return None
    # Measured variances, where all data have them, are better than the assumption that errors are
    # proportional to the response.
    has_variances = all(part.data.variance is not None for part in fits[0].responses)
    criterion = MaximumLikelihood() if has_variances else RelativeLikelihood()
    least = (_least_cost(fit, criterion) for fit in fits)
    return Likelihoods(criterion, tuple(fits), tuple(least))


@one_thread_at_a_time  # also frees what it compiles
def _least_cost(fit: Fit, criterion: Criterion) -> float | None:
    """Return the cost at the minimum of this criterion next to the estimate, if it is found.

    A fit would judge the minimum too, which takes several times as long.
    """
    if all(part.criterion_class == criterion.class_path for part in fit.parts):
        return fit.cost
    try:
        problem = problem_of(fit).with_(criterion=criterion)
    except (LookupError, ValueError):
        return None
    nlp, solver = SolverChoice().compiled(problem)
    start = np.array([[fit.estimate[name] for name in nlp.free]])
    minima = solver.polished(multistart(nlp, solver, start, movable=False)).minima
    is_found = minima and minima[0].cost <= fit.costs[criterion.name]
    return minima[0].cost if is_found else None
