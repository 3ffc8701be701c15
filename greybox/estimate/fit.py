"""Fitting a problem: many starts, then accuracy, then words."""

import contextlib
import math
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial, singledispatch
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from tqdm import tqdm

from greybox.compiled.compiled_problem import AnyProblem, CompiledProblem, compile_problem
from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.compiled.transcription.method import Transcription
from greybox.compiled.transient_part import TransientPart
from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.covariance import Accuracy, assess, known_directions, known_of, told_by
from greybox.estimate.diagnostics.delay_approximation import pade_error
from greybox.estimate.diagnostics.determined_together import determined_together
from greybox.estimate.diagnostics.discretization import discretization_warnings
from greybox.estimate.diagnostics.failure import failure_warnings
from greybox.estimate.diagnostics.general import warnings
from greybox.estimate.diagnostics.harmonics import harmonic_warnings
from greybox.estimate.diagnostics.intersample import intersample_warnings
from greybox.estimate.diagnostics.not_finite import explained, not_finite_warnings
from greybox.estimate.diagnostics.outlying_points import outlying_points
from greybox.estimate.diagnostics.records import finding_warnings, hidden_errors, record_warnings
from greybox.estimate.diagnostics.unused_noise import unused_noise
from greybox.estimate.equivalent_minima import equivalent_estimates
from greybox.estimate.fitted_part import FittedRecord, FittedResponse, FittedSpectrum
from greybox.estimate.fitted_record import fitted_record, stated
from greybox.estimate.fitted_spectrum import fitted_spectrum
from greybox.estimate.harmonic_numbers import are_open, with_enough_harmonics, with_more_harmonics
from greybox.estimate.profile import profiled_where_misleading
from greybox.estimate.quantities import quantities, slopes_of_parameters
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import counted
from greybox.formulation.frequency_criteria import evaluate
from greybox.formulation.included_criteria import CRITERIA
from greybox.formulation.prior_part import stated_priors
from greybox.formulation.problem import Problem
from greybox.formulation.starts import Chained, Listed, Sobol, Starts, UntilFoundAgain, as_starts
from greybox.formulation.sum import Sum
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.periodic_motions import response_of_test
from greybox.solve.discretization_error import DiscretizationError, refine_discretization
from greybox.solve.executors import packed, require_executor
from greybox.solve.global_search import TRIAL_POINTS, global_search
from greybox.solve.interruption import (
    Response,
    listening,
    responding,
    stop_requested,
    take_interrupt,
)
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.kept_runs import KeptRuns
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart
from greybox.solve.multistart import BATCHED, GLOBAL_SEARCH, SEARCHES, multistart, solver_for
from greybox.solve.outcome import RUN_OVER, SEARCH_OVER
from greybox.solve.time_limits import TimeLimits, current_limits, is_search_over, limited
from greybox.solve.waves import AllAtOnce, FoundAgain, PromisingFirst, Waves

FittedPart = FittedRecord | FittedResponse | FittedSpectrum

