"""The frequency responses of a problem as programs: cost and constraints for a solver.

Most responses are one SX expression of all frequencies; a large one is a formula of a single
frequency, mapped over all. Some responses belong to an operating point that Newton's method finds.
A root finder is not an SX function, and CasADi's derivatives through it take several times as long
as those of the cost. Such a program therefore takes the roots as inputs: it is an SX function,
whose derivatives include the effect of the roots (see `modeling.trim.Trimmed`), and can be
evaluated for many points at once.

The constants of the problem and the data are an input of all functions, see `data_input`. Small
programs are stored, so that problems with the same formulas share them. Within a study, the
formulas of small problems with equal models and options are traced only once.
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


# Functions of the last 64 structures, some 1 MB each, which problems with the same formulas share.
# In a study, each structure has two keys.
_stored = Stored(64)


@frozen
class CostProgram(Rebuilt):
    """The cost of frequency responses that a solver minimizes, and its constraints.

    Attributes
    ----------
    function : casadi.Function
        (z, smoothing, data) -> the cost in its `unit`, and the quantities that must be >= 0.
    explicit : casadi.Function or None
        The same as an SX function of (z, smoothing, data), or of (z, smoothing, data, w) if there
        are `roots`. None if responses are MX functions.
    roots : casadi.Function or None
        (z, data) -> w, the states and inputs of all operating points that Newton's method finds.
    shared : SharedResponses or None
        The cost in numpy, if all models are state spaces and the program is too large for a batch.
    unit : float
        The problem's cost is divided by this unit, see `solver_unit`.
    """

    function: ca.Function
    explicit: ca.Function | None = None
    roots: ca.Function | None = None
    shared: SharedResponses | None = None
    unit: float = 1.0

    @cached_property
    def solvers(self) -> dict[Any, Any]:
        """Solvers that were built for the program, by their options; they stay in this process."""
        return {}

    @cached_property
    def second_order(self) -> Columns | SharedResponses:
        """Return a function of columns: the shared or explicit cost, gradient and Hessian."""
        if self.shared is not None:
            return self.shared
        assert self.explicit is not None
        return second_order(*_inputs_and_cost(self.explicit))

    @cached_property
    def first_order(self) -> Callable[..., Sequence[Array]]:
        """Return a function of columns, as `second_order`: cost and gradient."""
        if self.shared is not None:
            shared = self.shared
            return lambda *inputs: shared(*inputs)[:2]
        program = self.function if self.explicit is None else self.explicit
        return first_order(*_inputs_and_cost(program))

    @cached_property
    def whole_second_order(self) -> Callable[..., Sequence[Array]]:
        """Return a function of columns, as `second_order`, with the whole Hessian.

        Cost and derivatives are those of `function` if responses are MX functions.
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
    """Return whether many points of a program (z, ...) -> cost, constraints fit into a batch.

    The cost must be an SX function without constraints other than bounds, and small: with more than
    50 000 instructions, most of IPOPT's time goes into cost, gradient and Hessian, and with more
    than 20 unknowns into eigenvalues, so that a batch saves little.
    """
    if program is None or not program.is_a("SXFunction") or program.numel_out(1):
        return False
    return program.numel_in(0) <= 20 and instructions(program) <= 50_000


def instructions(program: ca.Function) -> int:
    """Return about how many instructions a cost with gradient and Hessian takes.

    These are two for every operation of the cost and every unknown.
    """
    return max(program.n_instructions() * 2 * program.numel_in(0), 1)


