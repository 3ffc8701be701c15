"""The frequency responses of a problem as programs: cost and constraints for a solver.

Most responses are one SX expression. Large ones are a formula of one frequency, mapped over all
(`response_map`). The operating point of some is found by Newton's method: a root finder is not an
SX function, and CasADi's derivatives through one take several times as long as those of the cost.
With the roots as inputs the program is an SX function whose derivatives hold them (see
`modeling.trim.Trimmed`), so that it can be evaluated for many points at once.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.limits import limits_at
from greybox.compiled.response_map import LARGE, Mapped, lagrangian_hessian
from greybox.compiled.response_part import ResponsePart
from greybox.compiled.shared_response import SharedResponses, shared_responses
from greybox.data.frequency_response import FrequencyResponse
from greybox.formulation.frequency_criteria import Criterion, cost_of_zero
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.harmonic_balance import harmonic_function
from greybox.modeling.linear_response import formulas_at_one_frequency, response_formula
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.trim import Trimmed

Named = Mapping[str, Any]
ChooseCriterion = Callable[[Problem], Criterion]


@dataclass(frozen=True, eq=False)
class CostProgram:
    """What a solver of frequency responses minimizes.

    Attributes
    ----------
    function : casadi.Function
        (z, smoothing) -> the cost with `solver_weights`, and what must be >= 0.
    derivatives : dict
        Options of `casadi.nlpsol`: the Hessian of large responses, since CasADi's own takes longer.
    explicit : casadi.Function or None
        The same as an SX function (z, smoothing), or (z, smoothing, w) with the `roots` given; None
        where responses exist as MX functions only.
    roots : casadi.Function or None
        (z) -> w, the unknowns of all operating points that Newton's method finds.
    shared : SharedResponses or None
        The cost in numpy, where all models are state spaces and the program is too large for a
        batch.
    """

    function: ca.Function
    derivatives: dict[str, ca.Function] = field(default_factory=dict)
    explicit: ca.Function | None = None
    roots: ca.Function | None = None
    shared: SharedResponses | None = None


def fits_a_batch(program: ca.Function | None) -> bool:
    """Return whether the derivatives of a program are small enough, as expressions, for a batch.

    The program (z, smoothing, ...) -> cost, constraints needs an explicit cost (an SX function) and
    no constraints but bounds. From 50 000 instructions of cost, gradient and Hessian on, these take
    most of IPOPT's time, and from 20 unknowns on eigenvalues do: a batch gains little then.
    """
    if program is None or not program.is_a("SXFunction") or program.numel_out(1):
        return False
    return program.numel_in(0) <= 20 and instructions(program) <= 50_000


def instructions(program: ca.Function) -> int:
    """Estimate the instructions of cost, gradient and Hessian: two an operation and unknown."""
    return max(program.n_instructions() * 2 * program.numel_in(0), 1)


def compile_responses(
    problem: Problem | Sum[Problem],
    names: Sequence[str],
    point: ca.SX,
    values_at: Callable[[Any], Named],
) -> tuple[dict[Problem, ResponsePart], dict[str, Any]]:
    """Compile all frequency responses: their parts, and what `CompiledProblem` has of them all.

    `names` are those of all values; `values_at` turns symbols of the solver's variables, such as
    `point` (p,), into these values by name.
    """
    parts = [part for part in problem.parts if isinstance(part.data, FrequencyResponse)]
    mapped = _mapped(parts)
    formulas = [] if mapped else [_formula(part) for part in parts]
    models = [response.function() for response in mapped] or [
        formula.closed() if isinstance(formula, Trimmed) else formula for formula in formulas
    ]
    kind: Any = ca.SX if all(model.is_a("SXFunction") for model in models) else ca.MX

    def responses_at(named: Named) -> list[Complex]:
        pairs = zip(models, parts, strict=True)
        return [Complex(*model(_values(part, named))) for model, part in pairs]

    # In the user's parameters.
    x = kind.sym("x", len(names))
    by_name = dict(zip(names, ca.vertsplit(x), strict=True))
    # Limits take the kind of the responses, so that one function can hold both.
    limits, constraint = limits_at(problem, by_name, kind)
    responses = responses_at(by_name)
    costs = _costs(parts, responses, 0.0, _own_criterion)
    real, imaginary = [r.re for r in responses], [r.im for r in responses]

    # In the solver's variables.
    z, smoothing = kind.sym("z", point.numel()), kind.sym("smoothing")
    scaled = responses_at(values_at(z))
    _, scaled_limits = limits_at(problem, values_at(z), kind)
    trimmed = [formula for formula in formulas if isinstance(formula, Trimmed)]
    has_roots = kind is ca.MX and len(trimmed) == len(parts)

    def program(choose: ChooseCriterion) -> CostProgram:
        def cost(responses: Sequence[Complex], smoothing: Any) -> Any:
            costs = _costs(parts, responses, smoothing, choose)
            pairs = zip(solver_weights(parts), costs, strict=True)
            return sum(weight * cost for weight, cost in pairs)

        if has_roots:
            return _program_at_roots(problem, parts, trimmed, values_at, point, cost)

        total = kind(cost(scaled, smoothing))
        function = ca.Function("program", [z, smoothing], [total, scaled_limits])
        if mapped:
            large = shared(choose)
            return CostProgram(function, {} if large else derivatives(choose), shared=large)
        explicit = function if kind is ca.SX else None
        large = None if fits_a_batch(explicit) else shared(choose)
        return CostProgram(function, explicit=explicit, shared=large)

    def derivatives(choose: ChooseCriterion) -> dict[str, ca.Function]:
        named = values_at(point)
        terms = [
            (
                response,
                ca.SX(_values(part, named)),
                lambda r, smoothing, part=part: choose(part).cost(r, part.response, smoothing),
                weight,
            )
            for part, response, weight in zip(parts, mapped, solver_weights(parts), strict=True)
        ]
        _, at_point = limits_at(problem, named, ca.SX)
        return {"hess_lag": lagrangian_hessian(terms, point, at_point)}

    def shared(choose: ChooseCriterion) -> SharedResponses | None:
        if limits or len(parts) < len(problem.parts):
            return None
        named = values_at(point)
        return shared_responses(
            parts,
            solver_weights(parts),
            [*map(choose, parts)],
            point,
            lambda part: ca.SX(_values(part, named)),
        )

    is_located = any(_own_criterion(part).locator is not None for part in parts)
    criteria = (_locator, _own_criterion) if is_located else (_own_criterion,)
    compiled = (
        ResponsePart(
            problem=part,
            objective=ca.Function("objective", [z, smoothing], [kind(cost)]),
            model_response=ca.Function("response", [x], [ca.vertcat(response.re, response.im)]),
            scaled_response=ca.Function(
                "response", [z], [kind(ca.vertcat(scaled_response.re, scaled_response.im))]
            ),
        )
        for part, cost, response, scaled_response in zip(
            parts,
            _costs(parts, scaled, smoothing, _own_criterion),
            responses,
            scaled,
            strict=True,
        )
    )
    zero = [cost_of_zero(_locator(part), part.response) for part in parts]
    functions = {
        "zero_costs": np.array(solver_weights(parts)) * zero,
        "programs": tuple(program(choose) for choose in criteria),
        "response_cost": ca.Function("cost", [x], [ca.vertcat(kind(0, 1), *costs)]),
        "responses": ca.Function("responses", [x], [ca.vertcat(kind(0, 1), *real, *imaginary)]),
        "constraint": ca.Function("constraint", [x], [constraint]),
        "limits": limits,
    }

    return dict(zip(parts, compiled, strict=True)), functions


def _values(part: Problem, named: Named) -> Any:
    """Return the values of a part's own parameters as a vector."""
    return ca.vertcat(*part.local_values(named).values())


