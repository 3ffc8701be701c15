"""The change of variables between parameters and what a solver sees."""

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.files.arrays import Array, BoolArray, frozen
from greybox.modeling.parameter import Parameter


@frozen
class Scaling:
    """Parameters x and the solver's variables z, (..., p) each: x = factor · z, or x = exp(z)."""

    factor: Array
    logarithmic: BoolArray

    def to_solver(self, x: Array) -> Array:
        """Return z for x, along the last axis."""
        # A lower bound of zero has no logarithm: -inf, no bound, is right.
        with np.errstate(divide="ignore"):
            return np.where(
                self.logarithmic, np.log(np.where(self.logarithmic, x, 1.0)), x / self.factor
            )

    def to_parameters(self, z: Array) -> Array:
        """Return x for z, along the last axis."""
        return np.where(
            self.logarithmic, np.exp(np.where(self.logarithmic, z, 0.0)), z * self.factor
        )

    def slope(self, x: Array) -> Array:
        """Return dz/dx (p,)."""
        return 1 / np.where(self.logarithmic, x, self.factor)

    def expressions(self, z: Any) -> list[Any]:
        """Return x for a CasADi vector z."""
        return [
            ca.exp(z[k]) if log else z[k] * float(f)
            for k, (f, log) in enumerate(zip(self.factor, self.logarithmic, strict=True))
        ]


def scaling_of(parameters: Sequence[Parameter]) -> Scaling:
    """Return the scaling of the unknowns."""
    return Scaling(
        factor=np.array([_size(p) for p in parameters], dtype=float),
        logarithmic=np.array([p.scale == "log" for p in parameters]),
    )


def _size(parameter: Parameter) -> float:
    """Return the larger end of the start box: IPOPT takes half the time that it takes unscaled.

    Wider bounds would not do: IPOPT pushes starts away from bounds by a share of their distance.
    """
    for pair in (parameter.box, parameter.bounds, (parameter.start, parameter.start)):
        finite = [abs(v) for v in pair if math.isfinite(v) and v != 0]
        if finite:
            return max(finite)
    return 1.0
