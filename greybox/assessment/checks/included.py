"""The checks that every fit stands, unless you say otherwise.

They stand in the order of consequence: first what could make the answer meaningless, then what
makes parameters or standard errors doubtful, then single points; at the end, remarks.
"""

from collections.abc import Callable, Sequence

from greybox.assessment.checks.at_bounds import at_bounds
from greybox.assessment.checks.better_weights import better_weights
from greybox.assessment.checks.carried_over import carried_over
from greybox.assessment.checks.coarse_integration import coarse_integration
from greybox.assessment.checks.coarse_pade import coarse_pade
from greybox.assessment.checks.colored_predictions import colored_predictions
from greybox.assessment.checks.correlated_frequencies import correlated_frequencies
from greybox.assessment.checks.data_findings import data_findings
from greybox.assessment.checks.delays_within_a_sample import delays_within_a_sample
from greybox.assessment.checks.determined_together import determined_together
from greybox.assessment.checks.discontinuous_cost import discontinuous_cost
from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.faulty_samples import faulty_samples
from greybox.assessment.checks.feedback import feedback
from greybox.assessment.checks.few_agreeing_starts import few_agreeing_starts
from greybox.assessment.checks.finding import Findings
from greybox.assessment.checks.flattened_inputs import flattened_inputs
from greybox.assessment.checks.gain_at_limit import gain_at_limit
from greybox.assessment.checks.gusts import gusts
from greybox.assessment.checks.held_without_error import held_without_error
from greybox.assessment.checks.manoeuvre_errors import manoeuvre_errors
from greybox.assessment.checks.minimum_at_kink import minimum_at_kink
from greybox.assessment.checks.narrow_modes import narrow_modes
from greybox.assessment.checks.no_degrees_of_freedom import no_degrees_of_freedom
from greybox.assessment.checks.not_determined import not_determined
from greybox.assessment.checks.not_finite import not_finite
from greybox.assessment.checks.outlying_points import outlying_points
from greybox.assessment.checks.outlying_samples import outlying_samples
from greybox.assessment.checks.prior_conflicts import prior_conflicts
from greybox.assessment.checks.repeated_data import repeated_data
from greybox.assessment.checks.resting_inputs import resting_inputs
from greybox.assessment.checks.rival_minima import rival_minima
from greybox.assessment.checks.rounded_outputs import rounded_outputs
from greybox.assessment.checks.several_estimates import several_estimates
from greybox.assessment.checks.slow_errors import slow_errors
from greybox.assessment.checks.unequal_errors import unequal_errors
from greybox.assessment.checks.unexplained import unexplained
from greybox.assessment.checks.unexplained_outputs import unexplained_outputs
from greybox.assessment.checks.unfinished_runs import unfinished_runs
from greybox.assessment.checks.unlikely_noise import unlikely_noise
from greybox.assessment.checks.unstated_holds import unstated_holds
from greybox.assessment.checks.unused_noise import unused_noise
from greybox.assessment.checks.wrapped_outputs import wrapped_outputs

Check = Callable[[Evidence], Findings]
"""Looks at the evidence of a fit and yields what it finds; nothing where all is well."""

CHECKS: tuple[Check, ...] = (
    not_finite,
    wrapped_outputs,
    data_findings,
    faulty_samples,
    repeated_data,
    coarse_integration,
    unexplained,
    slow_errors,
    unexplained_outputs,
    feedback,
    colored_predictions,
    gain_at_limit,
    flattened_inputs,
    carried_over,
    gusts,
    not_determined,
    held_without_error,
    no_degrees_of_freedom,
    prior_conflicts,
    at_bounds,
    few_agreeing_starts,
    unfinished_runs,
    minimum_at_kink,
    rival_minima,
    several_estimates,
    coarse_pade,
    delays_within_a_sample,
    unstated_holds,
    unlikely_noise,
    narrow_modes,
    manoeuvre_errors,
    correlated_frequencies,
    discontinuous_cost,
    outlying_points,
    unequal_errors,
    outlying_samples,
    unused_noise,
    better_weights,
    resting_inputs,
    rounded_outputs,
    determined_together,
)


def require_checks(checks: Sequence[Check]) -> None:
    """Raise TypeError for anything but a sequence of functions."""
    if (
        isinstance(checks, str)
        or not isinstance(checks, Sequence)
        or not all(map(callable, checks))
    ):
        raise TypeError(
            f"checks is {checks!r:.80}: give functions of the evidence, [*gb.CHECKS, mine], or ()."
        )
