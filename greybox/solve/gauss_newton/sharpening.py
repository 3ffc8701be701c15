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
from greybox.solve.gauss_newton.homotopy import EXACT
from greybox.solve.gauss_newton.iterate import Iterate, Step
from greybox.solve.gauss_newton.line_search import line_search
from greybox.solve.gauss_newton.merit import merit_function
from greybox.solve.gauss_newton.polishing import MOST_STEPS, exact_step
from greybox.solve.gauss_newton.stability import are_stable


def is_blurred(hessian: Array | None) -> bool:
    """Tell whether a Hessian (p, p) has lost digits that steps need."""
    if hessian is None:
        return False
    moving = np.diag(hessian) > 0
    size = np.sqrt(np.diag(hessian)[moving])
    values = np.linalg.eigvalsh(hessian[np.ix_(moving, moving)] / np.outer(size, size))
    # Below this share, rounding of some 1e-14 is more than the hundred-thousandth part of a step.
    return bool(values.size and values[0] < 1e-9 * values[-1])


def sharpened(nlp: CompiledProblem, parts: AllParts, iterate: Iterate) -> Iterate:
    """Return where exact steps lead within all limits, where the Hessian has lost its digits."""
    progress = EXACT
    for _ in range(MOST_STEPS):
        step = sharp_step(nlp, parts, iterate, exact_step(parts, iterate, progress))
        normals, bounds = parts.limits.linearized(iterate.z)
        if step.decrease <= parts.settings.tolerance or np.any(normals @ step.dz < bounds):
            break
        progress = progress.with_penalties(step)
        merit = merit_function(parts, parts.residual_weights(iterate), progress)
        trial, _ = line_search(parts, iterate, step, merit, merit(iterate))
        if trial is None or not are_stable(parts, trial):
            break
        iterate = parts.made_continuous(trial, step)
    return iterate


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
    jacobian = np.vstack(rows)
    gradient = sum(
        (
            weight * system.gradient
            for weight, system in zip(parts.weights, step.condensed, strict=True)
        ),
        np.zeros(free),
    )

    size = np.linalg.norm(jacobian, axis=0)
    unit = 1 / np.where(size > 0, size, 1.0)
    _, singular, axes = np.linalg.svd(np.linalg.qr(jacobian * unit, mode="r"))
    determined = singular > 1e-8 * singular[0]  # smaller singular values are rounding as well
    along = (axes @ (gradient * unit))[determined] / singular[determined]
    dz = -unit * (axes[determined].T @ (along / singular[determined]))
    squares = float(along @ along)
    return replace(step, dz=dz, decrease=squares / 2, distance=squares / 2)
