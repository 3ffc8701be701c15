"""The frequency responses of a problem as programs: cost and constraints for a solver.

Most responses are one SX expression, large ones a formula of one frequency, mapped over all. The
operating point of some is found by Newton's method: a root finder is not an SX function, and
CasADi's derivatives through one take several times as long as those of the cost.
With the roots as inputs the program is an SX function whose derivatives hold them (see
`modeling.trim.Trimmed`), so that it can be evaluated for many points at once.

The constants of the problem and the data are an input of all functions, see `data_input`. Small
programs are stored: problems that are compiled to the same formulas share them. Within a study,
those of small problems with equal models and options are not traced again.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.rebuilt import Rebuilt
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.compiled.data_input import INCLUDED, DataInput, columns_of
from greybox.engine.compiled.response_part import ResponseFunctions, ResponsePart
from greybox.engine.compiled.shared_response import (
    SharedResponses,
    SharedSystem,
    response_symbols,
    shared_systems,
)
from greybox.engine.compiled.vectorized import CHUNK, Columns, first_order, second_order
from greybox.modeling.cached_property import cached_property
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.fingerprint import function_key, value_fingerprint
from greybox.modeling.formulation.frequency_criteria import Criterion, cost_of_zero
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.linear_response import response_formulas
from greybox.modeling.one_thread import Stored
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.symbolic_reading import entries_by_name, input_symbols, traced
from greybox.modeling.traced_once import unchanged_in
from greybox.modeling.trim import Trimmed

ChooseCriterion = Callable[[Problem], Criterion]


# Compiled problems of the same formulas share what was built for the last ones: some 1 MB a
# structure. In a study, each has two keys.
_stored = Stored(64)


@frozen
class CostProgram(Rebuilt):
    """What a solver of frequency responses minimizes.

    Attributes
    ----------
    function : casadi.Function
        (z, smoothing, data) -> the cost over its `unit`, and what must be >= 0.
    explicit : casadi.Function or None
        The same as an SX function (z, smoothing, data), or (z, smoothing, data, w) with the `roots`
        given; None where responses exist as MX functions only.
    roots : casadi.Function or None
        (z, data) -> w, the unknowns of all operating points that Newton's method finds.
    shared : SharedResponses or None
        The cost in numpy, where all models are state spaces and the program is too large for a
        batch.
    unit : float
        What the cost of the problem is divided by, see `solver_unit`.
    """

    function: ca.Function
    explicit: ca.Function | None = None
    roots: ca.Function | None = None
    shared: SharedResponses | None = None
    unit: float = 1.0

    @cached_property
    def solvers(self) -> dict[Any, Any]:
        """Return what solvers have built for the program, which stays in this process."""
        return {}

    @cached_property
    def second_order(self) -> Columns | SharedResponses:
        """Return the shared or explicit cost with its gradient and Hessian, for many columns."""
        if self.shared is not None:
            return self.shared
        assert self.explicit is not None
        return second_order(*_inputs_and_cost(self.explicit))

    @cached_property
    def first_order(self) -> Callable[..., Sequence[Array]]:
        """Return the cost with its gradient, for many columns as `second_order`."""
        if self.shared is not None:
            shared = self.shared
            return lambda *inputs: shared(*inputs)[:2]
        program = self.function if self.explicit is None else self.explicit
        return first_order(*_inputs_and_cost(program))

    @cached_property
    def whole_second_order(self) -> Callable[..., Sequence[Array]]:
        """Return the cost with its gradient and whole Hessian, as `second_order`.

        They are those of `function` where responses exist as MX functions only.
        """
        if self.shared is not None:
            return self.shared.with_curvature
        if self.explicit is not None:
            return self.second_order
        return second_order(*_inputs_and_cost(self.function))


def _inputs_and_cost(program: ca.Function) -> tuple[list[Any], Any]:
    """Return symbols for the inputs of a program, and its cost."""
    inputs = input_symbols(program)
    outputs: Any = program(*inputs)
    return inputs, outputs[0]


def fits_a_batch(program: ca.Function | None) -> bool:
    """Return whether the derivatives of a program are small enough, as expressions, for a batch.

    The program (z, ...) -> cost, constraints needs an explicit cost (an SX function) and no
    constraints but bounds. With 50 000 or more instructions, cost, gradient and Hessian take most
    of IPOPT's time, and with 20 or more unknowns eigenvalues do: a batch gains little then.
    """
    if program is None or not program.is_a("SXFunction") or program.numel_out(1):
        return False
    return program.numel_in(0) <= 20 and instructions(program) <= 50_000


def instructions(program: ca.Function) -> int:
    """Estimate the instructions of cost, gradient and Hessian: two an operation and unknown."""
    return max(program.n_instructions() * 2 * program.numel_in(0), 1)


class ResponseCompiler:
    """The frequency responses of a problem as expressions, and the functions that follow.

    `names` are those of all values; `values_at` turns symbols of the solver's variables and of the
    constants into these values by name, from which `constraint` computes what must be >= 0.
    """

    def __init__(
        self,
        problem: Problem | Sum[Problem],
        names: Sequence[str],
        constants: Array,
        values_at: Callable[[Any, Any], Mapping[str, Any]],
        constraint: ca.Function,
    ) -> None:
        self.problem = problem
        self.names = names
        self.constants = constants
        self.values_at = values_at
        self.constraint = constraint
        self.parts: list[Problem] = problem.parts_with(FrequencyResponse)
        self.unit = solver_unit(self.parts)
        self.weights = [part.weight / self.unit for part in self.parts]
        self.source = DataInput(constants, self.parts)

    def compiled(self) -> tuple[dict[Problem, ResponsePart], dict[str, Any]]:
        """Return the parts, and the attributes of `CompiledProblem` for all of them."""
        stated = self.stated()
        functions, programs = _stored.result(stated, self.traced) if stated else self.traced()
        data = self.source.numbers
        columns = zip(self.parts, functions, self.source.are_open, strict=True)
        parts = {
            part: ResponsePart(part, built_functions, data, is_open)
            for part, built_functions, is_open in columns
        }
        zero = [cost_of_zero(_locator(part), part.response) for part in parts]
        zero_costs = np.array(self.weights) * zero
        return parts, {**programs, "data": data, "zero_costs": zero_costs}

    def stated(self) -> tuple[str, str] | None:
        """Return a key of all that `traced` depends on; None if nobody knows that it suffices."""
        parts = self.parts
        study = unchanged_in.get()
        # A few large programs would fill the memory.
        is_small = len(self.names) * len(self.source.numbers) < 10_000
        is_included = all(type(part.criterion) in INCLUDED for part in parts)
        if not (study and is_small and is_included) or self.constraint.numel_out():
            return None
        fields = "model", "signals", "criterion", "rename", "tied"
        stated = [[getattr(part, field) for field in fields] for part in parts]
        shapes = [
            (part.response.omega, part.sampled_hold, *columns_of(part.response)) for part in parts
        ]
        common = *self.problem.parameters.items(), *self.weights, len(self.problem.parts)
        with suppress(Exception):  # a lambda has no key
            return study, value_fingerprint((stated, shapes, common))
        return None

    def traced(self) -> tuple[list[ResponseFunctions], dict[str, Any]]:
        """Trace the formulas; return what was built for the same ones, or build it."""
        self.point = ca.SX.sym("z", len(self.names) - len(self.constants))
        is_located = any(_own_criterion(part).locator is not None for part in self.parts)
        self.criteria = (_locator, _own_criterion) if is_located else (_own_criterion,)

        points = sum(len(part.response) for part in self.parts)
        # A batch takes no program of so many: its cost alone has some ten instructions a point.
        is_large = points * self.point.numel() > 2500
        self.formulas = [*_formulas(self.parts, is_large=is_large)]
        self.models = [
            formula.closed() if isinstance(formula, Trimmed) else formula
            for formula in self.formulas
        ]
        self.kind: Any = ca.SX if all(m.is_a("SXFunction") for m in self.models) else ca.MX

        self.x = self.kind.sym("x", len(self.names))
        self.responses = self.responses_at(entries_by_name(self.names, self.x))
        self.z = self.kind.sym("z", self.point.numel())
        self.smoothing = self.kind.sym("smoothing")
        self.data = self.kind.sym("data", len(self.source.numbers))
        symbols, self.measured = self.source.at(self.data)
        self.named = self.values_at(self.z, symbols)
        # Large problems are recognized without another copy of their costs.
        structure = None if is_large else self.structure()
        if structure is None or not fits_a_batch(structure):
            return self.built()
        return _stored.result((function_key(structure), *self.weights), self.built)

    def limits(self, named: Mapping[str, Any]) -> Any:
        """Return what must be >= 0 at values by name."""
        return self.constraint(ca.vertcat(*named.values()))

    def responses_at(self, named: Mapping[str, Any]) -> list[Complex]:
        """Return the responses of all parts at values by name."""
        pairs = zip(self.models, self.parts, strict=True)
        return [Complex(*model(_values(part, named))) for model, part in pairs]

    def costs(
        self,
        responses: Sequence[Complex],
        measured: Sequence[Any],
        smoothing: Any,
        choose: ChooseCriterion,
    ) -> list[Any]:
        """Return the costs of responses, with their measured data."""
        return [
            traced(f"the cost of {part.name!r}", choose(part).cost, response, data, smoothing)
            for part, response, data in zip(self.parts, responses, measured, strict=True)
        ]

    def weighted(self, costs: Sequence[Any]) -> Any:
        """Return the weighted sum of the costs."""
        return sum(w * cost for w, cost in zip(self.weights, costs, strict=True))

    @property
    def stacked(self) -> Any:
        """Real parts of all responses, then imaginary parts."""
        rows = [r.re for r in self.responses] + [r.im for r in self.responses]
        return ca.vertcat(*rows)

    def structure(self) -> ca.Function:
        """Return a function of all that `built` depends on, except the weights."""
        costs = [
            cost
            for choose in self.criteria
            for cost in self.costs(self.responses, self.measured, self.smoothing, choose)
        ]
        return ca.Function(
            "structure",
            [self.x, self.z, self.smoothing, self.data],
            [
                self.stacked,
                self.constraint(self.x),
                ca.vertcat(*costs),
                ca.vertcat(*self.named.values()),
            ],
        )

    def built(self) -> tuple[list[ResponseFunctions], dict[str, Any]]:
        """Return the functions of the parts, and those of the whole problem."""
        kind, x, z, data = self.kind, self.x, self.z, self.data
        scaled = self.responses_at(self.named)
        costs = [
            self.costs(scaled, self.measured, self.smoothing, choose) for choose in self.criteria
        ]
        programs = tuple(map(self.program, costs, self.criteria))
        systems = self.systems() if programs[-1].shared else {}
        functions = [
            ResponseFunctions(
                ca.Function(
                    "objective",
                    [z, self.smoothing, data],
                    [kind(cost), kind(ca.vertcat(at_z.re, at_z.im))],
                ),
                ca.Function("response", [x], [ca.vertcat(response.re, response.im)]),
                systems.get(k),
            )
            for k, (cost, response, at_z) in enumerate(
                zip(costs[-1], self.responses, scaled, strict=True)
            )
        ]
        costs = self.costs(self.responses, self.measured, 0.0, _own_criterion)
        judged = ca.Function("judged", [x, data], [ca.vertcat(*costs), self.stacked])
        return functions, {
            "programs": programs,
            # CasADi evaluates any number of columns, so that one has the same digits as many.
            "responses": Columns(judged, shared=(1,), fewest=CHUNK + 1),
        }

    def program(self, costs: Sequence[Any], choose: ChooseCriterion) -> CostProgram:
        """Return the program of the costs of all parts in the solver's variables."""
        trimmed = [formula for formula in self.formulas if isinstance(formula, Trimmed)]
        has_roots = any(formula.root is not None for formula in trimmed)
        if has_roots and len(trimmed) == len(self.parts):
            return self.program_at_roots(trimmed, choose)

        outputs = [self.kind(self.weighted(costs)), self.limits(self.named)]
        function = ca.Function("program", [self.z, self.smoothing, self.data], outputs)
        explicit = function if self.kind is ca.SX else None
        large = None if fits_a_batch(explicit) else self.shared(choose)
        return CostProgram(function, explicit, shared=large, unit=self.unit)

    def program_at_roots(self, formulas: Sequence[Trimmed], choose: ChooseCriterion) -> CostProgram:
        """Return the program of responses at operating points that Newton's method finds."""
        z, smoothing, data = self.z, self.smoothing, self.data
        sizes = [formula.function.numel_in(1) for formula in formulas]
        roots = [
            ca.MX(0, 1) if formula.root is None else formula.root(_values(part, self.named))
            for part, formula in zip(self.parts, formulas, strict=True)
        ]

        # The program is an SX function of the point and the roots.
        given, named, measured = self.at_point()
        s, w = ca.SX.sym("smoothing"), ca.SX.sym("w", sum(sizes))
        pieces = ca.vertsplit(w, np.cumsum([0, *sizes]).tolist())
        responses = []
        for part, formula, piece in zip(self.parts, formulas, pieces, strict=True):
            outputs: Any = formula.function(_values(part, named), piece)
            responses.append(Complex(*outputs))
        explicit = ca.Function(
            "explicit",
            [self.point, s, given, w],
            [
                ca.SX(self.weighted(self.costs(responses, measured, s, choose))),
                self.limits(named),
            ],
            {"cse": True},
        )

        # The derivatives of `explicit` hold the roots: CasADi must not differentiate them too.
        at_roots: Any = ca.Function("roots", [z, data], [ca.vertcat(*roots)])
        outputs = explicit(z, smoothing, data, ca.stop_diff(at_roots(z, data), 1))
        function = ca.Function("program", [z, smoothing, data], outputs)
        return CostProgram(function, explicit, at_roots, unit=self.unit)

    def at_point(self) -> tuple[ca.SX, Mapping[str, Any], list[FrequencyResponse]]:
        """Return SX symbols of the data, and with them the values by name and the data."""
        data = ca.SX.sym("data", len(self.source.numbers))
        constants, measured = self.source.at(data)
        return data, self.values_at(self.point, constants), measured

    def systems(self) -> dict[int, SharedSystem]:
        """Return the systems of the parts that are in numpy, at all values x."""
        x = ca.SX.sym("x", len(self.names))
        shared = shared_systems(self.parts, x, entries_by_name(self.names, x)) or []
        return dict(pair for system in shared for pair in system.of_pairs())

    def shared(self, choose: ChooseCriterion) -> SharedResponses | None:
        """Return the cost in numpy, if the responses share their solves."""
        if len(self.parts) < len(self.problem.parts):
            return None
        named = self.values_at(self.point, self.constants)
        systems = shared_systems(self.parts, self.point, named)
        if systems is None:
            return None
        data, _, measured = self.at_point()
        order = [part for system in systems for part, _ in system.pairs]
        stacked, members = response_symbols([self.parts[k] for k in order])
        responses = [response for _, response in sorted(zip(order, members, strict=True))]
        smoothing = ca.SX.sym("smoothing")
        cost = ca.SX(self.weighted(self.costs(responses, measured, smoothing, choose)))
        return SharedResponses(self.parts, systems, cost, (stacked, smoothing, data))


