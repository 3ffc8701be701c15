"""Parameter bounds at which a fractional power has an infinite slope, such as sqrt(x) at x = 0."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray
from greybox.data.record import Record
from greybox.modeling.formula_structure import ROOTS, operations, program_of
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import symbols, traced_column

# Distance that a search keeps from such a bound, in the solver's variables, whose start boxes end
# near one.
MARGIN = 1e-9

# Distances from a bound, as shares of the largest distance, at which slopes are compared. The slope
# of a square root differs by a factor of a thousand between them, a finite slope by rounding only.
NEAR, FAR = 1e-12, 1e-6


def steep_bounds(
    parts: Sequence[Problem], names: Sequence[str], values: Array, bound: Array, size: Array
) -> BoolArray:
    """Return at which of the bounds (p,) a fractional power has no finite slope: (p,) booleans.

    A search that ends at such a bound has no slope along which it could leave. This includes
    guarded roots, such as sqrt(max(x, 0)), whose slope at the bound is zero.

    Parameters
    ----------
    parts : sequence of Problem
    names : sequence of str
        Names of the parameters, p unknowns first.
    values : (k,) array
        Values of all parameters. Slopes are evaluated there, except for the unknown at its bound.
    bound : (p,) array
    size : (p,) array
        Largest distance that each unknown moves from the bound, with the sign of the inward
        direction; zero for a logarithmic scale, which has no bound.
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
        model_parameters = ca.vertcat(*(ca.SX(local[name]) for name in part.model.parameters))
        # Generic states and inputs, without special values such as zero: a slope that is infinite
        # only for some of them is not caused by the bound.
        signals = 1 + np.arange(z.numel()) / 7
        by_parameter = ca.Function("slopes", [z, p], [ca.jacobian(formulas, p)])
        slopes = by_parameter(signals, model_parameters) @ ca.jacobian(model_parameters, x)
        function = ca.Function("slopes", [x], [slopes])

        for k in np.flatnonzero(np.isfinite(bound)).tolist():
            near = _sizes(function, values, k, bound[k] + NEAR * size[k])
            far = _sizes(function, values, k, bound[k] + FAR * size[k])
            # The slope of a root grows by a power of the ratio of distances. A finite slope does
            # not change.
            steep[k] |= bool(np.any(np.isfinite(far) & (far > 0) & (near > 2 * far)))
    return steep


def _sizes(function: ca.Function, values: Array, k: int, value: float) -> Array:
    """Return the magnitudes (n,) of the slopes with respect to unknown k, at this value of it."""
    moved = values.copy()
    moved[k] = value
    return np.abs(function(moved).full()[:, k])
