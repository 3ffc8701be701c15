"""The number of harmonics of sine tests in a fit: as many as matter at the start values, then at the estimate.

The starts are searched with few harmonics, since a search takes many evaluations. If the estimate
needs more, every run is continued with them from its end.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.compiled.compiled_problem import AnyProblem, CompiledProblem, compile_problem
from greybox.estimate.covariance import assess
from greybox.estimate.diagnostics.harmonics import too_few_harmonics
from greybox.formulation.problem import Problem
from greybox.modeling.harmonic_balance import ENOUGH, enough_harmonics
from greybox.modeling.pade_delay import delay_order
from greybox.solve.interruption import stop_requested
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart
from greybox.solve.multistart import multistart
from greybox.solve.outcome import SCREENED, Run
from greybox.solve.runs import Runs


def are_open(problem: AnyProblem) -> list[bool]:
    """Return for every part whether its sine leaves the number of harmonics open."""
    return [
        part.amplitude is not None and part.amplitude.harmonics is None for part in problem.parts
    ]


def with_enough_harmonics(problem: AnyProblem) -> AnyProblem:
    """Return the problem with as many harmonics as matter at the start values, where the number is open."""
    if not any(are_open(problem)):
        return problem
    return problem.with_parts([_with_enough(part) for part in problem.parts])


def _with_enough(part: Problem) -> Problem:
    if part.amplitude is None or part.amplitude.harmonics is not None:
        return part
    data = part.response
    starts = {name: parameter.start for name, parameter in part.parameters.items()}
    sine = enough_harmonics(
        part.model,
        data.omega,
        part.amplitude,
        dict(part.local_values(starts)),
        input=data.input,
        output=data.output,
        at=part.at,
        pade=delay_order(part.delay),
    )
    return part.with_(amplitude=sine)


def with_more_harmonics(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver, open_parts: Sequence[bool]
) -> tuple[CompiledProblem, Multistart, LocalSolver]:
    """Continue with more harmonics in the `open_parts` in which they are too few at the estimate."""
    if not any(open_parts) or any(part.has_states for part in nlp.parts):
        return nlp, search, solver
    for _ in range(3):  # from 3 harmonics they reach 45
        if not search.minima or stop_requested():
            break
        problem = _refined(nlp, search, solver, open_parts)
        if problem is None:
            break
        finer = compile_problem(problem)
        finer_solver = solver.refined(finer)
        ends = np.array([run.estimate if run.converged else run.start for run in search.brought])
        continued = multistart(finer, finer_solver, ends, movable=False)
        if not continued.minima or len(continued.runs) < len(ends):
            break
        search = replace(
            continued,
            runs=_joined(search, continued, len(ends)),
            seconds=search.seconds + continued.seconds,
        )
        nlp = finer
        solver = finer_solver
    return nlp, search, solver


def _refined(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver, open_parts: Sequence[bool]
) -> AnyProblem | None:
    """Return the problem with the harmonics that it needs at the estimate; None if it has them."""
    best = search.minima[0].estimate
    accuracy = assess(nlp, best, solver.profile(best, search.nodes).trajectories)
    needed = {
        id(few.problem): few.harmonics
        for few in too_few_harmonics(nlp, best, accuracy)
        if few.change > 100 * ENOUGH
    }
    parts = [
        part.with_(amplitude=replace(part.amplitude, harmonics=needed[id(part)]))
        if is_open and id(part) in needed
        else part
        for part, is_open in zip(nlp.problem.parts, open_parts, strict=True)
    ]
    is_same = all(part is old for part, old in zip(parts, nlp.problem.parts, strict=True))
    return None if is_same else nlp.problem.with_parts(parts)


def _joined(search: Multistart, continued: Multistart, count: int) -> Runs:
    """Return the runs of both searches as one: `count` runs were continued."""
    pairs = zip(continued.runs[:count], search.brought, strict=True)
    runs: list[Run] = [
        replace(
            run,
            start=first.start,
            iterations=first.iterations + run.iterations,
            seconds=first.seconds + run.seconds,
        )
        for run, first in pairs
    ]
    runs += [*continued.runs[count:], *(run for run in search.runs if run.stage == SCREENED)]
    return Runs.of(replace(run, index=k) for k, run in enumerate(runs))
