"""The solver of large problems whose responses share one solve a frequency.

All starts but the first of a batch get short delays and move to a minimum with process noise,
where most of them meet; then all are improved together by Newton's method. The cost is that of
`greybox.engine.compiled.shared_response`, whose gradient is exact: a minimum counts where it
vanishes, and IPOPT need not confirm it. Constraints do not guide the search: most bounds of tied
parameters hold where it ends, and IPOPT continues where one does not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.solve.barrier_levels import BARRIERS, LAST
from greybox.engine.solve.batched_newton import BatchedNewton, Ends, continued
from greybox.engine.solve.minima import RIVAL, Minimum, likelihood_unit
from greybox.engine.solve.process_noise_start import ProcessNoise
from greybox.engine.solve.promising import Promising
from greybox.engine.solve.response_solver import FEW, NO_OPTIONS, ResponseSolver
from greybox.engine.solve.runs import NOT_FINITE, Outcome, Run, Runs
from greybox.modeling.cached_property import cached_property


@dataclass(frozen=True)
class Beginning:
    """How a start moves while there is process noise.

    Attributes
    ----------
    noise : float
        Process noise over the derivatives of the states, with relative errors of one in the
        responses.
    barriers : (levels,) array
        Factors of the barrier at the bounds, from the first to the last level.
    """

    noise: float
    barriers: Array


@dataclass(frozen=True)
class Stage:
    """A search with process noise, of which there are several with less and less noise.

    Attributes
    ----------
    share : float
        Share of the noise of the beginning.
    last : int
        Level of the barrier at which it ends.
    every : int
        It uses every so many frequencies.
    apart : float
        Distance up to which ends meet, in units of the start box.
    """

    share: float
    last: int = LAST
    every: int = 1
    apart: float = 1e-4


# Starts with more and with less noise miss different minima of two flexible modes. Behind a strong
# barrier starts meet. Behind a weak one fewer reach the minimum of five helicopters, after more
# iterations, but only there, and with less noise, do those of a rate with delays of many turns: a
# quarter of the first 32 starts.
STRONG, WEAK = BARRIERS
BEGINNINGS = (Beginning(30.0, STRONG), Beginning(3.0, STRONG), Beginning(3.0, WEAK))
OF_FIRST_FOUR = 0, 0, 1, 2
OF_LATER_FOUR = 0, 0, 1, 1
FIRST = 32

# Behind the first barrier, where most of the starts meet, every second frequency suffices. With one
# ratio of process noise, five of seven starts take 3 to 36 iterations.
STAGES = (Stage(1.0, last=0, every=2, apart=1e-2), Stage(1.0), Stage(0.1), Stage(0.01))


def beginnings(count: int) -> IntArray:
    """Return the place in `BEGINNINGS` for each of so many starts."""
    first = np.resize(OF_FIRST_FOUR, min(count, FIRST))
    later = np.resize(OF_LATER_FOUR, max(count - FIRST, 0))
    return np.concatenate([first, later])


class SharedSolver(ResponseSolver):
    """Newton's method on the shared cost, from starts with process noise."""

    # All starts are run where the promising ones disagree, as with weakly observable states.
    # With 32, 26 of 28 fits of two flexible modes at 15 % noise were right, in as much time.
    starts = 128
    # All five agree on the minimum of a helicopter. Where four of five, or of eight, sufficed, one
    # of twelve fits of three axes in wide boxes ended at another one, with five none.
    promising = Promising((5, 8), agree=5)
    # Starts that meet continue once: with 32 a start takes half as long again. More delay progress.
    together = 128
    fewest = 1  # a fit of the mirror from one start took three times as long by IPOPT

    def __init__(self, nlp: CompiledProblem, *arguments: Any, **options: Any) -> None:
        """Build the solver of a problem whose responses share one solve."""
        super().__init__(nlp, *arguments, **options)
        self._shared: Any = nlp.programs[-1].shared

    @staticmethod
    def serves(nlp: CompiledProblem) -> bool:
        """Return whether the responses of a problem share one solve."""
        return nlp.programs[-1].shared is not None

    def improved(self, z: Array, **limits: Any) -> Ends:
        """Return the ends of searches from the columns of z (p, m)."""
        # The first start of a batch stays: others end alike, and might agree on a wrong minimum.
        near, columns, iterations = self._with_process_noise(z)

        # Some starts take 250 iterations, and their time would be that of the whole fit. Without a
        # barrier: the first start may be a minimum of a similar problem.
        limits = {
            "max_iterations": min(self.limits["max_iterations"], 100),
            "from_near": True,
            **limits,
        }
        ends = super().improved(np.column_stack([z[:, 0], near]), **limits)
        ends = Ends._make(values[..., [0, *1 + columns]] for values in ends)
        ends.iterations[1:] += iterations

        # The Hessian lacks what large residuals add. For a wrong model, its steps may overshoot by
        # more than they gain, and rounding would decide which searches ever arrive.
        lowest = float(np.min(ends.cost))
        rival = ends.cost <= lowest + RIVAL * likelihood_unit(self.nlp, lowest)
        close = np.flatnonzero(rival & ~ends.at_minimum)
        return continued(ends, self.settled(ends.z[:, close]), close)

    def _with_process_noise(self, z: Array) -> tuple[Array, IntArray, IntArray]:
        """Return where all starts (p, m) but the first lead while there is process noise.

        Starts that meet continue once: the points (p, k), the point of each start (m - 1,), and its
        iterations (m - 1,).
        """
        near = self._in_phase(z[:, 1:])
        columns = np.arange(near.shape[1])
        iterations = np.zeros(near.shape[1], dtype=int)
        kinds = beginnings(near.shape[1])
        for stage in STAGES if near.size else ():
            noise = ProcessNoise(self._shared, z, stage.every)
            barriers = np.array([BEGINNINGS[kind].barriers for kind in kinds])
            size = np.array([BEGINNINGS[kind].noise for kind in kinds])
            search = BatchedNewton(noise, *self.nlp.bounds, barriers=barriers)
            ends = search.minimize(
                near,
                max_iterations=40,
                # With 1e-3, two instead of seven of twenty starts for two flexible modes end at the
                # minimum, with 1e-5 a tenth more time is spent.
                tolerance=1e-4,
                from_near=stage.share < 1,
                given=stage.share * size[None],
                last=stage.last,
            )
            iterations += ends.iterations[columns]

            # Starts meet if they are no farther apart than such ends are from a minimum, in units
            # of the start box, or agree to three digits.
            close = np.isclose(ends.z[:, None], ends.z[..., None], rtol=1e-3, atol=stage.apart)
            meet = close.all(axis=0) & (kinds == kinds[:, None])
            firsts, column = np.unique(meet.argmax(axis=1), return_inverse=True)
            near, kinds, columns = ends.z[:, firsts], kinds[firsts], column[columns]
        return near, columns, iterations

    def settled(self, z: Array, **limits: Any) -> Ends:
        """Return the ends of searches from z (p, m), after some steps with the whole Hessian."""
        ends = super().settled(z, **{**limits, "max_iterations": FEW})
        rest = np.flatnonzero(~ends.at_minimum)
        curved = self._curved.minimize(
            ends.z[:, rest], **{**self.limits, "from_near": True, **limits}
        )
        return continued(ends, curved, rest)

    @cached_property
    def _curved(self) -> BatchedNewton:
        return BatchedNewton(self._shared.with_curvature, *self.nlp.bounds, self.nlp.data)

    def _in_phase(self, z: Array) -> Array:
        """Return z (p, m) with delays of less than half a turn at the highest frequency.

        A search whose delay is more than half a turn off at most frequencies ends at a gain of
        zero; few delays are longer.
        """
        for system in self._shared.systems if z.size else ():
            half_turn = np.pi / system.omega[-1]
            for k in np.flatnonzero(system.delayed):
                _, delays, *_, slopes = system.matrices(z)
                along = slopes[:, k].T
                excess = half_turn * (delays[:, k] // half_turn)
                # A fixed delay follows no variable.
                z = z - excess * along / np.maximum(np.sum(along**2, axis=0), 1e-300)
        return z

    def again(
        self, x: Array, earlier: Outcome | Run, options: Mapping[str, Any] = NO_OPTIONS
    ) -> Outcome:
        """Return a run that did not arrive, since IPOPT would take minutes, or IPOPT's end.

        IPOPT leads a minimum that misses a constraint back to it.
        """
        if not self.meets_constraints(x):
            return super().again(x, earlier, options)
        status = (
            "Maximum_Iterations_Exceeded" if np.isfinite(self.nlp.costs(x[None])) else NOT_FINITE
        )
        return Outcome(x, status, earlier.iterations, earlier.seconds, converged=False)

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return no run: the searches have met IPOPT's conditions."""
        return {}
