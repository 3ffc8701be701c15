"""Implicit integrators: stages that a system of equations determines, solved by Newton's method within every step.

A collocation method is an implicit integrator whose stages are left to the solver of the whole
problem; both have the same solution. So a problem that was solved by collocation is judged by these
steps.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from greybox.modeling.integrators import Integrator
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics

# Largest residual of the stage equations, relative to the largest state, with which a step counts
# as solved: far above the rounding in which Newton's method ends, and far below what an integrator
# of any order leaves.
SOLVED = 1e-9

# Of Newton's method: what it may leave of the equations, and iterations, of which a step that is
# short enough needs three or four.
TOLERANCE = 1e-13
ITERATIONS = 30


@dataclass(frozen=True)
class ImplicitIntegrator(Integrator):
    """A scheme given by the equations of its stages (n, stages); a subclass says which, and where a step ends."""

    implicit: ClassVar[bool] = True
    reach: ClassVar[float] = float("inf")

    @property
    @abstractmethod
    def stages(self) -> int:
        """Number of stages."""

    @abstractmethod
    def equations(
        self, system: Dynamics, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        """Return what must be zero, as many numbers as `stages` (n, stages) has; the others as for `advance`."""

    @abstractmethod
    def end(self, x: Any, stages: Any) -> Any:
        """Return the state (n,) at the end of the step."""

    @one_thread_at_a_time
    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x one step later; NaN where Newton's method does not solve the stages. Its derivatives are exact."""
        n, m = len(system.states), len(system.inputs)
        symbols = [ca.SX.sym("x", n), ca.SX.sym("u", m), ca.SX.sym("slope", m)]
        symbols += [ca.SX.sym("p", len(system.parameters)), ca.SX.sym("h")]
        stages = ca.SX.sym("stages", n, self.stages)
        start, at, ramp, parameters, span = symbols
        equations = ca.vec(self.equations(system, start, stages, at, ramp, parameters, span))
        options = {"error_on_fail": False, "abstol": TOLERANCE, "max_iter": ITERATIONS}
        known = ca.vertcat(*symbols)
        statement = {"x": ca.vec(stages), "p": known, "g": equations}
        newton = ca.rootfinder("stages", "newton", statement, options)
        residual = ca.Function("residual", [ca.vec(stages), known], [ca.norm_inf(equations)])

        given = ca.vertcat(x, u, slope, p, h)
        found = newton(ca.repmat(x, self.stages, 1), given)
        solved = residual(found, given) <= SOLVED * (1 + ca.norm_inf(x))
        end = self.end(x, ca.reshape(found, n, self.stages))
        return ca.if_else(solved, end, ca.MX.nan(n))


@dataclass(frozen=True)
class Radau(ImplicitIntegrator):
    """Radau IIA with `degree` stages, of order 2 · degree - 1: collocation at Radau points, for stiff models too.

    Source: Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., IV.5.
    """

    substeps: int | None = 1
    degree: int = 3

    @property
    def order(self) -> int:  # type: ignore[override]
        """Order of the end of the step."""
        return 2 * self.degree - 1

    @property
    def name(self) -> str:
        """What users call it."""
        return f"Radau IIA of order {self.order}"

    @property
    def stages(self) -> int:
        """One at each collocation point."""
        return self.degree

    def equations(
        self, system: Dynamics, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        """Return the slopes of the polynomial through x and the stages less the derivatives, times h."""
        points = ca.collocation_points(self.degree, "radau")
        slopes, _, _ = ca.collocation_coeff(points)
        polynomial = ca.horzcat(x, stages) @ slopes
        rows = [
            polynomial[:, k] - h * system.derivative(stages[:, k], u + slope * h * point, p)
            for k, point in enumerate(points)
        ]
        return ca.horzcat(*rows)

    def end(self, x: Any, stages: Any) -> Any:
        """Return the last stage, which lies at the end."""
        return stages[:, self.degree - 1]
