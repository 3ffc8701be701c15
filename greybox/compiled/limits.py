"""The constraints of a problem and the bounds of its tied parameters, as functions >= 0."""

import math
from collections.abc import Mapping
from typing import Any

import casadi as ca

from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum


def limits_at(
    problem: Problem | Sum[Problem], named: Mapping[str, Any], kind: Any
) -> tuple[tuple[str, ...], Any]:
    """Return what must be >= 0, in words, and its values (c,) at values by outside name.

    `kind` is that of the symbols. A constraint that parts share counts once.
    """
    limits: dict[Any, tuple[str, Any]] = {}
    x = kind.sym("x", len(problem.parameters))
    symbols = dict(zip(problem.parameters, ca.vertsplit(x), strict=True))
    for part in problem.parts:
        local = part.local_values(named)
        for k, constraint in enumerate(part.constraints):
            # Formulas are compared as compiled: equal lambdas are different objects in Python.
            label = f"constraints[{k}] of {part.name!r}"
            formula = ca.Function("formula", [x], [kind(constraint(part.local_values(symbols)))])
            limits.setdefault((label, formula.serialize()), (label, constraint(local)))
        for name in part.tied:
            sides = zip(("lower", "upper"), part.declared[name].bounds, (1, -1), strict=True)
            for side, bound, sign in sides:
                if math.isfinite(bound):
                    label = f"the {side} bound {bound:g} of the tied {part.outside(name)}"
                    limits.setdefault(label, (label, sign * (local[name] - bound)))

    labels = tuple(label for label, _ in limits.values())
    return labels, ca.vertcat(kind(0, 1), *[value for _, value in limits.values()])
