"""Problems with records, minimized with parameters or another quantity held: what a profile of records asks for."""

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.outcome import Outcome


class NoMinimumError(ValueError):
    """The minimum of a fit is not found again."""


class HeldRecords:
    """The solver of records with the parameters at some places held by their bounds, or a quantity by an equation.

    A point is the solver's variables (p,), alone or with the states at the nodes of all parts
    behind them: from those of a neighbor a solution takes a few iterations. Pickled, it is the
    problem and what is held.

    Parameters
    ----------
    nlp : CompiledProblem
    shapes : sequence of (int, int)
        Of the nodes of every part.
    places : sequence of int
    quantity : casadi.Function, optional
        (z) -> the value of what is held.
    """

    def __init__(
        self,
        nlp: CompiledProblem,
        shapes: Sequence[tuple[int, ...]],
        places: Sequence[int] = (),
        quantity: ca.Function | None = None,
        solver: GaussNewton | None = None,
    ) -> None:
        """Build the solver, unless it is there."""
        self._nlp, self._shapes, self._places, self._quantity = (
            nlp,
            list(shapes),
            list(places),
            quantity,
        )
        self._solver = solver or GaussNewton(nlp)

    def __reduce__(
        self,
    ) -> tuple[
        type["HeldRecords"],
        tuple[CompiledProblem, list[tuple[int, ...]], list[int], ca.Function | None],
    ]:
        return HeldRecords, (self._nlp, self._shapes, self._places, self._quantity)

    def of_quantity(self, quantity: ca.Function) -> "HeldRecords":
        """Return the same for a quantity (z) -> value."""
        return HeldRecords(self._nlp, self._shapes, (), quantity, self._solver)

    def of(self, *places: int) -> "HeldRecords":
        """Return the same for the parameters at these places."""
        return HeldRecords(self._nlp, self._shapes, places, None, self._solver)

    def solve(
        self, starts: Sequence[Array], values: Sequence[float | Array]
    ) -> list[tuple[Array, float]]:
        """Return the best points with what is held at these values, from each start, and their cost; inf without one.

        Several parameters have as many values.
        """
        return [self._solved(start, value) for start, value in zip(starts, values, strict=True)]

    def _solved(self, start: Array, value: float | Array) -> tuple[Array, float]:
        scaling, p = self._nlp.scaling, len(self._nlp.free)
        x = scaling.to_parameters(start[:p])
        x[self._places] = value
        lower, upper = self._nlp.lower.copy(), self._nlp.upper.copy()
        lower[self._places] = upper[self._places] = x[self._places]
        equation = (
            None
            if self._quantity is None
            else _equation(self._quantity, start[:p], float(np.ravel(value)[0]))
        )
        solver = self._solver.within(scaling.to_solver(lower), scaling.to_solver(upper), equation)
        x = np.clip(x, lower, upper)
        sizes = [math.prod(shape) for shape in self._shapes]
        found = None
        if len(start) > p:
            pieces = np.split(start[p:], np.cumsum(sizes)[:-1])
            nodes = [
                piece.reshape(shape) for piece, shape in zip(pieces, self._shapes, strict=True)
            ]
            found = solver.solved_from(x, nodes)
        if found is None or not found.converged:
            found = solver.run(x)
        return point_of(self._nlp, found), found.cost if found.converged else math.inf


@one_thread_at_a_time
def _equation(quantity: ca.Function, z: Array, value: float) -> ca.Function:
    """Return (z) -> quantity less value, of slope one at the point z (p,): as steep as a bound is."""
    point = ca.SX.sym("z", len(z))
    size = float(np.linalg.norm(slope_of(quantity, z)))
    return ca.Function("equation", [point], [(quantity(point) - value) / (size or 1.0)])


@one_thread_at_a_time
def slope_of(quantity: ca.Function, z: Array) -> Array:
    """Return the derivatives (p,) of a quantity (z) -> value at the point z (p,)."""
    point = ca.SX.sym("z", len(z))
    slope = ca.Function("slope", [point], [ca.jacobian(quantity(point), point)])
    return np.asarray(ca.DM(slope(z))).ravel()


def best_of_records(
    nlp: CompiledProblem, x: Array
) -> tuple[HeldRecords, Array, float, tuple[Trajectory, ...]]:
    """Return the solver of a problem, its best point from an estimate x (p,), the cost and the trajectories there."""
    solver = GaussNewton(nlp)
    states = solver.profile(x)
    found = solver.solved_from(x, [trajectory.nodes for trajectory in states.trajectories])
    if not found.converged or found.nodes is None:
        raise NoMinimumError(
            f"no minimum of {nlp.problem.name!r} is found at the estimate again: {found.status}."
        )
    held = HeldRecords(nlp, [nodes.shape for nodes in found.nodes])
    return (
        held,
        point_of(nlp, found),
        found.cost,
        solver.profile(found.estimate, found.nodes).trajectories,
    )


def point_of(nlp: CompiledProblem, outcome: Outcome) -> Array:
    """Return where a run ended as a point."""
    nodes = [] if outcome.nodes is None else [each.ravel() for each in outcome.nodes]
    return np.concatenate([nlp.scaling.to_solver(outcome.estimate), *nodes])
