"""The settings of the record solver: strategies that can be switched off, and the constants that steer them."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any


@dataclass(frozen=True)
class Strategies:
    """What the solver for records may do beyond plain Gauss-Newton steps, and the constants that steer it.

    `MultipleShooting(strategies=Strategies(second_order_correction=False))` switches one off. What
    each buys is measured by `benchmarks/ablation.py` on 29 hard problems and stands below it; the
    kept output is `benchmarks/results/ablation.txt` (20 November 2026, one seed, for some problems
    two: 156 to 209 runs). Constants of which nothing is said were varied there to about a tenth and
    ten times without a significant change of the success, some of them on 17 of these problems or
    on those alone that consult them.
    """

    # --- before the first iteration

    moved_starts: bool = True
    """Drawn starts at which the model is not finite move toward one at which it is.

    Without it 5 of 156 runs fewer end at the best minimum (tanks, conversion, reactor).
    """
    screened_starts: bool = True
    """Of the default starts the promising ones are run alone, from where prediction errors over short segments lead.

    Of 17 fits from the default starts ten take 1.5 to 8 times as long without it, and four of NIST's regressions more
    than 40 s; MGH17 takes half as long.
    """
    scanned_initial_states: bool = True
    """Sizes over many decades are tried for unmeasured states where the model is not finite at zero.

    Without it the two models of tanks are never found (8 of 12 runs with it).
    """
    accurate_substeps: bool = True
    """The number of substeps is chosen by the local integration error too, not by the poles alone.

    Buys no success, but up to a third of the time where substeps are refined afterwards (tanks, pendulum).
    """
    stretches_first: bool = True
    """A long record is first solved on a few stretches spread over it.

    At 25 000 samples it buys nothing yet; a first pass over 600 000 costs a sixtieth of one over them all.
    """

    shared_runs: bool = True
    """Of many starts all but the first are solved on excerpts, and those that meet there go on as one.

    20 starts on 6000 samples take a third of their time. Of 180 runs on 15 problems, most of them far below
    `short_record`, 124 end at the best minimum with it and 106 without (`benchmarks/shared_runs.py`).
    """

    # --- within an iteration

    states_first: bool = True
    """The first iterations move the node states alone, at held parameters.

    Mixed: 3 runs lost and 4 won without it, and 2 of 29 fits lost.
    """
    continuity_homotopy: bool = True
    """Continuity is a quadratic penalty first, whose weight grows in stages until it is an exact constraint.

    70 % of runs end at the best minimum with it, 62 % without; Lorenz 6 of 6 instead of none.
    """
    skipped_stages: bool = True
    """A stage of the homotopy is skipped after a step that decreased the merit function exactly as predicted.

    Saves an iteration of seven on the tilt plant.
    """
    damped_parameters: bool = True
    """Levenberg-Marquardt damping of the parameters.

    Without it the predictors of the tilt plant are never found. (Bennett5 would be: 4 of 6 instead of none.)
    """
    damped_states: bool = True
    """Levenberg-Marquardt damping of the node states besides that of the parameters.

    Six runs fewer on chain, tanks and thrust without it, and 17 % more iterations.
    """
    second_order_correction: bool = True
    """Gaps that curvature leaves after a step are closed before the step is judged (Maratos effect).

    Mixed: tanks, stiff and guarded tanks lose 4 runs without it, the tanh chain is solved without it.
    """
    simulation_fallback: bool = True
    """Records are simulated from their first states where Newton steps do not close the gaps.

    3 of 209 runs lost and 1 won without it (reactor, tanks, chain).
    """
    held_discontinuous_delays: bool = True
    """Delays at which the cost jumps keep their values once they block the steps of all parameters.

    Halves the time where a held input reaches an output directly.
    """
    restart_near_data: bool = True
    """A stalled run begins once more with its parameters and with node states from the data.

    5 of 189 runs lost and none won without it (chain, guarded tanks, thrust).
    """
    covariance_curvature: bool = True
    """Near the minimum the Hessian accounts for the estimated noise covariance, which follows the parameters.

    107 iterations instead of 172 with a full covariance and a model that is too simple.
    """
    extrapolated_convergence: bool = True
    """A run ends when the last two decreases show that the next is negligible, without another iteration.

    Saves one linearization at the end of every run, 5 % of the time on the tilt plant.
    """

    # --- predictors

    riccati_gains: bool = True
    """The gain begins with that of the best of several steady-state Kalman filters.

    Without it no predictor of the tilt plant is found (6 of 7 runs with it).
    """
    early_prediction: bool = True
    """A problem of predictors alone leaves the homotopy after its first stage, or at a blocked step.

    13 to 19 % fewer iterations of predictors.
    """
    simulated_predictors: bool = True
    """A stable predictor is simulated over whole stretches instead of being cut into segments.

    Without it 1 of 7 runs of the predictors of the tilt plant is found, 6 with it.
    """
    stability_constraints: bool = True
    """Steps that would make a stable predictor unstable are constrained by its linearized poles.

    Buys nothing on the benchmark; where the likelihood grows toward the limit, runs stall without it
    (`tests/compiled/test_kalman_gain.py`).
    """

    # --- around the starts

    scaled_neighbors: bool = True
    """The best end is left again with every parameter with a positive lower bound a factor smaller and larger.

    The overflow with 12 starts is found with it alone; it takes up to half the time of a fit with two starts.
    """
    simulated_neighbors: bool = True
    """Runs from the neighborhood of the best end begin with a simulation from its initial states.

    The overflow with 12 starts is found with it alone (cost -1836, -546 without).
    """
    continued_runs: bool = True
    """A run that ends unfinished at a lower cost than the best so far goes on from its end.

    Bennett5 is found with it alone.
    """
    polished_minimum: bool = True
    """The best minimum is polished by undamped steps, beyond the tolerance of a run.

    Buys digits, not success: of NIST's 27 regressions nine or more are right instead of four to eight.
    """
    refined_substeps: bool = True
    """Substeps are refined, and the best minima followed, until that shifts the estimate negligibly.

    One of eleven problems, the swing, is biased without it.
    """

    # --- constants: the penalty on gaps

    assumed_error: float = 0.1
    """Output error assumed as long as continuity is a penalty, as a share of a signal's standard deviation."""
    first_gap: float = 3.0
    """First standard deviation of gaps, in the jump of a state that moves a segment's outputs by their signal's."""
    gap_reduction: float = 0.1
    """Factor on that standard deviation from one stage of the homotopy to the next."""
    last_gap: float = 2e-4
    """Share of the first standard deviation below which continuity becomes an exact constraint."""
    kept_promise: float = 0.1
    """Relative error of a predicted decrease up to which the next stage begins; also the share of the merit that a
    predicted decrease must exceed for the stage to go on."""
    well_kept_promise: float = 0.01
    """Relative error of a predicted decrease up to which a stage is skipped."""
    state_iterations: int = 3
    """Iterations of the node states alone, at most."""

    # --- constants: steps and damping

    max_iterations: int = 100
    """Iterations of a run.

    With 10 of them 48 % of runs end at the best minimum instead of 72 %; with 1000 it is 81 %, in three times the time.
    """
    shortest_step: float = 1e-3
    """Share of a step below which the line search gives up."""
    step_reduction: float = 0.4
    """Factor from one trial of the line search to the next."""
    short_step: float = 0.05
    """Share of a step below which a run counts as blocked."""
    poor_decrease: float = 0.25
    """Share of the predicted decrease below which the damping grows after a full step."""
    damping_factor: float = 10.0
    """Factor by which the damping grows and falls."""
    first_damping: float = 1e-2
    """Damping after a poor full step or a failed line search, relative to the diagonal of the Hessian."""
    blocked_damping: float = 1e2
    """Damping from which discontinuous delays may be held."""
    largest_damping: float = 1e6
    """Damping beyond which a run has stalled."""
    constraint_penalty: float = 1e3
    """First penalty on violated constraints in the merit function."""
    parameter_ridge: float = 1e-10
    """Curvature added to every scaled parameter, for those that the data do not determine."""
    state_ridge: float = 1e-10
    """Curvature added to every node state, relative to its mean curvature."""
    least_curvature: float = 0.05
    """Share of the Hessian of a known covariance that an estimated one leaves, at least."""
    covariance_decrease: float = 1.0
    """Predicted decrease of the cost below which the Hessian accounts for the estimated covariance."""

    # --- constants: rescues

    gap_closings: int = 5
    """Iterations of the second-order correction."""
    lost_simulation: float = 10.0
    """Root mean square residual, in standard deviations of a signal, beyond which a simulation is discarded."""
    long_record: int = 20000
    """Samples from which some stretches are solved first."""
    short_record: int = 2000
    """Samples up to which runs from many starts are made on whole records, each by itself."""

    # --- constants: convergence

    tolerance: float = 1e-8
    """Of half the squared length of a step in standard errors, and of the decrease of the cost."""
    cost_rounding: float = 1e-9
    """Relative change of the cost that counts as rounding."""
    gap_rounding: float = 1e-9
    """Gap, relative to the largest value of a state, that counts as rounding."""

    # --- constants: predictors

    prediction_gap: float = 0.5
    """As `last_gap`, for problems of predictors alone."""
    brief_step: float = 0.1
    """Share of a step below which a problem of predictors alone leaves the homotopy."""
    process_noise: float = 1.0
    """Largest process noise of the steady-state filters, as a share of the first variance of gaps; 12 decades down."""
    pole_difference: float = 1e-6
    """Relative difference by which derivatives of poles are taken."""
    stability_share: float = 0.9
    """Share of the way to the stability limit that one step may go."""
    forgetting: float = 3.0
    """Time constants of the slowest pole that the longest stretch must hold: the stability limit."""
    gain_samples: int = 3000
    """Samples on which the steady-state filters are compared."""

    # --- constants: around the starts

    neighbor_factor: float = 4.0
    """Factor by which a parameter is made smaller and larger around the best end."""
    neighbor_iterations: int = 40
    """Iterations of a run from the neighborhood of the best end."""
    continued_samples: int = 3_000_000
    """Samples times iterations of a run that is continued; at most 2000 iterations, at least those of a run."""

    # --- constants: discretization and initial states

    looks: int = 100
    """Samples at which the model is evaluated to choose substeps and segments."""
    local_accuracy: float = 1e-4
    """Integration error over `local_span` samples, relative to the spread of a state, for the first substeps."""
    local_span: int = 10
    """Samples over which this error is taken."""
    negligible_shift: float = 0.1
    """Shift of an estimate by twice the substeps, in standard errors, that is accepted."""
    rival_cost: float = 10.0
    """Cost above the best up to which a minimum is followed when substeps are refined."""
    mean_over_deviation: float = 0.5
    """Mean over standard deviation from which a measured state begins as measured instead of at zero."""
    sweeps: int = 2
    """Sweeps over the unmeasured states, each of which tries all sizes."""


def with_options(settings: Strategies, options: Mapping[str, Any]) -> Strategies:
    """Return the settings with `max_iter` and `tol`, as IPOPT calls them.

    Raises
    ------
    ValueError
        For another option, which is IPOPT's alone, or a value that is none.
    """
    known = {"max_iter": "max_iterations", "tol": "tolerance"}
    for name, value in options.items():
        if name not in known:
            raise ValueError(
                f"solver_options {name!r} is not known to the Gauss-Newton solver: give max_iter or tol, or solve by "
                "IPOPT, method=MultipleShooting(ipopt=True)."
            )
        if not isinstance(value, int if name == "max_iter" else int | float) or not value > 0:
            kind = "a whole number of iterations" if name == "max_iter" else "a number above 0"
            raise ValueError(f"solver_options {name!r} is {value!r}: give {kind}.")
    return replace(settings, **{known[name]: value for name, value in options.items()})


def switches() -> tuple[str, ...]:
    """Return the names of all strategies that can be switched off."""
    return tuple(f.name for f in fields(Strategies) if isinstance(f.default, bool))


def constants() -> tuple[str, ...]:
    """Return the names of all constants."""
    return tuple(f.name for f in fields(Strategies) if not isinstance(f.default, bool))
