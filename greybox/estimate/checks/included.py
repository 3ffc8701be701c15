"""The checks that every fit stands, unless you say otherwise.

They stand in the order of consequence: first what could make the answer meaningless, then what
makes parameters or standard errors doubtful, then single points; at the end, remarks.
"""

from collections.abc import Callable, Sequence

from greybox.estimate.checks.at_bounds import at_bounds
from greybox.estimate.checks.better_weights import better_weights
from greybox.estimate.checks.carried_over import carried_over
from greybox.estimate.checks.coarse_integration import coarse_integration
from greybox.estimate.checks.coarse_pade import coarse_pade
from greybox.estimate.checks.colored_predictions import colored_predictions
from greybox.estimate.checks.correlated_frequencies import correlated_frequencies
from greybox.estimate.checks.data_findings import data_findings
from greybox.estimate.checks.delays_within_a_sample import delays_within_a_sample
from greybox.estimate.checks.determined_together import determined_together
from greybox.estimate.checks.discontinuous_cost import discontinuous_cost
from greybox.estimate.checks.evidence import Evidence
from greybox.estimate.checks.feedback import feedback
from greybox.estimate.checks.few_agreeing_starts import few_agreeing_starts
from greybox.estimate.checks.finding import Findings
from greybox.estimate.checks.flattened_inputs import flattened_inputs
from greybox.estimate.checks.gain_at_limit import gain_at_limit
from greybox.estimate.checks.gusts import gusts
from greybox.estimate.checks.held_without_error import held_without_error
from greybox.estimate.checks.manoeuvre_errors import manoeuvre_errors
from greybox.estimate.checks.minimum_at_kink import minimum_at_kink
from greybox.estimate.checks.narrow_modes import narrow_modes
from greybox.estimate.checks.no_degrees_of_freedom import no_degrees_of_freedom
from greybox.estimate.checks.not_determined import not_determined
from greybox.estimate.checks.not_finite import not_finite
from greybox.estimate.checks.outlying_points import outlying_points
from greybox.estimate.checks.outlying_samples import outlying_samples
from greybox.estimate.checks.prior_conflicts import prior_conflicts
from greybox.estimate.checks.repeated_data import repeated_data
from greybox.estimate.checks.resting_inputs import resting_inputs
from greybox.estimate.checks.rival_minima import rival_minima
from greybox.estimate.checks.rounded_outputs import rounded_outputs
from greybox.estimate.checks.several_estimates import several_estimates
from greybox.estimate.checks.slow_errors import slow_errors
from greybox.estimate.checks.unequal_errors import unequal_errors
from greybox.estimate.checks.unexplained import unexplained
from greybox.estimate.checks.unexplained_outputs import unexplained_outputs
from greybox.estimate.checks.unfinished_runs import unfinished_runs
from greybox.estimate.checks.unlikely_noise import unlikely_noise
from greybox.estimate.checks.unused_noise import unused_noise
from greybox.estimate.checks.wrapped_outputs import wrapped_outputs

Check = Callable[[Evidence], Findings]
"""Looks at the evidence of a fit and yields what it finds; nothing where all is well."""

CHECKS: tuple[Check, ...] = (
    not_finite,
    wrapped_outputs,
    data_findings,
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
