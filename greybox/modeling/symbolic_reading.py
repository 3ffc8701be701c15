"""Evaluates a user's formula with CasADi expressions, with a clear message if that fails."""

import re
import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from numbers import Real
from typing import Any, Literal

import casadi as ca
import numpy as np

from greybox.data.files.wording import counted
from greybox.modeling.formula_arguments import Names
from greybox.modeling.formula_structure import has_switches, with_finite_slopes
from greybox.modeling.model import Model, ParameterFormula
from greybox.modeling.state_space import StateSpace
from greybox.modeling.traced_once import once

CURE = (
    "write it with p.NAME for parameters, + - * / **, gb.exp, gb.where, gb.maximum and the like, "
    "not with self.NAME for parameters, math, numpy, if, max or and."
)

ARGUMENTS = "write derivative(self, x, u, p), output(self, x, u, p) or response(self, s, p)."

# All threads share the filters of warnings: two threads that change them at once could leave them
# changed.
_FILTERS = threading.RLock()


def parameter_names(model: Model, p: Any) -> Names:
    """Name the entries of a parameter vector."""
    return Names(entries_by_name(model.parameters, p), model.label)


def entries_by_name(names: Iterable[str], column: Any) -> dict[str, Any]:
    """Return the entries (n,) of a column of CasADi by these names."""
    return dict(zip(names, ca.vertsplit(column), strict=True))


def as_column(entries: Iterable[Any]) -> ca.SX:
    """Return numbers and scalar expressions as a column (n, 1), also without any."""
    # The first part makes it an SX: numbers alone would be a DM.
    return ca.vertcat(ca.SX(0, 1), *entries)


def dense_jacobian(values: Any, by: Any) -> Any:
    """Return the Jacobian of expressions as a dense matrix."""
    # By default CasADi repeats what it calls for every 64 columns, and takes up to twice as many
    # columns as rows one after the other, with up to half more operations.
    options = {"max_num_dir": by.numel(), "ad_weight": 0.5}
    return ca.densify(ca.jacobian(values, by, {"helper_options": options}))


def symbols(model: Model) -> tuple[ca.SX, ca.SX]:
    """Return symbols of states and inputs (n + m,), and of parameters."""
    z = ca.SX.sym("z", len(model.state_names) + len(model.input_names))
    return z, ca.SX.sym("p", len(model.parameters))


def input_symbols(function: ca.Function) -> list[Any]:
    """Return new symbols for the inputs, of the kind that the function is made of."""
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym("v", *function.size_in(k)) for k in range(function.n_in())]


def split(model: StateSpace, z: Any) -> tuple[Names, Names]:
    """Name the states and the inputs in the stacked vector `z`."""
    n = len(model.states)
    x = Names({name: z[k] for k, name in enumerate(model.states)}, f"{model.label}.states")
    u = Names({name: z[n + k] for k, name in enumerate(model.inputs)}, f"{model.label}.inputs")
    return x, u


def traced(owner: str, formula: Callable[..., Any], *arguments: Any) -> Any:
    """Call a user's formula with CasADi expressions.

    Raises
    ------
    ValueError
        If CasADi or Python refuses the formula.
    """
    try:
        with _FILTERS, warnings.catch_warnings():
            # CasADi's long notice about numpy functions, which do work.
            warnings.simplefilter("ignore", FutureWarning)
            return formula(*arguments)
    except (RuntimeError, NotImplementedError, TypeError) as error:
        # The first line has the reason, behind a path in CasADi's own sources.
        reason = re.sub(r"^\.\.\./casadi\S+ ", "", str(error).strip().partition("\n")[0])
        # So Python begins when it calls a function with too many or too few arguments.
        cure = ARGUMENTS if reason.startswith(f"{formula.__qualname__}() ") else CURE
        raise ValueError(f"{owner} cannot be compiled ({reason.rstrip('.')}): {cure}") from error
    except AttributeError as error:
        name, model = error.name or "", getattr(formula, "__self__", None)
        if isinstance(error.obj, Names) and hasattr(model, name):
            raise AttributeError(
                f"{error} {name} is an attribute of the class: write self.{name}, or declare it as "
                "a gb.Parameter."
            ) from error
        raise


def called(what: str, function: ParameterFormula, p: Any) -> Any:
    """Call a user's function of the parameters; ValueError names it where it fails.

    The message of Python alone would not show which of the user's functions failed.
    """
    try:
        return traced(what, function, p)
    except (AttributeError, KeyError, ArithmeticError) as error:
        raise ValueError(f"{what}: {error}") from error