def _values(part: Problem, named: Mapping[str, Any]) -> Any:
    """Return the values of a part's own parameters as a vector."""
    return ca.vertcat(*part.local_values(named).values())


# --- the models


def _formulas(parts: Sequence[Problem], *, is_large: bool) -> Iterator[Trimmed | ca.Function]:
    """Yield the responses of all parts; those of one state space share an elimination.

    Large ones are formulas of one frequency, mapped over all of them.
    """

    def place(part: Problem) -> tuple[Any, ...]:
        omega = part.response.omega.tobytes()
        hold = part.sampled_hold
        return id(part.model), part.at, part.delay, omega, hold

    for _, alike in groupby(parts, place):
        members = [*alike]
        first = members[0]
        omega = first.response.omega
        pairs = [(part.signals["input"], part.signals["output"]) for part in members]
        symbol = ca.SX.sym("omega") if is_large else None
        for formula in response_formulas(
            first.model,
            omega,
            pairs,
            symbol,
            at=first.at,
            pade=delay_order(first.delay),
            hold=first.sampled_hold,
        ):
            if is_large:
                p, w, _ = formula.function.mx_in()
                over_all = formula.function.map("rows", "serial", omega.size, [0, 1], [])
                rows = [row.T for row in over_all(p, w, omega[None])]
                yield Trimmed(formula.root, ca.Function("response", [p, w], rows))
            else:
                yield formula


