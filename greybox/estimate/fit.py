"""From a problem to its answer: search from many starts, then accuracy, then warnings."""

import math
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import field, replace
from functools import partial
from types import MappingProxyType

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import AnyProblem, compile_problem
from greybox.compiled.transcription.method import Transcription
from greybox.estimate.covariance import (
    Accuracy,
    assess,
    directions_beside,
    known_directions,
    prior_shares,
)
from greybox.estimate.diagnostics.general import warnings, warnings_of_failure
from greybox.estimate.diagnostics.identifiability import determined_together
from greybox.estimate.diagnostics.noise_level import better_weights, unused_noise
from greybox.estimate.diagnostics.not_finite import explained
from greybox.estimate.diagnostics.records import resting_inputs, rounded_outputs
from greybox.estimate.diagnostics.repeated import once
from greybox.estimate.fitted_values import fitted_part
from greybox.estimate.misfit_assessment import assessed_misfit
from greybox.estimate.profile import with_profiles_where_misleading
from greybox.estimate.quantities import parameter_values, quantities
from greybox.estimate.result import Fit
from greybox.estimate.verdict import wrapped
from greybox.files.arrays import Named, by_name, frozen
from greybox.files.progress import DELAY, bar
from greybox.files.text_table import counted, require_kind
from greybox.files.version import __version__
from greybox.formulation.prior_part import stated_priors
from greybox.formulation.starts import AnyStarts, as_starts
from greybox.modeling.fingerprint import value_fingerprint
from greybox.modeling.one_thread import LOCK, one_thread_at_a_time, traced_once
from greybox.solve.discretization_error import DiscretizationError, refine_discretization
from greybox.solve.executors import one_blas_thread, require_executor
from greybox.solve.interruption import (
    Interrupted,
    Response,
    building,
    end_after,
    is_search_over,
    limited,
    listening,
    responding,
    stop_requested,
    take_interrupt,
)
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart, agreeing_runs, best_unfinished
from greybox.solve.multistart import BATCHED, SEARCHES, ProgressReport, multistart, solver_for
from greybox.solve.robust_fit import with_robust_errors
from greybox.solve.runs import SEARCH_OVER, RunStorage


