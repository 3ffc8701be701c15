"""The step: the condensed systems of all parts add up to a quadratic program in the parameters."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.files.arrays import Array, BoolArray
from greybox.solve.gauss_newton.all_parts import AllParts
from greybox.solve.gauss_newton.homotopy import EXACTNESS, Progress
from greybox.solve.gauss_newton.iterate import Iterate, Step
from greybox.solve.gauss_newton.stability import stability_constraints
from greybox.solve.quadratic_program import solve_small_qp

# Slack, in scaled variables, of a constraint that holds a step: what the quadratic program leaves
# of zero.
ACTIVE = 1e-9


def gauss_newton_step(
    parts: AllParts,
    iterate: Iterate,
    linearizations: Sequence[Any],
    progress: Progress,
    *,
    held: BoolArray,
    states_only: bool,
) -> Step:
    """Return the step of nodes and z from an iterate; with `states_only` of the nodes alone.

    Levenberg-Marquardt damping scales with the diagonal of the Hessian. Variables that are `held`
    (p,) do not move.
    """
    settings = parts.settings
    p = len(iterate.z)
    variances = progress.continuity_variance
    node_damping = progress.damping if settings.damped_states else 0.0
    condensed = []
    hessian = np.zeros((p, p))
    gradient = np.zeros(p)
    decrease = 0.0
    each = zip(
        parts.parts, parts.weights, linearizations, iterate.trajectories, variances, strict=True
    )
    for part, weight, linearization, trajectory, variance in each:
        system = part.condense(linearization, trajectory, variance, node_damping)
        condensed.append(system)
        hessian += weight * system.hessian
        gradient += weight * system.gradient
        decrease += weight * system.decrease
    if states_only:
        return progress.update_multipliers(
            Step(linearizations, condensed, np.zeros(p), decrease, 0.0)
        )

    progress.hessian = hessian
    damping = progress.damping * np.diag(np.diag(hessian)) if settings.damped_parameters else 0.0
    damped = hessian + damping + settings.parameter_ridge * np.eye(p)
    normals, bounds = parts.limits.linearized(iterate.z, held)
    dz = solve_small_qp(damped, gradient, normals, bounds)
    if settings.stability_constraints:
        inside, left = stability_constraints(parts, iterate, dz)
        if len(left):
            normals, bounds = np.vstack([normals, inside]), np.concatenate([bounds, left])
            dz = solve_small_qp(damped, gradient, normals, bounds)

    force = damped @ dz + gradient
    multiplier = largest_multiplier(force, normals, normals @ dz - bounds)
    progress.constraint_penalty = max(progress.constraint_penalty, EXACTNESS * multiplier)
    distance = 0.5 * float(dz @ hessian @ dz)
    decrease += (
        progress.constraint_penalty * parts.limits.violation(iterate.z)
        - float(gradient @ dz)
        - distance
    )
    decrease += sum(
        w * system.damping_penalty(dz) for w, system in zip(parts.weights, condensed, strict=True)
    )
    return progress.update_multipliers(Step(linearizations, condensed, dz, decrease, distance))


def largest_multiplier(force: Array, normals: Array, slack: Array) -> float:
    """Return the largest multiplier of the constraints that hold a step, whose sum times `normals` is `force` (p,)."""
    active = slack <= ACTIVE
    if not active.any():
        return 0.0
    return float(np.abs(np.linalg.lstsq(normals[active].T, force, rcond=None)[0]).max())
