"""Steps along directions that the normal equations have lost in rounding.

The Hessian JᵀJ holds the squares of the singular values of J: of parameters whose effects differ by
less than a millionth, as a slope and an intercept far from the data, it holds no digit, and a step
along them is missing although the data determine them. A triangular factor of J itself has them.

Source: Björck (1996), Numerical Methods for Least Squares Problems, section 2.2.
"""

import math
from dataclasses import replace

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.gauss_newton.all_parts import AllParts
from greybox.solve.gauss_newton.iterate import Iterate, Step

# Least eigenvalue of a Hessian with unit diagonal, relative to the largest, below which it is not
# enough: rounding of some 1e-14 is then more than the hundred-thousandth part of a step.
BLURRED = 1e-9

# Singular value of a Jacobian with unit columns, relative to the largest, below which it is
# rounding as well.
RANK = 1e-8


def is_blurred(hessian: Array | None) -> bool:
    """Tell whether a Hessian (p, p) has lost digits that steps need."""
    if hessian is None:
        return False
    moving = np.diag(hessian) > 0
    size = np.sqrt(np.diag(hessian)[moving])
    values = np.linalg.eigvalsh(hessian[np.ix_(moving, moving)] / np.outer(size, size))
    return bool(values.size and values[0] < BLURRED * values[-1])


def sharp_step(nlp: CompiledProblem, parts: AllParts, iterate: Iterate, step: Step) -> Step:
    """Return a step of the same quadratic model, by a triangular factor of the Jacobian."""
    x = nlp.scaling.to_parameters(iterate.z)
    slope = nlp.scaling.slope(x)
    free = len(nlp.free)
    rows = []
    for part, trajectory in zip(nlp.parts, parts.split(iterate), strict=True):
        information = part.information(nlp.names, nlp.all_values(x), (), trajectory, slope)
        bread, _ = information.spread(1.0)
        rows.append(math.sqrt(part.weight * bread) * information.jacobian[:, :free] / slope)
    gradient = sum(
        (
            weight * system.gradient
            for weight, system in zip(parts.weights, step.condensed, strict=True)
        ),
        np.zeros(free),
    )
    jacobian = np.vstack(rows)
    size = np.linalg.norm(jacobian, axis=0)
    unit = 1 / np.where(size > 0, size, 1.0)
    _, singular, axes = np.linalg.svd(np.linalg.qr(jacobian * unit, mode="r"))
    seen = singular > RANK * singular[0]
    along = (axes @ (gradient * unit))[seen] / singular[seen]
    dz = -unit * (axes[seen].T @ (along / singular[seen]))
    squares = float(along @ along)
    return replace(step, dz=dz, decrease=squares / 2, distance=squares / 2)
