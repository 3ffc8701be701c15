"""The solver of large problems whose responses share one solve a frequency.

Three of four starts move to a minimum of the equation error first, except those of sine tests; then
all are improved together by Newton's method. The cost is that of
`greybox.compiled.shared_response`, whose gradient is exact: a minimum counts where it vanishes, and
IPOPT need not confirm it.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.shared_response import SineTest
from greybox.files.arrays import Array
from greybox.solve.batched_newton import BatchedNewton, Ends
from greybox.solve.equation_error_start import EquationErrors
from greybox.solve.minima import Minimum
from greybox.solve.response_solver import NO_OPTIONS, TOLERANCE, ResponseSolver
from greybox.solve.runs import Outcome, Run, Runs

# Iterations of a start that did not move, over those of the others where they are at a minimum, and
# at most. From measured states they take 12, such a start takes up to 250, and its time is that of
# the whole fit.
TIMES, MOST = 4, 100
UNFINISHED = "Maximum_Iterations_Exceeded"


class SharedSolver(ResponseSolver):
    """Newton's method on the shared cost, from starts by equation error."""

    # All are run where the promising ones disagree, as with states that the outputs hardly show:
    # with 200, a helicopter with a rotor takes a minute.
    starts = 32
    together = 16  # more do not become cheaper
    polished_to = 1e-11  # as the equations of periodic motions: beyond, steps are rounding

    def __init__(self, problem: CompiledProblem, *arguments: Any, **options: Any) -> None:
        """Build the solver; starts of sine tests share no work, and their progress is shown."""
        super().__init__(problem, *arguments, **options)
        shared = problem.programs[-1].shared
        assert shared is not None
        self._shared = shared
        self._is_sine_test = any(isinstance(system, SineTest) for system in shared.systems)
        if self._is_sine_test:
            self.together, self.fewest = 2, 1

    @staticmethod
    def serves(problem: CompiledProblem) -> bool:
        """Return whether the responses of a problem share one solve."""
        return problem.programs[-1].shared is not None

    def improved(self, z: Array, **limits: Any) -> Ends:
        """Return the ends of searches from the columns of z (p, m)."""
        if self._is_sine_test:
            return super().improved(z, **limits)
        # One start in four stays: the others end alike, and might agree on a wrong minimum.
        moved = np.arange(z.shape[1]) % 4 > 0
        errors = BatchedNewton(EquationErrors(self._shared, z), self.lower, self.upper)
        near = errors.minimize(z, max_iterations=50, tolerance=TOLERANCE, from_near=True).z
        at_minimum, iterations = np.zeros(z.shape[1], bool), np.zeros(z.shape[1], int)
        z = np.where(moved, near, z)
        for columns in (moved, ~moved):
            ends = super().improved(z[:, columns], **limits)
            z[:, columns], at_minimum[columns] = ends.z, ends.at_minimum
            iterations[columns] = ends.iterations
            if ends.at_minimum.any():
                typical = int(np.median(ends.iterations[ends.at_minimum]))
                limits = {"max_iterations": min(TIMES * typical, MOST)}
        return Ends(z, at_minimum, iterations)

    def again(
        self, x: Array, earlier: Outcome | Run, options: Mapping[str, Any] = NO_OPTIONS
    ) -> Outcome:
        """Return a run that did not arrive: IPOPT would take minutes."""
        return Outcome(x, UNFINISHED, earlier.iterations, earlier.seconds, converged=False)

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return no run: the searches have met IPOPT's conditions."""
        return {}