def fit(  # noqa: PLR0913  (what to fit, from where, how, and how long)
    problem: AnyProblem,
    starts: AnyStarts | None = None,
    seed: int | None = None,
    *,
    method: Transcription | None = None,
    search: str = BATCHED,
    solver_options: Named = MappingProxyType({}),
    executor: Executor | None = None,
    seconds: float | None = None,
    profiles: bool = True,
    progress: bool | ProgressReport = True,
) -> Fit:
    """Fit a problem from many starts: by IPOPT, or, where data are records, by Gauss-Newton steps.

    Newton's method searches frequency responses from all starts at once (``search="batched"``), and
    IPOPT polishes every minimum. Large problems of state spaces are searched together, too, with
    one solution of (jωI - A)⁻¹ for all responses; there, all starts but the most promising one of a
    batch, or the first of your own list, first move to a minimum with process noise. Other problems
    that do not fit into a batch (finite amplitudes, large ones) are solved by IPOPT from every
    start, as with ``search="multistart"``. For records, ``"multistart"`` is one sparse program for
    IPOPT from every start.

    No run ends above the cost of its start. Whether its end is a minimum follows from the cost and
    its derivatives there, not from what a solver calls it.

    Parameters
    ----------
    problem : Problem or a sum of problems
    starts : int, Starts, or list
        A number: the declared values, then Sobol points. Or a rule such as `Sobol(200)`,
        or a list of ``{name: value}``. By default the 8 most promising of 200 (5 or 8 of 128 if the
        responses share one solution), with records 4 of 20; all of them if few of these runs agree.
        With records, a start at which the model is not finite moves toward one at which it is
        finite.
    seed : int, optional
        Seed of the Sobol points, 0 by default; a rule has its own. More starts with the same seed
        include the same points.
    method : MultipleShooting, SingleShooting or Collocation, optional
        How records are transcribed and solved; `MultipleShooting()` by default.
    search : "batched" or "multistart"
        See above.
    solver_options : mapping
        ``{"max_iter": 100, "tol": 1e-9}``, and all other options of IPOPT where IPOPT solves. For
        records, `tol` limits the decrease of the cost and half the squared length of a step in
        standard errors, 1e-8 by default. `max_iter` limits every run; that of records is continued
        beyond it if it ends unfinished at the lowest cost, and begins again where its steps are too
        long to be stable.
    executor : concurrent.futures.Executor, optional
        Makes the runs: `greybox.solve.WorkerPool(2)`, a `ProcessPoolExecutor`, Dask's
        ``client.get_executor()``; by default this process. The answer is the same.
    seconds : float, optional
        Time limit of the whole search, in s. The best runs until then are judged; the answer
        depends on the speed of the machine, and says so.
    profiles : bool
        After default starts, look for other minima that the data hardly distinguish from the best
        one; for records, if the model is linear and has more states than outputs. Profile the
        likelihood of responses and manoeuvres, as `greybox.profile` does, along parameters without
        an interval by the standard error, or whose interval leaves the bounds, whose error exceeds
        half the value, or changes by 30 % within one error: `Fit.profiles`. Where that would take
        a second or longer, a note names these parameters. Slow problems (records, trims inside the
        optimization, finite amplitudes) are not profiled unless you name the parameters in
        `greybox.profile`.
    progress : bool or function
        A bar on a terminal for fits longer than two seconds; or a function of the numbers of
        finished and of all runs.

    Returns
    -------
    Fit
        If no start converged, `Fit.converged` is False, the values are NaN, and `Fit.best_effort`
        has the values of the best run.

    Raises
    ------
    ValueError, TypeError
        For bad input, in one sentence.
    RuntimeError
        When the executor has lost its workers.
    KeyboardInterrupt
        After Ctrl-C, at the end of the current iteration; its attribute ``fit`` is the best fit so
        far.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> answer = gb.fit(pitch_hover.problem(), starts=20)
    >>> answer.converged, answer.agreeing
    (True, 20)
    >>> round(answer.estimate["a1"], 2), round(answer.standard_error["a1"], 1)
    (-13.58, 1.3)
    """
    by = SolverChoice(method, search, solver_options)
    with limited(end_after(seconds)):
        return fit_with_storage(
            None,
            problem,
            starts,
            seed,
            by=by,
            executor=executor,
            profiles=profiles,
            progress=progress,
        )


@frozen
class SolverChoice:
    """The arguments `method`, `search` and `solver_options` of `fit`.

    Raises
    ------
    ValueError, TypeError
        For bad input, in one sentence.
    """

    method: Transcription | None = None
    search: str = BATCHED
    options: Named = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        """Check all of them."""
        cure = "IPOPT's options as {name: value}"
        require_kind("solver_options", self.options, Mapping, cure)
        cure = "an instance such as MultipleShooting()"
        require_kind("method", self.method, Transcription | None, cure)

        if self.search not in SEARCHES:
            raise ValueError(
                f"search is {self.search!r:.40}: give one of {', '.join(map(repr, SEARCHES))}."
            )

    def solver(self, problem: AnyProblem) -> LocalSolver:
        """Return the solver of a problem, which is compiled for it.

        Raises
        ------
        ValueError
            If a formula does not trace, or divides by the number zero.
        TimeoutError
            If the time limit ends before.
        """
        try:
            with building():
                return solver_for(compile_problem(problem, self.method), self.options, self.search)
        except ZeroDivisionError as error:
            # The command line and studies name the line; in Python the traceback shows it.
            raise ValueError(
                f"a formula of {problem.name!r} divides by zero: change the constants in it."
            ) from error