class ResponseCompiler:
    """Builds the functions of a problem's frequency responses.

    Parameters
    ----------
    problem : Problem or Sum
    names : sequence of str
        Names of all values, in their order.
    constants : (c,) array
        Values of the fixed parameters.
    values_at : function
        From symbols of the solver's variables (p,) and of the constants (c,) to all values by name.
    constraint : casadi.Function
        (all values) -> the stacked quantities that must be >= 0.
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
        """Return the compiled parts, and the attributes of `CompiledProblem` for all of them."""
        key = self.stated()
        if key is None:
            functions, programs = self.traced()
        else:
            functions, programs = _stored.result(key, self.traced)

        data = self.source.numbers
        parts = {}
        for part, own, is_open in zip(self.parts, functions, self.source.are_open, strict=True):
            parts[part] = ResponsePart(part, own, data, is_open)
        zero = [cost_of_zero(_locator(part), part.response) for part in parts]
        zero_costs = np.array(self.weights) * zero
        return parts, {**programs, "data": data, "zero_costs": zero_costs}

    def stated(self) -> tuple[str, str] | None:
        """Return a key of everything that the result of `traced` depends on.

        None outside of a study, and where the key may be incomplete, as for criteria of the user.
        """
        parts = self.parts
        study = unchanged_in.get()
        # Large programs are not stored: a few of them would fill the memory.
        is_small = len(self.names) * len(self.source.numbers) < 10_000
        is_included = all(type(part.criterion) in INCLUDED for part in parts)
        has_constraints = self.constraint.numel_out() > 0
        if not (study and is_small and is_included) or has_constraints:
            return None
        statements = [
            (part.model, part.signals, part.criterion, part.rename, part.tied) for part in parts
        ]
        shapes = [
            (part.response.omega, part.sampled_hold, *columns_of(part.response)) for part in parts
        ]
        common = (
            *self.problem.parameters.items(),
            *self.weights,
            len(self.problem.parts),
        )
        with suppress(Exception):  # a lambda has no fingerprint
            return study, value_fingerprint((statements, shapes, common))
        return None

    def traced(self) -> tuple[list[ResponseFunctions], dict[str, Any]]:
        """Trace the formulas, and return the functions of the parts and of the whole problem.

        Functions that were built before for the same formulas are used again.
        """
        self.point = ca.SX.sym("z", len(self.names) - len(self.constants))
        is_located = any(_own_criterion(part).locator is not None for part in self.parts)
        # The choice of criteria of every program.
        self.criteria = (_locator, _own_criterion) if is_located else (_own_criterion,)

        points = sum(len(part.response) for part in self.parts)
        # With some ten instructions for every point, such a program is too large for a batch.
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
        # A large problem is not stored, so that its costs are not traced once more for a key.
        structure = None if is_large else self.structure()
        if structure is None or not fits_a_batch(structure):
            return self.built()
        return _stored.result((function_key(structure), *self.weights), self.built)

    def limits(self, named: Mapping[str, Any]) -> Any:
        """Return the quantities that must be >= 0, at values by name."""
        return self.constraint(ca.vertcat(*named.values()))

    def responses_at(self, named: Mapping[str, Any]) -> list[Complex]:
        """Return the responses (n,) of all parts at values by name."""
        return [
            Complex(*model(_values(part, named)))
            for model, part in zip(self.models, self.parts, strict=True)
        ]

    def costs(
        self,
        responses: Sequence[Complex],
        measured: Sequence[Any],
        smoothing: Any,
        choose: ChooseCriterion,
    ) -> list[Any]:
        """Return the costs of the responses of all parts, by the criteria that `choose` returns."""
        return [
            traced(f"the cost of {part.name!r}", choose(part).cost, response, data, smoothing)
            for part, response, data in zip(self.parts, responses, measured, strict=True)
        ]

    def weighted(self, costs: Sequence[Any]) -> Any:
        """Return the weighted sum of the costs, in the solver's unit."""
        return sum(weight * cost for weight, cost in zip(self.weights, costs, strict=True))

    @property
    def stacked(self) -> Any:
        """Real parts of all responses, then imaginary parts."""
        real = [response.re for response in self.responses]
        imaginary = [response.im for response in self.responses]
        return ca.vertcat(*real, *imaginary)

    def structure(self) -> ca.Function:
        """Return a function of all expressions that `built` uses, except the weights.

        It is the key of what is built: equal functions have equal fingerprints.
        """
        costs = []
        for choose in self.criteria:
            costs += self.costs(self.responses, self.measured, self.smoothing, choose)
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
        """Return the functions of the parts, and those of the whole problem by attribute."""
        kind, x, z, data = self.kind, self.x, self.z, self.data
        # The responses as expressions of the solver's variables z, instead of all values x.
        responses_at_z = self.responses_at(self.named)
        programs = []
        costs: list[Any] = []
        for choose in self.criteria:
            costs = self.costs(responses_at_z, self.measured, self.smoothing, choose)
            programs.append(self.program(costs, choose))

        # The costs are now those of the last program, by the problem's own criteria.
        systems = self.systems() if programs[-1].shared else {}
        functions = []
        for k, cost in enumerate(costs):
            at_z, at_x = responses_at_z[k], self.responses[k]
            objective = ca.Function(
                "objective",
                [z, self.smoothing, data],
                [kind(cost), kind(ca.vertcat(at_z.re, at_z.im))],
            )
            response = ca.Function("response", [x], [ca.vertcat(at_x.re, at_x.im)])
            functions.append(ResponseFunctions(objective, response, systems.get(k)))

        exact_costs = self.costs(self.responses, self.measured, 0.0, _own_criterion)
        judged = ca.Function("judged", [x, data], [ca.vertcat(*exact_costs), self.stacked])
        return functions, {
            "programs": tuple(programs),
            # CasADi evaluates any number of columns, so that one has the same digits as many.
            "responses": Columns(judged, shared=(1,), fewest=CHUNK + 1),
        }

    def program(self, costs: Sequence[Any], choose: ChooseCriterion) -> CostProgram:
        """Return the program of the costs of all parts, which are expressions of z."""
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
        roots = []
        for part, formula in zip(self.parts, formulas, strict=True):
            root = ca.MX(0, 1)
            if formula.root is not None:
                root = formula.root(_values(part, self.named))
            roots.append(root)

        # `explicit` is an SX function, with SX symbols for the data, the smoothing and the roots w.
        given, named, measured = self.at_point()
        sizes = [formula.function.numel_in(1) for formula in formulas]
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

        # The derivatives of `explicit` include the effect of the roots, so that CasADi must not
        # differentiate the root finder as well.
        at_roots: Any = ca.Function("roots", [z, data], [ca.vertcat(*roots)])
        outputs = explicit(z, smoothing, data, ca.stop_diff(at_roots(z, data), 1))
        function = ca.Function("program", [z, smoothing, data], outputs)
        return CostProgram(function, explicit, at_roots, unit=self.unit)

    def at_point(self) -> tuple[ca.SX, Mapping[str, Any], list[FrequencyResponse]]:
        """Return SX symbols of the data (g,), and with them the values by name and the data."""
        data = ca.SX.sym("data", len(self.source.numbers))
        constants, measured = self.source.at(data)
        return data, self.values_at(self.point, constants), measured

    def systems(self) -> dict[int, SharedSystem]:
        """Return the state space of every part, by its number, as functions of all values x."""
        x = ca.SX.sym("x", len(self.names))
        systems = {}
        for shared in shared_systems(self.parts, x, entries_by_name(self.names, x)) or []:
            systems |= dict(shared.of_pairs())
        return systems

    def shared(self, choose: ChooseCriterion) -> SharedResponses | None:
        """Return the cost in numpy; None unless all parts are responses of state spaces."""
        if len(self.parts) < len(self.problem.parts):
            return None
        named = self.values_at(self.point, self.constants)
        systems = shared_systems(self.parts, self.point, named)
        if systems is None:
            return None
        data, _, measured = self.at_point()
        # The systems have their parts in an order of their own.
        order = [number for system in systems for number, _ in system.pairs]
        stacked, members = response_symbols([self.parts[number] for number in order])
        by_number = dict(zip(order, members, strict=True))
        responses = [by_number[number] for number in sorted(by_number)]
        smoothing = ca.SX.sym("smoothing")
        cost = ca.SX(self.weighted(self.costs(responses, measured, smoothing, choose)))
        return SharedResponses(self.parts, systems, cost, (stacked, smoothing, data))


