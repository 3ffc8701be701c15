"""Minima with parameters, or another quantity, held at values: the points of a profile.

Parameters are held by their bounds, any other quantity by an equation. One solver is used for all
parameters, and one program for each other quantity.
"""

import math
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


Held = list[int] | ca.Function
"""What is held: the parameters at these places, or a quantity (z) -> value."""


class HeldResponses:
    """A problem of frequency responses; a point is the solver's variables z (p,)."""

    def __init__(self, nlp: CompiledProblem) -> None:
        self._nlp = nlp
        self._lower = nlp.scaling.to_solver(nlp.lower)
        self._upper = nlp.scaling.to_solver(nlp.upper)
        self._built: dict[Any, tuple[Ipopt, dict[str, Array]]] = {}

    @cached_property
    def _newton(self) -> BatchedNewton | None:
        """Newton's method, where there are only bounds; it takes a tenth of IPOPT's time."""
        program = self._nlp.programs[-1]
        if not ResponseSolver.serves(self._nlp):
            return None
        assert program.explicit is not None
        return BatchedNewton(program.explicit, self._lower, self._upper, program.roots)

    def _ipopt(self, quantity: ca.Function | None) -> tuple[Ipopt, dict[str, Array]]:
        """Return IPOPT, and the bounds of its constraints and of the equation for a quantity."""
        if quantity not in self._built:
            program = self._nlp.program
            kind: Any = ca.SX if program.is_a("SXFunction") else ca.MX
            z = kind.sym("z", len(self._nlp.free))
            p = kind.sym("p", 2)
            cost, limits = program(z, p[0])
            equation = kind(0, 1) if quantity is None else quantity(z) - p[1]

            ipopt = Ipopt({"x": z, "p": p, "f": cost, "g": ca.vertcat(limits, equation)}, WARM)
            upper = np.concatenate([np.full(limits.numel(), np.inf), np.zeros(equation.numel())])
            self._built[quantity] = ipopt, {"lbg": np.zeros(upper.size), "ubg": upper}
        return self._built[quantity]

    def solve(
        self, held: Held, starts: Sequence[Array], value: float | Array
    ) -> list[tuple[Array, float]]:
        """Return the minimum from each start with a quantity held at a value: point and cost.

        Several parameters have an array of values. A cost is infinite where the solver failed.
        """
        scaling = self._nlp.scaling
        # A held parameter has equal bounds: the solver then needs no equation for it.
        lower = self._lower.copy()
        upper = self._upper.copy()
        quantity = None if isinstance(held, list) else held
        if isinstance(held, list):
            x = np.ones(lower.size)
            x[held] = value
            lower[held] = upper[held] = scaling.to_solver(x)[held]

        ends = np.clip(np.array(starts), lower, upper)
        converged = np.zeros(len(starts), bool)
        remaining = ~converged
        # Newton's method knows bounds only, so a held quantity needs IPOPT.
        if quantity is None and self._newton is not None:
            minima = self._newton.minimize(
                ends.T,
                from_near=True,
                max_iterations=WARM["max_iter"],
                tolerance=TOLERANCE,
                bounds=(np.tile(lower[:, None], len(ends)), np.tile(upper[:, None], len(ends))),
            )
            converged = minima.at_minimum
            ends[converged] = minima.z.T[converged]
            # Where rounding ended Newton's method, IPOPT may converge. A run that took all
            # iterations runs away.
            remaining = ~converged & (minima.iterations < WARM["max_iter"])

        for k in np.flatnonzero(remaining).tolist():
            ipopt, equations = self._ipopt(quantity)
            bounds = {"lbx": lower, "ubx": upper, **equations}
            ends[k], status, _ = ipopt.solve(ends[k], [SMOOTHING, np.ravel(value)[0]], bounds)
            converged[k] = status in CONVERGED

        costs = np.where(converged, self._nlp.costs(scaling.to_parameters(ends)), np.inf)
        return list(zip(ends, np.where(np.isfinite(costs), costs, np.inf).tolist(), strict=True))


class HeldRecords:
    """A problem with records.

    A point consists of the solver's variables (p,), which may be followed by the states at the
    nodes of all parts.

    Parameters
    ----------
    nlp : CompiledProblem
    shapes : sequence of (int, int)
        Shapes of the nodes of every part.
    """

    def __init__(self, nlp: CompiledProblem, shapes: Sequence[tuple[int, ...]]) -> None:
        """Build the solver."""
        self._nlp = nlp
        self._shapes = list(shapes)
        self._solver = GaussNewton(nlp)

    def solve(
        self, held: Held, starts: Sequence[Array], value: float | Array
    ) -> list[tuple[Array, float]]:
        """Return the minimum from each start, as `HeldResponses.solve` does."""
        return [self._solved(held, start, value) for start in starts]

    def _solved(self, held: Held, start: Array, value: float | Array) -> tuple[Array, float]:
        scaling = self._nlp.scaling
        p = len(self._nlp.free)
        x = scaling.to_parameters(start[:p])
        lower = self._nlp.lower.copy()
        upper = self._nlp.upper.copy()
        equation = None

        if isinstance(held, list):
            x[held] = lower[held] = upper[held] = value
        else:
            equation = steep_equation(held, start[:p], float(np.ravel(value)[0]))

        solver = self._solver.within(scaling.to_solver(lower), scaling.to_solver(upper), equation)
        x = np.clip(x, lower, upper)
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
        return _point(self._nlp, outcome), outcome.cost if outcome.converged else math.inf


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
    point = ca.SX.sym("z", len(z))
    slope = ca.Function("slope", [point], [ca.jacobian(quantity(point), point)])
    return np.asarray(ca.DM(slope(z))).ravel()


def best_of_records(
    nlp: CompiledProblem, x: Array
) -> tuple[HeldRecords, Array, float, tuple[Trajectory, ...]]:
    """Return the solver of records, its minimum from x (p,), the cost, and the trajectories.

    Raises
    ------
    NoMinimumError
    """
    # A fit does not store the states at the nodes: they are solved again, then everything together.
    solver = GaussNewton(nlp)
    states = solver.profile(x)
    outcome = solver.solved_from(x, [trajectory.nodes for trajectory in states.trajectories])
    if not outcome.converged or outcome.nodes is None:
        raise NoMinimumError(
            f"the minimum of {nlp.problem.name!r} is not found again from the estimate: "
            f"{outcome.status}."
        )

    held = HeldRecords(nlp, [nodes.shape for nodes in outcome.nodes])
    trajectories = solver.profile(outcome.estimate, outcome.nodes).trajectories
    return held, _point(nlp, outcome), outcome.cost, trajectories


def _point(nlp: CompiledProblem, outcome: Outcome) -> Array:
    nodes = [] if outcome.nodes is None else [part.ravel() for part in outcome.nodes]
    return np.concatenate([nlp.scaling.to_solver(outcome.estimate), *nodes])