CURVE = 2000  # points from which a curve for figures is not refined further


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a fit.

    Attributes
    ----------
    fit : Fit or None
        The best fit so far: of the starts that were done, judged as any other. None if not one had
        been begun.
    """

    def __init__(self, fit: Fit | None) -> None:
        super().__init__(fit)
        self.fit = fit

    def __str__(self) -> str:
        if self.fit is None:
            return "interrupted before the first start"
        return f"interrupted after {counted(len(self.fit.runs), 'start')}; the best fit so far is in the attribute fit"


def fit(  # noqa: PLR0913  (what to fit, from where, how, and how long)
    problem: AnyProblem,
    starts: int | Starts | Sequence[Mapping[str, float] | Starts] | None = None,
    seed: int | None = None,
    *,
    method: Transcription | None = None,
    search: str = BATCHED,
    solver_options: Mapping[str, Any] = MappingProxyType({}),
    executor: Executor | None = None,
    seconds: float | None = None,
    start_seconds: float | None = None,
    profiles: bool = True,
    progress: bool | Callable[[int, int], None] = True,
) -> Fit:
    """Fit a problem from many starts: by IPOPT, or, where data are records, by Gauss-Newton steps.

    Frequency responses are searched from all starts at once by Newton's method
    (``search="batched"``), and IPOPT solves every minimum that was found once more. What a batch
    does not serve (finite amplitudes, large problems) is solved by IPOPT from every start that is
    tried, as ``search="multistart"`` does. ``search="global-search"`` is the scatter search of
    MATLAB's GlobalSearch, with 1000 trial points by default, see `greybox.solve.global_search`.

    Parameters
    ----------
    problem : Problem or a sum of problems
    starts : int, Starts, or list
        A number of Sobol points, all of which are brought to a minimum, a rule such as
        `LatinHypercube(200)` or `UntilFoundAgain(error=0.01)`, or a list of ``{name: value}``. By
        default 200 Sobol points: in a multistart all, otherwise the 8 with the lowest costs, and
        all if fewer than half of these end at the best minimum. Of records, the declared values and
        those 3 of 19 Sobol points that promise most over short segments, where they are improved
        first (`Run.start` stays the point itself); all, if fewer than 3 of these 4 end at the best
        minimum, or with constraints. Drawn points at which a model of records is not finite move
        toward the first at which it is. Of several starts on records, the search goes on from the
        best end with every parameter whose lower bound is above zero made four times larger and
        smaller; a lower cost is reported as an extra run.
    seed : int, optional
        Of the Sobol points, 0 by default; a rule has its own. More starts of one seed begin with
        the same points.
    method : MultipleShooting, SingleShooting or Collocation, optional
        How records are transcribed and solved; `MultipleShooting()` by default.
    search : "batched", "multistart" or "global-search"
        See above.
    solver_options : mapping
        ``{"max_iter": 100, "tol": 1e-9}``, and where IPOPT solves all its other options. For
        records `tol` is that of the decrease of the cost and of half the squared length of a step
        in standard errors, 1e-8 by default.
    executor : concurrent.futures.Executor, optional
        What makes the runs: `greybox.solve.WorkerPool(2)`, a `ProcessPoolExecutor`, Dask's
        ``client.get_executor()``; this process by default. The answer is the same. The first run,
        the refinement and the judgment are made here.
    seconds : float, optional
        After which no run goes on, from the call on; what was reached is judged. The answer then
        depends on the speed of the machine, and says so.
    start_seconds : float, optional
        The same for the runs from each start.
    profiles : bool
        Profile the likelihood of responses, as `greybox.profile` does, along parameters whose
        interval by the standard error leaves the bounds, or whose error exceeds half the value:
        `Fit.profiles`. Problems that take long (trims inside the optimization, finite amplitudes)
        or have constraints are left out: profile these by name.
    progress : bool or function
        A bar on a terminal for anything longer than two seconds; or a function of finished and all
        runs.

    Returns
    -------
    Fit
        Also when no start converged: then `Fit.converged` is False, the values are NaN, and
        `Fit.best_effort` has those of the best run.

    Raises
    ------
    ValueError, TypeError
        For bad input, in one sentence.
    RuntimeError
        When the executor has lost its workers.
    KeyboardInterrupt
        After Ctrl-C, when the iteration at hand has ended; its attribute ``fit`` is the best fit so
        far.
    """
    by = SolverChoice(method, search, solver_options)
    with limited(TimeLimits.from_now(seconds, start_seconds)):
        return fit_keeping(
            None,
            problem,
            starts,
            seed,
            by=by,
            executor=executor,
            profiles=profiles,
            progress=progress,
        )


@dataclass(frozen=True)
class SolverChoice:
    """What solves a problem: `method`, `search` and `solver_options` of `fit`.

    Raises
    ------
    ValueError, TypeError
        For bad input, in one sentence.
    """

    method: Transcription | None = None
    search: str = BATCHED
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        """Check all of them."""
        if not isinstance(self.options, Mapping):
            raise TypeError(
                f"solver_options is {self.options!r:.60}: give IPOPT's options as {{name: value}}."
            )
        if self.method is not None and not isinstance(self.method, Transcription):
            raise TypeError(
                f"method is {self.method!r:.60}: give an instance such as MultipleShooting()."
            )
        if self.search not in SEARCHES:
            raise ValueError(
                f"search is {self.search!r:.40}: give one of {', '.join(map(repr, SEARCHES))}."
            )

    def solver(self, nlp: CompiledProblem) -> LocalSolver:
        """Return the solver of a compiled problem."""
        return solver_for(nlp, self.options, self.search)


def fit_keeping(
    kept: KeptRuns | None,
    problem: AnyProblem,
    starts: int | Starts | Sequence[Mapping[str, float] | Starts] | None = None,
    seed: int | None = None,
    *,
    by: SolverChoice | None = None,
    executor: Executor | None = None,
    profiles: bool = True,
    progress: bool | Callable[[int, int], None] = True,
) -> Fit:
    """Fit as `fit` does, and keep every run as soon as it is done; runs that were kept before are not made again."""
    if not isinstance(problem, Problem | Sum):
        raise TypeError(
            f"problem is {problem!r:.80}: give a Problem(model, data) or a sum of them."
        )
    require_executor(executor)
    try:
        with listening():
            choice = by or SolverChoice()
            answer = _fitted_from(
                problem,
                starts,
                seed,
                choice,
                profiles=profiles,
                progress=progress,
                executor=executor,
                kept=kept,
            )
            if answer is None or take_interrupt():
                raise Interrupted(answer)
            return answer
    except Interrupted:
        raise
    except KeyboardInterrupt as pressed:
        raise Interrupted(None) from pressed


def fingerprint(problem: AnyProblem, by: SolverChoice | None = None) -> str:
    """Return what a fit keeps its runs under: a number of the compiled problem, its data and its solver's options."""
    by = by or SolverChoice()
    return packed(by.solver(compile_problem(with_enough_harmonics(problem), by.method)))[0]


