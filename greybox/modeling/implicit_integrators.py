"""Implicit integrators, whose stages solve equations by Newton's method within every step.

A collocation method is an implicit integrator whose stages the solver of the whole problem finds;
both have the same solution. So these steps evaluate problems that were solved by collocation.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import casadi as ca

from greybox.modeling.integrators import Integrator
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics


@dataclass(frozen=True)
class ImplicitIntegrator(Integrator):
    """A scheme defined by equations of its stages (n, stages).

    A subclass defines the equations and the end of a step.
    """

    implicit = True
    reach = float("inf")

    @property
    @abstractmethod
    def stages(self) -> int:
        """Number of stages."""

    @abstractmethod
    def equations(
        self, system: Dynamics, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        """Return what must be zero, as many numbers as `stages` (n, stages) has.

        The other arguments are those of `advance`.
        """

    @abstractmethod
    def end(self, x: Any, stages: Any) -> Any:
        """Return the state (n,) at the end of the step."""

    @one_thread_at_a_time
    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x one step later, with exact derivatives; NaN where Newton's method fails."""
        # Newton's method is compiled from SX symbols and called with MX arguments.
        n, m = len(system.states), len(system.inputs)
        sizes = (n, m, m, len(system.parameters), 1)
        symbols = [ca.SX.sym("v", size) for size in sizes]
        start, at, ramp, parameters, span = symbols
        stages = ca.SX.sym("stages", n, self.stages)
        equations = ca.vec(self.equations(system, start, stages, at, ramp, parameters, span))
        # A step that is short enough takes three or four iterations. They are plain, as usual with
        # stiff models: a search along the residuals would follow the fastest state alone.
        options = {
            "error_on_fail": False,
            "show_eval_warnings": False,
            "line_search": False,
            "abstol": 1e-13,
            "max_iter": 30,
        }
        arguments = ca.vertcat(*symbols)
        statement = {"x": ca.vec(stages), "p": arguments, "g": equations}
        newton = ca.rootfinder("stages", "newton", statement, options)
        residual = ca.Function("residual", [ca.vec(stages), arguments], [ca.norm_inf(equations)])

        values = ca.vertcat(x, u, slope, p, h)
        solution = newton(ca.repmat(x, self.stages, 1), values)
        # Far above the rounding at which Newton's method ends, far below the error of any order.
        is_solved = residual(solution, values) <= 1e-9 * (1 + ca.norm_inf(x))
        end = self.end(x, ca.reshape(solution, n, self.stages))
        return ca.if_else(is_solved, end, ca.MX.nan(n))


@dataclass(frozen=True)
class Radau(ImplicitIntegrator):
    """Radau IIA with `degree` stages, of order 2 · degree - 1, for stiff models.

    It is L-stable: what is much faster than a step has died away at its end. Its stages are the
    points of `Collocation`.

    Source: Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., IV.5.

    Parameters
    ----------
    substeps : int, optional
        Equal steps from one sample to the next; by default as many as the model needs.
    degree : int
        Number of stages.
    """

    degree: int = 3
    # Fast poles that die away need no steps, however they turn; the data decide about the others.
    wave = float("inf")

    @property
    def order(self) -> int:  # type: ignore[override]
        """Order of the end of the step."""
        return 2 * self.degree - 1

    @property
    def name(self) -> str:
        """Name for users."""
        return f"Radau IIA of order {self.order}"

    @property
    def stages(self) -> int:
        """One at each collocation point."""
        return self.degree

    def equations(
        self, system: Dynamics, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        """Return h times the slopes of the polynomial through x and the stages less derivatives."""
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
