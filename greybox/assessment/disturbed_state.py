"""Which state a slow disturbance reaches: the one whose effect the residuals show.

A disturbance of one state moves all outputs in a ratio and with delays that depend on the state and
on the frequency. White residuals have as much power along the effect of one state as along that of
another; a disturbance adds power along its own.
"""

import casadi as ca
import numpy as np

from greybox.assessment.misfit.equations import dynamic_equations
from greybox.data.files.arrays import Array, ComplexArray
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart

# Relative difference in power that is rounding: with a single output, all states are alike, and the
# first is named.
ALIKE = 1e-6


def disturbed_state(part: RecordPart, trajectory: Trajectory) -> str:
    """Return the name of the state that a slow disturbance reaches; the first of those alike."""
    weight = part.residual_weight(trajectory)
    residuals = np.nan_to_num(weight @ part.residuals(trajectory))
    lines = np.fft.rfft(residuals)[:, 1:].T
    angles = 2 * np.pi * np.arange(1, len(lines) + 1) / residuals.shape[1]
    effects = _effects(part, trajectory, weight, angles)

    places = reached_states(part)
    strength = np.zeros(len(places))
    for k, place in enumerate(places):
        effect = effects[..., place]
        size = np.linalg.norm(effect, axis=1) + 1e-300
        power = np.abs(np.einsum("lk,lk->l", effect.conj(), lines) / size) ** 2
        # Squares favor the few frequencies of a disturbance over the many of white noise.
        strength[k] = np.sum(power**2)

    is_strongest = strength >= (1 - ALIKE) * strength.max()
    return part.system.states[places[int(np.argmax(is_strongest))]]


def reached_states(part: RecordPart) -> list[int]:
    """Return the places of the states that gusts may reach: all dynamic ones but actuators.

    An actuator follows its input whatever the vehicle does: its equation has no other state, and no
    output shows it.
    """
    system = part.system
    x, u, p = system.symbols
    by_states = ca.jacobian(system.derivative(x, u, p), x).sparsity()
    of_outputs = ca.jacobian(system.output(x, u, p), x).sparsity()
    states, outputs = range(len(system.states)), range(len(system.outputs))

    def is_actuator(place: int) -> bool:
        follows = any(by_states.has_nz(place, other) for other in states if other != place)
        return not follows and not any(of_outputs.has_nz(k, place) for k in outputs)

    dynamic = [equation.index for equation in dynamic_equations(part)]
    return [place for place in dynamic if not is_actuator(place)] or dynamic


def _effects(
    part: RecordPart, trajectory: Trajectory, weight: Array, angles: Array
) -> ComplexArray:
    """Return the effects (l, k, n) of disturbances of n states on weighted residuals.

    At l angles per sample, by the mean linearization along a trajectory, its gains included.
    """
    transition, outputs = part.segments.mean_transition(trajectory.course)
    one = np.eye(len(transition))
    turned = np.exp(1j * angles)[:, None, None] * one
    # What adds to a derivative during a step moves its end by the mean of both transitions.
    moved = np.linalg.solve(turned - transition, (one + transition) / 2)
    return np.asarray(weight @ outputs @ moved, complex)
