"""The step: the condensed systems of all parts add up to a quadratic program in the parameters."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.solve.gauss_newton.all_parts import AllParts
from greybox.engine.solve.gauss_newton.iterate import Iterate, Progress, Step
from greybox.engine.solve.gauss_newton.stability import stable_step
from greybox.engine.solve.quadratic_program import solve_small_qp

# Penalties exceed the largest multiplier so far by this factor: an l1 merit function is exact when
# they are larger, and 1 would leave the sign of the directional derivative to rounding (Nocedal and
# Wright, section 18.3).
EXACTNESS = 1.2


def gauss_newton_step(
    parts: AllParts,
    iterate: Iterate,
    linearizations: Sequence[Any],
    progress: Progress,
    *,
    states_only: bool = False,
) -> Step:
    """Return the step of nodes and z from an iterate; with `states_only` of the nodes alone."""
    p = len(iterate.z)
    variances = [None] * len(parts.parts) if progress.is_exact else progress.continuity_variance
    systems: list[Any] = []
    hessian = np.zeros((p, p))
    gradient = np.zeros(p)
    decrease = distance = 0.0
    for part, trajectory, linearization, variance in parts.along(
        iterate, linearizations, variances
    ):
        weight = part.residual_weight(trajectory) if progress.is_exact else part.initial_weight()
        system = part.condense(linearization, trajectory, variance, progress.damping, weight=weight)
        hessian += part.weight * system.hessian
        gradient += part.weight * system.gradient
        decrease += part.weight * system.decrease
        systems.append(system)

    dz = np.zeros(p)
    penalty = progress.constraint_penalty
    if not states_only:
        # The ridge, far below what data determine, holds parameters that the data do not show. A
        # gain of 1e6 Pa per m/s has little information per unit, and nothing that scales it.
        ridge = 1e-10 / np.maximum(parts.is_gain * iterate.z**2, 1.0)
        damped = hessian + np.diag(ridge + progress.damping * np.diag(hessian))
        constraints = parts.limits.linearized(iterate.z, progress.held)
        solve = partial(solve_small_qp, damped, gradient)
        dz, normals, bounds = stable_step(parts, iterate, constraints, solve)

        force = damped @ dz + gradient
        multiplier = largest_multiplier(force, normals, normals @ dz - bounds)
        penalty = max(penalty, EXACTNESS * multiplier)
        distance = 0.5 * float(dz @ hessian @ dz)
        decrease += penalty * parts.limits.violation(iterate.z) - float(gradient @ dz) - distance
        for part, system in zip(parts.parts, systems, strict=True):
            decrease += part.weight * system.damping_penalty(dz)

    multipliers: list[Array] = []
    if progress.is_exact:
        multipliers = [EXACTNESS * system.largest_multiplier(dz) for system in systems]

        # Penalties only grow: with smaller ones two iterations could undo each other.
        if progress.multipliers:
            multipliers = list(map(np.maximum, progress.multipliers, multipliers))
    return Step(
        linearizations,
        systems,
        dz,
        float(decrease),
        distance,
        gradient,
        hessian,
        multipliers,
        penalty,
    )


def exact_step(parts: AllParts, iterate: Iterate, progress: Progress) -> Step:
    """Return the step where continuity is exact."""
    weights = parts.residual_weights(iterate)
    return gauss_newton_step(parts, iterate, parts.linearize(iterate, weights), progress)


def largest_multiplier(force: Array, normals: Array, slack: Array) -> float:
    """Return the largest multiplier of the active constraints, which balance `force` (p,)."""
    active = slack <= 1e-9  # in scaled variables: what the quadratic program leaves of zero
    if not active.any():
        return 0.0
    return float(np.abs(np.linalg.lstsq(normals[active].T, force)[0]).max())
