"""Minima of the cost with a quantity held: the points of a likelihood profile."""

import math
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.solve.batched_newton import BatchedNewton
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.gauss_newton.settings import USUAL
from greybox.engine.solve.ipopt import WARM
from greybox.engine.solve.response_solver import TOLERANCE, ResponseSolver
from greybox.engine.solve.runs import Outcome
from greybox.engine.solve.search_method import solver_for
from greybox.modeling.cached_property import cached_property
from greybox.modeling.one_thread import one_thread_at_a_time

Held = int | ca.Function
"""What is held: the parameter at this place, or a quantity (z) -> value."""


class NoProfileError(ValueError):
    """There is no likelihood, or the solver does not return to the minimum of the fit."""


@frozen
class Point:
    """A minimum with a quantity held at a value.

    Attributes
    ----------
    z : (p,) array
        The parameters in the variables of the solver.
    cost : float
        Infinite where the solver failed.
    nodes : tuple of arrays
        The states at the nodes of every part; empty where they are not known.
    value : float
    """

    z: Array
    cost: float = math.inf
    nodes: tuple[Array, ...] | None = ()
    value: float = 0.0


class HeldMinima:
    """The minima of a problem with a quantity held, and its minimum at an estimate x (p,).

    Attributes
    ----------
    nlp : CompiledProblem
    best : Point
        The minimum. Records are solved again, so it may be slightly lower than the minimum of the
        fit.
    x : (p,) array
        The parameters there.

    Raises
    ------
    NoProfileError
        If the minimum is not found again.
    """

    def __init__(self, nlp: CompiledProblem, x: Array) -> None:
        self.nlp = nlp
        self.best = self._minimum(x)
        self.x = nlp.scaling.to_parameters(self.best.z)

    def _minimum(self, x: Array) -> Point:
        nlp = self.nlp
        if not nlp.has_states:
            return self._response_minimum(nlp.scaling.to_solver(x))

        # A fit does not store the states at the nodes: they are solved again, then everything
        # together.
        outcome = self._solver.near(x)
        if not outcome.converged:
            raise NoProfileError(
                f"the minimum of {nlp.problem.name!r} was not reached again from the estimate: "
                f"{outcome.status}."
            )
        return self._point(outcome)

    @cached_property
    def numbers(self) -> float:
        """N for costs of the form N/2 log(sum of squares); infinite for other costs."""
        is_logarithm = all(part.is_logarithm for part in self.nlp.parts)
        return self.nlp.numbers if is_logarithm else math.inf

    @cached_property
    def _solver(self) -> GaussNewton:
        # Ends move by 1e-6 of a standard error, and profiles take two thirds of the time.
        return GaussNewton(self.nlp, settings=replace(USUAL, tol=1e-5))

    @cached_property
    def _newton(self) -> BatchedNewton | None:
        """Newton's method for responses with bounds alone; it takes a tenth of the time."""
        solver = solver_for(self.nlp)
        if isinstance(solver, ResponseSolver) and solver.together > 1 and not self.nlp.limits:
            return solver.batches[-1]
        return None

    def lowest(self, held: Held, starts: Sequence[Point], value: float) -> Point:
        """Return the lowest minimum from these starts with a quantity held at a value."""
        lower = self.nlp.lower.copy()
        upper = self.nlp.upper.copy()
        # A parameter is held by its bounds, any other quantity by an equation.
        is_parameter = isinstance(held, int)
        if is_parameter:
            lower[held] = value
            upper[held] = value
        lower = self.nlp.scaling.to_solver(lower)
        upper = self.nlp.scaling.to_solver(upper)

        minima = []
        if self._newton is not None and is_parameter:
            ends = self._newton.minimize(
                np.array([start.z for start in starts]).T,
                from_near=True,
                max_iterations=WARM["max_iter"],
                tolerance=TOLERANCE,
                bounds=(lower[:, None], upper[:, None]),
            )
            for z, at_minimum in zip(ends.z.T, ends.at_minimum, strict=True):
                minima.append(self._response_minimum(z) if at_minimum else Point(z))
        else:
            for start in starts:
                equation = None if is_parameter else steep_equation(held, start.z, value)
                minima.append(self._solved(self._solver.within(lower, upper, equation), start))
        return min(minima, key=lambda minimum: minimum.cost)

    def _solved(self, solver: GaussNewton, start: Point) -> Point:
        """Return the minimum that a solver finds from a start."""
        x = self.nlp.scaling.to_parameters(solver.limits.clipped(start.z))
        # From the states of a neighboring point a solution takes a few iterations.
        outcome = solver.solved_from(x, start.nodes) if start.nodes else None
        # States of a distant neighbor may lead nowhere: then begin with the states of the data.
        if outcome is None or not outcome.converged:
            outcome = solver.run(x)
        return self._point(outcome)

    def _point(self, outcome: Outcome) -> Point:
        cost = outcome.cost if outcome.converged else math.inf
        return Point(self.nlp.scaling.to_solver(outcome.estimate), cost, outcome.nodes)

    def at_bounds(self, point: Point) -> set[str]:
        """Return the names of the parameters at a bound."""
        x = self.nlp.scaling.to_parameters(point.z)
        room = np.minimum(x - self.nlp.lower, self.nlp.upper - x)
        # IPOPT's barrier leaves a relative distance of up to 1e-4 to an active bound.
        return {self.nlp.free[k] for k in np.flatnonzero(room <= 1e-4 * np.abs(x))}

    def _response_minimum(self, z: Array) -> Point:
        """Return the point z (p,) with the cost of responses, without the smoothing of solvers."""
        cost = self.nlp.costs(self.nlp.scaling.to_parameters(z)[None]).item()
        return Point(z, cost if math.isfinite(cost) else math.inf)


@one_thread_at_a_time
def steep_equation(quantity: ca.Function, z: Array, value: float) -> ca.Function:
    """Return (z) -> quantity less value, with slope one at z (p,), like a bound."""
    # The solver measures violations in absolute terms: without the scaling, an equation in small
    # units would be met inaccurately, and one in large units would outweigh the cost.
    point = ca.SX.sym("z", len(z))
    size = float(np.linalg.norm(slope_of(quantity, z)))
    return ca.Function("equation", [point], [(quantity(point) - value) / (size or 1.0)])


@one_thread_at_a_time
def slope_of(quantity: ca.Function, z: Array) -> Array:
    """Return the derivatives (p,) of a quantity (z) -> value at the point z (p,)."""
    nominal_output = 0  # CasADi's Jacobian takes the output, too, but does not use it
    return quantity.jacobian()(z, nominal_output).full().ravel()