# --- the costs


def _own_criterion(part: Problem) -> Criterion:
    assert isinstance(part.criterion, Criterion)
    return part.criterion


def _locator(part: Problem) -> Criterion:
    return _own_criterion(part).locator or _own_criterion(part)


def solver_unit(parts: Sequence[Problem]) -> float:
    """Return what the weights of responses are divided by, so that the solver's tolerance is met.

    The rounding errors of a model are relative to its magnitude M. Where errors have a known size
    σ, the gradient of the cost is rounded to some ε Σ (M/σ)², which for errors below a thousandth
    exceeds the tolerance of the solver, 1e-8.
    """
    precision = 0.0
    for part in parts:
        criterion = _own_criterion(part)
        if criterion.known_noise:
            data = part.response
            ratios = np.abs(data.response) / criterion.error_size(data.response, data)
            precision += part.weight * float((ratios**2).sum())

    # A hundred rounding errors over the tolerance: with ten, a quarter of the runs on 14 points
    # with errors of 1e-4 does not reach it, with a hundred all runs do.
    unit = max(1.0, 100 * float(np.finfo(float).eps) / 1e-8 * precision)
    # Rounded up to a power of two, so that other data of the same kind rarely need other programs.
    return 2.0 ** math.ceil(math.log2(unit))
