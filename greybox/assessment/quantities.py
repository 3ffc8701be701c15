"""The quantities of an answer: parameters, ties and derived quantities, with their errors."""

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from greybox.assessment.result import Quantity
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import attributes
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem
from greybox.engine.covariance.accuracy import Accuracy, degrees, propagate
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import entries_by_name


class Formula(NamedTuple):
    """A quantity that follows from the parameters of a part; `function` takes these by name."""

    name: str
    kind: Literal["tied", "derived"]
    unit: str
    about: str
    part: Problem
    function: Callable[[Any], Any]


@one_thread_at_a_time
def quantities(accuracy: Accuracy) -> tuple[tuple[Quantity, ...], Array, Array]:
    """Return all quantities, then the covariance and slopes (m, k) of the parameters.

    Parameters are free, fixed or tied; slopes are derivatives with respect to all values (k,). The
    errors of tied and derived quantities are of first order. NaN where the data do not determine a
    quantity.
    """
    nlp = accuracy.nlp
    x = nlp.all_values(accuracy.x)
    follow = formulas(nlp.problem)
    # Exact derivatives: finite differences would limit the errors of ratios of close values.
    function = quantity_function(nlp, [*nlp.names, *(formula.name for formula in follow)])
    values = function(x).full()
    slopes = function.jacobian()(x, 0).full()

    # Errors are propagated once for all lines.
    errors = propagate(accuracy, slopes)
    numbers = (values, errors, degrees(accuracy, slopes), slopes @ accuracy.bias)
    columns = np.column_stack(numbers).tolist()

    # Free parameters come first: `Fit.free` and all matrices of a fit rely on this order.
    lines = []
    for line, (value, error, dof, bias) in zip([*nlp.names, *follow], columns, strict=True):
        if isinstance(line, Formula):
            limit = f"of the tied {line.name}"
            stated = attributes(line, "name", "kind", "unit", "about")
            stated["at_bound"] = any(label.endswith(limit) for label in accuracy.active)
        else:
            declared = nlp.problem.parameters[line]
            stated = attributes(declared, "unit", "about", "bounds", "box", "has_computed_bounds")
            stated |= {"name": line, "kind": "fixed" if declared.fixed else "free"}
            stated["at_bound"] = line in accuracy.at_bound
        lines.append(Quantity(value=value, standard_error=error, dof=dof, bias=bias, **stated))

    of_parameters = slopes[[line.kind != "derived" for line in lines]]
    covariance = of_parameters @ accuracy.covariance @ of_parameters.T
    # The covariance within the determined directions is finite, and too small, for the others.
    unknown = np.isnan(errors[: len(covariance)])
    covariance[unknown | unknown[:, None]] = np.nan
    return tuple(lines), covariance, of_parameters


def parameter_values(nlp: CompiledProblem, x: Array) -> dict[str, float]:
    """Return free, fixed and tied parameters by name, where the free ones are `x` (p,)."""
    tied = (formula.name for formula in formulas(nlp.problem) if formula.kind == "tied")
    names = (*nlp.names, *tied)
    values = quantity_function(nlp, names)(nlp.all_values(x)).full()
    return dict(zip(names, values.ravel().tolist(), strict=True))


@one_thread_at_a_time
def quantity_function(nlp: CompiledProblem, names: Sequence[str]) -> ca.Function:
    """Return the named parameters and formulas as a function of all values (k,)."""
    x = ca.SX.sym("x", len(nlp.names))
    named = entries_by_name(nlp.names, x)
    every = named | {
        f.name: ca.SX(f.function(f.part.local_values(named))) for f in formulas(nlp.problem)
    }
    return ca.Function("quantities", [x], [ca.densify(ca.vertcat(*(every[n] for n in names)))])


def formulas(problem: AnyProblem) -> list[Formula]:
    """Return the tied parameters of a problem, then its derived quantities.

    The name of a derived quantity includes that of its part where the part renames or ties.
    """
    formulas_by_name: dict[str, Formula] = {}
    for part in problem.parts:
        for name in part.tied:
            declared = part.model.parameters[name]
            label, value = part.outside(name), itemgetter(name)
            formula = Formula(label, "tied", declared.unit, declared.about, part, value)
            formulas_by_name.setdefault(label, formula)

    used_names = {*problem.parameters, *formulas_by_name}
    for part in problem.parts:
        differs = bool(part.rename or part.tied) and len(problem.parts) > 1
        for name, function in part.model.derived.items():
            # Parts that name or tie parameters alike have the same derived quantity: it is one
            # line.
            label = f"{name} ({part.name})" if differs or name in used_names else name
            formulas_by_name.setdefault(label, Formula(label, "derived", "", "", part, function))

    return list(formulas_by_name.values())
