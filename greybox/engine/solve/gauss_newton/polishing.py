"""Undamped steps beyond the tolerance of a run, also where the normal equations have lost digits.

The Hessian JᵀJ holds the squares of the singular values of J. It has no correct digit for
parameters whose effects differ by less than a millionth, such as a slope and an intercept far from
the data: a step along them is missing although the data determine them. A triangular factor of J
itself keeps these digits. Source: Björck (1996), Numerical Methods for Least Squares Problems,
section 2.2.
"""

import math
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array, positive_or_one
from greybox.engine.solve.gauss_newton.all_parts import AllParts
from greybox.engine.solve.gauss_newton.iterate import EXACT, Iterate, Step
from greybox.engine.solve.gauss_newton.iteration import descend, followed
from greybox.engine.solve.gauss_newton.line_search import line_search, merit_function
from greybox.engine.solve.gauss_newton.normal_equations import exact_step
from greybox.engine.solve.gauss_newton.stability import are_stable
from greybox.statistics.column_space import triangle_of

# Steps that polish a minimum, at most: those of a model that hardly explains the data shrink by a
# third only.
MOST_STEPS = 50

# Squared length of an undamped step above which damped steps come first: it is in a narrow curved
# valley. Runs that end with more to gain than settled ones had only noise left.
LONG_STEP = 1e-7

ROUNDING = float(np.finfo(float).eps)


def polished(parts: AllParts, start: Iterate) -> Iterate:
    """Return where undamped steps lead, as long as they grow shorter.

    They are judged by their length in standard errors, since the cost no longer shows them.
    """
    end, distance = _undamped(parts, start)
    # Initial states that the data hardly determine may creep on, which moves no parameter.
    if LONG_STEP < distance < EXACT.undamped_decrease:
        damped = descend(parts, end, replace(EXACT, undamped_decrease=LONG_STEP), MOST_STEPS)
        end, _ = _undamped(parts, damped.iterate)
    return end


def _undamped(parts: AllParts, iterate: Iterate) -> tuple[Iterate, float]:
    """Return the end of undamped steps, and the squared length of the next one."""
    progress = EXACT
    end = iterate
    shortest = distance = math.inf
    for _ in range(MOST_STEPS):
        step = exact_step(parts, iterate, progress)
        progress = progress.with_penalties(step)

        # The gaps between segments promise this much more than the step itself.
        promise = abs(step.decrease - step.distance)
        # Below the rounding of the cost it ends no steps: parameters would lack 1e-7 of an error.
        if promise <= ROUNDING * abs(parts.cost(iterate)):
            promise = 0.0
        remaining = 2 * step.distance + promise
        # The step is below 1e-9 standard errors, or 1e-12 of every parameter, which long records
        # determine to many digits: only rounding is left.
        is_last = remaining < 1e-18 or np.all(np.abs(step.dz) <= 1e-12 * np.abs(iterate.z))
        # Steps that no longer shrink are rounding.
        if not (is_last or remaining < shortest):
            break
        end = iterate
        shortest = remaining
        distance = 2 * step.distance

        following = None if is_last else followed(parts, iterate, step)
        del step  # for a long record, a tenth of the memory
        if following is None:
            break
        iterate = following
    return end, distance


def is_blurred(hessian: Array | None) -> bool:
    """Return whether a Hessian (p, p) has lost digits that steps need."""
    if hessian is None:
        return False
    moving = np.diag(hessian) > 0
    size = np.sqrt(np.diag(hessian)[moving])
    values = np.linalg.eigvalsh(hessian[np.ix_(moving, moving)] / np.outer(size, size))
    # Below this share, rounding errors of about 1e-14 exceed 1e-5 of a step.
    return bool(values.size and values[0] < 1e-9 * values[-1])


def sharpened(parts: AllParts, iterate: Iterate) -> Iterate:
    """Return where exact steps lead within all limits, where the Hessian has lost its digits."""
    progress = EXACT
    for _ in range(MOST_STEPS):
        step = sharp_step(parts, iterate, exact_step(parts, iterate, progress))
        normals, bounds = parts.limits.linearized(iterate.z)

        # Where a bound stops the step, the quadratic program has found the end.
        if step.decrease <= parts.settings.tol or np.any(normals @ step.dz < bounds):
            break
        progress = progress.with_penalties(step)
        merit = merit_function(parts, parts.residual_weights(iterate), progress)
        trial, _ = line_search(parts, iterate, step, merit, merit(iterate))
        if trial is None or not are_stable(parts, trial):
            break
        iterate = parts.made_continuous(trial, step)
    return iterate


def sharp_step(parts: AllParts, iterate: Iterate, step: Step) -> Step:
    """Return a step of the same quadratic model, by a triangular factor of the Jacobian."""
    nlp = parts.nlp
    x = nlp.scaling.to_parameters(iterate.z)
    slope = nlp.scaling.slope(x)
    free = len(nlp.free)
    rows = []
    for part, trajectory in zip(nlp.parts, parts.groups.split(iterate.trajectories), strict=True):
        information = part.information(nlp.names, nlp.all_values(x), (), trajectory, slope)
        bread, _ = information.spread(1.0)
        rows.append(math.sqrt(part.weight * bread) * information.jacobian[:, :free] / slope)
    jacobian = np.vstack(rows)

    size = np.linalg.norm(jacobian, axis=0)
    unit = 1 / positive_or_one(size)
    _, singular, axes = np.linalg.svd(triangle_of(jacobian * unit))
    determined = singular > 1e-8 * singular[0]  # smaller singular values are rounding as well
    along = (axes @ (step.gradient * unit))[determined] / singular[determined]
    dz = -unit * (axes[determined].T @ (along / singular[determined]))
    squares = float(along @ along)
    return replace(step, dz=dz, decrease=squares / 2, distance=squares / 2)
