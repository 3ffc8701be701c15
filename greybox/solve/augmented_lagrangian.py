"""Constraints of a search from many points, by Newton's method for all at once.

A search begins where the constraints c(z) >= 0 are met: a point where they are not moves to the
nearest ones that are. A logarithmic barrier keeps it on its side of them, so that searches end at
different minima where the constraints part the box, and is reduced once. Then, with multipliers λ
and a penalty ρ of each search of its own,

    f(z) + Σ (max(0, λ - ρ c(z))² - λ²) / (2 ρ)

has its minimum where f has it under the constraints, once λ is that of the KKT conditions. λ begins
with that of the barrier and becomes max(0, λ - ρ c) at every minimum; ρ grows where the constraints
are not met much better than before (Nocedal and Wright, Numerical Optimization, sections 17.4 and
19.6).
"""

import casadi as ca
import numpy as np

from greybox.compiled.response_part import SMOOTHING
from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.batched_newton import INSIDE, LOOSE, BatchedNewton, Ends
from greybox.solve.interruption import reason_to_end

FEASIBLE = 1e-8  # how far a constraint may be missed, in the solver's variables: as IPOPT may leave its bounds

# Factors of the barrier: those of the weak one of the bounds. A strong one would drive searches far
# away where nothing else bounds them.
BARRIERS = (1e-2, 1e-4)

# Of the first Lagrangian: costs are of the order of one, their curvatures of up to some hundred.
# Too small a penalty lets a search leave its minimum; for Newton's method a large one is no harder.
PENALTY = 1e3
GROWTH = 10.0
FALL = 0.25  # of what is missed, from one turn to the next, below which the penalty stays
TURNS = (
    20  # multipliers converge by a factor of ten or more a turn; IPOPT goes on with what takes more
)


class ConstrainedNewton:
    """Minimizes a function of z within bounds and under constraints, from many points at once."""

    @one_thread_at_a_time
    def __init__(
        self,
        program: ca.Function,
        lower: Array,
        upper: Array,
        origin: Array,
        roots: ca.Function | None = None,
    ) -> None:
        """Take what `BatchedNewton` takes; the program returns what must be >= 0 after the cost.

        The constraints are scaled by their slopes at the origin (p,).
        """
        inputs = [ca.SX.sym("v", program.numel_in(k)) for k in range(program.n_in())]
        z = inputs[0]
        cost, limits = program(*inputs)
        slopes = ca.Function("slopes", [z], [ca.densify(ca.jacobian(limits, z))])
        size = np.linalg.norm(np.asarray(ca.DM(slopes(origin))), axis=1)
        limits = limits / np.where(np.isfinite(size) & (size > 0), size, 1.0)
        missing = ca.Function(
            "missing", [z, ca.SX.sym("smoothing")], [ca.sumsqr(ca.fmax(INSIDE - limits, 0))]
        )

        barrier, penalty, multipliers = (
            ca.SX.sym("barrier"),
            ca.SX.sym("penalty"),
            ca.SX.sym("m", limits.numel()),
        )
        shifted = ca.fmax(multipliers - penalty * limits, 0)
        cost += (ca.sumsqr(shifted) - ca.sumsqr(multipliers)) / (2 * penalty)
        cost -= barrier * ca.sum1(ca.if_else(barrier > 0, ca.log(limits), 0))
        whole = ca.Function("whole", [*inputs, ca.vertcat(barrier, penalty, multipliers)], [cost])
        self._limits = ca.Function("limits", [z], [limits])
        self._missing = BatchedNewton(missing, lower, upper)
        self._newton = BatchedNewton(whole, lower, upper, roots)

    def minimize(
        self, z: Array, *, max_iterations: int, tolerance: float, from_near: bool = False
    ) -> Ends:
        """Search from the columns of z (p, m), see `BatchedNewton.minimize`; at a minimum the constraints are met."""
        begun = z if from_near else self._moved_inside(z, max_iterations)
        ends = Ends(begun.copy(), np.zeros(z.shape[1], bool), np.zeros(z.shape[1], int))
        limits = self._values(ends.z)
        multipliers = np.zeros_like(limits)
        if not from_near:
            for barrier in BARRIERS:
                inside = np.flatnonzero((limits > 0).all(axis=0))
                given = np.vstack(
                    [np.full(inside.size, v) for v in (barrier, PENALTY, *np.zeros(len(limits)))]
                )
                found = self._newton.minimize(
                    ends.z[:, inside],
                    max_iterations=max_iterations,
                    tolerance=LOOSE,
                    from_near=barrier < BARRIERS[0],
                    given=given,
                )
                ends.z[:, inside] = found.z
                ends.iterations[inside] += found.iterations
                limits = self._values(ends.z)
                multipliers[:, inside] = barrier / np.maximum(limits[:, inside], SMOOTHING)
        self._meet(ends, multipliers, max_iterations, tolerance)
        return ends

    def _meet(self, ends: Ends, multipliers: Array, max_iterations: int, tolerance: float) -> None:
        """Go on with augmented Lagrangians from the ends."""
        m = ends.z.shape[1]
        penalty, missed, left = np.full(m, PENALTY), np.full(m, np.inf), np.arange(m)
        for _ in range(TURNS):
            if not left.size or reason_to_end():
                break
            found = self._newton.minimize(
                ends.z[:, left],
                max_iterations=max_iterations,
                tolerance=tolerance,
                from_near=True,
                given=np.vstack([np.zeros(left.size), penalty[left], multipliers[:, left]]),
            )
            ends.z[:, left] = found.z
            ends.iterations[left] += found.iterations
            limits, before = self._values(found.z), multipliers[:, left]
            multipliers[:, left] = np.maximum(before - penalty[left] * limits, 0)
            # Of a constraint that is not active, how far its multiplier is from zero.
            miss = np.abs(np.minimum(limits, before / penalty[left])).max(axis=0)
            ends.at_minimum[left] = found.at_minimum & (miss <= FEASIBLE)
            penalty[left] *= np.where(miss > FALL * missed[left], GROWTH, 1.0)
            missed[left] = miss
            left = left[
                found.at_minimum & (miss > FEASIBLE) & (ends.iterations[left] < max_iterations)
            ]

    def _moved_inside(self, z: Array, max_iterations: int) -> Array:
        """Return the points, those where constraints are missed moved to the nearest ones where they are met."""
        moved = z.copy()
        outside = np.flatnonzero(~(self._values(z) > 0).all(axis=0))
        if outside.size:
            found = self._missing.minimize(
                z[:, outside],
                max_iterations=max_iterations,
                tolerance=LOOSE * INSIDE,
                from_near=True,
            )
            moved[:, outside] = found.z
        return moved

    def _values(self, z: Array) -> Array:
        """Return the constraints (c, m), scaled."""
        return np.asarray(ca.DM(self._limits(z)))
