"""Bounds at which a formula is infinitely steep, as a root is at zero."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray
from greybox.data.record import Record
from greybox.modeling.formula_structure import ROOTS, operations, program_of
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import symbols, traced_column

# Of the solver's variables, whose start boxes end near one: how far a search stays away.
MARGIN = 1e-9


def steep_bounds(
    parts: Sequence[Problem], names: Sequence[str], values: Array, bound: Array, size: Array
) -> BoolArray:
    """Return at which of the bounds (p,) a root in a formula has no finite slope: (p,) booleans.

    A search that ends there has no slope along which it could leave, also where a guard of the root
    gives it the slope zero.

    Parameters
    ----------
    parts : sequence of Problem
    names : sequence of str
        Names of the parameters, p unknowns first.
    values : (k,) array
        Where the other parameters are.
    bound : (p,) array
    size : (p,) array
        How far from the bound each unknown moves at most; with the sign of the direction inward.
    """
    steep = np.zeros(len(bound), dtype=bool)
    x = ca.SX.sym("x", len(names))
    named = dict(zip(names, ca.vertsplit(x), strict=True))
    for part in parts:
        if not (isinstance(part.model, StateSpace) and isinstance(part.data, Record)):
            continue
        z, p = symbols(part.model)
        formulas = ca.vertcat(
            traced_column(part.model, "derivative", z, p), traced_column(part.model, "output", z, p)
        )
        if ROOTS.isdisjoint(operations(program_of(formulas))):
            continue
        local = part.local_values(named)
        inside = ca.vertcat(*(ca.SX(local[name]) for name in part.model.parameters))
        # Any states and inputs: a slope that is infinite at one place only is not that of a bound.
        signals = 1 + np.arange(z.numel()) / 7
        by_parameter = ca.Function("slopes", [z, p], [ca.jacobian(formulas, p)])
        slopes = by_parameter(signals, inside) @ ca.jacobian(inside, x)
        function = ca.Function("slopes", [x], [slopes])

        for k in np.flatnonzero(np.isfinite(bound)).tolist():
            near, far = (
                _sizes(function, values, k, bound[k] + share * size[k]) for share in (1e-12, 1e-6)
            )
            # A root's slope grows by a power of the ratio; a smooth one stays the same.
            steep[k] |= bool(np.any(np.isfinite(far) & (far > 0) & (near > 2 * far)))
    return steep


def _sizes(function: ca.Function, values: Array, k: int, value: float) -> Array:
    """Return the magnitudes (n,) of the slopes for unknown k, at a value of it."""
    moved = values.copy()
    moved[k] = value
    return np.abs(function(moved).full()[:, k])
