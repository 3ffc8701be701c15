"""From a problem to its answer, in three steps: search the minima, estimate there, assess.

Each step can be used without the next: `search_minima` knows no errors, `estimate_at_minimum` no
checks, and `gb.fit(..., checks=())` ends after the second.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.assessment.assess import assess
from greybox.assessment.at_minimum import estimate_at_minimum
from greybox.assessment.checks.included import CHECKS, Check, require_checks
from greybox.assessment.result import Fit
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.engine.compiled.compiled_problem import AnyProblem, compile_problem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.blas_threads import one_blas_thread
from greybox.engine.solve.executors import require_executor
from greybox.engine.solve.interruption import (
    Interrupted,
    Response,
    building,
    end_after,
    limited,
    listening,
    responding,
    take_interrupt,
)
from greybox.engine.solve.local_solver import LocalSolver
from greybox.engine.solve.multistart import ProgressReport
from greybox.engine.solve.run_storage import RunStorage
from greybox.engine.solve.search import search_minima
from greybox.engine.solve.search_method import (
    BATCHED,
    AnySearch,
    as_search_method,
    solver_for,
)
from greybox.modeling.fingerprint import value_fingerprint
from greybox.modeling.formulation.starts import AnyStarts
from greybox.modeling.one_thread import LOCK, one_thread_at_a_time
from greybox.modeling.traced_once import traced_once


@public
def fit(  # noqa: PLR0913  (what to fit, from where, how, and how long)
    problem: AnyProblem,
    starts: AnyStarts | None = None,
    seed: int | None = None,
    *,
    method: Transcription | None = None,
    search: AnySearch = BATCHED,
    solver_options: Mapping[str, Any] = MappingProxyType({}),
    executor: Executor | None = None,
    seconds: float | None = None,
    checks: Sequence[Check] = CHECKS,
    profiles: bool = True,
    progress: bool | ProgressReport = True,
) -> Fit:
    """Fit a problem from many starts: by IPOPT, or, where data are records, by Gauss-Newton steps.

    Newton's method searches frequency responses from all starts at once (``search="batched"``), and
    IPOPT polishes every minimum. Large problems of state spaces are searched together, too, with
    one solution of (jωI - A)⁻¹ for all responses; there, all starts but the most promising one of a
    batch, or the first of your own list, first move to a minimum with process noise. Other problems
    that do not fit into a batch (large ones) are solved by IPOPT from every
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
    search : "batched", "multistart", or a Solver
        See above. An instance of your own `greybox.Solver` makes the runs: starts, ranking, errors
        and checks stay as they are, and only ends that are minima count.
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
    checks : sequence of functions
        What the answer is judged by: functions of the `Evidence` that yield `Finding`s, all of
        `greybox.CHECKS` by default. Add your own with ``checks=[*gb.CHECKS, mine]``. With
        ``checks=()`` the answer has its estimates and standard errors, and nothing is judged: no
        misfit, no warnings, no profiles; the verdict says so.
    profiles : bool
        After default starts, look for other minima that the data hardly distinguish from the best
        one; for records, if the model is linear and has more states than outputs. Profile the
        likelihood of responses and manoeuvres, as `greybox.profile` does, along parameters without
        an interval by the standard error, or whose interval leaves the bounds, whose error exceeds
        half the value, or changes by 30 % within one error: `Fit.profiles`. Where that would take
        a second or longer, a note names these parameters. Slow problems (records, trims inside the
        optimization) are not profiled unless you name the parameters in
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
            checks=checks,
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
    search: AnySearch = BATCHED
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        """Check all of them."""
        cure = "IPOPT's options as {name: value}"
        require_kind("solver_options", self.options, Mapping, cure)
        cure = "an instance such as MultipleShooting()"
        require_kind("method", self.method, Transcription | None, cure)

        as_search_method(self.search)

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
def fit_with_storage(  # noqa: PLR0913  (what to fit, from where, how, and how long)
    storage: RunStorage | None,
    problem: AnyProblem,
    starts: AnyStarts | None = None,
    seed: int | None = None,
    *,
    by: SolverChoice,
    executor: Executor | None = None,
    checks: Sequence[Check] = CHECKS,
    profiles: bool = True,
    progress: bool | ProgressReport = True,
) -> Fit:
    """Fit as `fit` does, and store every run at once; stored runs are not repeated."""
    require_executor(executor)
    require_checks(checks)
    began = time.perf_counter()
    solver = by.solver(problem)

    with responding(Response.STOP):
        search = search_minima(
            solver,
            starts,
            seed,
            executor=executor,
            storage=storage,
            beside=profiles,
            progress=progress,
        )
    # Ctrl-C no longer ends the work: the search is complete, and judging it takes a moment.
    with responding(Response.FINISH):
        evidence = estimate_at_minimum(search)
        answer = assess(evidence, checks, profiles=profiles)
        answer = replace(answer, seconds=time.perf_counter() - began)

    # What CasADi built is freed here, not at the return while another thread builds.
    with LOCK:
        del solver, search, evidence
    if take_interrupt():
        raise Interrupted(
            f"interrupted after {counted(len(answer.runs), 'start')}; the best fit so far is "
            "sys.last_value.fit in a notebook, and the attribute fit of this exception",
            fit=answer,
        )
    return answer


@one_thread_at_a_time  # also frees what it compiles
def fingerprint(problem: AnyProblem, by: SolverChoice) -> str:
    """Return the key of stored runs: of the compiled problem, its data and the solver options."""
    return value_fingerprint(by.solver(problem))
