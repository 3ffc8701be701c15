"""The compiled problem: its parts and constraints as functions of the solver's variables."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import field, replace
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import Array, BoolArray, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.engine.compiled.part import Part, Portable
from greybox.engine.compiled.record_part import compile_records
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.response_programs import CostProgram, ResponseCompiler
from greybox.engine.compiled.steep_bounds import MARGIN, steep_bounds
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.compiled.transcription.multiple_shooting import MultipleShooting
from greybox.engine.compiled.transient_part import compile_manoeuvres
from greybox.engine.compiled.vectorized import Columns
from greybox.modeling.fingerprint import function_key
from greybox.modeling.formulation.prior_part import with_priors
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.parameter import Parameter, lower_and_upper
from greybox.modeling.symbolic_reading import as_column, entries_by_name


@frozen
class Scaling:
    """How parameters x and the solver's variables z, (..., p) each, follow from each other.

    Attributes
    ----------
    factor : (p,) array
        x = factor · z for a parameter on a linear scale.
    logarithmic : (p,) array of bool
        Whether x = exp(z).
    """

    factor: Array
    logarithmic: BoolArray

    def to_solver(self, x: Array) -> Array:
        """Return z for x, along the last axis."""
        # The logarithm of a lower bound of zero is -inf, which is no bound, as it should be.
        with np.errstate(divide="ignore"):
            return np.log(x, out=x / self.factor, where=self.logarithmic)

    def to_parameters(self, z: Array) -> Array:
        """Return x for z, along the last axis."""
        return np.exp(z, out=z * self.factor, where=self.logarithmic)

    def slope(self, x: Array) -> Array:
        """Return dz/dx (p,) at x (p,)."""
        return 1 / np.where(self.logarithmic, x, self.factor)

    def bend(self, x: Array) -> Array:
        """Return d²z/dx² (p,) at x (p,)."""
        # The square is only of parameters on a logarithmic scale, which are not zero.
        divisor = np.where(self.logarithmic, x, 1.0) ** 2
        return np.where(self.logarithmic, -1 / divisor, 0.0)

    def expressions(self, z: Any) -> list[Any]:
        """Return the entries of x for a CasADi vector z."""
        entries = []
        for k, factor in enumerate(self.factor):
            entries.append(ca.exp(z[k]) if self.logarithmic[k] else z[k] * float(factor))
        return entries


def scaling_of(parameters: Sequence[Parameter]) -> Scaling:
    """Return the scaling of the unknowns."""
    return Scaling(
        factor=np.array([_size(p) for p in parameters], dtype=float),
        logarithmic=np.array([p.scale == "log" for p in parameters]),
    )


def _size(parameter: Parameter) -> float:
    """Return the scale of a parameter: the larger end of its start box, in magnitude.

    With this scale, IPOPT takes half the time. The bounds and the start replace a box without a
    finite end other than zero.
    """
    for values in (parameter.box, parameter.bounds, (parameter.start,)):
        finite = [abs(value) for value in values if math.isfinite(value) and value != 0]
        if finite:
            return max(finite)
    return 1.0


AnyProblem = Problem | Sum[Problem]


def require_problem(problem: Any) -> None:
    """Raise TypeError for anything but a problem or a sum of them."""
    cure = "a Problem(model, data) or a sum of them"
    require_kind("problem", problem, Problem | Sum, cure)


PartKind = TypeVar("PartKind", bound=Part)
# `responses` of a problem without frequency responses.
NOTHING = Columns(ca.Function("nothing", [], []))


@frozen
class CompiledProblem(Portable):
    """A problem ready for a solver.

    Attributes
    ----------
    problem : Problem or Sum
        What was compiled.
    free : tuple of str
        Names of the p unknowns, in the order of every vector here.
    constants : tuple of str
        Names of the c fixed parameters. In "all values" they follow the unknowns.
    constant_values : (c,) array
    lower, upper : (p,) arrays
        Bounds of the unknowns, in their own units.
    scaling : Scaling
        Between the unknowns and the solver's variables.
    steep : (2, p) array of bool
        Lower and upper bounds at which a formula, such as a root, has no finite slope.
    method : Transcription
        How records are transcribed.
    parts : tuple of Part
        In the order of the parts of the problem.
    constraint : casadi.Function
        (all values) -> the stacked quantities that must be >= 0.
    limits : tuple of str
        The names of these quantities in words.
    programs : tuple of CostProgram
        The costs of frequency responses that a solver minimizes one after the other: that of the
        criteria that locate the minimum, if there are any, then that of the problem's own criteria.
    zero_costs : (responses,) array
        Cost of a zero response, for each frequency response, weighted as in the first program.
    data : (g,) array
        The constants and the data of all frequency responses, an input of their functions.
    responses : Columns
        (all values, data) -> the cost of every frequency response, without smoothing and weight,
        and a vector (2 N,) of the real parts of all responses, then their imaginary parts.

    The attributes from `programs` on are empty if no data are frequency responses.
    """

    problem: AnyProblem
    free: tuple[str, ...]
    constants: tuple[str, ...]
    constant_values: Array
    lower: Array
    upper: Array
    scaling: Scaling
    steep: BoolArray
    method: Transcription
    parts: tuple[Part, ...]
    constraint: ca.Function
    limits: tuple[str, ...]
    programs: tuple[CostProgram, ...] = ()
    zero_costs: Array = field(default_factory=lambda: np.zeros(0))
    data: Array = field(default_factory=lambda: np.zeros(0))
    responses: Columns = NOTHING

    def parts_of(self, kind: type[PartKind]) -> list[PartKind]:
        """Return the parts of one class."""
        return [part for (part,) in self.rows_of(kind)]

    def rows_of(
        self, kind: type[PartKind], *beside: Sequence[Any]
    ) -> list[tuple[PartKind, *tuple[Any, ...]]]:
        """Return the parts of one class, each with its entries of other sequences.

        The other sequences have one entry for every part of the problem, or none at all: a fit
        without degrees of freedom has no accuracy of its parts. The result is then empty.
        """
        rows: Any = zip(self.parts, *beside, strict=False)
        return [row for row in rows if isinstance(row[0], kind)]

    @property
    def has_states(self) -> bool:
        """Whether states of some part are unknowns besides the parameters, as in every record."""
        return any(part.has_states for part in self.parts)

    @property
    def numbers(self) -> int:
        """Number of real numbers that are compared with the model."""
        return sum(part.numbers for part in self.parts)

    @property
    def substeps(self) -> int:
        """Largest number of integration steps from sample to sample; zero without states."""
        return max(part.substeps for part in self.parts)

    def refined(self, factor: int) -> "CompiledProblem":
        """Return the problem with `factor` times the steps per sample."""
        return replace(self, parts=tuple(part.refined(factor) for part in self.parts))

    def has_stable_steps(self, z: Array, nodes: Sequence[Array]) -> bool:
        """Return whether explicit steps of all parts are stable at z (p,) and their nodes."""
        return all(
            part.has_stable_steps(z, part_nodes)
            for part, part_nodes in zip(self.parts, nodes, strict=True)
        )

    @property
    def noise_sizes(self) -> set[str]:
        """Names of the parameters that are sizes of process noise."""
        return {name for part in self.parts for name in part.noise_sizes}

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, then constants: the order of all values."""
        return (*self.free, *self.constants)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (p,) of the solver's variables z, just inside of steep ones."""
        low, high = self.scaling.to_solver(self.lower), self.scaling.to_solver(self.upper)
        return low + MARGIN * self.steep[0], high - MARGIN * self.steep[1]

    def limits_at(self, z: Any) -> Any:
        """Return the quantities that must be >= 0, at symbols z (p,) of the solver's variables."""
        return self.constraint(ca.vertcat(*self.scaling.expressions(z), *self.constant_values))

    def all_values(self, x: Array) -> Array:
        """Append the constants to unknowns x (..., p)."""
        leading = np.shape(x)[:-1]
        constants = np.broadcast_to(self.constant_values, (*leading, len(self.constants)))
        return np.concatenate([x, constants], axis=-1)

    def estimate_at(self, z: Array) -> Array:
        """Return the unknowns (..., p) at the solver's variables z (..., p), within the bounds."""
        return np.clip(self.scaling.to_parameters(z), self.lower, self.upper)

    def with_constants(self, values: Array) -> "CompiledProblem":
        """Return the problem with other values (c,) of its fixed parameters.

        Raises
        ------
        ValueError
            If data are records, whose functions are compiled for the values.
        """
        changed = np.flatnonzero(values != self.constant_values)
        if self.has_states and changed.size:
            k = changed[0]
            name = self.constants[k]
            raise ValueError(
                f"{name} is fixed at {self.constant_values[k]:g} here: give {values[k]:g} to the "
                f"problem, fixed={{{name!r}: ...}}."
            )
        data = self.data
        if data.size:
            # The data of frequency responses begin with the constants.
            data = np.concatenate([values, data[len(values) :]])
        return replace(self, constant_values=values, data=data)

    # --- frequency responses alone, many points at once

    def costs(self, x: Array) -> Array:
        """Return the costs (r,) of the frequency responses without smoothing, for x (r, p)."""
        return self.judged(x)[0]

    def _judged(self, values: Array) -> tuple[Array, Array]:
        """Return the weighted costs (r,) and responses (2 N, r) at all values (k, r)."""
        costs, responses = self.responses(values, self.data)
        weights = [part.weight for part in self.parts if not part.has_states]
        return np.array(weights) @ costs, responses

    def data_of(self, constants: Array, responses: Iterable[ComplexArray]) -> Array:
        """Return the data (g,) for other constants (c,) and other measured responses (n,)."""
        pieces = [constants]
        for part, response in zip(self.parts_of(ResponsePart), responses, strict=True):
            pieces.append(part.numbers_of(response))
        return np.concatenate(pieces)

    def judged(self, x: Array) -> tuple[Array, Array]:
        """Return costs (r,) and signatures (r, 2 N) for x (r, p), see `Part.signature`."""
        costs, responses = self._judged(self.all_values(x).T)
        # Relative to the measured magnitudes, so that responses of different units are comparable.
        magnitudes = [part.magnitude for part in self.parts_of(ResponsePart)]
        magnitude = np.concatenate([np.zeros(0), *magnitudes])
        return costs, (responses / np.tile(magnitude, 2)[:, None]).T


