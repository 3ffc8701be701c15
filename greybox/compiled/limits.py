"""The constraints of a problem and the bounds of its tied parameters, as functions >= 0."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.model import Names


@dataclass(frozen=True, eq=False)
class Limit:
    """A function of a part's values that must be >= 0: a constraint or a tied parameter's bound."""

    label: str
    part: Problem
    value: Callable[[Names], Any]


def limits_of(problem: Problem | Sum[Problem], kind: Any) -> list[Limit]:
    """Return all limits for this `kind` of symbols; a constraint that parts share counts once."""
    limits: dict[Any, Limit] = {}
    parameters = problem.parameters
    x = kind.sym("x", len(parameters))
    named = dict(zip(parameters, ca.vertsplit(x), strict=True))
    for part in problem.parts:
        for k, constraint in enumerate(part.constraints):
            # Formulas are compared as compiled: equal lambdas are different objects in Python.
            label = f"constraints[{k}] of {part.name!r}"
            value = ca.Function("value", [x], [kind(constraint(part.local_values(named)))])
            limits.setdefault((label, value.serialize()), Limit(label, part, constraint))
        for name in part.tied:
            sides = zip(("lower", "upper"), part.declared[name].bounds, (1, -1), strict=True)
            for side, bound, sign in sides:
                if math.isfinite(bound):
                    label = f"the {side} bound {bound:g} of the tied {part.outside(name)}"
                    # Default arguments keep the present value of each loop variable.
                    limit = Limit(label, part, lambda p, k=name, b=bound, s=sign: s * (p[k] - b))
                    limits.setdefault(label, limit)

    return list(limits.values())


def stacked(limits: Sequence[Limit], named: Mapping[str, Any], kind: Any) -> Any:
    """Return the limits (c,) at values by outside name."""
    return ca.vertcat(
        kind(0, 1), *[limit.value(limit.part.local_values(named)) for limit in limits]
    )