def _values(part: Problem, named: Mapping[str, Any]) -> Any:
    """Return the values of a part's own parameters as a vector."""
    return ca.vertcat(*part.local_values(named).values())


# --- the models


def _formulas(parts: Sequence[Problem], *, is_large: bool) -> Iterator[Trimmed | ca.Function]:
    """Yield the responses of all parts, as functions of the parameters.

    The responses of one state space at one operating point share an elimination. Large responses
    are formulas of one frequency, mapped over all of them.
    """

    def key(part: Problem) -> tuple[Any, ...]:
        """Return a key that is equal for parts whose responses share an elimination."""
        omega = part.response.omega.tobytes()
        return id(part.model), part.at, part.delay, omega, part.sampled_hold

    for _, alike in groupby(parts, key):
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
    """Return the criterion of a response."""
    assert isinstance(part.criterion, Criterion)
    return part.criterion


def _locator(part: Problem) -> Criterion:
    """Return the criterion that locates the minimum; usually the response's own."""
    return _own_criterion(part).locator or _own_criterion(part)


def solver_unit(parts: Sequence[Problem]) -> float:
    """Return the unit of the cost in a solver: one, or more where rounding would hide the minimum.

    The rounding errors of a model are relative to its magnitude M. If the measured errors have a
    known size σ, the gradient of the cost has rounding errors of about ε Σ (M/σ)². For σ below a
    thousandth of M, this exceeds the solver's tolerance of 1e-8.
    """
    precision = 0.0  # Σ (M/σ)²
    for part in parts:
        criterion = _own_criterion(part)
        if criterion.known_noise:
            data = part.response
            ratios = np.abs(data.response) / criterion.error_size(data.response, data)
            precision += part.weight * float((ratios**2).sum())

    # The tolerance is then a hundred rounding errors. With ten of them, a quarter of the runs on 14
    # points with errors of 1e-4 misses the tolerance; with a hundred, all runs meet it.
    unit = max(1.0, 100 * float(np.finfo(float).eps) / 1e-8 * precision)
    # A power of two, so that other data of the same kind rarely need another program.
    return 2.0 ** math.ceil(math.log2(unit))
