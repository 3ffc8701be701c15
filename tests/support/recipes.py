"""What CONTRIBUTING's recipes tell to write, as a user writes it in a file beside the log."""

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from huber import Huber

import greybox as gb
from greybox.engine.compiled.transcription.method import Transcribed
from greybox.modeling.implicit_integrators import ImplicitIntegrator


class Spring(gb.StateSpace):
    """A mass on a spring."""

    states = ("x", "v")
    inputs = ("F",)
    outputs = ("x", "v")
    k = gb.Parameter(6.0, bounds=(0.1, 100), unit="1/s²", about="stiffness")
    c = gb.Parameter(0.8, bounds=(-5, 20), unit="1/s", about="damping")
    b = gb.Parameter(1.5, bounds=(-50, 50), unit="1/kg", about="acceleration per force")

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - p.c * x.v + p.b * u.F)

    def output(self, x, u, p):
        return (x.x, x.v)


@dataclass(frozen=True)
class Heun(gb.Integrator):
    """Heun's method, Hairer, Nørsett, Wanner: Solving ODEs I, II.1."""

    order: ClassVar[int] = 2
    reach: ClassVar[float] = 2.0
    wave: ClassVar[float] = 0.2

    def advance(self, system: Any, x: Any, u: Any, slope: Any, p: Any, h: Any) -> Any:
        k1 = system.derivative(x, u, p)
        k2 = system.derivative(x + h * k1, u + slope * h, p)
        return x + h / 2 * (k1 + k2)


@dataclass(frozen=True)
class TrapezoidalRule(ImplicitIntegrator):
    """The trapezoidal rule: its only stage is the end of the step."""

    substeps: int | None = 1
    order: ClassVar[int] = 2
    name: ClassVar[str] = "trapezoidal rule"

    @property
    def stages(self) -> int:
        return 1

    def equations(
        self, system: Any, x: Any, stages: Any, u: Any, slope: Any, p: Any, h: Any
    ) -> Any:
        slopes = system.derivative(x, u, p) + system.derivative(stages, u + slope * h, p)
        return stages - x - h / 2 * slopes

    def end(self, x: Any, stages: Any) -> Any:
        return stages


@dataclass(frozen=True)
class Trapezoidal(gb.Transcription):
    """The states at all samples, joined by the trapezoidal rule, Betts (2010), 2nd ed., section
    4.6."""

    label: ClassVar[str] = "trapezoidal collocation"

    @property
    def scheme(self) -> TrapezoidalRule:
        return TrapezoidalRule()

    def transcribe(self, step: Any, data: Any, q: Any, rows: Any) -> Transcribed:
        n = step.function.size1_in(0)
        x, parameters, row = (
            ca.SX.sym(name, step.measurement.numel_in(k)) for k, name in enumerate("xqd")
        )
        following = ca.SX.sym("following", n)
        corrected, mean, change, residual, _ = step.measurement(x, parameters, row)
        p = parameters[: len(step.system.parameters)]
        h = row[row.numel() - 1]
        error = self.scheme.equations(
            step.system, corrected, following, mean - change / 2, change / h, p, h
        )
        residuals = ca.Function("residuals", [x, parameters, row], [residual])
        equations = ca.Function("equations", [x, following, parameters, row], [error])

        nodes = ca.MX.sym("nodes", n, data.samples)
        last = np.cumsum([count * data.segment_length for count in data.segment_counts]) - 1
        linked = np.setdiff1d(np.arange(data.samples), last)
        before = linked.tolist()
        after = (linked + 1).tolist()
        joined = equations.map("joined", "serial", len(linked), [2], [])
        return Transcribed(
            unknowns=ca.vec(nodes),
            residuals=residuals.map("all", "serial", data.samples, [1], [])(nodes, q, rows),
            equations=ca.vec(joined(nodes[:, before], nodes[:, after], q, rows[:, before])),
            initial=nodes[:, [0, *(last[:-1] + 1).tolist()]],
            start=lambda states: states.ravel(order="F"),
        )

    def finer(self, substeps: int) -> str:
        return "method=MultipleShooting()"


@dataclass(frozen=True)
class Halton(gb.Starts):
    """Scrambled Halton points in the start boxes."""

    number: int
    seed: int = 0

    def draw(self, parameters):
        from scipy.stats import qmc

        shares = qmc.Halton(len(parameters), rng=np.random.default_rng(self.seed)).random(
            self.number
        )
        return np.column_stack([p.in_box(shares[:, k]) for k, p in enumerate(parameters.values())])

    def __str__(self) -> str:
        return f"{self.number} by Halton, seed {self.seed}"


