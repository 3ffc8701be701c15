"""All warnings of a fit, the most serious first."""

from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.discretization import (
    coarse_pade,
    delays_within_a_sample,
    discretization_warnings,
)
from greybox.estimate.diagnostics.global_minimum import (
    discontinuous_costs,
    failure_warnings,
    few_agreeing_starts,
    minimum_at_kink,
    rival_minima,
    several_estimates_of_one_response,
    unfinished_runs,
)
from greybox.estimate.diagnostics.identifiability import (
    at_bounds,
    held_without_error,
    no_degrees_of_freedom,
    not_determined,
    prior_conflicts,
)
from greybox.estimate.diagnostics.noise_level import (
    correlated_frequencies,
    gusts,
    manoeuvre_warnings,
    narrow_modes,
    unlikely_noise,
)
from greybox.estimate.diagnostics.not_finite import not_finite_warnings
from greybox.estimate.diagnostics.outlying_points import outlying_points, outlying_samples
from greybox.estimate.diagnostics.records import (
    finding_warnings,
    record_warnings,
    repeated_data,
)
from greybox.estimate.diagnostics.repeated import once
from greybox.estimate.result import Fit
from greybox.estimate.verdict import wrapped
from greybox.files.arrays import Strings
from greybox.solve.discretization_error import DiscretizationError
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart

UNEXPLAINED = (
    "the model does not explain the data, so its estimates may be biased, and the standard errors "
    "would be valid only if it did."
)


def warnings_of_failure(search: Multistart, solver: LocalSolver) -> Strings:
    """Return the warnings of a fit without a converged run."""
    return (
        *not_finite_warnings(solver.nlp, search),
        *failure_warnings(search, solver),
        *finding_warnings(solver.nlp),
    )


def warnings(
    search: Multistart,
    accuracy: Accuracy,
    answer: Fit,
    error: DiscretizationError | None,
) -> Strings:
    """Return the warnings of a converged fit."""
    # In the order of consequence: first what could make the answer meaningless, then what makes
    # parameters or standard errors doubtful, then single points.
    nlp, x = accuracy.nlp, accuracy.x
    misfit = answer.misfit
    explained = answer.is_explained
    exact = misfit and misfit.is_exact
    # Disturbances under feedback may look like missing terms, which leave a part of the misfit.
    noisy = not exact and not (misfit and misfit.is_large)
    # Residuals of a wrong model are not errors, nor is rounding: their correlation does not matter.
    errors = explained and not exact
    return (
        *not_finite_warnings(nlp, search),
        *wrapped(answer),
        *finding_warnings(nlp),
        *repeated_data(nlp),
        *discretization_warnings(accuracy, error),
        *(() if explained else (UNEXPLAINED,)),
        *record_warnings(answer, accuracy, noisy=noisy),
        *gusts(accuracy, noisy=noisy, explained=explained),
        *not_determined(accuracy),
        *held_without_error(accuracy),
        *no_degrees_of_freedom(nlp),
        *prior_conflicts(answer),
        *at_bounds(answer, accuracy),
        *few_agreeing_starts(search, answer.agreeing),
        *unfinished_runs(search),
        *minimum_at_kink(search),
        *rival_minima(search, accuracy),
        *several_estimates_of_one_response(search, accuracy),
        *coarse_pade(answer.responses),
        *delays_within_a_sample(nlp, answer),
        *unlikely_noise(accuracy),
        *once(narrow_modes(answer)),
        *manoeuvre_warnings(accuracy),
        *(correlated_frequencies(accuracy) if errors else ()),
        *discontinuous_costs(nlp),
        *(() if exact else outlying_points(nlp, x, explained=explained)),
        *(once(outlying_samples(answer.records)) if errors else ()),
    )