# --- the models


def _formula(part: Problem) -> Trimmed | ca.Function:
    data = part.response
    options: Any = {"input": data.input, "output": data.output, "at": part.at}
    options["pade"] = delay_order(part.delay)
    if part.amplitude is not None:
        return harmonic_function(part.model, data.omega, part.amplitude, **options)
    return response_formula(part.model, data.omega, **options)


def _mapped(parts: Sequence[Problem]) -> list[Mapped]:
    """Return the responses as formulas of one frequency if they are large; else none.

    All must have such a formula.
    """
    size = sum(part.response.omega.size * (len(part.declared) + 1) for part in parts)
    # Formulas have fewer than 300 instructions per frequency, so that small problems are recognized
    # without building them.
    if 300 * size < LARGE or any(part.amplitude is not None for part in parts):
        return []
    mapped = []
    for _, group in groupby(parts, lambda part: (id(part.model), part.at, part.delay)):
        alike = list(group)
        first, data = alike[0], [part.response for part in alike]
        formulas = formulas_at_one_frequency(
            first.model,
            np.unique(np.hstack([response.omega for response in data])),
            [(response.input, response.output) for response in data],
            at=first.at,
            pade=delay_order(first.delay),
        )
        if not formulas:
            return []
        mapped += [Mapped(*pair) for pair in zip(formulas, (d.omega for d in data), strict=True)]

    return mapped if sum(response.work for response in mapped) > LARGE else []


