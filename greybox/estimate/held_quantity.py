"""Minima with parameters held at values, or with another quantity held: the points of a profile.

Parameters are held by their two bounds, any other quantity by an equation. One solver serves all
parameters, and one program each other quantity.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.response_part import SMOOTHING
from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.ipopt import CONVERGED, WARM, Ipopt
from greybox.solve.response_solver import TOLERANCE, ResponseSolver
from greybox.solve.runs import Outcome


class NoMinimumError(ValueError):
    """The solver does not find the minimum of a fit again."""


class HeldQuantity(ABC):
    """A problem with the parameters at some places held, or with a quantity (z) -> value held."""

    @abstractmethod
    def of(self, *places: int) -> "HeldQuantity":
        """Return the same problem with the parameters at these places held."""

    @abstractmethod
    def of_quantity(self, quantity: ca.Function) -> "HeldQuantity":
        """Return the same problem with a quantity (z) -> value held."""

    @abstractmethod
    def solve(
        self, starts: Sequence[Array], values: Sequence[float | Array]
    ) -> list[tuple[Array, float]]:
        """Return the minimum from each start with the held quantity at a value: point and cost.

        Several held parameters have an array of values. A cost is infinite where the solver failed.
        """


class _Programs:
    """The solvers of frequency responses, each built when it is first used."""

    def __init__(self, nlp: CompiledProblem, quantity: ca.Function | None) -> None:
        self._nlp = nlp
        self._quantity = quantity
        self.lower = nlp.scaling.to_solver(nlp.lower)
        self.upper = nlp.scaling.to_solver(nlp.upper)

    @cached_property
    def newton(self) -> BatchedNewton | None:
        """Newton's method, where there are only bounds; it takes a tenth of IPOPT's time."""
        program = self._nlp.programs[-1]
        if self._quantity is not None or not ResponseSolver.serves(self._nlp):
            return None
        assert program.explicit is not None
        return BatchedNewton(program.explicit, self.lower, self.upper, program.roots)

    @cached_property
    def ipopt(self) -> tuple[Ipopt, dict[str, Array]]:
        """IPOPT, and the bounds of its constraints and equation."""
        program = self._nlp.program
        kind: Any = ca.SX if program.is_a("SXFunction") else ca.MX
        z = kind.sym("z", len(self._nlp.free))
        p = kind.sym("p", 2)
        cost, limits = program(z, p[0])
        equation = kind(0, 1) if self._quantity is None else self._quantity(z) - p[1]
        ipopt = Ipopt({"x": z, "p": p, "f": cost, "g": ca.vertcat(limits, equation)}, WARM)
        upper = np.concatenate([np.full(limits.numel(), np.inf), np.zeros(equation.numel())])
        return ipopt, {"lbg": np.zeros(upper.size), "ubg": upper}


class HeldResponses(HeldQuantity):
    """A problem of frequency responses; a point is the solver's variables z (p,)."""

    def __init__(
        self,
        nlp: CompiledProblem,
        places: Sequence[int] = (),
        quantity: ca.Function | None = None,
        programs: _Programs | None = None,
    ) -> None:
        self._nlp = nlp
        self._places = list(places)
        self._quantity = quantity
        self._programs = programs or _Programs(nlp, quantity)

    def of(self, *places: int) -> "HeldResponses":
        """Hold the parameters at these places."""
        return HeldResponses(self._nlp, places, None, self._programs)

    def of_quantity(self, quantity: ca.Function) -> "HeldResponses":
        """Hold a quantity."""
        return HeldResponses(self._nlp, (), quantity)

    def solve(
        self, starts: Sequence[Array], values: Sequence[float | Array]
    ) -> list[tuple[Array, float]]:
        """Minimize from each start."""
        scaling = self._nlp.scaling
        lower = np.tile(self._programs.lower, (len(starts), 1))
        upper = np.tile(self._programs.upper, (len(starts), 1))
        if self._places:
            x = np.ones(lower.shape)
            x[:, self._places] = np.array([np.ravel(value) for value in values])
            z = scaling.to_solver(x)[:, self._places]
            lower[:, self._places] = upper[:, self._places] = z

        ends = np.clip(np.array(starts), lower, upper)
        converged = np.zeros(len(starts), bool)
        remaining = ~converged
        if self._programs.newton is not None:
            minima = self._programs.newton.minimize(
                ends.T,
                from_near=True,
                max_iterations=WARM["max_iter"],
                tolerance=TOLERANCE,
                bounds=(lower.T, upper.T),
            )
            converged = minima.at_minimum
            ends[converged] = minima.z.T[converged]
            # Where rounding ended Newton's method, IPOPT may converge. What took all iterations
            # runs away.
            remaining = ~converged & (minima.iterations < WARM["max_iter"])
        for k in np.flatnonzero(remaining).tolist():
            ipopt, equations = self._programs.ipopt
            bounds = {"lbx": lower[k], "ubx": upper[k], **equations}
            ends[k], status, _ = ipopt.solve(ends[k], [SMOOTHING, np.ravel(values[k])[0]], bounds)
            converged[k] = status in CONVERGED
        costs = np.where(converged, self._nlp.costs(scaling.to_parameters(ends)), np.inf)
        return list(zip(ends, np.where(np.isfinite(costs), costs, np.inf).tolist(), strict=True))