@dataclass(frozen=True, eq=False)
class DiagonalPrediction(gb.TimeCriterion):
    """Prediction errors, where each output corrects the state of its own name alone."""

    rule: ClassVar[str] = "prediction error with diagonal gains"
    condition: ClassVar[str] = "white innovations"
    corrects_states: ClassVar[bool] = True

    def gains(self, model, outputs):
        return tuple((name, name) for name in outputs if name in model.states)


@dataclass(frozen=True)
class SoftErrors(gb.formulation.ErrorDistribution):
    """Errors with tails: what `scipy.optimize.least_squares` calls soft_l1."""

    bound: float = 1.5
    description: ClassVar[str] = "large errors softly bounded"

    def influence(self, errors):
        return errors / np.sqrt(1 + (errors / self.bound) ** 2)

    def slope(self, errors):
        return (1 + (errors / self.bound) ** 2) ** -1.5


@dataclass(frozen=True)
class OneBoard(gb.formulation.ErrorCovariance):
    """Sensors on one board: noise of each, and a disturbance that all of them have in common."""

    own: float = 0.02
    common: float = 0.05
    description: ClassVar[str] = "covariance of the board"
    is_correlated: ClassVar[bool] = True

    def known(self, outputs):
        count = len(outputs)
        return self.own**2 * np.eye(count) + self.common**2 * np.ones((count, count))


@dataclass(frozen=True)
class Waves(gb.formulation.Disturbance):
    """Swell: white noise through a lightly damped oscillator, whose velocity is the disturbance."""

    damping: float = 0.1
    states: ClassVar[tuple[str, ...]] = ("swell", "heave")
    driven: ClassVar[tuple[str, ...]] = ("swell",)

    def parameters(self, state, times):
        step, duration = times
        bounds = (6 / duration, 1 / step)
        return {"peak": gb.Parameter(1.0, bounds=bounds, scale="log", unit="rad/s")}

    def derivative(self, x, p):
        return [-2 * self.damping * p.peak * x.swell - p.peak**2 * x.heave, x.swell]


@dataclass(frozen=True)
class Slsqp(gb.Solver):
    """Sequential quadratic programs, by SciPy: values, gradients, bounds and constraints."""

    takes_constraints: ClassVar[bool] = True
    tolerance: float = 1e-9
    most: int = 300

    def solve(self, objective, start):
        from scipy.optimize import minimize

        limits = {
            "type": "ineq",
            "fun": objective.constraints,
            "jac": objective.constraint_jacobian,
        }
        end = minimize(
            objective.value_and_gradient,
            start,
            jac=True,
            method="SLSQP",
            bounds=[*zip(objective.lower, objective.upper, strict=True)],
            constraints=[limits] if objective.limits else [],
            options={"ftol": self.tolerance, "maxiter": self.most},
        )
        return gb.Solution(end.x, end.message, end.nit)


class Hold(gb.Controller):
    """Holds the position of the mass."""

    inputs = ("x", "v")
    outputs = ("F",)
    K = gb.Parameter(4.0, bounds=(0, 100), unit="N/m", about="force per error")
    D = gb.Parameter(1.0, bounds=(0, 100), unit="N·s/m", about="force per velocity")

    def update(self, x, u, p):
        return (), (p.K * (u.reference - u.x) - p.D * u.v,)


TRUTH = {"k": 9.0, "c": 1.0, "b": 2.0}


def record(wind=0.0):
    """A flight of the mass under its controller."""
    reference = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 30), 20)
    options = {
        "controller": Hold(rate=20.0),
        "noise": {"x": 0.02, "v": 0.06},
        "process_noise": {"v": wind},
        "seed": 1,
    }
    return gb.virtual_flight(Spring(), TRUTH, {"reference": reference}, **options)


def problem():
    """Output errors of a flight without wind."""
    return gb.Problem(Spring(), record(), gb.OutputError(inputs="held"))


def windy():
    """A criterion of the user's own for records."""
    return gb.Problem(Spring(), record(0.5), DiagonalPrediction(inputs="held"))


def response():
    """A criterion of the user's own for responses."""
    omega = np.geomspace(0.5, 20, 15)
    exact = gb.frequency_response(Spring(), TRUTH, omega, output="x").response
    noise = 0.02 * np.random.default_rng(0).normal(size=(2, 15))
    return gb.Problem(
        Spring(),
        gb.FrequencyResponse(omega, exact * (1 + noise[0] + 1j * noise[1]), "F", "x"),
        Huber(0.1),
    )


settings = {"starts": Halton(3), "method": gb.MultipleShooting(integrator=Heun())}