def _program_at_roots(
    problem: Problem | Sum[Problem],
    parts: Sequence[Problem],
    formulas: Sequence[Trimmed],
    values_at: Callable[[Any], Named],
    point: ca.SX,
    cost: Callable[[Sequence[Complex], Any], Any],
) -> CostProgram:
    """Return the program of responses at operating points that Newton's method finds."""
    z, smoothing = ca.MX.sym("z", point.numel()), ca.MX.sym("smoothing")
    sizes = [formula.function.numel_in(1) for formula in formulas]
    roots = [
        ca.MX(0, 1) if formula.root is None else formula.root(_values(part, values_at(z)))
        for part, formula in zip(parts, formulas, strict=True)
    ]

    # As an SX function of the point and the roots.
    named, s, w = values_at(point), ca.SX.sym("smoothing"), ca.SX.sym("w", sum(sizes))
    pieces = ca.vertsplit(w, np.cumsum([0, *sizes]).tolist())
    responses = []
    for part, formula, piece in zip(parts, formulas, pieces, strict=True):
        outputs: Any = formula.function(_values(part, named), piece)
        responses.append(Complex(*outputs))
    explicit = ca.Function(
        "explicit",
        [point, s, w],
        [ca.SX(cost(responses, s)), limits_at(problem, named, ca.SX)[1]],
        {"cse": True},
    )

    # The derivatives of `explicit` hold the roots: CasADi must not differentiate them too.
    at_roots: Any = ca.Function("roots", [z], [ca.vertcat(*roots)])
    outputs = explicit(z, smoothing, ca.stop_diff(at_roots(z), 1))
    function = ca.Function("program", [z, smoothing], outputs)
    return CostProgram(function, explicit=explicit, roots=at_roots)


# --- the costs


def _own_criterion(part: Problem) -> Criterion:
    assert isinstance(part.criterion, Criterion)
    return part.criterion


def _locator(part: Problem) -> Criterion:
    return _own_criterion(part).locator or _own_criterion(part)


def _costs(
    parts: Sequence[Problem],
    responses: Sequence[Complex],
    smoothing: Any,
    choose: ChooseCriterion,
) -> list[Any]:
    pairs = zip(parts, responses, strict=True)
    return [choose(part).cost(response, part.response, smoothing) for part, response in pairs]


def solver_weights(parts: Sequence[Problem]) -> list[float]:
    """Return the weights of responses, so small that the solver's tolerance can be reached.

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
    return [part.weight / unit for part in parts]
