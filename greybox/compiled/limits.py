"""The constraints of a problem and the bounds of its tied parameters, as functions >= 0."""

import math
from typing import Any

import casadi as ca

from greybox.files.arrays import Labels, Strings
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.symbolic_reading import entries_by_name


def limits_of(problem: Problem | Sum[Problem], names: Labels) -> tuple[Strings, ca.Function]:
    """Return what must be >= 0, in words, and (values of these names) -> its values, stacked.

    A constraint that parts share counts once.
    """
    limits: dict[Any, tuple[str, Any]] = {}
    x = ca.SX.sym("x", len(names))
    for part in problem.parts:
        if not (part.constraints or part.tied):
            continue
        local = part.local_values(entries_by_name(names, x))
        for k, constraint in enumerate(part.constraints):
            # Formulas are compared as compiled: equal lambdas are different objects in Python.
            label, value = f"constraints[{k}] of {part.name!r}", ca.SX(constraint(local))
            formula = ca.Function("formula", [x], [value])
            limits.setdefault(formula.serialize(), (label, value))
        for name in part.tied:
            sides = zip(("lower", "upper"), part.declared[name].bounds, (1, -1), strict=True)
            for side, bound, sign in sides:
                if math.isfinite(bound):
                    label = f"the {side} bound {bound:g} of the tied {part.outside(name)}"
                    limits.setdefault(label, (label, sign * (local[name] - bound)))

    values = ca.vertcat(ca.SX(0, 1), *[value for _, value in limits.values()])
    return tuple(label for label, _ in limits.values()), ca.Function("constraint", [x], [values])