@one_thread_at_a_time
def compile_problem(problem: AnyProblem, method: Transcription | None = None) -> CompiledProblem:
    """Build the CasADi functions of a problem; `method` is the transcription of its records.

    Raises
    ------
    TypeError
        For anything but a problem or a sum of problems.
    ValueError
        If no parameter is free, or CasADi cannot evaluate a formula.
    """
    require_problem(problem)
    # Priors become parts of the problem: costs, counts and covariances then include them without
    # a special case.
    problem = with_priors(problem)
    method = method or MultipleShooting()
    parameters = problem.parameters
    free = tuple(name for name, p in parameters.items() if not p.fixed)
    constants = tuple(name for name, p in parameters.items() if p.fixed)
    if not free:
        cure = "there is nothing to estimate"
        if constants:
            cure = f"free one, e.g. free=({constants[0]!r},)"
        raise ValueError(f"no parameter of {problem.name!r} is free: {cure}.")

    unknowns = [parameters[name] for name in free]
    scaling = scaling_of(unknowns)
    lower, upper = lower_and_upper(unknowns)
    constant_values = np.array([parameters[name].start for name in constants])
    names = (*free, *constants)
    starts = np.array([*(p.start for p in unknowns), *constant_values], dtype=float)
    # A logarithmic scale never reaches zero, and elsewhere its slopes are finite.
    inward = np.where(scaling.logarithmic, 0.0, scaling.factor)
    steep = np.array(
        [
            steep_bounds(problem.parts, names, starts, lower, inward),
            steep_bounds(problem.parts, names, starts, upper, -inward),
        ]
    )

    def values_at(z: Any, constants: Any) -> dict[str, Any]:
        """Return all values by name, at symbols of the solver's variables and the constants."""
        return dict(zip(names, [*scaling.expressions(z), *constants], strict=True))

    limits, constraint = limits_of(problem, names)
    parts: dict[Problem, Part] = {}
    functions: dict[str, Any] = {}
    if problem.parts_with(FrequencyResponse):
        responses = ResponseCompiler(problem, names, constant_values, values_at, constraint)
        response_parts, functions = responses.compiled()
        parts |= response_parts
    point = ca.SX.sym("z", len(free))
    named = values_at(point, constant_values)
    spectra = problem.parts_with(TransientSpectrum)
    parts |= zip(spectra, compile_manoeuvres(spectra, named, point), strict=True)
    records = problem.parts_with(Record)
    if records:
        record_parts = compile_records(records, named, point, method)
        parts |= zip(records, record_parts, strict=True)
        # Stiff models are transcribed by another method, unless one was stated.
        method = record_parts[0].model.method

    return CompiledProblem(
        problem=problem,
        free=free,
        constants=constants,
        constant_values=constant_values,
        lower=lower,
        upper=upper,
        scaling=scaling,
        steep=steep,
        method=method,
        parts=tuple(parts[part] for part in problem.parts),
        constraint=constraint,
        limits=limits,
        **functions,
    )


