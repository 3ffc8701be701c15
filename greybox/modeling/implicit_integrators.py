"""Implicit integrators, whose stages solve equations by Newton's method within every step.

A collocation method is an implicit integrator whose stages the solver of the whole problem finds;
both have the same solution. So these steps evaluate problems that were solved by collocation. A
trapezoidal one, written as a user would write it, is in `tests/support/recipes.py`.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import casadi as ca

from greybox.data.files.public import public
from greybox.modeling.integrators import Integrator
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics

# γ of the error estimate: RADAU5's, one over the real eigenvalue of its matrix.
FILTER = 0.2749
# A step that is short enough takes three or four iterations; RADAU5 gives up after seven. They are
# plain, as usual with stiff models: a search along the residuals would follow the fastest state
# alone.
NEWTON = {
    "error_on_fail": False,
    "show_eval_warnings": False,
    "line_search": False,
    "abstol": 1e-13,
    "max_iter": 10,
}


@public
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

    def defect(self, x: Any, stages: Any, rate: Any) -> Any:
        """Return the slope at the beginning, times h, less that of the model, `rate` (n,).

        A filtered share of it estimates the error of a step; zero means no estimate.
        """
        return 0 * x

    @abstractmethod
    def end(self, x: Any, stages: Any) -> Any:
        """Return the state (n,) at the end of the step."""

    @one_thread_at_a_time
    def advance(self, system: Dynamics, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        """Return x one step later, with exact derivatives; NaN where Newton's method fails.

        A step that it does not solve is halved, up to eleven times. So is one with too large an
        error, unless the number of steps was chosen.
        """
        # Newton's method is compiled from SX symbols and called with MX arguments.
        n, m = len(system.states), len(system.inputs)
        given = ca.SX.sym("v", n + 2 * m + len(system.parameters) + 1)
        unit, change = ca.SX.sym("unit", n), ca.SX.sym("change", n, self.stages)
        places = [0, n, n + m, n + 2 * m, given.numel() - 1, given.numel()]
        start, *rest = ca.vertsplit(given, places)
        stages = ca.repmat(start, 1, self.stages) + ca.repmat(unit, 1, self.stages) * change
        equations = self.equations(system, start, stages, *rest)
        equations = ca.vec(equations / ca.repmat(unit, 1, self.stages))
        unknown, arguments = ca.vec(change), ca.vertcat(given, unit)
        newton = ca.rootfinder(
            "stages", "newton", {"x": unknown, "p": arguments, "g": equations}, NEWTON
        )
        rate = rest[3] * system.derivative(start, rest[0], rest[2])
        end = self.end(start, stages)
        results = [
            end,
            # CasADi's largest absolute value leaves out NaN.
            ca.norm_1(equations),
            FILTER * self.defect(start, stages, rate),
            ca.SX.eye(n) - FILTER * ca.jacobian(rate, start),
        ]
        solved = ca.Function("solved", [unknown, arguments], results)
        slopes = [ca.jacobian(f, by) for f in (end, equations) for by in (given, unknown)]
        differentiated = ca.Function("differentiated", [unknown, arguments], slopes)

        v, change = ca.MX.sym("v", given.numel()), ca.MX.sym("change", unknown.numel())
        start, at, ramp, parameters, span = ca.vertsplit(v, places)
        # Its tolerances are absolute, so every state is measured by its own size.
        last = span * system.derivative(start, at + ramp * span, parameters)
        largest = ca.norm_inf(ca.vertcat(start, last))
        # The errors of a state below this share of the largest one, or of its change, do not
        # matter. From zero, a state changes by up to 1e8 sizes, whose rounding is 1e-8, within what
        # is accepted below.
        unit = ca.fmax(ca.fabs(start), 1e-8 * largest + (largest < 1e-200))
        values = ca.vertcat(v, unit)
        solution = newton(0, values)
        end, residual, missed, matrix = solved(solution, values)
        # A state that grows from zero is measured by its size after a longer step, up to a share of
        # the largest state: by itself alone, a rod of 100 states that is heated from rest needs 512
        # steps to the first sample, 178 with this.
        longer = ca.MX.sym("longer", n)
        size = ca.fmax(ca.fmax(ca.fabs(end), unit), ca.fmin(longer, 1e-3 * largest))
        # Twice filtered, as at the first step of RADAU5: modes much faster than a step do not count
        # (Hairer and Wanner, IV.8).
        error = ca.solve(matrix, ca.solve(matrix, missed)) / size
        # It ends before a step of 1e-12, where stiff residuals may be a million times larger.
        solution += ca.if_else(residual <= 1e-6, 0, float("nan"))
        # Error of a step, in sizes of the states, above which it is halved. The estimate is that of
        # a scheme of order three: 1e-5 corresponds to a tolerance of 1e-6 in RADAU5. With 1e-4
        # estimates of nine stiff models are up to 5e-4 standard errors off, with 1e-5 up to 3e-5,
        # in 1.7 times the time.
        is_coarse = ca.norm_1(error) > (1e-5 if self.substeps is None else ca.inf)
        # Outside the domain of a formula, the residual is NaN and shorter steps do not help.
        is_short = 1 - ca.logic_or(residual > 1e-6, is_coarse)
        by_given, by_change, *equations = differentiated(change, values)
        slopes = by_given - by_change @ ca.solve(equations[1], equations[0])

        # Halves of a step: the second begins with the inputs in the middle.
        first = ca.vertcat(v[:-1], span / 2)
        second = ca.vertcat(at + ramp * span / 2, ramp, parameters, span / 2)

        def halved(*slopes: Any) -> ca.Function:
            whole_step = ca.Function(
                "taken", [v, change, longer], [solved(change, values)[0], *slopes]
            )
            step = ca.Function("step", [v, longer], whole_step.call([v, solution, size]))
            # Half a step with a jump is halved again, so that only steps near the jump are short.
            # With 6 halvings until Newton's method converges, a fit of Robertson's kinetics is
            # lost; with 21 it takes five times as long.
            for _ in range(11):
                middle, *by_first = step.call([first, longer])
                result = step.call([ca.vertcat(middle, second), longer])
                if by_first:
                    result[1] @= ca.vertcat(
                        by_first[0] @ ca.jacobian(first, v), ca.jacobian(second, v)
                    )
                halves = ca.Function("halves", [v, change, longer], result)
                chosen = ca.Function.if_else("chosen", whole_step, halves)
                step = ca.Function("step", [v, longer], chosen.call([is_short, v, solution, size]))
            return step

        # Derivatives by CasADi would solve every step repeatedly and take four times as long.
        slopes = halved(slopes).call([v, 0])[1:]
        # Inlined, it does not ask for the end of the step, which would be solved once more.
        jacobian = ca.Function(
            "jac_step", [v, ca.MX.sym("out", n)], slopes, {"always_inline": True}
        )
        # A simulation needs no slopes, whose equations take most of the time of many states.
        options = {"custom_jacobian": jacobian, "jac_penalty": 0}
        return ca.Function("step", [v], [halved()(v, 0)], options)(ca.vertcat(x, u, slope, p, h))


@public
@dataclass(frozen=True)
class Radau(ImplicitIntegrator):
    """Radau IIA with `degree` stages, of order 2 · degree - 1, for stiff models.

    It is L-stable: a mode much faster than a step has died away at its end. Its stages are the
    points of `Collocation`.

    Source: Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., IV.5 and IV.8.

    Parameters
    ----------
    substeps : int, optional
        Equal steps from one sample to the next; by default as many as the model needs, each
        halved where its error is too large.
    degree : int
        Number of stages.

    Examples
    --------
    >>> from greybox.models.tilt import LinearTilt
    >>> record = gb.Record(np.arange(100) / 100, {"u": np.ones(100)})
    >>> len(gb.simulate(LinearTilt(), record=record, integrator=gb.Radau()))
    100
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

    def defect(self, x: Any, stages: Any, rate: Any) -> Any:
        """Return the slope of the polynomial at the beginning, times h, less the rate."""
        slopes, _ = ca.collocation_interpolators(ca.collocation_points(self.degree, "radau"))
        return ca.horzcat(x, stages) @ ca.DM(slopes)[0, :].T - rate

    def end(self, x: Any, stages: Any) -> Any:
        """Return the last stage, which lies at the end."""
        return stages[:, -1]
