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

# Size of a state over the largest one, or its change, below which its errors do not matter. From
# zero, a state changes by up to 1e8 sizes, whose rounding is 1e-8, within what is accepted below.
LEAST_SIZE = 1e-8
# Lengths of a step, each half of the one before, until Newton's method converges. With 6, a fit
# of Robertson's kinetics is lost; with 21 it takes five times as long.
ATTEMPTS = 11


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
        """Return x one step later, with exact derivatives; NaN where Newton's method fails.

        A step that it does not solve is halved, up to ten times.
        """
        # Newton's method is compiled from SX symbols and called with MX arguments.
        n, m = len(system.states), len(system.inputs)
        symbols = [ca.SX.sym("v", size) for size in (n, m, m, len(system.parameters), 1, n)]
        start, at, ramp, parameters, span, unit = symbols
        change = ca.SX.sym("change", n, self.stages)
        units = ca.repmat(unit, 1, self.stages)
        stages = ca.repmat(start, 1, self.stages) + units * change
        equations = self.equations(system, start, stages, at, ramp, parameters, span)
        equations, unknown = ca.vec(equations / units), ca.vec(change)
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
        newton = ca.rootfinder(
            "stages", "newton", {"x": unknown, "p": arguments, "g": equations}, options
        )
        # CasADi's largest absolute value leaves out NaN.
        judged = ca.Function(
            "end", [unknown, arguments], [self.end(start, stages), ca.norm_1(equations)]
        )

        given = x, u, slope, p, h
        inputs = [ca.MX.sym("v", *value.shape) for value in symbols[:-1]]
        x, u, slope, p, h = inputs
        # Its tolerances are absolute, so every state is measured by its own size.
        largest = ca.norm_inf(ca.vertcat(x, h * system.derivative(x, u + slope * h, p)))
        unit = ca.fmax(ca.fabs(x), LEAST_SIZE * largest + (largest == 0))
        values = ca.vertcat(*inputs, ca.stop_diff(unit, 1))
        end, residual = judged(newton(ca.MX.zeros(n * self.stages), values), values)
        # It ends before a step of 1e-12, where stiff residuals may be a million times larger.
        end = ca.if_else(residual <= 1e-6, end, ca.MX.nan(n))
        # Half a step with a jump is halved again, so that only steps near the jump are short.
        reached, half = ca.MX.sym("reached", n), h / 2
        whole = ca.Function("whole", [*inputs, reached], [reached])
        step = ca.Function("step", inputs, [ca.MX.nan(n)])
        for _ in range(ATTEMPTS):
            middle = step(x, u, slope, p, half)
            last = step(middle, u + slope * half, slope, p, half)
            halves = ca.Function("halves", [*inputs, reached], [last])
            chosen = ca.Function.if_else("chosen", whole, halves)
            # Outside the domain of a formula, the residual is NaN and shorter steps are no help.
            step = ca.Function("step", inputs, [chosen(1 - (residual > 1e-6), *inputs, end)])
        return step(*given)


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
