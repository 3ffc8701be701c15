"""The cost of frequency responses as a function of their data, so that many data sets share one compilation.

A compiled problem contains its data as numbers, and hundreds of refits would spend most of their
time on compilations. Here frequencies, measured values and their errors are an input, and so are
the constants of the problem, which an earlier fit may give with errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.limits import limits_of, stacked
from greybox.compiled.response_map import LARGE
from greybox.compiled.response_programs import response_options, solver_weights
from greybox.data.frequency_response import FrequencyResponse
from greybox.files.arrays import Array
from greybox.formulation.problem import Problem
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.linear_response import formula_at_one_frequency
from greybox.modeling.one_thread import one_thread_at_a_time

ROWS = ("omega", "re", "im", "coherence", "variance", "dof")


def data_table(data: FrequencyResponse) -> Array:
    """Return the numbers of a response, `ROWS` by points; NaN for missing ones."""
    rows = [
        data.omega,
        data.response.real,
        data.response.imag,
        data.coherence,
        data.variance,
        data.dof,
    ]
    return np.array([np.full(len(data), np.nan) if row is None else row for row in rows])


def program_input(constants: Array, counts: Array, tables: Sequence[Array]) -> Array:
    """Return the third input of an `open_program`: constants, the count of every part, and its table."""
    return np.concatenate([constants, counts, *(table.ravel() for table in tables)])


def formulas_of_frequency(nlp: CompiledProblem) -> list[ca.Function] | None:
    """Return (parameters, frequency) -> response of every part of a problem of responses; None if one has none.

    A part has none if its trim is found by Newton's method, or if the response is that to a sine of
    finite amplitude.
    """
    formulas = []
    for part in nlp.problem.parts:
        formula = None
        if part.amplitude is None:
            options = response_options(part)
            formula = formula_at_one_frequency(part.model, part.response.omega, **options)
        if formula is None:
            return None
        formulas.append(formula)
    return formulas


def open_program(
    nlp: CompiledProblem, formulas: Sequence[ca.Function] | None, sizes: Sequence[int]
) -> ca.Function:
    """Return the function (z, smoothing, data) -> cost in the solver's units, limits that must be >= 0.

    Without `formulas` the frequencies in the data have no effect: they are those of the problem.

    Parameters
    ----------
    nlp : CompiledProblem
    formulas : sequence of casadi.Function, or None
        From `formulas_of_frequency`.
    sizes : sequence of int
        Number of points of every part.

    Raises
    ------
    ValueError
        If a criterion accepts numbers alone.
    """
    parts = nlp.problem.parts
    small = all(f.is_a("SXFunction") for f in formulas or [nlp.responses])
    if formulas is not None:
        small &= (
            sum(
                f.n_instructions() * n * (len(nlp.free) + 1)
                for f, n in zip(formulas, sizes, strict=True)
            )
            < LARGE
        )
    kind: Any = ca.SX if small else ca.MX
    z, smoothing = kind.sym("z", len(nlp.free)), kind.sym("smoothing")
    lengths = [len(nlp.constants), len(parts), *(len(ROWS) * size for size in sizes)]
    numbers = kind.sym("data", sum(lengths))
    constants, counts, *tables = ca.vertsplit(numbers, np.cumsum([0, *lengths]).tolist())
    values = [*nlp.scaling.expressions(z), *ca.vertsplit(constants)]
    named = dict(zip(nlp.names, values, strict=True))
    local = [part.local_values(named) for part in parts]
    if formulas is None:
        responses = _at_own_frequencies(nlp, ca.vertcat(*values))
    else:
        responses = [
            _response(formula, ca.vertcat(*p.values()), table[:size])
            for formula, p, table, size in zip(formulas, local, tables, sizes, strict=True)
        ]
    costs = [
        count * weight * _cost(part, response, _open(part.response, table, size), smoothing)
        for part, weight, count, response, table, size in zip(
            parts,
            solver_weights(parts),
            ca.vertsplit(counts),
            responses,
            tables,
            sizes,
            strict=True,
        )
    ]
    limits = stacked(limits_of(nlp.problem, kind), named, kind)
    return ca.Function("program", [z, smoothing, numbers], [kind(sum(costs)), limits])


class _Measured(Complex):
    """A measured response as symbols, with `np.abs`, which criteria use on data."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> Any:
        return abs(self) if ufunc is np.absolute else NotImplemented


@dataclass(frozen=True, eq=False)
class _OpenData:
    """The fields of a `FrequencyResponse` that criteria use, as symbols; None for missing ones."""

    omega: Any
    response: _Measured
    coherence: Any
    variance: Any
    dof: Any

    def __len__(self) -> int:
        return self.omega.numel()


def _open(data: FrequencyResponse, table: Any, size: int) -> Any:
    """Return the rows of a table as data with the same fields as these."""
    omega, re, im, coherence, variance, dof = ca.vertsplit(table, size)
    return _OpenData(
        omega,
        _Measured(re, im),
        None if data.coherence is None else coherence,
        None if data.variance is None else variance,
        None if data.dof is None else dof,
    )


def _cost(part: Problem, response: Complex, data: Any, smoothing: Any) -> Any:
    criterion: Any = part.criterion
    try:
        return criterion.cost(response, data, smoothing)
    except (TypeError, AttributeError, NotImplementedError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:120].rstrip(".")
        raise ValueError(
            f"{type(criterion).__name__} accepts numbers alone ({reason}), and many data sets are fitted at once as "
            "symbols: write its cost with data.response, abs and the functions of greybox."
        ) from error


@one_thread_at_a_time
def _response(formula: ca.Function, p: Any, omega: Any) -> Complex:
    if isinstance(omega, ca.SX):
        values = [formula(p, omega[k]) for k in range(omega.numel())]
        return Complex(ca.vertcat(*[re for re, _ in values]), ca.vertcat(*[im for _, im in values]))
    re, im = formula.map("responses", "serial", omega.numel(), [0], [])(p, omega.T)
    return Complex(re.T, im.T)


def _at_own_frequencies(nlp: CompiledProblem, values: Any) -> list[Complex]:
    stacked: Any = nlp.responses(values)
    count = stacked.numel() // 2
    responses = []
    begin = 0
    for part in nlp.problem.parts:
        end = begin + len(part.data)
        responses.append(Complex(stacked[begin:end], stacked[count + begin : count + end]))
        begin = end
    return responses
