"""The warnings that an answer may have whatever its data are, most serious first."""

from collections.abc import Sequence

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.estimate.covariance import Accuracy
from greybox.estimate.diagnostics.delay_approximation import coarse_pade
from greybox.estimate.diagnostics.frequency_correlation import correlated_frequencies
from greybox.estimate.diagnostics.global_minimum import (
    discontinuous_costs,
    few_agreeing_starts,
    rival_minima,
    several_estimates_of_one_response,
    unfinished_runs,
)
from greybox.estimate.diagnostics.identifiability import (
    at_bounds,
    held_without_error,
    no_degrees_of_freedom,
    not_determined,
)
from greybox.estimate.diagnostics.noise_level import biased_gains, unlikely_noise
from greybox.solve.minima import Multistart


def warnings(
    nlp: CompiledProblem,
    search: Multistart,
    accuracy: Accuracy,
    pade_errors: Sequence[float | None],
    trajectories: Sequence[Trajectory],
) -> tuple[str, ...]:
    """Return everything a reader should know before believing the estimate, most serious first."""
    best = search.minima[0]
    return (
        *not_determined(nlp, accuracy),
        *held_without_error(nlp, accuracy),
        *no_degrees_of_freedom(nlp),
        *at_bounds(nlp, best, accuracy),
        *few_agreeing_starts(nlp, search),
        *unfinished_runs(search),
        *rival_minima(nlp, search),
        *several_estimates_of_one_response(nlp, search, accuracy),
        *coarse_pade(nlp, pade_errors),
        *biased_gains(nlp, accuracy),
        *unlikely_noise(nlp, trajectories),
        *correlated_frequencies(nlp, best.estimate, accuracy),
        *discontinuous_costs(nlp),
    )
