"""How many harmonics a fit of sine tests takes: as many as matter at its start values, then at its estimate.

The starts are searched with few harmonics, since a search takes many evaluations. Where the
estimate needs more, every run goes on with them from its end.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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

REFITS = 3  # with more harmonics each time: from 3 they reach 45


def are_open(problem: AnyProblem) -> list[bool]:
    """Tell of every part whether its sine leaves the number of harmonics open."""
    return [
        part.amplitude is not None and part.amplitude.harmonics is None for part in problem.parts
    ]


def with_enough_harmonics(problem: AnyProblem) -> AnyProblem:
    """Return the problem with as many harmonics as matter at the start values, where that is open."""
    if not any(are_open(problem)):
        return problem
    return _with_harmonics(problem, [_enough(part) for part in problem.parts])


def _enough(problem: Problem) -> int | None:
    sine = problem.amplitude
    if sine is None:
        return None
    data = problem.response
    signals: Any = {
        "input": data.input,
        "output": data.output,
        "at": problem.at,
        "pade": delay_order(problem.delay),
    }
    starts = {name: parameter.start for name, parameter in problem.parameters.items()}
    local = dict(problem.local_values(starts))
    return enough_harmonics(problem.model, data.omega, sine, local, **signals).harmonics


def _with_harmonics(problem: AnyProblem, harmonics: Sequence[int | None]) -> AnyProblem:
    """Return the problem with these numbers of harmonics; None where there is no sine."""
    parts = [
        part if number is None else part.with_(amplitude=replace(part.amplitude, harmonics=number))
        for part, number in zip(problem.parts, harmonics, strict=True)
    ]
    return problem.with_parts(parts)


def with_more_harmonics(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver, open_parts: Sequence[bool]
) -> tuple[CompiledProblem, Multistart, LocalSolver]:
    """Go on with more harmonics in the `open_parts` in which they do not suffice at the estimate."""
    if not any(open_parts) or any(part.has_states for part in nlp.parts):
        return nlp, search, solver
    for _ in range(REFITS):
        if not search.minima or stop_requested():
            break
        numbers = _numbers(nlp, search, solver, open_parts)
        if numbers == [part.amplitude and part.amplitude.harmonics for part in nlp.problem.parts]:
            break
        finer = compile_problem(_with_harmonics(nlp.problem, numbers))
        finer_solver = solver.refined(finer)
        ends = np.array([run.estimate if run.converged else run.start for run in search.brought])
        followed = multistart(finer, finer_solver, ends, movable=False)
        count = len(ends)
        if not followed.minima or len(followed.runs) < count:
            break
        continued = [
            _continued(run, before)
            for run, before in zip(followed.runs[:count], search.brought, strict=True)
        ]
        runs = (
            *continued,
            *followed.runs[count:],
            *(run for run in search.runs if run.stage == SCREENED),
        )
        runs = Runs.of(replace(run, index=k) for k, run in enumerate(runs))
        search = replace(followed, runs=runs, seconds=search.seconds + followed.seconds)
        nlp, solver = finer, finer_solver
    return nlp, search, solver


def _numbers(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver, open_parts: Sequence[bool]
) -> list[int | None]:
    """Return the number of harmonics that every part needs at the estimate."""
    best = search.minima[0].estimate
    accuracy = assess(nlp, best, solver.profile(best, search.nodes).trajectories)
    more = {
        id(found.problem): found.more
        for found in too_few_harmonics(nlp, best, accuracy)
        if found.change > 100 * ENOUGH
    }
    return [
        more.get(id(part), part.amplitude.harmonics)
        if is_open
        else part.amplitude and part.amplitude.harmonics
        for part, is_open in zip(nlp.problem.parts, open_parts, strict=True)
    ]


def _continued(run: Run, before: Run) -> Run:
    """Return a run as one from where the run before it began."""
    spent = {
        "iterations": before.iterations + run.iterations,
        "seconds": before.seconds + run.seconds,
    }
    return replace(run, start=before.start, **spent)
