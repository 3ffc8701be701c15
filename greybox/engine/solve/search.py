"""The first of the three steps of a fit: from a compiled problem to its minima."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor

import numpy as np

from greybox.data.files.frozen_values import frozen
from greybox.data.files.progress import DELAY, bar
from greybox.data.files.wording import counted
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.solve.discretization_error import DiscretizationError, refine_discretization
from greybox.engine.solve.interruption import is_search_over, stop_requested
from greybox.engine.solve.local_solver import LocalSolver
from greybox.engine.solve.minima import Multistart
from greybox.engine.solve.multistart import ProgressReport, multistart
from greybox.engine.solve.not_finite import explained
from greybox.engine.solve.robust_fit import with_robust_errors
from greybox.engine.solve.run_storage import RunStorage
from greybox.engine.solve.runs import SEARCH_OVER
from greybox.modeling.formulation.starts import AnyStarts, as_starts


@frozen
class Search:
    """What a search found, and with which solver.

    Attributes
    ----------
    found : Multistart
        All runs, and the distinct minima, best first.
    solver : LocalSolver
        The solver with the compiled problem at which the minima were confirmed: perhaps with finer
        steps of integration, or with bounded errors, than at the starts.
    error : DiscretizationError or None
        What twice the steps of integration would change; None where it was not computed.
    seed : int or None
    starts : str
        The rule of the starts, in words.
    count : int
        Number of starts that were asked for.
    interrupted : bool
        Whether Ctrl-C came before the last of them.
    """

    found: Multistart
    solver: LocalSolver
    error: DiscretizationError | None
    seed: int | None
    starts: str
    count: int
    interrupted: bool = False

    @property
    def nlp(self) -> CompiledProblem:
        """The compiled problem."""
        return self.solver.nlp

    def cut_short(self) -> Iterator[str]:
        """Say how many of the starts were run before Ctrl-C or the time limit."""
        done = len(self.found.brought)
        is_over = np.any(self.found.runs.status == SEARCH_OVER)
        if (self.interrupted and done < self.count) or is_over:
            cause = "the time limit ended the search" if is_search_over() else "interrupted"
            machine = ", and a faster machine may answer otherwise" if is_search_over() else ""
            yield (
                f"{cause} after {done} of {counted(self.count, 'start')}: another start may end at "
                f"a lower cost{machine}."
            )


def search_minima(
    solver: LocalSolver,
    starts: AnyStarts | None = None,
    seed: int | None = None,
    *,
    executor: Executor | None = None,
    storage: RunStorage | None = None,
    beside: bool = True,
    progress: bool | ProgressReport = True,
) -> Search:
    """Run the solver from all starts, refine the integration, and polish the minima.

    See `greybox.fit` for `starts`, `seed`, `executor` and `progress`. With `beside`, and without
    `starts`, other minima are looked for beside the best one.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C before the end of the first run.
    """
    nlp = solver.nlp
    rule = as_starts(solver.starts if starts is None else starts, seed)
    # SciPy prints a traceback of an interrupt while it loads the numbers of Sobol points.
    points = rule.draw({name: nlp.problem.parameters[name] for name in nlp.free})

    def run(progress: ProgressReport | None) -> Multistart:
        return multistart(
            solver,
            points,
            executor=executor,
            storage=storage,
            promising=solver.promising if starts is None else None,
            beside=beside,
            progress=progress,
        )

    found = _with_progress(run, len(points), progress)
    if not found.runs:  # Ctrl-C came before the end of the first one
        raise KeyboardInterrupt

    # Ask now: a later Ctrl-C does not end the search, which is complete.
    interrupted = stop_requested()
    # Explain failures before a refinement replaces the compiled problem in which they happened.
    found = explained(nlp, found)
    # Refine before ranking: minima of too coarse an integration may change their order.
    found, solver, error = refine_discretization(found, solver)
    # A batch stops at a loose tolerance; IPOPT confirms each minimum once.
    found = solver.polished(found)
    found, solver = with_robust_errors(found, solver)
    return Search(found, solver, error, rule.seed, str(rule), len(points), interrupted)


def _with_progress(
    run: Callable[[ProgressReport | None], Multistart],
    count: int,
    progress: bool | ProgressReport,
) -> Multistart:
    """Return what `run` finds from this many starts, its progress shown or reported."""
    # A bar would be in the way of a function that reports progress in another form.
    if callable(progress) or not progress:
        return run(progress or None)

    with bar(total=count, unit="start") as progress_bar:

        def report(done: int, count: int) -> None:
            # Shown as soon as the first start takes longer than half a second.
            progress_bar.delay = min(DELAY, done / 2)
            progress_bar.update(done - progress_bar.n)

        return run(report)
