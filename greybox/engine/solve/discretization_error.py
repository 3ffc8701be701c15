"""Whether the integration is accurate enough: how far twice the steps would shift the estimate.

A fixed-step integrator with too few steps shifts the parameters without a trace in the residuals:
it damps and slows oscillations by itself. The shift follows from the gradient of the finer
integration at the estimate, in units of the standard errors for white noise; a shift far below them
does not matter. The integrator is that of the method which solved the problem: for a collocation,
the implicit steps of its polynomials.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array, all_finite, positive_or_one, real_root
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Part, Trajectory
from greybox.engine.solve.interruption import stop_requested
from greybox.engine.solve.local_solver import LocalSolver
from greybox.engine.solve.minima import Multistart, distinct_ends, find_minima, minimum_of
from greybox.engine.solve.runs import TOO_COARSE, Outcome, Runs, spent
from greybox.modeling.step_size import MOST_SUBSTEPS, substep_growth
from greybox.statistics.column_space import pseudo_inverse

RIVAL_COST = 10.0
TINY = 1e-300

# Shift of an estimate by twice the substeps, in standard errors, that is accepted.
NEGLIGIBLE_SHIFT = 0.1
# Shift to which steps are refined where that is cheap: estimates then agree in six digits with
# those of an exact integration. With 0.1 they differed by up to 8e-4 of their values.
INVISIBLE_SHIFT = 1e-5


@frozen
class DiscretizationError:
    """The change of the estimate by steps of half the length.

    Attributes
    ----------
    shift : (p,) array
        Shift of the unknowns in standard errors, or the relative change of the standard errors
        where that is more: at its stability limit an integrator's outputs depend on fast poles that
        the model's do not show.
    order : int
        The shift falls with this power of the number of steps.
    """

    shift: Array
    order: int

    @property
    def largest(self) -> float:
        """The largest shift, in standard errors."""
        return float(np.abs(self.shift).max(initial=0.0))

    @property
    def matters(self) -> bool:
        """True when the estimate would move noticeably."""
        return self.largest > NEGLIGIBLE_SHIFT

    @property
    def growth(self) -> int:
        """Factor on the number of steps that makes the shift small, by its order; at most eight."""
        return substep_growth(self.largest, NEGLIGIBLE_SHIFT, self.order)


def discretization_error(
    nlp: CompiledProblem, trajectories: Sequence[Trajectory]
) -> DiscretizationError:
    """Return how twice the steps would shift the estimate, to first order."""
    p = len(nlp.free)
    order = nlp.method.scheme.order
    hessian, hessian_fine, change = np.zeros((p, p)), np.zeros((p, p)), np.zeros(p)
    fine = nlp.refined(2).parts
    refined = [finer.trajectory(t.z, t.nodes) for finer, t in zip(fine, trajectories, strict=True)]
    # The linearizations below take most of the time.
    if all(map(_is_rounding, trajectories, refined)):
        return DiscretizationError(change, order)

    for part, trajectory, finer, moved in zip(nlp.parts, trajectories, fine, refined, strict=True):
        weight = part.residual_weight(trajectory)
        H, g = quadratic_model(part, trajectory, weight)
        # Where the finer steps diverge, or their derivatives overflow, the shift is infinite.
        H_fine = H
        g_fine = np.full(p, math.inf)
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
            if moved.finite:
                H_fine, g_fine = quadratic_model(finer, moved, weight)
        hessian += part.weight * H
        hessian_fine += part.weight * H_fine
        change += part.weight * (g_fine - g)
    shift = _in_standard_errors(hessian, change)
    widened = _widened(hessian, hessian_fine)
    shift = np.where(widened > np.abs(shift), widened, shift)
    return DiscretizationError(shift, order)


def refine_discretization(
    search: Multistart, solver: LocalSolver
) -> tuple[Multistart, LocalSolver, DiscretizationError | None]:
    """Refine the steps until the error does not matter, and follow the best minima.

    A number of substeps that the method fixes stays. Minima that are artifacts of the integrator
    are removed. Also returns the remaining error, None where it was not computed.
    """
    error = None
    if not solver.nlp.substeps or not search.minima:
        return search, solver, error

    # Beyond its limit of stability, an integrator has no error that could be estimated.
    z = solver.nlp.scaling.to_solver(search.minima[0].estimate)
    while search.nodes and not solver.nlp.has_stable_steps(z, search.nodes):
        solver = solver.with_problem(solver.nlp.refined(2))
    # A fixed number of substeps is the user's choice: it is judged, but not changed.
    # One of the eleven hard problems, the swing, is biased without refinement.
    is_fine = solver.nlp.method.scheme.substeps is not None
    while not is_fine and not stop_requested():
        nlp = solver.nlp
        best = solver.profile(search.minima[0].estimate, search.nodes)
        error = discretization_error(nlp, best.trajectories)
        if nlp.substeps >= MOST_SUBSTEPS:
            break
        # Once: behind kinks, the error falls too slowly with the steps.
        is_fine = not error.matters
        growth = _cheap_growth(nlp, error) if is_fine else error.growth
        if growth == 1:
            break
        finer = solver.with_problem(nlp.refined(growth))
        # Behind kinks, states that follow from too long steps lead to worse minima than the data.
        begin = search if is_fine else replace(search, nodes=None)
        followed = with_finer_steps(begin, finer)
        if followed is None:
            break
        search = followed
        solver = finer
    sound = without_aliases(search, solver)
    is_same_best = sound.minima[0].runs[0] == search.minima[0].runs[0]
    return sound, solver, error if is_same_best else None


def _cheap_growth(nlp: CompiledProblem, error: DiscretizationError) -> int:
    """Return the factor on the number of steps that makes the error invisible, if it is cheap."""
    # The errors of implicit steps are limited where they are made.
    if nlp.method.scheme.implicit or error.largest <= INVISIBLE_SHIFT:
        return 1
    growth = substep_growth(error.largest, INVISIBLE_SHIFT, error.order)
    growth = min(growth, MOST_SUBSTEPS // nlp.substeps)
    operations = sum(part.operations for part in nlp.parts)
    # A simulation of 5 million operations takes some 10 ms. Fits of records with fewer than 1000
    # samples that need finer steps take up to twice the time.
    return max(min(growth, 5_000_000 // max(operations, 1)), 1)


def without_aliases(search: Multistart, solver: LocalSolver) -> Multistart:
    """Return the search without minima that finer steps move by standard errors.

    Too long steps can turn a fast mode into a slow one. Such an alias costs no more than the true
    parameters, or even less, and may have their response. It remains only if all minima are
    aliases.
    """
    nlp = solver.nlp
    limit = search.minima[0].cost + RIVAL_COST

    # An alias may have the response of the true parameters: ends are judged, not minima.
    rivals = np.array([k for m in search.minima if m.cost <= limit for k in m.runs])
    # Judging one end takes as long as two iterations.
    ends = [rivals[k] for k in distinct_ends(nlp, search.runs.estimate[rivals])[:10]]
    if len(ends) < 2:
        return search
    aliases = []
    for group in ends:
        end = solver.profile(search.runs[group[0]].estimate)
        # An end that twice the steps shift by more than a standard error is taken for an artifact
        # if another end stays below. After refinement, the best has a tenth of this.
        if end.converged and discretization_error(nlp, end.trajectories).largest > 1.0:
            aliases.append(group)
    if len(aliases) in (0, len(ends)):
        return search

    lost = np.concatenate(aliases).tolist()
    runs = Runs.of(
        replace(run, converged=False, status=TOO_COARSE) if run.index in lost else run
        for run in search.runs
    )
    sound = ([k for k in minimum.runs if k not in lost] for minimum in search.minima)
    minima = [minimum_of(nlp, runs[np.array(numbers)]) for numbers in sound if numbers]
    minima.sort(key=lambda m: m.cost)
    nodes = search.nodes
    if minima[0].runs[0] != search.minima[0].runs[0]:
        nodes = tuple(t.nodes for t in solver.profile(minima[0].estimate).trajectories)
    return replace(search, runs=runs, minima=tuple(minima), nodes=nodes)


def with_finer_steps(search: Multistart, solver: LocalSolver) -> Multistart | None:
    """Return the search with its best minima moved by this solver; None if none converges.

    The runs that ended there move with them, so that runs and minima have the same costs. Minima
    that are not rivals of the best stay. The best run begins at the nodes of the search, others and
    those of a search without nodes at the data.
    """
    limit = search.minima[0].cost + RIVAL_COST
    ends: dict[int, Outcome] = {}
    count = 0
    least = math.inf
    for minimum in search.minima:
        # Three rivals are followed to the finer steps, at least one run each: they may become the
        # best, as may a minimum whose cost lies below all that have moved.
        is_rival = count < 3 and minimum.cost <= limit
        if not (is_rival or minimum.cost < least < math.inf):
            break

        # One minimum may have several parameter vectors (lags that swap), which move by themselves.
        numbers = np.array(minimum.runs)
        for group in distinct_ends(solver.nlp, search.runs.estimate[numbers]):
            # The first is the best run, whose nodes the search has.
            nodes = None if ends else search.nodes
            outcome = solver.near(search.runs.estimate[numbers[group[0]]], nodes)
            ends |= dict.fromkeys(numbers[group].tolist(), outcome)
        count += 1
        least = min((end.cost for end in ends.values() if end.converged), default=math.inf)
    if math.isinf(least):
        return None

    runs = Runs.of(
        spent(ends[run.index], run).as_run(run.index, run.start) if run.index in ends else run
        for run in search.runs
    )
    signatures = [ends[run.index].signature if run.index in ends else None for run in runs]
    moved = find_minima(solver.nlp, [run for run in runs if run.index in ends], signatures)
    # The first that moved is the best, to rounding: the others cost no less than any that moved.
    best, *others = moved
    others = sorted([*others, *search.minima[count:]], key=lambda m: m.cost)
    return replace(search, runs=runs, minima=(best, *others), nodes=ends[best.runs[0]].nodes)


def quadratic_model(part: Part, trajectory: Trajectory, weight: Array) -> tuple[Array, Array]:
    """Return Hessian and gradient of the weighted squares with respect to the unknowns."""
    linearization = part.linearize(trajectory, weight)
    condensed = part.condense(linearization, trajectory)
    return condensed.hessian, condensed.gradient


def _is_rounding(trajectory: Trajectory, finer: Trajectory) -> bool:
    # All samples are compared, since a response to an input may have decayed at the ends of the
    # segments. Changes are relative to the largest value, since a state may pass through zero.
    size = np.abs(trajectory.states).max(axis=1, initial=0.0)
    changes = np.hstack([finer.states - trajectory.states, (finer.ends - trajectory.ends).T])
    return bool(np.all(np.abs(changes).max(axis=1, initial=0.0) <= 1e-7 * size))


def _in_standard_errors(hessian: Array, change: Array) -> Array:
    """Return the step -H⁻¹ g in standard errors, along directions that the data determine."""
    if not all_finite(change):
        return np.full(len(change), math.inf)

    inverse = pseudo_inverse(hessian, 1e-12)
    errors = real_root(np.diag(inverse))
    return -(inverse @ change) / positive_or_one(errors)


def _widened(coarse: Array, fine: Array) -> Array:
    """Return the factor on each standard error (p,) less one, with the other parameters known."""
    coarse_curvature = np.maximum(np.diag(coarse), TINY)
    fine_curvature = np.maximum(np.diag(fine), TINY)
    # The standard error may become infinite: with fine steps, an alias of a slow mode decays before
    # the next sample.
    log_ratio = np.abs(np.log(fine_curvature) - np.log(coarse_curvature))
    return np.where(coarse_curvature > TINY, np.expm1(log_ratio / 2), 0.0)
