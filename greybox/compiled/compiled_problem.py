"""The compiled problem: one CasADi graph of the cost, in scaled variables, built once and used by every start."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.record_part import RecordPart
from greybox.compiled.transcription.method import Transcription
from greybox.compiled.transcription.multiple_shooting import MultipleShooting
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.formulation.frequency_criteria import Criterion
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.harmonic_balance import harmonic_function
from greybox.modeling.linear_response import response_function
from greybox.modeling.model import Names
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.parameter import Parameter

AnyProblem = Problem | Sum[Problem]


@dataclass(frozen=True, eq=False)
class Scaling:
    """The change of variables between parameters x and what the solver sees, z: x = factor · z, or x = exp(z)."""

    factor: NDArray[np.float64]
    logarithmic: NDArray[np.bool_]

    def to_solver(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return z for x, along the last axis."""
        with np.errstate(divide="ignore"):
            return np.where(self.logarithmic, np.log(np.where(self.logarithmic, x, 1.0)), x / self.factor)

    def to_parameters(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x for z, along the last axis."""
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, z, 0.0)), z * self.factor)

    def expressions(self, z: Any) -> list[Any]:
        """Return x for a CasADi vector z."""
        return [
            ca.exp(z[k]) if log else z[k] * float(f)
            for k, (f, log) in enumerate(zip(self.factor, self.logarithmic, strict=True))
        ]


@dataclass(frozen=True, eq=False)
class Nlp:
    """A problem ready for a solver.

    Attributes
    ----------
    problem : Problem or Sum
        What was compiled.
    free, constants : tuple of str
        Names of the unknowns, in the order of every vector here, and of the fixed parameters after them.
    lower, upper : (p,) arrays
        Bounds of the unknowns, in their own units.
    scaling : Scaling
        Between the unknowns and the solver's variables.
    expressions : dict
        ``x, p, f, g`` as `casadi.nlpsol` takes them, of the frequency responses; p is the smoothing of the cost.
    first : dict or None
        The same with the criteria that locate the minimum, where they differ.
    records : tuple of RecordPart
        The parts whose data are records; `responding` are the others.
    cost : casadi.Function
        (all values) -> the cost without smoothing, of every frequency response, unweighted, stacked.
    responses : casadi.Function
        (all values) -> real and imaginary parts of all frequency responses, stacked: (2 N,).
    constraint : casadi.Function
        (all values) -> what must be >= 0, stacked.
    limits : tuple of str
        What each of these is, in words.
    """

    problem: AnyProblem
    free: tuple[str, ...]
    constants: tuple[str, ...]
    constant_values: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    scaling: Scaling
    expressions: Mapping[str, Any]
    first: Mapping[str, Any] | None
    records: tuple[RecordPart, ...]
    cost: ca.Function
    responses: ca.Function
    constraint: ca.Function
    limits: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, then constants: the order of all values."""
        return (*self.free, *self.constants)

    @property
    def weights(self) -> NDArray[np.float64]:
        """The weight of every frequency response."""
        return np.array([part.weight for part in self.responding])

    @property
    def responding(self) -> tuple[Problem, ...]:
        """The parts whose data are frequency responses."""
        return tuple(part for part in self.problem.parts if isinstance(part.data, FrequencyResponse))

    def all_values(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Append the constants to unknowns x (..., p)."""
        x = np.asarray(x, dtype=float)
        constants = np.broadcast_to(self.constant_values, (*x.shape[:-1], len(self.constants)))
        return np.concatenate([x, constants], axis=-1)

    def costs(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cost without smoothing of the frequency responses, for every row of x (r, p): (r,)."""
        if not len(x):
            return np.zeros(0)
        parts = np.asarray(self.cost(self.all_values(x).T))
        return self.weights @ parts

    def response_rows(self, x: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return all frequency responses, stacked, for every row of x (r, p): (r, N)."""
        values = np.asarray(self.responses(self.all_values(x).T)).T
        half = values.shape[1] // 2
        return values[:, :half] + 1j * values[:, half:]

    def split(self, stacked: NDArray[Any]) -> list[NDArray[Any]]:
        """Cut an array whose first axis runs over the points of all frequency responses into one array for each."""
        ends = np.cumsum([len(part.data) for part in self.responding])[:-1]
        return np.split(stacked, ends)


def compile_problem(problem: AnyProblem, method: Transcription | None = None) -> Nlp:
    """Build the CasADi expressions of a problem; `method` is that of its records.

    Raises
    ------
    ValueError
        If no parameter is free, or a formula does not trace.
    """
    parameters = problem.parameters
    free = tuple(name for name, p in parameters.items() if not p.fixed)
    constants = tuple(name for name, p in parameters.items() if p.fixed)
    if not free:
        cure = f"free one, e.g. free=({constants[0]!r},)" if constants else "there is nothing to estimate"
        raise ValueError(f"no parameter of {problem.name!r} is free: {cure}.")
    responding = [part for part in problem.parts if isinstance(part.data, FrequencyResponse)]
    models = [_response(part) for part in responding]
    # A trim that is found by Newton's method exists as MX only; everything else is faster as SX.
    kind: Any = ca.SX if all(f.is_a("SXFunction") for f in models) else ca.MX
    scaling = _scaling([parameters[name] for name in free])
    constant_values = np.array([parameters[name].start for name in constants])

    def trace(values: list[Any]) -> tuple[list[Complex], dict[str, Any]]:
        """Return the response of every part and the limits by label, for values in the order free, constants."""
        local = [part.local_values(dict(zip((*free, *constants), values, strict=True))) for part in problem.parts]
        there = [p for part, p in zip(problem.parts, local, strict=True) if part in responding]
        responses = [Complex(*f(ca.vertcat(*p.values()))) for f, p in zip(models, there, strict=True)]
        limits = [item for part, p in zip(problem.parts, local, strict=True) for item in _limits(part, p).items()]
        return responses, dict(limits)

    x = kind.sym("x", len(free) + len(constants))
    responses, limits = trace(ca.vertsplit(x))
    costs = [_criterion(part).cost(r, part.response) for part, r in zip(responding, responses, strict=True)]
    stacked = ca.vertcat(kind(0, 1), *[r.re for r in responses], *[r.im for r in responses])

    z, smoothing = kind.sym("z", len(free)), kind.sym("smoothing")
    scaled, scaled_limits = trace([*scaling.expressions(z), *constant_values])
    statement = {"x": z, "p": smoothing, "g": ca.vertcat(kind(0, 1), *scaled_limits.values())}
    locating = any(_criterion(part).locator is not None for part in responding)
    point = ca.SX.sym("z", len(free))
    named = dict(zip((*free, *constants), [*scaling.expressions(point), *constant_values], strict=True))
    records = [part for part in problem.parts if isinstance(part.data, Record)]
    return Nlp(
        problem=problem,
        free=free,
        constants=constants,
        constant_values=constant_values,
        lower=np.array([parameters[name].bounds[0] for name in free]),
        upper=np.array([parameters[name].bounds[1] for name in free]),
        scaling=scaling,
        expressions=statement | {"f": kind(_total(responding, scaled, smoothing, locate=False))},
        first=statement | {"f": kind(_total(responding, scaled, smoothing, locate=True))} if locating else None,
        records=tuple(RecordPart(part, named, point, method or MultipleShooting()) for part in records),
        cost=ca.Function("cost", [x], [ca.vertcat(kind(0, 1), *costs)]),
        responses=ca.Function("responses", [x], [stacked]),
        constraint=ca.Function("constraint", [x], [ca.vertcat(kind(0, 1), *limits.values())]),
        limits=tuple(limits),
    )


def _limits(part: Problem, p: Names) -> dict[str, Any]:
    """Return what must be >= 0, by a label: the constraints, and the declared bounds of tied parameters."""
    result = {f"constraints[{k}] of {part.name!r}": constraint(p) for k, constraint in enumerate(part.constraints)}
    for name in part.tied:
        low, high = part.model.parameters[name].bounds
        tied = f"of the tied {part.rename.get(name, name)}"
        result |= {f"the lower bound {low:g} {tied}": p[name] - low} if math.isfinite(low) else {}
        result |= {f"the upper bound {high:g} {tied}": high - p[name]} if math.isfinite(high) else {}
    return result


def _total(parts: list[Problem], responses: list[Complex], smoothing: Any, locate: bool) -> Any:
    total: Any = 0.0
    for part, response in zip(parts, responses, strict=True):
        criterion = (_criterion(part).locator if locate else None) or _criterion(part)
        total = total + part.weight * criterion.cost(response, part.response, smoothing)
    return total


def _criterion(part: Problem) -> Criterion:
    assert isinstance(part.criterion, Criterion)
    return part.criterion


def _response(part: Problem) -> ca.Function:
    data = part.response
    options: Any = {"input": data.input, "output": data.output, "at": part.at, "pade": delay_order(part.delay)}
    if part.amplitude is not None:
        return harmonic_function(part.model, data.omega, part.amplitude, **options)
    return response_function(part.model, data.omega, **options)


def _scaling(parameters: list[Parameter]) -> Scaling:
    return Scaling(
        factor=np.array([_size(p) for p in parameters]),
        logarithmic=np.array([p.scale == "log" for p in parameters]),
    )


def _size(parameter: Parameter) -> float:
    """Return the larger end of the start box: IPOPT then needs about half the time that it takes unscaled.

    Not that of wider bounds, from which IPOPT would push the starts away by a share of their distance.
    """
    for pair in (parameter.box, parameter.bounds, (parameter.start, parameter.start)):
        finite = [abs(v) for v in pair if math.isfinite(v) and v != 0]
        if finite:
            return max(finite)
    return 1.0
