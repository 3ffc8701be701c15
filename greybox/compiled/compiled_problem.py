"""The compiled problem: its parts and constraints as functions of the solver's variables, built once for all starts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.explicit_program import derivatives_at, explicit_program, roots_of
from greybox.compiled.limits import limits_of, stacked
from greybox.compiled.part import Part
from greybox.compiled.record_part import compile_records
from greybox.compiled.response_map import LARGE, Mapped, lagrangian_hessian
from greybox.compiled.response_part import ResponsePart
from greybox.compiled.scaling import Scaling, scaling_of
from greybox.compiled.strategies import Strategies
from greybox.compiled.transcription.method import Transcription
from greybox.compiled.transcription.multiple_shooting import MultipleShooting
from greybox.compiled.transient_part import compile_spectrum
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.arrays import Array
from greybox.formulation.frequency_criteria import Criterion
from greybox.formulation.prior_part import with_priors
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.harmonic_balance import harmonic_function
from greybox.modeling.linear_response import formula_at_one_frequency, response_formula
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.trim import Trimmed

AnyProblem = Problem | Sum[Problem]

# Frequencies times parameters below which no formula makes a response `LARGE` (which takes 300
# instructions here).
FEW = 1000

# A hundred rounding errors over the tolerance of the solvers, 1e-8: with ten, a quarter of the runs
# on 14 points with errors of 1e-4 does not come below it, with a hundred none.
ROUNDED = 100 * float(np.finfo(float).eps) / 1e-8


@dataclass(frozen=True, eq=False)
class CompiledProblem:
    """A problem ready for a solver.

    Attributes
    ----------
    problem : Problem or Sum
        What was compiled.
    free, constants : tuple of str
        Names of the unknowns, in the order of every vector here, and of the fixed parameters after
        them.
    lower, upper : (p,) arrays
        Bounds of the unknowns, in their own units.
    scaling : Scaling
        Between the unknowns and the solver's variables.
    origin : (p,) array
        The declared start values, as the solver sees them.
    method : Transcription
        Of the records.
    parts : tuple of Part
        In the order of the problem's.
    program : casadi.Function
        (z, smoothing) -> the cost of the frequency responses with `solver_weights`, and what must
        be >= 0.
    locating : casadi.Function or None
        The same with the criteria that locate the minimum, where they differ.
    locating_derivatives, program_derivatives : dict of casadi.Function
        Of both, as options of `casadi.nlpsol`, where CasADi's own take longer: see `response_map`,
        `explicit_program`.
    explicit : tuple of casadi.Function
        `locating`, if any, and `program` as SX functions (z, smoothing), or (z, smoothing, w) with
        roots that are given; none where responses exist as MX only.
    roots : casadi.Function or None
        (z) -> w, the unknowns of all trims that are found by Newton's method.
    constraint : casadi.Function
        (all values) -> what must be >= 0, stacked.
    limits : tuple of str
        What each of these is, in words.
    response_cost : casadi.Function
        (all values) -> the cost without smoothing of every frequency response, unweighted, stacked.
    responses : casadi.Function
        (all values) -> real and imaginary parts of all frequency responses, stacked: (2 N,).
    magnitudes : (N,) array
        Of the measured responses, above zero.
    """

    problem: AnyProblem
    free: tuple[str, ...]
    constants: tuple[str, ...]
    constant_values: Array
    lower: Array
    upper: Array
    scaling: Scaling
    origin: Array
    method: Transcription
    parts: tuple[Part, ...]
    program: ca.Function
    locating: ca.Function | None
    locating_derivatives: dict[str, ca.Function]
    program_derivatives: dict[str, ca.Function]
    explicit: tuple[ca.Function, ...]
    roots: ca.Function | None
    constraint: ca.Function
    limits: tuple[str, ...]
    response_cost: ca.Function
    responses: ca.Function
    magnitudes: Array

    def __getstate__(self) -> dict[str, Any]:
        """Leave the problem, with the user's classes, where it was compiled: solvers need the rest alone."""
        return {name: value for name, value in vars(self).items() if name != "problem"}

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, then constants: the order of all values."""
        return (*self.free, *self.constants)

    @property
    def strategies(self) -> Strategies:
        """The settings of the solver for records."""
        return self.method.strategies

    @property
    def by_ipopt(self) -> bool:
        """True when IPOPT solves the records as one sparse program."""
        return self.method.by_ipopt

    def all_values(self, x: Array) -> Array:
        """Append the constants to unknowns x (..., p)."""
        x = np.asarray(x, dtype=float)
        constants = np.broadcast_to(self.constant_values, (*x.shape[:-1], len(self.constants)))
        return np.concatenate([x, constants], axis=-1)

    # --- frequency responses alone, many points at once

    def cost(self, values: Array) -> float:
        """Return the cost without smoothing of the frequency responses at all values (k,)."""
        return float(self._weights @ np.asarray(self.response_cost(values)).ravel())

    def costs(self, x: Array) -> Array:
        """Return the cost without smoothing of the frequency responses, for every row of x (r, p): (r,)."""
        if not len(x):
            return np.zeros(0)
        return self._weights @ np.asarray(self.response_cost(self.all_values(x).T))

    @property
    def _weights(self) -> Array:
        return np.array([part.weight for part in self.parts if not part.has_states])

    def signatures(self, x: Array) -> Array:
        """Return the signatures (r, 2 N) of the frequency responses for every row of x (r, p), see `Part.signature`."""
        return (
            np.asarray(self.responses(self.all_values(x).T)) / np.tile(self.magnitudes, 2)[:, None]
        ).T


@one_thread_at_a_time
def compile_problem(problem: AnyProblem, method: Transcription | None = None) -> CompiledProblem:
    """Build the CasADi expressions of a problem; `method` is that of its records.

    Raises
    ------
    ValueError
        If no parameter is free, or a formula does not trace.
    """
    problem = with_priors(problem)
    parameters = problem.parameters
    free = tuple(name for name, p in parameters.items() if not p.fixed)
    constants = tuple(name for name, p in parameters.items() if p.fixed)
    if not free:
        cure = (
            f"free one, e.g. free=({constants[0]!r},)"
            if constants
            else "there is nothing to estimate"
        )
        raise ValueError(f"no parameter of {problem.name!r} is free: {cure}.")
    scaling = scaling_of([parameters[name] for name in free])
    constant_values = np.array([parameters[name].start for name in constants])
    names = (*free, *constants)
    responding = [part for part in problem.parts if isinstance(part.data, FrequencyResponse)]
    mapped = _mapped(responding)
    formulas = [] if mapped else [_formula(part) for part in responding]
    models = (
        [m.function() for m in mapped] if mapped else [_closed(formula) for formula in formulas]
    )
    # A trim that is found by Newton's method and a mapped response exist as MX only; everything
    # else is faster as SX.
    kind: Any = ca.SX if all(f.is_a("SXFunction") for f in models) else ca.MX
    limits = limits_of(problem, kind)

    def at(point: Any) -> dict[str, Any]:
        """Return all values by name, at a point of the solver."""
        return dict(zip(names, [*scaling.expressions(point), *constant_values], strict=True))

    def modeled(named: Mapping[str, Any]) -> list[Complex]:
        """Return the response of every part."""
        each = zip(models, responding, strict=True)
        return [
            Complex(*model(ca.vertcat(*part.local_values(named).values()))) for model, part in each
        ]

    x = kind.sym("x", len(names))
    by_name = dict(zip(names, ca.vertsplit(x), strict=True))
    responses = modeled(by_name)
    costs = _costs(responding, responses, 0.0, _criterion)
    z, smoothing, point = kind.sym("z", len(free)), kind.sym("smoothing"), ca.SX.sym("z", len(free))
    scaled, named = modeled(at(z)), at(point)
    scaled_limits = stacked(limits, at(z), kind)

    trimmed = (
        [formula for formula in formulas if isinstance(formula, Trimmed)] if kind is ca.MX else []
    )
    roots = None
    if trimmed and len(trimmed) == len(responding):
        roots = ca.Function("roots", [z], [roots_of(responding, trimmed, at(z))])

    def stated(name: str, choose: Callable[[Problem], Criterion], costs: list[Any]) -> _Stated:
        """Return the program in one criterion, of these costs."""
        program = ca.Function(
            name, [z, smoothing], [kind(_weighted(responding, costs)), scaled_limits]
        )
        if mapped:
            hessian = _composed_hessian(
                responding, mapped, named, point, stacked(limits, named, ca.SX), choose
            )
            return _Stated(program, {"hess_lag": hessian})
        if roots is None:
            return _Stated(program, {}, (program,) if kind is ca.SX else ())
        explicit = explicit_program(
            responding,
            trimmed,
            named,
            point,
            lambda found, smoothing: _weighted(
                responding, _costs(responding, found, smoothing, choose)
            ),
            stacked(limits, named, ca.SX),
        )
        return _Stated(program, derivatives_at(roots, explicit), (explicit,))

    own_costs = _costs(responding, scaled, smoothing, _criterion)
    own, located = stated("program", _criterion, own_costs), None
    if any(_criterion(part).locator is not None for part in responding):
        located = stated("locating", _locator, _costs(responding, scaled, smoothing, _locator))
    compiled_responses = {
        part: ResponsePart(
            problem=part,
            objective=ca.Function("objective", [z, smoothing], [kind(cost)]),
            model_response=ca.Function("response", [x], [ca.vertcat(response.re, response.im)]),
            scaled_response=ca.Function(
                "response", [z], [kind(ca.vertcat(scaled_response.re, scaled_response.im))]
            ),
        )
        for part, cost, response, scaled_response in zip(
            responding, own_costs, responses, scaled, strict=True
        )
    }
    method = method or MultipleShooting()
    compiled: dict[Problem, Part] = {**compiled_responses}
    compiled |= {
        p: compile_spectrum(p, named, point)
        for p in problem.parts
        if isinstance(p.data, TransientSpectrum)
    }
    recorded = [part for part in problem.parts if isinstance(part.data, Record)]
    compiled |= dict(zip(recorded, compile_records(recorded, named, point, method), strict=True))
    return CompiledProblem(
        problem=problem,
        free=free,
        constants=constants,
        constant_values=constant_values,
        lower=np.array([parameters[name].bounds[0] for name in free], dtype=float),
        upper=np.array([parameters[name].bounds[1] for name in free], dtype=float),
        scaling=scaling,
        origin=scaling.to_solver(np.array([parameters[name].start for name in free])),
        method=method,
        parts=tuple(compiled[part] for part in problem.parts),
        program=own.program,
        locating=located.program if located else None,
        locating_derivatives=located.derivatives if located else {},
        program_derivatives=own.derivatives,
        explicit=(*(located.explicit if located else ()), *own.explicit),
        roots=roots,
        constraint=ca.Function("constraint", [x], [stacked(limits, by_name, kind)]),
        limits=tuple(limit.label for limit in limits),
        response_cost=ca.Function("cost", [x], [ca.vertcat(kind(0, 1), *costs)]),
        responses=ca.Function(
            "responses",
            [x],
            [ca.vertcat(kind(0, 1), *[r.re for r in responses], *[r.im for r in responses])],
        ),
        magnitudes=np.concatenate(
            [np.zeros(0), *[part.magnitude for part in compiled_responses.values()]]
        ),
    )


class _Stated(NamedTuple):
    """A program with its derivatives for IPOPT and, where there is one, its explicit form; see `CompiledProblem`."""

    program: ca.Function
    derivatives: dict[str, ca.Function]
    explicit: tuple[ca.Function, ...] = ()


def _costs(
    parts: list[Problem],
    responses: list[Complex],
    smoothing: Any,
    criterion: Callable[[Problem], Criterion],
) -> list[Any]:
    pairs = zip(parts, responses, strict=True)
    return [criterion(part).cost(response, part.response, smoothing) for part, response in pairs]


def _weighted(parts: list[Problem], costs: list[Any]) -> Any:
    total: Any = 0.0
    for weight, cost in zip(solver_weights(parts), costs, strict=True):
        total = total + weight * cost
    return total


def solver_weights(parts: Sequence[Problem]) -> list[float]:
    """Return the weights of responses in what the solver minimizes, so small that its tolerance can be reached.

    A model is rounded relative to its magnitude M. Where errors are known to be of a size σ, the
    gradient of the cost is rounded to some ε Σ (M/σ)², which for errors below a thousandth exceeds
    the tolerance of the solver.
    """
    precision = 0.0
    for part in parts:
        criterion = _criterion(part)
        if criterion.known_noise:
            data = part.response
            ratios = np.abs(data.response) / criterion.error_size(data.response, data)
            precision += part.weight * float((ratios**2).sum())
    unit = max(1.0, ROUNDED * precision)
    return [part.weight / unit for part in parts]


def _criterion(part: Problem) -> Criterion:
    assert isinstance(part.criterion, Criterion)
    return part.criterion


def _locator(part: Problem) -> Criterion:
    return _criterion(part).locator or _criterion(part)


def _formula(part: Problem) -> Trimmed | ca.Function:
    if part.amplitude is not None:
        return harmonic_function(
            part.model, part.response.omega, part.amplitude, **response_options(part)
        )
    return response_formula(part.model, part.response.omega, **response_options(part))


def _closed(formula: Trimmed | ca.Function) -> ca.Function:
    return formula.closed() if isinstance(formula, Trimmed) else formula


def response_options(part: Problem) -> dict[str, Any]:
    """Return how the response of a part is evaluated, as `response_formula` takes it."""
    data = part.response
    return {
        "input": data.input,
        "output": data.output,
        "at": part.at,
        "pade": delay_order(part.delay),
    }


def _mapped(parts: list[Problem]) -> list[Mapped] | None:
    """Return the responses as formulas of one frequency if together they are large, and all of them have one."""
    size = sum(part.response.omega.size * (len(part.declared) + 1) for part in parts)
    if size < FEW or any(part.amplitude is not None for part in parts):
        return None
    formulas = [
        formula_at_one_frequency(part.model, part.response.omega, **response_options(part))
        for part in parts
    ]
    found = [
        Mapped(f, part.response.omega)
        for f, part in zip(formulas, parts, strict=True)
        if f is not None
    ]
    return found if len(found) == len(parts) and sum(m.work for m in found) > LARGE else None


def _composed_hessian(
    responding: list[Problem],
    mapped: list[Mapped],
    named: Mapping[str, Any],
    z: ca.SX,
    limits: ca.SX,
    choose: Callable[[Problem], Criterion],
) -> ca.Function:
    """Return the Hessian of the weighted costs of mapped responses and of the limits (c,)."""
    parts = [
        (
            response,
            ca.SX(ca.vertcat(*part.local_values(named).values())),
            lambda r, smoothing, part=part: choose(part).cost(r, part.response, smoothing),
            weight,
        )
        for part, response, weight in zip(
            responding, mapped, solver_weights(responding), strict=True
        )
    ]
    return lagrangian_hessian(parts, z, limits)