def limits_of(problem: AnyProblem, names: Sequence[str]) -> tuple[tuple[str, ...], ca.Function]:
    """Return the constraints of a problem: their names, and a function (values) -> (limits,).

    All its results must be >= 0; `names` are those of the values. A constraint that several parts
    share counts once.
    """
    # Name and expression, by a key that is equal for equal constraints.
    limits: dict[Any, tuple[str, Any]] = {}
    x = ca.SX.sym("x", len(names))
    for part in problem.parts:
        local = part.local_values(entries_by_name(names, x))
        for k, constraint in enumerate(part.constraints):
            # Equal lambdas are different objects in Python: compiled formulas are compared instead.
            label = f"constraints[{k}] of {part.name!r}"
            value = ca.SX(constraint(local))
            formula = ca.Function("formula", [x], [value])
            limits.setdefault(function_key(formula), (label, value))
        for name in part.tied:
            lower, upper = part.declared[name].bounds
            sides = [("lower", lower, local[name] - lower), ("upper", upper, upper - local[name])]
            for side, bound, distance in sides:
                if math.isfinite(bound):
                    label = f"the {side} bound {bound:g} of the tied {part.outside(name)}"
                    limits.setdefault(label, (label, distance))

    values = as_column(value for _, value in limits.values())
    return tuple(label for label, _ in limits.values()), ca.Function("constraint", [x], [values])