@contextmanager
def _interruptible() -> Iterator[None]:
    """Listen for Ctrl-C; one that leaves no fit becomes `Interrupted` too."""
    try:
        with listening():
            yield
    except Interrupted:
        raise
    except KeyboardInterrupt as pressed:
        raise Interrupted("interrupted before the first start") from pressed


@_interruptible()
@one_blas_thread()
@traced_once()
# Bounds may be as wide as numbers are: what overflows there is no minimum, which is checked.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def fit_with_storage(
    storage: RunStorage | None,
    problem: AnyProblem,
    starts: AnyStarts | None = None,
    seed: int | None = None,
    *,
    by: SolverChoice,
    executor: Executor | None = None,
    profiles: bool = True,
    progress: bool | ProgressReport = True,
) -> Fit:
    """Fit as `fit` does, and store every run at once; stored runs are not repeated."""
    require_executor(executor)
    began = time.perf_counter()
    solver = by.solver(problem)
    nlp = solver.nlp
    rule = as_starts(solver.starts if starts is None else starts, seed)

    with responding(Response.STOP):
        # SciPy prints a traceback of an interrupt while it loads the numbers of Sobol points.
        points = rule.draw({name: nlp.problem.parameters[name] for name in nlp.free})
        run = partial(
            multistart,
            solver,
            points,
            executor=executor,
            storage=storage,
            promising=solver.promising if starts is None else (),
            beside=profiles,
        )
        search = _with_progress(run, len(points), progress)
        if not search.runs:  # Ctrl-C came before the end of the first one
            raise KeyboardInterrupt
        # Ask now: a later Ctrl-C does not end the search, which is complete.
        interrupted = stop_requested()
        # Explain failures before a refinement replaces the compiled problem in which they happened.
        search = explained(nlp, search)
        # Refine before ranking: minima of too coarse an integration may change their order.
        search, solver, error = refine_discretization(search, solver)
        # A batch stops at a loose tolerance; IPOPT confirms each minimum once.
        search = solver.polished(search)
        search, solver = with_robust_errors(search, solver)

    # Ctrl-C no longer ends the work: the search is complete, and judging it takes a moment.
    with responding(Response.FINISH):
        answer = assemble(search, solver, seed=rule.seed, starts=str(rule), error=error)
        messages = tuple(_cut_short(search, len(points), interrupted=interrupted))
        # A search that was cut short has no time for profiles.
        if profiles and answer.converged and not messages:
            answer = with_profiles_where_misleading(solver.nlp, answer)
        seconds = time.perf_counter() - began
        answer = replace(answer, warnings=(*messages, *answer.warnings), seconds=seconds)
    # What CasADi built is freed here, not at the return while another thread builds.
    with LOCK:
        del run, nlp, search, solver
    if take_interrupt():
        raise Interrupted(
            f"interrupted after {counted(len(answer.runs), 'start')}; the best fit so far is "
            "sys.last_value.fit in a notebook, and the attribute fit of this exception",
            fit=answer,
        )
    return answer


def _with_progress(
    run: Callable[..., Multistart], count: int, progress: bool | ProgressReport
) -> Multistart:
    """Return the search that `run` makes from this many starts, its progress shown or reported."""
    # A bar would be in the way of a function that reports progress in another form.
    if callable(progress) or not progress:
        return run(progress=progress or None)
    with bar(total=count, unit="start") as progress_bar:

        def report(done: int, count: int) -> None:
            # Shown as soon as the first start takes longer than half a second.
            progress_bar.delay = min(DELAY, done / 2)
            progress_bar.update(done - progress_bar.n)

        return run(progress=report)


@one_thread_at_a_time  # also frees what it compiles
def fingerprint(problem: AnyProblem, by: SolverChoice) -> str:
    """Return the key of stored runs: of the compiled problem, its data and the solver options."""
    return value_fingerprint(by.solver(problem))


