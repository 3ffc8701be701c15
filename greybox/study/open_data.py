"""The cost of frequency responses as a function of the measured values.

Begin with `open_program`. A compiled problem contains its data as numbers, and hundreds of refits
would spend most of their time on compilations. Here they share one compilation: the measured values
are an input, and so are the constants of the problem, which an earlier fit may give with errors.
"""

from collections.abc import Iterable
from copy import copy
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.limits import limits_at
from greybox.compiled.response_programs import solver_weights
from greybox.files.arrays import Array, ComplexArray
from greybox.formulation.problem import Problem
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.one_thread import one_thread_at_a_time


def program_input(constants: Array, measured: Iterable[ComplexArray]) -> Array:
    """Return the third input of an `open_program`: constants, real parts, then imaginary parts."""
    values = np.concatenate(list(measured))
    return np.concatenate([constants, values.real, values.imag])


@one_thread_at_a_time
def open_program(nlp: CompiledProblem) -> ca.Function:
    """Return the function (z, smoothing, data) -> cost in the solver's units, limits (>= 0).

    Raises
    ------
    ValueError
        If a criterion accepts only numbers.
    """
    parts = nlp.problem.parts
    # SX expressions can be evaluated for many replicates at once; sines of finite amplitude need
    # MX.
    kind: Any = ca.SX if nlp.responses.is_a("SXFunction") else ca.MX
    z = kind.sym("z", len(nlp.free))
    smoothing = kind.sym("smoothing")
    # The real parts of all responses come first, then the imaginary parts.
    sizes = [len(part.data) for part in parts]
    ends = np.cumsum([0, *sizes, *sizes]).tolist()
    count = len(nlp.constants)
    numbers = kind.sym("data", count + ends[-1])
    measured = ca.vertsplit(numbers[count:], ends)
    values = [*nlp.scaling.expressions(z), *ca.vertsplit(numbers[:count])]
    modeled = ca.vertsplit(nlp.responses(ca.vertcat(*values)), ends)
    cost = kind(0)
    for k, (part, weight) in enumerate(zip(parts, solver_weights(parts), strict=True)):
        response = Complex(*modeled[k :: len(parts)])
        data = copy(part.response)  # a new one would check its values, which are symbols
        object.__setattr__(data, "response", _Measured(*measured[k :: len(parts)]))
        cost += weight * _cost(part, response, data, smoothing)
    named = dict(zip(nlp.names, values, strict=True))
    _, limits = limits_at(nlp.problem, named, kind)
    return ca.Function("program", [z, smoothing, numbers], [cost, limits])


class _Measured(Complex):
    """A measured response as symbols, with `np.abs`, which criteria use on data."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> Any:
        return abs(self) if ufunc is np.absolute else NotImplemented


def _cost(part: Problem, response: Complex, data: Any, smoothing: Any) -> Any:
    # A user's criterion may call numpy functions that do not take symbols.
    criterion: Any = part.criterion
    try:
        return criterion.cost(response, data, smoothing)
    except (TypeError, AttributeError, NotImplementedError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:120].rstrip(".")
        raise ValueError(
            f"{type(criterion).__name__} accepts only numbers ({reason}), but the bootstrap gives "
            "it symbols for the data: write its cost with data.response, abs and the functions of "
            "greybox."
        ) from error