def _fitted_from(
    problem: AnyProblem,
    starts: Any,
    seed: int | None,
    by: SolverChoice,
    *,
    profiles: bool,
    progress: bool | Callable[[int, int], None],
    executor: Executor | None,
    kept: KeptRuns | None,
) -> Fit | None:
    """Return the fit from these starts, or after Ctrl-C from those that were done; None if there are none."""
    began = time.perf_counter()
    open_parts = are_open(problem)
    problem = with_enough_harmonics(problem)
    nlp = compile_problem(problem, by.method)
    parameters = problem.parameters
    solver = by.solver(nlp)
    by_default = TRIAL_POINTS if by.search == GLOBAL_SEARCH and starts is None else starts
    rule = _rule(by_default, seed, solver)
    points = rule.draw({name: parameters[name] for name in nlp.free})
    movable = not isinstance(rule, Listed)
    waves = _waves(starts, rule, solver)
    run = partial(
        multistart, nlp, solver, points, movable=movable, executor=executor, kept=kept, waves=waves
    )
    if by.search == GLOBAL_SEARCH:
        run = partial(
            global_search,
            nlp,
            _required_ipopt(solver, executor),
            points,
            seed=rule.seed or 0,
            kept=kept,
        )
    with responding(Response.STOP):
        if callable(progress) or not progress:
            search = run(progress=progress or None)
        else:
            with tqdm(total=len(points), disable=None, delay=2, unit="start", leave=False) as bar:

                def advance(done: int, _: int) -> None:
                    bar.update(done - bar.n)

                search = run(progress=advance)
        interrupted = stop_requested()
        nlp, search, solver = with_more_harmonics(nlp, search, solver, open_parts)
        search = explained(nlp, search, solver)
        nlp, search, solver, error = refine_discretization(nlp, search, solver)
        search = solver.polished(search)
    if not search.runs:
        return None
    with responding(Response.FINISH):
        answer = assemble(
            nlp, search, solver, seed=rule.seed, starts=str(rule), began=began, error=error
        )
        said = tuple(_cut_short(search, len(points), interrupted=interrupted))
        found = (
            profiled_where_misleading(nlp, answer)
            if profiles and answer.converged and not said
            else None
        )
        if found is not None:
            said, answer = (
                found.warnings,
                replace(answer, profiles=found, seconds=time.perf_counter() - began),
            )
        return replace(answer, warnings=(*said, *answer.warnings)) if said else answer


def _cut_short(search: Multistart, count: int, *, interrupted: bool) -> Iterator[str]:
    """Say what Ctrl-C and time limits have left out of a search from so many starts."""
    done, total = len(search.brought), counted(count, "start")
    is_over = bool(np.any(search.runs.status == SEARCH_OVER))
    if (interrupted and done < count) or is_over:
        cause = "the time limit ended the search" if is_search_over() else "interrupted"
        machine = ", and a faster machine may answer otherwise" if is_search_over() else ""
        yield f"{cause} after {done} of {total}: another one may end at a lower cost{machine}."
    cut = int(np.count_nonzero(search.runs.status == RUN_OVER))
    if cut:
        yield (
            f"{cut} of {total} {'was' if cut == 1 else 'were'} cut at {current_limits().start:g} s, the time limit of "
            "a start: on a faster machine it may end at a lower cost."
        )