def _cut_short(search: Multistart, count: int, *, interrupted: bool) -> Iterator[str]:
    """Return how many of `count` starts were run before Ctrl-C or the time limit."""
    done = len(search.brought)
    total = counted(count, "start")
    is_over = np.any(search.runs.status == SEARCH_OVER)
    if (interrupted and done < count) or is_over:
        cause = "the time limit ended the search" if is_search_over() else "interrupted"
        machine = ", and a faster machine may answer otherwise" if is_search_over() else ""
        yield f"{cause} after {done} of {total}: another start may end at a lower cost{machine}."


@one_thread_at_a_time
def assemble(
    search: Multistart,
    solver: LocalSolver,
    *,
    seed: int | None,
    starts: str,
    error: DiscretizationError | None,
) -> Fit:
    """Turn the runs of a search into the answer.

    `starts` describes their rule, `error` is the error of discretization where it is known.
    """
    nlp = solver.nlp
    # The end of a run that did not converge is not an estimate: the values of a failed fit are NaN.
    accuracy = Accuracy.unknown(nlp)
    misfit = None
    if search.minima:
        best = search.minima[0].estimate
        trajectories = solver.profile(best, search.nodes).trajectories
        accuracy = assess(nlp, best, trajectories)
        misfit = assessed_misfit(nlp, best, trajectories, accuracy.at_bound, {}, solver)

    values = nlp.all_values(accuracy.x)
    estimate = by_name(nlp.names, values.tolist())
    lines, covariance, slopes = quantities(accuracy)
    # The warnings below read the fitted values, so the parts come first.
    # Values, not the compiled parts: a fit must be small, and readable without its model.
    parts = tuple(
        fitted_part(part, trajectory, values, dict(part.problem.local_values(estimate)))
        for part, trajectory in zip(nlp.parts, accuracy.trajectories, strict=True)
    )
    at = np.array([line.value for line in lines[: len(slopes)]])
    directions = known_directions(accuracy, at, slopes)
    if directions is not None and directions.unseen.any():
        # Where two values are equal, the data seem to determine their sum and their product alike.
        # A second point shows which combination is determined everywhere.
        elsewhere = directions_beside(
            nlp,
            accuracy.x,
            accuracy.at_bound,
            lambda x: solver.profile(x, search.nodes).trajectories,
        )
        directions = replace(directions, elsewhere=elsewhere)

    answer = Fit(
        name=nlp.problem.name,
        parts=parts,
        quantities=lines,
        covariance=covariance,
        dof=accuracy.dof,
        cost=search.minima[0].cost if search.minima else math.nan,
        runs=search.runs,
        minima=search.minima,
        agreeing=len(agreeing_runs(nlp, search.runs, search.minima)),
        warnings=(),
        seed=seed,
        starts=starts,
        seconds=0.0,
        versions={
            "greybox": __version__,
            "casadi": ca.CasadiMeta.version(),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        models=tuple(part.model for part in nlp.problem.parts),
        white=accuracy.white,
        independent=accuracy.independent,
        directions=directions,
        priors={n: pair for p in stated_priors(nlp.problem) for n, pair in p.stated.items()},
        prior_share=prior_shares(accuracy),
        misfit=misfit,
    )

    if not search.minima:
        run = best_unfinished(search.runs)
        return replace(
            answer,
            warnings=(*wrapped(answer), *warnings_of_failure(search, solver)),
            best_effort=None if run is None else parameter_values(nlp, run.estimate),
        )
    return replace(
        answer,
        warnings=warnings(search, accuracy, answer, error),
        notes=(
            *once(unused_noise(nlp.problem)),
            # No weight could account for the misfit of a wrong model.
            *(better_weights(accuracy) if answer.is_explained else ()),
            *resting_inputs(nlp),
            *(() if misfit and misfit.is_exact else rounded_outputs(answer.records)),
            *(determined_together(answer) if accuracy.combinations else ()),
        ),
    )
