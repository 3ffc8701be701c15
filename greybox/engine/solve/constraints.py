"""Bounds and constraints of a problem with records, and the way back to them."""

from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.vectorized import Columns
from greybox.engine.solve.quadratic_program import solve_small_qp
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import dense_jacobian


@frozen
class Limits:
    """What the solver's point z (p,) must satisfy: low <= z <= high, and constraints(z) >= 0.

    Attributes
    ----------
    low, high : (p,) arrays
    constraints : Columns
        (z) -> values (c,) and their derivatives, row by row (c p,).
    """

    low: Array
    high: Array
    constraints: Columns

    @property
    def count(self) -> int:
        """Number of constraints besides the bounds; most problems have none."""
        return int(self.constraints.function.numel_out(0))

    @one_thread_at_a_time
    def with_equation(self, equation: ca.Function) -> "Limits":
        """Return these limits and an equation (z) -> 0, as two constraints."""
        z = ca.SX.sym("z", len(self.low))
        value = equation(z)
        values = ca.vertcat(self.constraints.function(z)[0], value, -value)
        return replace(self, constraints=constraints_of(values, z))

    def clipped(self, z: Array) -> Array:
        """Return the point within the bounds."""
        return np.clip(z, self.low, self.high)

    def after(self, z: Array, step: Array) -> Array:
        """Return the point after a step within the bounds; on a bound if the rest is rounding."""
        end = self.clipped(z + step)

        # A variable next to a bound, by rounding, would still count as free. One is the size of a
        # start box.
        for bound in (self.low, self.high):
            end = np.where(np.abs(end - bound) <= 1e-12 * np.abs(step) + 1e-15, bound, end)
        return end

    def violation(self, z: Array, rounding: float = 1e-9) -> float:
        """Return by how much all constraints together are violated, beyond a relative rounding."""
        if not self.count:
            return 0.0
        value, normal = self._at(z)
        tolerated = rounding * (np.abs(normal) @ np.maximum(np.abs(z), 1.0))
        below = -value
        return float(np.where(below > tolerated, below, 0.0).sum())

    def linearized(self, z: Array, held: BoolArray | bool = False) -> tuple[Array, Array]:
        """Return normals (n, p) and limits (n,) of a step dz from z: normals · dz >= limits.

        Variables that are `held` (p,) do not move. A step that satisfies the limits also leads back
        to a linearized constraint that is violated at z.
        """
        value, normal = self._at(z)

        # A point may lie beyond a bound by rounding: no step need lead back.
        low = np.where(held, 0.0, np.minimum(self.low - z, 0.0))
        high = np.where(held, 0.0, np.minimum(z - self.high, 0.0))
        eye = np.eye(len(z))
        rows = np.vstack([eye, -eye, normal])
        limits = np.concatenate([low, high, -value])
        finite = np.isfinite(limits)
        return rows[finite], limits[finite]

    def _at(self, z: Array) -> tuple[Array, Array]:
        """Return the values (c,) of the constraints at z (p,), and their derivatives (c, p)."""
        values, slopes = self.constraints(z[:, None])
        return values[:, 0], slopes.reshape(-1, len(z))

    def nearest(self, z: Array) -> Array:
        """Return a point near z that satisfies all limits, as closely as 20 steps find one."""
        z = self.clipped(z)

        # Constraints may be curved, and each step follows their tangents.
        for _ in range(20):
            if not self.violation(z) > 0:
                break
            step = solve_small_qp(np.eye(len(z)), np.zeros(len(z)), *self.linearized(z))
            z = self.clipped(z + step)
        return z


@one_thread_at_a_time
def limits_of(nlp: CompiledProblem) -> Limits:
    """Return the bounds and constraints of a problem in the solver's variables."""
    z = ca.SX.sym("z", len(nlp.free))
    return Limits(*nlp.bounds, constraints_of(nlp.limits_at(z), z))


def constraints_of(values: ca.SX, z: ca.SX) -> Columns:
    """Return the constraints (z) -> values (c,) and their derivatives, row by row."""
    return Columns(ca.Function("constraints", [z], [values, dense_jacobian(values, z).T]))
