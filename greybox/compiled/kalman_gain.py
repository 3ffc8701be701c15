"""The Kalman gain of a record in innovations form: its stability, and initial values.

A predictor x[k+1] = F(x[k] + K e[k], u) whose poles lie within the unit circle forgets its initial
state. It can be simulated from the first sample of a stretch to the last: an unstable plant does
not diverge, and no nodes are needed in between.
"""

import math
from collections.abc import Sequence
from typing import cast

import numpy as np

from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.riccati import reached, steady_state_gain
from greybox.compiled.segmented_part import Placed
from greybox.files.arrays import Array, IntArray, all_finite, frozen
from greybox.modeling.one_thread import cached_property


@frozen
class KalmanGain:
    """The gain K (n, k) of one record.

    Attributes
    ----------
    part : RecordPart
    states, outputs, places : (g,) arrays
        State and output of every entry, and its place among the parameters of a sample.
    unknowns : (u,) array
        Places of the estimated parameters: these entries, or the sizes of the noise that determines
        them.
    """

    part: RecordPart
    states: IntArray
    outputs: IntArray
    places: IntArray
    unknowns: IntArray

    @cached_property
    def limit(self) -> float:
        """Return the limit of magnitudes of poles: initial states fade over the longest stretch.

        A predictor beyond the limit would fit later samples with its free initial states. Where
        noise hardly drives a mode, the likelihood grows toward the unit circle without a maximum,
        as for the unit root of a moving average: Sargan and Bhargava (1983), Econometrica 51(3).
        """
        # Three time constants of the slowest pole.
        return 1 - 3.0 / max(map(len, self.part.data.stretches))

    def is_stable(self, trajectory: Trajectory, placed: Placed | None = None) -> bool:
        """Return whether errors of the states fade within the limit, or as those of the model do.

        By the poles of the mean linearization of a trajectory, at its own parameters or at those
        `placed` elsewhere. Without process noise, states that settle slowly need no correction.
        """
        radius = spectral_radius(self.error_transition(trajectory, placed))
        return radius < self.limit or (
            radius <= spectral_radius(self.error_transition(trajectory, placed, gain=0)) < 1
        )

    def is_at_limit(self, trajectory: Trajectory) -> bool:
        """Return whether a pole has come to the limit, where the likelihood has no maximum."""
        distance = self.limit - spectral_radius(self.error_transition(trajectory))
        # Steps go at most 0.9 of the way to the limit: two of them come within 0.01.
        return abs(distance) < 0.02 * (1 - self.limit)

    def error_transition(
        self, trajectory: Trajectory, placed: Placed | None = None, gain: float = 1.0
    ) -> Array:
        """Return the transition over a sample for errors of the states that innovations reach.

        The gain may be a share of its value.
        """
        at: Placed = placed or trajectory.detail
        q = at.q.copy()
        q[self.places] *= gain
        A, _ = self.part.segments.mean_transition(trajectory.states, q, at.data)
        return self._reached(A)

    def pole_derivatives(self, trajectory: Trajectory, z: Array) -> tuple[Array, Array]:
        """Return the derivatives of the poles' magnitudes (m, p) by z, and their room to grow (m,).

        By finite differences of the transition along a trajectory.
        """
        A = self.error_transition(trajectory)
        steps = 1e-6 * np.maximum(np.abs(z), 1.0)
        slopes = [
            (self.error_transition(trajectory, self.part.place(z + row)) - A) / step
            for row, step in zip(np.diag(steps), steps, strict=True)
        ]
        poles, right = np.linalg.eig(A)
        left = np.linalg.pinv(right)
        slopes = np.einsum("mi,pij,jm->mp", left, np.array(slopes), right)
        # A pole at zero has no direction, and is far from the limit.
        size = np.maximum(np.abs(poles), 1e-12)

        return np.real(np.conj(poles)[:, None] * slopes) / size[:, None], self.limit - np.abs(poles)

    def _reached(self, A: Array) -> Array:
        noise = self.part.noise_model
        rows = reached(A, self.states if noise is None else noise.driven)
        return A[np.ix_(rows, rows)]

    def simulated_cost(self, z: Array, nodes: Array) -> float:
        """Return the cost of a simulation from the first nodes, for the covariance it shows."""
        products = self.part.trajectory(z, nodes, simulated=True).products
        return self.part.covariance.cost(products)

    def steady_state(self, trajectory: Trajectory, process: Sequence[Array]) -> list[Array | None]:
        """Return the unknowns (u,) of steady Kalman filters; None for an unstable predictor.

        The process noise has variances (n,) per sample in the corrected or driven states; the
        residuals of the trajectory are the measurement noise.
        """
        placed = trajectory.detail
        q = placed.q.copy()
        q[self.places] = 0
        F, C = self.part.segments.mean_transition(trajectory.states, q, placed.data)
        noise = self.part.noise_model
        covariance = self.part.covariance.covariance(trajectory.products)
        # In units of the measurement noise, as the equation of the filter needs them.
        root = self.part.covariance.weight(trajectory.products)
        corrected = np.isin(np.arange(len(F)), self.states)

        filters: list[Array | None] = []
        for variance in process:
            K = np.zeros((len(F), len(C)))
            if noise is None:
                gain = steady_state_gain(F, root @ C, np.where(corrected, variance, 0.0)) @ root
                K[self.states, self.outputs] = unknowns = gain[self.states, self.outputs]
            else:
                intensities = np.sqrt(variance[noise.driven] / noise.step)
                unknowns = np.concatenate([intensities, np.sqrt(np.diag(covariance))])
                q[self.unknowns] = unknowns
                K = noise.at(q).gain
            stable = spectral_radius(self._reached(F @ (np.eye(len(F)) - K @ C))) < self.limit
            filters.append(unknowns if stable else None)

        return filters

    def placed(self, trajectory: Trajectory, z: Array, values: Array) -> Array:
        """Return the point z (p,) with the values (u,) of unknowns that one variable each sets."""
        slope, z = trajectory.detail.slope, z.copy()
        active = self.part.model.active.tolist()
        for k, value in zip(self.unknowns.tolist(), values, strict=True):
            # An unknown that several variables determine cannot be set by one of them.
            row = slope[active.index(k)] if k in active else np.zeros(len(z))
            (variables,) = np.nonzero(row)
            if len(variables) == 1:
                z[variables] = value / row[variables]
        return z


def kalman_gain(part: Part) -> KalmanGain | None:
    """Return the gain of a part; None where its criterion has none."""
    if not part.gains:
        return None
    part = cast(RecordPart, part)  # no other part has gains
    places = np.array(
        [part.model.parameters.index(f"K_{state}_{output}") for state, output in part.gains],
        dtype=int,
    )
    noise = part.noise_model
    unknowns = places if noise is None else np.concatenate([noise.intensities, noise.deviations])

    return KalmanGain(
        part,
        states=np.array([part.system.states.index(state) for state, _ in part.gains], dtype=int),
        outputs=np.array([part.outputs.index(output) for _, output in part.gains], dtype=int),
        places=places,
        unknowns=unknowns,
    )


def spectral_radius(A: Array) -> float:
    """Return the largest magnitude of an eigenvalue of A (n, n); infinite where A is not finite."""
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) if all_finite(A) else math.inf
