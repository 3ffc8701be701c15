"""Minima with parameters, or another quantity, held at values: the points of a profile.

Parameters are held by their bounds, any other quantity by an equation. One solver is used for all
parameters, and one program for each other quantity.
"""

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.ipopt import WARM
from greybox.solve.response_solver import TOLERANCE, ResponseSolver
from greybox.solve.runs import Outcome


class NoProfileError(ValueError):
    """No likelihood, or the solver does not find the minimum of a fit again."""


Held = list[int] | ca.Function
"""What is held: the parameters at these places, or a quantity (z) -> value."""


class HeldMinima:
    """The minima of a problem with something held.

    A point consists of the solver's variables (p,), which may be followed by the states at the
    nodes of all parts.

    Parameters
    ----------
    nlp : CompiledProblem
    shapes : sequence of (int, int)
        Shapes of the nodes of every part, if it has any.
    """

    def __init__(self, nlp: CompiledProblem, shapes: Sequence[tuple[int, ...]] = ()) -> None:
        self._nlp = nlp
        self._shapes = list(shapes)

    @cached_property
    def _solver(self) -> GaussNewton:
        return GaussNewton(self._nlp)

    @cached_property
    def _newton(self) -> BatchedNewton | None:
        """Newton's method for responses with bounds alone; it takes a tenth of the time."""
        program, scaling = self._nlp.programs[-1], self._nlp.scaling
        if program.explicit is None or not ResponseSolver.serves(self._nlp):
            return None
        lower, upper = map(scaling.to_solver, (self._nlp.lower, self._nlp.upper))
        return BatchedNewton(program.explicit, lower, upper, program.roots)

    def solve(
        self, held: Held, starts: Sequence[Array], value: float | Array
    ) -> list[tuple[Array, float]]:
        """Return the minimum from each start with a quantity held at a value: point and cost.

        Several parameters have an array of values. A cost is infinite where the solver failed.
        """
        if not isinstance(held, list) or self._newton is None:
            return [self._solved(held, start, value) for start in starts]

        bounds = map(self._nlp.scaling.to_solver, self._bounds(held, value))
        lower, upper = (np.tile(bound[:, None], len(starts)) for bound in bounds)
        ends = self._newton.minimize(
            np.clip(np.array(starts).T, lower, upper),
            from_near=True,
            max_iterations=WARM["max_iter"],
            tolerance=TOLERANCE,
            bounds=(lower, upper),
        )
        pairs = zip(ends.z.T, ends.at_minimum, strict=True)
        return [(z, self._cost(z) if at_minimum else math.inf) for z, at_minimum in pairs]

    def _bounds(self, held: list[int], value: float | Array) -> tuple[Array, Array]:
        """Return the bounds (p,), which are equal for a held parameter."""
        lower, upper = self._nlp.lower.copy(), self._nlp.upper.copy()
        lower[held] = upper[held] = value
        return lower, upper

    def _cost(self, z: Array) -> float:
        """Return the cost of a response at z (p,), without the smoothing of solvers."""
        cost = self._nlp.cost(self._nlp.all_values(self._nlp.scaling.to_parameters(z)))
        return cost if math.isfinite(cost) else math.inf

    def _solved(self, held: Held, start: Array, value: float | Array) -> tuple[Array, float]:
        scaling = self._nlp.scaling
        p = len(self._nlp.free)
        equation = None
        if isinstance(held, list):
            lower, upper = self._bounds(held, value)
        else:
            lower, upper = self._nlp.lower, self._nlp.upper
            equation = steep_equation(held, start[:p], float(np.ravel(value)[0]))

        solver = self._solver.within(scaling.to_solver(lower), scaling.to_solver(upper), equation)
        x = np.clip(scaling.to_parameters(start[:p]), lower, upper)
        # From the states of a neighboring point a solution takes a few iterations.
        outcome = None
        if len(start) > p:
            ends = np.cumsum([math.prod(shape) for shape in self._shapes])[:-1]
            nodes = [
                piece.reshape(shape)
                for piece, shape in zip(np.split(start[p:], ends), self._shapes, strict=True)
            ]
            outcome = solver.solved_from(x, nodes)

        # States of a distant neighbor may lead nowhere: then begin with the states of the data.
        if outcome is None or not outcome.converged:
            outcome = solver.run(x)
        point = _point(self._nlp, outcome)
        if not outcome.converged:
            return point, math.inf
        return point, outcome.cost if len(self._shapes) else self._cost(point)


@one_thread_at_a_time
def steep_equation(quantity: ca.Function, z: Array, value: float) -> ca.Function:
    """Return (z) -> quantity less value, with slope one at z (p,), like a bound."""
    # The solver measures violations in absolute terms: without the scaling an equation in small
    # units would hardly hold, and one in large units would outweigh the cost.
    point = ca.SX.sym("z", len(z))
    size = float(np.linalg.norm(slope_of(quantity, z)))
    return ca.Function("equation", [point], [(quantity(point) - value) / (size or 1.0)])


@one_thread_at_a_time
def slope_of(quantity: ca.Function, z: Array) -> Array:
    """Return the derivatives (p,) of a quantity (z) -> value at the point z (p,)."""
    return quantity.jacobian()(z, 0).full().ravel()


def best_of_records(
    nlp: CompiledProblem, x: Array
) -> tuple[HeldMinima, Array, float, tuple[Trajectory, ...]]:
    """Return the solver of records, its minimum from x (p,), the cost, and the trajectories.

    Raises
    ------
    NoProfileError
    """
    # A fit does not store the states at the nodes: they are solved again, then everything together.
    solver = GaussNewton(nlp)
    states = solver.profile(x)
    outcome = solver.solved_from(x, [trajectory.nodes for trajectory in states.trajectories])
    if not outcome.converged or outcome.nodes is None:
        raise NoProfileError(
            f"the minimum of {nlp.problem.name!r} is not found again from the estimate: "
            f"{outcome.status}."
        )

    held = HeldMinima(nlp, [nodes.shape for nodes in outcome.nodes])
    trajectories = solver.profile(outcome.estimate, outcome.nodes).trajectories
    return held, _point(nlp, outcome), outcome.cost, trajectories


def _point(nlp: CompiledProblem, outcome: Outcome) -> Array:
    nodes = [] if outcome.nodes is None else [part.ravel() for part in outcome.nodes]
    return np.concatenate([nlp.scaling.to_solver(outcome.estimate), *nodes])
