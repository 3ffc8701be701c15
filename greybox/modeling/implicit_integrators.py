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
# Error of a step, relative to the size of a state, above which the step is halved. With 1e-4,
# estimates of van der Pol oscillators are 4e-4 standard errors off, with 1e-5 3e-5 and with 1e-6
# less, at half more time each.
TOLERANCE = 1e-5
# γ of the error estimate, the real eigenvalue of the coefficients of the scheme with three stages.
FILTER = 0.2749


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

    def defect(
        self, system: Dynamics, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        return 0 * x

    @abstractmethod
    def end(self, x: Any, stages: Any) -> Any:
        """Return the state (n,) at the end of the step."""

    @one_thread_at_a_time
    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x one step later, with exact derivatives; NaN where Newton's method fails.

        A step that it does not solve, or whose error is too large, is halved, up to eleven times.
        """
        # Newton's method is compiled from SX symbols and called with MX arguments.
        n, m = len(system.states), len(system.inputs)
        symbols = [ca.SX.sym("v", size) for size in (n, m, m, len(system.parameters), 1)]
        start, at, ramp, parameters, span = symbols
        unit, change = ca.SX.sym("unit", n), ca.SX.sym("change", n, self.stages)
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
        given = ca.vertcat(*symbols)
        arguments = ca.vertcat(given, unit)
        newton = ca.rootfinder(
            "stages", "newton", {"x": unknown, "p": arguments, "g": equations}, options
        )
        missed = self.defect(system, start, stages, at, ramp, parameters, span)
        rate = system.derivative(start, at + ramp * span, parameters)
        filtering = ca.SX.eye(n) - FILTER * span * ca.jacobian(rate, start)
        # CasADi's largest absolute value leaves out NaN.
        end = self.end(start, stages)
        judged = ca.Function(
            "judged",
            [unknown, arguments],
            [end, ca.norm_1(equations), FILTER * missed, filtering],
        )
        slopes = ca.Function(
            "slopes",
            [unknown, arguments],
            [ca.jacobian(f, v) for f in (equations, end) for v in (unknown, given)],
        )

        # Its tolerances are absolute, so every state is measured by its own size.
        largest = ca.norm_inf(ca.vertcat(start, span * rate))
        unit = ca.fmax(ca.fabs(start), LEAST_SIZE * largest + (largest < 1e-200))
        sizes = ca.Function("sizes", [given], [ca.vertcat(given, unit)])

        v, changes = ca.MX.sym("v", given.numel()), ca.MX.sym("change", unknown.numel())
        values = sizes(v)
        solution = newton(ca.MX.zeros(n * self.stages), values)
        end, residual, missed, filtering = judged(solution, values)
        size = ca.fmax(ca.fabs(end), values[-n:])
        error = ca.norm_1(ca.solve(filtering, ca.solve(filtering, missed)) / size)
        # It ends before a step of 1e-12, where stiff residuals may be a million times larger.
        is_solved = residual <= 1e-6
        # Outside the domain of a formula, the residual is NaN and shorter steps are no help.
        accepted = 1 - ca.logic_or(residual > 1e-6, error > TOLERANCE)

        by_change, by_given, end_by_change, end_by_given = slopes(changes, values)
        reached = judged(changes, values)[0]
        by_whole = end_by_given - end_by_change @ ca.solve(by_change, by_given)
        whole = [reached, ca.densify(by_whole)]
        state, span = v[:n], v[-1] / 2
        first = ca.vertcat(v[:-1], span)
        rest = ca.vertcat(v[n : n + m] + v[n + m : n + 2 * m] * span, v[n + m : -1], span)
        steps = []
        for count in (1, 2):
            taken = ca.Function("whole", [v, changes], whole[:count])
            unsolved = ca.if_else(is_solved, 0, ca.MX.nan(1))
            step = ca.Function("step", [v], [r + unsolved for r in taken.call([v, solution])])
            # Half a step with a jump is halved again, so that only steps near the jump are short.
            for _ in range(ATTEMPTS):
                middle, *by_first = step.call([first])
                last, *by_second = step.call([ca.vertcat(middle, rest)])
                chain = [
                    b @ ca.vertcat(a @ ca.jacobian(first, v), ca.jacobian(rest, v))
                    for a, b in zip(by_first, by_second)
                ]
                halves = ca.Function("halves", [v, changes], [last, *chain])
                chosen = ca.Function.if_else("chosen", taken, halves)
                step = ca.Function("step", [v], chosen.call([accepted, v, solution]))
            steps.append(step)
        out = ca.MX.sym("out", n)
        jacobian = ca.Function("jac_step", [v, out], [steps[1].call([v])[1]])
        options = {"custom_jacobian": jacobian, "jac_penalty": 0, "never_inline": True}
        step = ca.Function("step", [v], steps[0].call([v]), options)
        return step(ca.vertcat(x, u, slope, p, h))


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

    def defect(
        self, system: Dynamics, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        points = ca.collocation_points(self.degree, "radau")
        slopes, _ = ca.collocation_interpolators(points)
        return ca.horzcat(x, stages) @ ca.DM(slopes)[0, :].T - h * system.derivative(x, u, p)

    def end(self, x: Any, stages: Any) -> Any:
        """Return the last stage, which lies at the end."""
        return stages[:, self.degree - 1]
