"""The Kalman gain of a record in innovations form: its stability, and initial values.

A predictor x[k+1] = F(x[k] + K e[k], u) whose poles lie within the unit circle forgets its initial
state. It can be simulated from the first sample of a stretch to the last: an unstable plant does
not diverge, and no nodes are needed in between.
"""

import math
from dataclasses import replace
from typing import cast

import numpy as np

from greybox.data.files.arrays import Array, IntArray, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import places_of
from greybox.engine.compiled.part import Part, Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.riccati import reached, steady_state_gain
from greybox.modeling.cached_property import cached_property


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

    def moved(self, trajectory: Trajectory, z: Array) -> Trajectory:
        """Return a trajectory with the parameters at z (p,) and the states that it has."""
        return replace(trajectory, detail=self.part.place(z))

    def radius(self, trajectory: Trajectory) -> float:
        """Return how large a pole may be: errors of the states fade within the limit.

        Or as those of the model do: without process noise, slow states need no correction.
        """
        of_model = spectral_radius(self.error_transition(trajectory, corrected=False))
        return max(self.limit, of_model if of_model < 1 else 0.0)

    def is_stable(self, trajectory: Trajectory) -> bool:
        """Return whether errors of the states fade within the limit, or as those of the model do.

        The errors fade with the poles of the mean linearization of a trajectory.
        """
        return spectral_radius(self.error_transition(trajectory)) <= self.radius(trajectory)

    def is_at_limit(self, trajectory: Trajectory) -> bool:
        """Return whether a pole has come to the limit, where the likelihood has no maximum."""
        radius = self.radius(trajectory)
        largest = spectral_radius(self.error_transition(trajectory))
        # Steps go at most 0.9 of the way to the limit: two of them come within 0.01. Without any
        # gain, poles are those of the model, and nothing limits them.
        return 0 < abs(radius - largest) < 0.02 * (1 - radius)

    def error_transition(self, trajectory: Trajectory, *, corrected: bool = True) -> Array:
        """Return the transition over a sample for errors of the states that innovations reach.

        They are those of the model alone if the gain has not `corrected` them.
        """
        A, _ = self._mean_transition(trajectory, corrected)
        return self._reached(A)

    def _mean_transition(self, trajectory: Trajectory, corrected: bool) -> tuple[Array, Array]:
        """Return the mean transition (n, n) and output matrix (k, n), with or without the gain."""
        q = trajectory.detail.q.copy()
        if not corrected:
            q[self.places] = 0
        return self.part.segments.mean_transition(trajectory.course._replace(q=q))

    def room(self, trajectory: Trajectory) -> Array:
        """Return how far the poles are from what limits them (m,), negative beyond it.

        Two poles, the roots of λ² - tλ + d, lie within a circle of radius r if d <= r² and ±rt <=
        r² + d (Jury's criterion). Where two poles meet, t and d are smooth, and the poles are not.
        """
        A = self.error_transition(trajectory)
        if not all_finite(A):
            return np.array([-np.inf])
        poles = np.linalg.eigvals(A)
        r = self.radius(trajectory)
        upper = poles[poles.imag > 0]
        real = np.sort(poles[poles.imag == 0].real)[::-1]
        # Neighbors may meet; a pole without one has a partner at zero.
        first, second = np.pad(real, (0, len(real) % 2)).reshape(-1, 2).T
        total = np.append(2 * upper.real, first + second)
        product = np.append(np.abs(upper) ** 2, first * second)
        inner = r**2 + product
        return np.sort([r**2 - product, inner - r * total, inner + r * total]).ravel()

    def _reached(self, A: Array) -> Array:
        noise = self.part.noise_model
        rows = reached(A, self.states if noise is None else noise.driven)
        return A[np.ix_(rows, rows)]

    def simulated_cost(self, z: Array, nodes: Array) -> float:
        """Return the cost of a simulation from the first nodes, for the covariance it shows."""
        products = self.part.trajectory(z, nodes, simulated=True).products
        return self.part.covariance.cost(products)

    def filtered(self, trajectory: Trajectory, z: Array, variance: Array) -> Array:
        """Return z (p,) with the unknowns of a steady Kalman filter; NaN for an unstable one.

        The process noise has the variances (n,) per sample in the corrected or driven states; the
        residuals of the trajectory are the measurement noise.
        """
        F, C = self._mean_transition(trajectory, corrected=False)
        placed = trajectory.detail
        K = 0 * C.T
        noise = self.part.noise_model
        errors = self.part.covariance
        if noise is None:
            # In units of the measurement noise, as the equation of the filter needs them.
            root = errors.weight(trajectory.products)
            process = 0 * variance
            process[self.states] = variance[self.states]
            gain = steady_state_gain(F, root @ C, process) @ root
            K[self.states, self.outputs] = unknowns = gain[self.states, self.outputs]
        else:
            deviations = np.diag(errors.covariance(trajectory.products))
            unknowns = np.sqrt(np.append(variance[noise.driven] / noise.step, deviations))
            q = placed.q.copy()
            q[self.unknowns] = unknowns
            K = noise.at(q).gain
        if spectral_radius(self._reached(F - F @ K @ C)) >= self.limit:
            return np.nan * z

        z = z.copy()
        active = self.part.model.active.tolist()
        for k, value in zip(self.unknowns.tolist(), unknowns, strict=True):
            # An unknown that several variables determine cannot be set by one of them.
            row = placed.slope[active.index(k)] if k in active else 0 * z
            (variables,) = np.nonzero(row)
            if len(variables) == 1:
                z[variables] = value / row[variables]
        return z


def kalman_gain(part: Part) -> KalmanGain | None:
    """Return the gain of a part; None where its criterion has none."""
    if not part.gains:
        return None
    part = cast(RecordPart, part)  # no other part has gains
    states, outputs = zip(*part.gains, strict=True)
    gains = (f"K_{state}_{output}" for state, output in part.gains)
    places = places_of(gains, part.model.parameters)
    noise = part.noise_model
    unknowns = places if noise is None else np.concatenate([noise.intensities, noise.deviations])

    return KalmanGain(
        part,
        states=places_of(states, part.system.states),
        outputs=places_of(outputs, part.outputs),
        places=places,
        unknowns=unknowns,
    )


def spectral_radius(A: Array) -> float:
    """Return the largest magnitude of an eigenvalue of A (n, n); infinite where A is not finite."""
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) if all_finite(A) else math.inf