class HeldRecords(HeldQuantity):
    """A problem with records.

    A point is the solver's variables (p,), alone or followed by the states at the nodes of all
    parts: from those of a neighbor a solution takes a few iterations.

    Parameters
    ----------
    nlp : CompiledProblem
    shapes : sequence of (int, int)
        Shapes of the nodes of every part.
    places : sequence of int
    quantity : casadi.Function, optional
    solver : GaussNewton, optional
    """

    def __init__(
        self,
        nlp: CompiledProblem,
        shapes: Sequence[tuple[int, ...]],
        places: Sequence[int] = (),
        quantity: ca.Function | None = None,
        solver: GaussNewton | None = None,
    ) -> None:
        """Build the solver, unless it is given."""
        self._nlp = nlp
        self._shapes = list(shapes)
        self._places = list(places)
        self._quantity = quantity
        self._solver = solver or GaussNewton(nlp)

    def of(self, *places: int) -> "HeldRecords":
        """Hold the parameters at these places."""
        return HeldRecords(self._nlp, self._shapes, places, None, self._solver)

    def of_quantity(self, quantity: ca.Function) -> "HeldRecords":
        """Hold a quantity."""
        return HeldRecords(self._nlp, self._shapes, (), quantity, self._solver)

    def solve(
        self, starts: Sequence[Array], values: Sequence[float | Array]
    ) -> list[tuple[Array, float]]:
        """Minimize from each start."""
        return [self._solved(start, value) for start, value in zip(starts, values, strict=True)]

    def _solved(self, start: Array, value: float | Array) -> tuple[Array, float]:
        scaling = self._nlp.scaling
        p = len(self._nlp.free)
        x = scaling.to_parameters(start[:p])
        x[self._places] = value
        lower = self._nlp.lower.copy()
        upper = self._nlp.upper.copy()
        lower[self._places] = upper[self._places] = x[self._places]
        equation = None
        if self._quantity is not None:
            equation = steep_equation(self._quantity, start[:p], float(np.ravel(value)[0]))

        solver = self._solver.within(scaling.to_solver(lower), scaling.to_solver(upper), equation)
        x = np.clip(x, lower, upper)
        outcome = None
        if len(start) > p:
            ends = np.cumsum([math.prod(shape) for shape in self._shapes])[:-1]
            nodes = [
                piece.reshape(shape)
                for piece, shape in zip(np.split(start[p:], ends), self._shapes, strict=True)
            ]
            outcome = solver.solved_from(x, nodes)
        if outcome is None or not outcome.converged:
            outcome = solver.run(x)
        return _point(self._nlp, outcome), outcome.cost if outcome.converged else math.inf


@one_thread_at_a_time
def steep_equation(quantity: ca.Function, z: Array, value: float) -> ca.Function:
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
    """Return the solver of records, its minimum from an estimate x (p,), the cost, and the trajectories.

    Raises
    ------
    NoMinimumError
    """
    solver = GaussNewton(nlp)
    states = solver.profile(x)
    outcome = solver.solved_from(x, [trajectory.nodes for trajectory in states.trajectories])
    if not outcome.converged or outcome.nodes is None:
        raise NoMinimumError(
            f"the minimum of {nlp.problem.name!r} is not found again from the estimate: {outcome.status}."
        )
    held = HeldRecords(nlp, [nodes.shape for nodes in outcome.nodes])
    trajectories = solver.profile(outcome.estimate, outcome.nodes).trajectories
    return held, _point(nlp, outcome), outcome.cost, trajectories


def _point(nlp: CompiledProblem, outcome: Outcome) -> Array:
    nodes = [] if outcome.nodes is None else [part.ravel() for part in outcome.nodes]
    return np.concatenate([nlp.scaling.to_solver(outcome.estimate), *nodes])
