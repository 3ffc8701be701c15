"""The lines of an answer: parameters, tied values and derived quantities, each with its standard error."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import AnyProblem, Nlp
from greybox.estimate.covariance import Accuracy, degrees, propagate
from greybox.estimate.result import Quantity
from greybox.formulation.problem import Problem


class Formula(NamedTuple):
    """A quantity that follows from the parameters: `of` takes their values by outside name."""

    name: str
    kind: Literal["tied", "derived"]
    unit: str
    about: str
    of: Callable[[Mapping[str, Any]], Any]


def quantities(
    nlp: Nlp, accuracy: Accuracy, estimate: Mapping[str, float]
) -> tuple[tuple[Quantity, ...], tuple[str, ...], NDArray[np.float64]]:
    """Return all lines, and the names and covariance matrix of free, fixed and tied parameters.

    Errors of tied and derived quantities follow to first order from the gradient. NaN stands for what the data do not
    determine.
    """
    formulas = _tied(nlp.problem) + _derived(nlp.problem)
    values, gradients = _evaluated(nlp, formulas, estimate)
    rows = np.vstack([np.eye(len(nlp.names)), gradients])
    errors = propagate(accuracy, rows)
    bare = [_parameter(nlp, accuracy, name, estimate[name]) for name in nlp.names]
    bare += [_line(formula, float(value), accuracy) for formula, value in zip(formulas, values, strict=True)]
    lines = [
        replace(line, standard_error=float(error), dof=float(dof))
        for line, error, dof in zip(bare, errors, degrees(accuracy, rows), strict=True)
    ]
    named = [line for line in lines if line.kind != "derived"]
    rows, known = rows[: len(named)], errors[: len(named)] + errors[: len(named), None]
    return tuple(lines), tuple(line.name for line in named), np.where(np.isnan(known), np.nan, _product(rows, accuracy))


def _product(rows: NDArray[np.float64], accuracy: Accuracy) -> NDArray[np.float64]:
    return rows @ accuracy.covariance @ rows.T


def _line(formula: Formula, value: float, accuracy: Accuracy) -> Quantity:
    hit = formula.kind == "tied" and any(text.endswith(f"of the tied {formula.name}") for text in accuracy.active)
    return Quantity(formula.name, value, math.nan, formula.kind, formula.unit, formula.about, at_bound=hit)


def _parameter(nlp: Nlp, accuracy: Accuracy, name: str, value: float) -> Quantity:
    declared = nlp.problem.parameters[name]
    kind = "fixed" if declared.fixed else "free"
    hit = name in accuracy.at_bound
    return Quantity(name, value, math.nan, kind, declared.unit, declared.about, declared.bounds, hit)


def _evaluated(
    nlp: Nlp, formulas: list[Formula], estimate: Mapping[str, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the values (f,) and gradients (f, k) with respect to all values."""
    symbols = ca.SX.sym("x", len(nlp.names))
    named = dict(zip(nlp.names, ca.vertsplit(symbols), strict=True))
    stacked = ca.vertcat(ca.SX(0, 1), *[ca.SX(formula.of(named)) for formula in formulas])
    both = ca.Function("quantities", [symbols], [stacked, ca.jacobian(stacked, symbols)])
    value, gradient = both([estimate[name] for name in nlp.names])
    return np.asarray(value).ravel(), np.asarray(ca.DM(gradient)).reshape(len(formulas), len(nlp.names))


def _tied(problem: AnyProblem) -> list[Formula]:
    found: dict[str, Formula] = {}
    for part in problem.parts:
        for name in part.tied:
            outside, declared = part.rename.get(name, name), part.model.parameters[name]
            found.setdefault(outside, Formula(outside, "tied", declared.unit, declared.about, _tie(part, name)))
    return list(found.values())


def _derived(problem: AnyProblem) -> list[Formula]:
    """List the derived quantities; parts that rename parameters or tie them have their own, named after the part."""
    taken = {*problem.parameters, *(formula.name for formula in _tied(problem))}
    found: dict[str, Formula] = {}
    for position, part in enumerate(problem.parts):
        for name, function in part.model.derived.items():
            own = bool(part.rename or part.tied) and len(problem.parts) > 1
            label = f"{name} ({part.name})" if own or name in taken else name
            label = f"{name} (part {position})" if own and label in found else label
            found.setdefault(label, Formula(label, "derived", "", "", _derivation(part, function)))
    return list(found.values())


def _tie(part: Problem, name: str) -> Callable[[Mapping[str, Any]], Any]:
    return lambda values: part.local_values(values)[name]


def _derivation(part: Problem, function: Callable[[Any], Any]) -> Callable[[Mapping[str, Any]], Any]:
    return lambda values: function(part.local_values(values))