@one_thread_at_a_time
def assemble(
    nlp: CompiledProblem,
    search: Multistart,
    solver: LocalSolver,
    *,
    seed: int | None,
    starts: str,
    began: float,
    error: DiscretizationError | None = None,
) -> Fit:
    """Turn what a multistart left into the answer; `began` is the clock reading when the work began."""
    problem = nlp.problem
    found = bool(search.minima)
    best = search.minima[0].estimate if found else np.full(len(nlp.free), np.nan)
    trajectories = solver.profile(best, search.nodes).trajectories if found else ()
    accuracy = assess(nlp, best, trajectories) if found else _nothing(nlp)
    estimate = dict(zip(nlp.names, nlp.all_values(best).tolist(), strict=True))
    lines, names, covariance = quantities(nlp, accuracy, estimate)
    parts = tuple(
        fitted_part(
            part, trajectory, nlp.all_values(best), dict(part.problem.local_values(estimate))
        )
        for part, trajectory in zip(
            nlp.parts, trajectories or (None,) * len(nlp.parts), strict=True
        )
    )
    parts = tuple(_with_errors(nlp, parts, accuracy))
    pade_errors = [part.pade_error if isinstance(part, FittedResponse) else None for part in parts]
    answer = Fit(
        name=problem.name,
        parts=parts,
        quantities=lines,
        free=nlp.free,
        names=names,
        covariance=covariance,
        dof=accuracy.dof,
        cost=search.minima[0].cost if found else math.nan,
        costs=_all_costs(parts),
        runs=search.runs,
        minima=search.minima,
        warnings=(
            *not_finite_warnings(nlp, search, solver),
            *(() if found else failure_warnings(nlp, search, solver)),
            *finding_warnings(nlp),
            *(discretization_warnings(nlp, trajectories, error) if found else ()),
            *(record_warnings(nlp, parts, trajectories, accuracy) if found else ()),
            *(intersample_warnings(nlp, best, accuracy) if found else ()),
            *(harmonic_warnings(nlp, best, accuracy) if found else ()),
            *(warnings(nlp, search, accuracy, pade_errors, trajectories) if found else ()),
            *(outlying_points(nlp, best, accuracy) if found else ()),
        ),
        notes=(*unused_noise(problem), *hidden_errors(accuracy)) if found else (),
        seed=seed,
        starts=starts,
        seconds=time.perf_counter() - began,
        versions={
            "greybox": version("greybox-id"),
            "casadi": ca.CasadiMeta.version(),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        models=tuple(part.model for part in problem.parts),
        white=accuracy.white,
        independent=accuracy.independent,
        directions=(
            known_directions(
                nlp, best, accuracy, lambda x: solver.profile(x, search.nodes).trajectories
            )
            if found
            else None
        ),
        equivalents=equivalent_estimates(nlp, search) if found else None,
        priors={
            name: pair for prior in stated_priors(problem) for name, pair in prior.stated.items()
        },
        known=known_of(nlp, accuracy, *slopes_of_parameters(nlp, estimate)) if found else None,
    )
    return replace(answer, notes=(*answer.notes, *determined_together(answer)))


def _with_errors(
    nlp: CompiledProblem, parts: Sequence[FittedPart], accuracy: Accuracy
) -> Iterator[FittedPart]:
    """Yield the parts with what their data tell of the parameters, and records with the errors of their outputs."""
    if accuracy.white is None:
        yield from parts
        return
    each = zip(
        parts, told_by(nlp, accuracy), accuracy.informations, accuracy.correlation, strict=True
    )
    for part, (along, alone), told, colored in each:
        changes: dict[str, Any] = {"information": along, "information_alone": alone}
        if isinstance(part, FittedRecord) and told.output_errors is not None:
            changes["error"] = told.output_errors(accuracy.covariance, colored)
        yield replace(part, **changes)


@singledispatch
def fitted_part(
    part: Part, trajectory: Trajectory | None, x: Array, values: dict[str, float]
) -> FittedPart:
    """Return the plain values that the answer keeps of a part, at all values x (k,), by the model's name `values`.

    `trajectory` is the best one there; None without an answer.
    """
    raise TypeError(f"{type(part).__name__} has no form in which an answer keeps it.")


@fitted_part.register
def _(
    part: RecordPart, trajectory: Trajectory | None, x: Array, values: dict[str, float]
) -> FittedRecord:
    return fitted_record(part, trajectory)


@fitted_part.register
def _(
    part: TransientPart, trajectory: Trajectory | None, x: Array, values: dict[str, float]
) -> FittedSpectrum:
    return fitted_spectrum(part, trajectory)


@fitted_part.register
def _(
    part: ResponsePart, trajectory: Trajectory | None, x: Array, values: dict[str, float]
) -> FittedResponse:
    return _response(part.problem, values, part.response(x))


def _required_ipopt(solver: LocalSolver, executor: Executor | None) -> IpoptSolver:
    """Return the solver, if the scatter search can use it."""
    if not isinstance(solver, IpoptSolver):
        raise ValueError(
            "search='global-search' is for frequency responses alone: leave it out for records."
        )
    if executor is not None:
        raise ValueError(
            "search='global-search' decides after every run what to try next: leave out the executor."
        )
    return solver


def _rule(starts: Any, seed: int | None, solver: LocalSolver) -> Starts:
    """Return the rule for starts; where the solver asks for it, the declared values are the first of a number."""
    number = solver.starts if starts is None else starts
    rule = as_starts(number, seed)
    if isinstance(number, Starts | Sequence) or not solver.tries_declared_values:
        return rule
    return (
        Chained((Listed(({},)), Sobol(number - 1, rule.seed or 0))) if number > 1 else Listed(({},))
    )


def _waves(starts: Any, rule: Starts, solver: LocalSolver) -> Waves:
    """Return in which order the starts are tried: by default the promising ones first, where they can be told."""
    if isinstance(rule, UntilFoundAgain):
        return FoundAgain(rule.error)
    return PromisingFirst(*solver.promising) if starts is None else AllAtOnce()


def _nothing(nlp: CompiledProblem) -> Accuracy:
    k = len(nlp.names)
    covariance = np.full((k, k), np.nan)
    return Accuracy(
        nlp.names,
        covariance,
        np.zeros((k, 0)),
        np.ones(k),
        0.0,
        (),
        (),
        (),
        (),
        np.full(len(nlp.parts), np.nan),
        np.zeros(k),
    )


def _response(problem: Problem, values: dict[str, float], response: ComplexArray) -> FittedResponse:
    data = problem.response
    curve = error = None
    if np.all(np.isfinite(response)):
        error = pade_error(problem, values)
        signals = {
            "input": data.input,
            "output": data.output,
            "at": problem.at,
            "delay": problem.delay,
        }
        with contextlib.suppress(ValueError):  # an undamped resonance exactly on the grid
            curve = _curve(
                lambda omega: response_of_test(
                    problem.model, values, omega, problem.amplitude, data.omega, **signals
                ),
                data.omega,
            )
    return FittedResponse(
        **stated(problem),
        data=data,
        response=response,
        curve=curve,
        at={name: float(value) for name, value in problem.at.items()},
        pade_error=error,
        sine=problem.amplitude,
        nuisances=problem.criterion.nuisances,
    )


def _curve(response: Callable[[Array], FrequencyResponse], omega: Array) -> FrequencyResponse:
    """Evaluate on a grid over the band of `omega`, halved where a step is coarse, as at a resonance."""
    grid = np.geomspace(omega.min(), omega.max(), 200) if omega.size > 1 else omega
    curve = response(grid)
    for _ in range(12):
        steps = np.abs(np.diff(curve.response))
        turns = np.abs(np.angle(curve.response[1:] * curve.response[:-1].conj()))
        coarse = (steps > 0.02 * np.abs(curve.response).max()) | (turns > np.radians(5))
        if not coarse.any() or grid.size > CURVE:
            break
        grid = np.sort(np.concatenate([grid, np.sqrt(grid[:-1] * grid[1:])[coarse]]))
        curve = response(grid)
    return curve


def _all_costs(parts: Sequence[FittedPart]) -> dict[str, float]:
    """Return the value of every criterion for responses at the estimate, where all data are such."""
    responses = [part for part in parts if isinstance(part, FittedResponse)]
    if len(responses) < len(parts):
        return {}
    return {
        criterion.name: sum(
            part.weight * evaluate(criterion, part.response, part.data) for part in responses
        )
        for criterion in CRITERIA
    }
