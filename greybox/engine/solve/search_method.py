"""How the runs of a fit are made: the argument `search`, as a word or an object."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.gauss_newton.settings import settings
from greybox.engine.solve.local_solver import LocalSolver
from greybox.engine.solve.response_solver import NO_OPTIONS, ResponseSolver
from greybox.engine.solve.shared_solver import SharedSolver
from greybox.engine.solve.transcribed_program import TranscribedProgram
from greybox.modeling.one_thread import one_thread_at_a_time


class SearchMethod(ABC):
    """A choice of the solver that makes the runs of a fit."""

    @abstractmethod
    def local_solver(self, nlp: CompiledProblem, options: Mapping[str, Any]) -> LocalSolver:
        """Return the solver of a problem.

        Raises
        ------
        ValueError
            For options that the solver does not take.
        """


@frozen
class Batched(SearchMethod):
    """Compare the starts, and improve many at once.

    Parts with hidden unknowns, such as records, are solved by Gauss-Newton steps, or as one sparse
    program by IPOPT if the method asks for it.
    """

    def local_solver(self, nlp: CompiledProblem, options: Mapping[str, Any]) -> LocalSolver:
        """Return the solver of a problem."""
        if not nlp.has_states:
            kind = SharedSolver if SharedSolver.serves(nlp) else ResponseSolver
            return kind(nlp, options)
        if nlp.method.by_ipopt:
            return TranscribedProgram(nlp, options)
        return GaussNewton(nlp, settings=settings(options))


@frozen
class FromEveryStart(SearchMethod):
    """Run IPOPT from every start."""

    def local_solver(self, nlp: CompiledProblem, options: Mapping[str, Any]) -> LocalSolver:
        """Return the solver of a problem."""
        if nlp.has_states:
            return TranscribedProgram(nlp, options)
        return ResponseSolver(nlp, options, batched=False)


BATCHED = "batched"
INCLUDED: Mapping[str, SearchMethod] = {BATCHED: Batched(), "multistart": FromEveryStart()}
SEARCHES = tuple(INCLUDED)

AnySearch = str | SearchMethod
"""One of the words, or an object such as an own `greybox.Solver`."""


def as_search_method(search: AnySearch) -> SearchMethod:
    """Return the method of a word; an object is one already.

    Raises
    ------
    ValueError
        For anything else.
    """
    if isinstance(search, SearchMethod):
        return search
    if isinstance(search, str) and search in INCLUDED:
        return INCLUDED[search]
    words = ", ".join(map(repr, SEARCHES))
    raise ValueError(
        f"search is {search!r:.60}: give one of {words}, or an instance of your own Solver."
    )


@one_thread_at_a_time
def solver_for(
    nlp: CompiledProblem, options: Mapping[str, Any] = NO_OPTIONS, search: AnySearch = BATCHED
) -> LocalSolver:
    """Return the solver of a problem.

    Raises
    ------
    ValueError
        For options that the solver does not take.
    """
    # For a worker: a view of a mapping does not travel.
    return as_search_method(search).local_solver(nlp, dict(options))