@once
def derivative_function(model: StateSpace) -> ca.Function:
    """Return the CasADi function (states and inputs, parameters) -> derivative."""
    z, p = symbols(model)
    return ca.Function("derivative", [z, p], [traced_column(model, "derivative", z, p)])


RAMP = (
    "Write the switch as a ramp one sample wide: gb.maximum(gb.minimum((a - b) / step + 0.5, 1), "
    "0) in place of a > b."
)


def switching_parameters(model: Model) -> tuple[str, ...]:
    """Return the parameters that a model's formulas contain only where they have no slope.

    These are thresholds in a condition or a sign, and what is rounded. Empty for a model without
    states and outputs.
    """
    return tuple(name for name, (_, slopes) in _formulas_of(model).items() if slopes.nnz() == 0)


def limited_parameters(model: Model) -> tuple[str, ...]:
    """Return the parameters that have a slope, but in formulas that switch: it may be zero here.

    These are limits and dead zones, and what acts beyond them. Empty for a model without states and
    outputs.
    """
    return tuple(
        name
        for name, (formulas, slopes) in _formulas_of(model).items()
        if slopes.nnz() > 0 and has_switches(formulas)
    )


def _formulas_of(model: Model) -> dict[str, tuple[ca.SX, ca.SX]]:
    """Return the formulas that contain each parameter and their slopes, if there are any."""
    if not isinstance(model, StateSpace):
        return {}
    z, p = symbols(model)
    formulas = ca.vertcat(
        traced_column(model, "derivative", z, p), traced_column(model, "output", z, p)
    )
    slopes = ca.sparsify(ca.jacobian(formulas, p))
    result = {}
    for k, name in enumerate(model.parameters):
        rows = [row for row in range(formulas.numel()) if ca.depends_on(formulas[row], p[k])]
        if rows:
            result[name] = formulas[rows], slopes[rows, k]
    return result


def state_starts(model: StateSpace, p: Any) -> list[Any]:
    """Return where the states (n,) begin in a search, for parameters by name; by default at 0."""
    starts = [(name, model.state_starts.get(name, 0.0)) for name in model.state_names]
    return [
        called(f"{model.label}.state_starts[{name!r}]", start, p) if callable(start) else start
        for name, start in starts
    ]


def as_list(result: Any) -> list[Any]:
    """Return the values of a derivative or an output as a list; a single value needs no tuple."""
    return list(result) if isinstance(result, tuple | list) else [result]


def column(owner: str, values: Sequence[Any]) -> ca.SX:
    """Stack scalar expressions; ValueError names a value that is not an expression."""
    for k, value in enumerate(values):
        if not isinstance(value, Real | ca.SX | ca.DM):
            is_container = isinstance(value, dict | np.ndarray | None)
            cure = "return a tuple of expressions." if is_container else CURE
            raise ValueError(
                f"{owner} gives a {type(value).__name__} as value {k}, not an expression: {cure}"
            )
        if isinstance(value, ca.SX | ca.DM) and not value.is_scalar():
            raise ValueError(
                f"{owner} gives {value.numel()} numbers as value {k}: return one scalar for each."
            )

    return require_no_nan(owner, as_column(values))


def require_no_nan(owner: str, expression: ca.SX) -> ca.SX:
    """Refuse an expression that contains NaN, which `math.sin` silently returns for a symbol."""
    # A constant NaN is an instruction of the formula, whatever the symbols are.
    function = ca.Function("scan", ca.symvar(expression), [expression])
    for k in range(function.n_instructions()):
        if function.instruction_id(k) == ca.OP_CONST and np.isnan(function.instruction_constant(k)):
            raise ValueError(
                f"{owner} becomes NaN when it is compiled, as math.sin of an expression does: "
                f"{CURE}"
            )
    return expression


def traced_column(
    model: StateSpace, formula: Literal["derivative", "output"], z: ca.SX, p: ca.SX
) -> ca.SX:
    """Evaluate the derivative (n, 1) or the output (k, 1) of a model on expressions."""
    owner = f"{model.label}.{formula}"
    names = model.states if formula == "derivative" else model.outputs
    arguments = *split(model, z), parameter_names(model, p)
    values = as_list(traced(owner, getattr(model, formula), *arguments))
    if len(values) != len(names):
        raise ValueError(
            f"{owner} returns {counted(len(values), 'value')} and must return {len(names)}, as a "
            f"tuple: one for each of {', '.join(names)}."
        )

    return with_finite_slopes(column(owner, values))
