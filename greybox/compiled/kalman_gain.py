"""The gain of a predictor: its stability, the states it leads to, and the values it begins with.

A predictor x[k+1] = F(x[k] + K e[k], u) whose poles lie within the unit circle forgets its initial state. It is
simulated from the first sample of a stretch to the last: an unstable plant does not run away, and no states in between
have to be found and joined. Steps that would lead out of the circle are bent along it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.record_part import Path, Place, RecordPart

Array = NDArray[np.float64]
COMPARED = 3000  # samples on which sizes of the process noise are compared
PIECES = 3  # of a record, that hold them
DOUBLINGS = 60  # of the time after which a filter is taken to be steady
FORGOTTEN = 3.0  # time constants: an initial state has faded to a twentieth
AT = 0.02  # of the distance of the limit from the unit circle: what is as close has come to it
STEADY = 1e-12  # relative change of a covariance that ends them


@dataclass(frozen=True, eq=False)
class Predictor:
    """The gain K (n, k) of one record.

    Attributes
    ----------
    part : RecordPart
    states, outputs, places : (g,) arrays
        State and output of every entry, and its place among the parameters q.
    names : tuple of str
        Of the entries, as the problem knows them.
    """

    part: RecordPart
    states: NDArray[np.integer]
    outputs: NDArray[np.integer]
    places: NDArray[np.integer]
    names: tuple[str, ...]

    @cached_property
    def limit(self) -> float:
        """The largest magnitude of a pole: what is left of an initial state fades over the longest stretch.

        A predictor beyond would look into the future through its free initial states. Where a mode is hardly driven
        by noise, the likelihood grows toward the unit circle and has no maximum within, as for the unit root of a
        moving average: Sargan and Bhargava (1983), Econometrica 51(3).
        """
        return 1 - FORGOTTEN / max(len(stretch) for stretch in self.part.experiment.stretches)

    def is_stable(self, path: Path, place: Place) -> bool:
        """Tell whether the poles of the mean linearization along a path are within the limit."""
        return radius(self._driven(path, place)) < self.limit

    def is_bounded(self, path: Path, place: Place) -> bool:
        """Tell whether a pole has come to the limit, where the likelihood has no maximum."""
        return 1 - radius(self._driven(path, place)) < (1 + AT) * (1 - self.limit)

    def _driven(self, path: Path, place: Place) -> Array:
        """Return the transition over a sample of the errors of those states that innovations drive."""
        A, _ = self.part.shooting.mean_derivatives(path.states, place.q, place.data)
        return self._part_driven(A)

    def _part_driven(self, A: Array) -> Array:
        driven = np.zeros(len(A), dtype=bool)
        driven[self.states] = True
        for _ in range(len(A)):
            driven |= (A[:, driven] != 0).any(axis=1)
        return A[np.ix_(driven, driven)]

    def outward(self, path: Path, place: Place, places: Sequence[Place], steps: Array) -> tuple[Array, Array]:
        """Return how the magnitudes of the poles (m,) change with the point, (m, p), and how far they may grow (m,).

        `places` are those after `steps` (p,) along one entry of the point each.
        """
        A = self._driven(path, place)
        poles, right = np.linalg.eig(A)
        left = np.linalg.pinv(right)
        change = np.array([(self._driven(path, at) - A) / step for at, step in zip(places, steps, strict=True)])
        slopes = np.einsum("mi,pij,jm->mp", left, change, right)
        size = np.maximum(np.abs(poles), 1e-12)
        return np.real(np.conj(poles)[:, None] * slopes) / size[:, None], self.limit - np.abs(poles)

    def cost(self, nodes: Array, place: Place) -> float:
        """Return about what `followed` costs, by some pieces of the record that begin at their own nodes."""
        part, length = self.part, self.part.experiment.segment
        rows, samples = part.shooting.rows(place.data), 0
        products = np.zeros((len(part.outputs), len(part.outputs)))
        for first, count in self._pieces:
            some = slice(first * length, (first + count) * length)
            _, residuals = part.step.follow(nodes[first], place.q, rows[some])
            products, samples = products + residuals.T @ residuals, samples + count * length
        return part.noise.cost(products * (len(rows) / samples))

    @cached_property
    def _pieces(self) -> list[tuple[int, int]]:
        """First segment and number of segments of every piece."""
        counts = self.part.experiment.counts
        ends, size = np.cumsum(counts), max(COMPARED // (PIECES * self.part.experiment.segment), 1)
        firsts = np.unique(np.linspace(0, max(ends[-1] - size, 0), PIECES).astype(int))
        left = ends[np.searchsorted(ends, firsts, side="right")] - firsts
        return [(int(first), int(min(size, rest))) for first, rest in zip(firsts, left, strict=True)]

    def steady(self, path: Path, place: Place, process: Sequence[Array]) -> list[Array | None]:
        """Return the entries (g,) of steady Kalman filters, None where the predictor would not be stable.

        For process noise of variances (n,) a sample in the states that are corrected, and the residuals of the path as
        measurement noise.
        """
        q = place.q.copy()
        q[self.places] = 0
        F, C = self.part.shooting.mean_derivatives(path.states, q, place.data)
        root, found = self.part.noise.weight(path.products), list[Array | None]()
        corrected = np.isin(np.arange(len(F)), self.states)
        for variance in process:
            gain = steady_gain(F, root @ C, np.where(corrected, variance, 0.0)) @ root
            K = np.zeros_like(gain)
            K[self.states, self.outputs] = entries = gain[self.states, self.outputs]
            stable = radius(self._part_driven(F @ (np.eye(len(F)) - K @ C))) < self.limit
            found.append(entries if stable else None)
        return found

    def placed(self, z: Array, place: Place, entries: Array) -> Array:
        """Return the point z (p,) of the solver with these entries (g,) of the gain, where z alone sets them."""
        z, active = z.copy(), self.part.active.tolist()
        for k, value in zip(self.places.tolist(), entries, strict=True):
            slope = place.slope[active.index(k)] if k in active else np.zeros(len(z))
            (of,) = np.nonzero(slope)
            if len(of) == 1:
                z[of] = value / slope[of]
        return z


def predictor(part: RecordPart) -> Predictor | None:
    """Return the predictor of a record; None where its criterion has none."""
    if not part.criterion.corrects_states:
        return None
    pairs = part.criterion.gains(part.part.model, part.outputs)
    names = [f"K_{state}_{output}" for state, output in pairs]
    declared = list(part.part.declared)
    return Predictor(
        part,
        states=np.array([part.system.states.index(state) for state, _ in pairs], dtype=int),
        outputs=np.array([part.outputs.index(output) for _, output in pairs], dtype=int),
        places=np.array([declared.index(name) for name in names], dtype=int),
        names=tuple(part.part.rename.get(name, name) for name in names),
    )


@np.errstate(over="ignore", invalid="ignore")
def steady_gain(F: Array, C: Array, process: Array) -> Array:
    """Return the gain (n, k) of the steady Kalman filter of x[k+1] = F (x[k] + K e[k]) + w, y = C x + v; NaN without.

    `process` (n,) are the variances of w; v has unit variances. By the structure-preserving doubling algorithm, which
    needs as many iterations as the filter takes doublings of the sample to settle.
    Source: Chu, Fan, Lin, Wang (2004), International Journal of Control 77(8); Simon (2006), Optimal State Estimation,
    section 7.3.
    """
    n, size = len(F), np.sqrt(np.where(process > 0, process, process.max(initial=0.0)))
    A, seen = F.T * size[:, None] / size, C * size
    G, H, eye = seen.T @ seen, np.diag(process / size**2), np.eye(n)
    for _ in range(DOUBLINGS):
        if not np.all(np.isfinite(A)) or not np.all(np.isfinite(H)):
            break
        try:
            both = np.linalg.solve(eye + G @ H, np.hstack([A, G]))
        except np.linalg.LinAlgError:
            break
        step, seen_later = both[:, :n], both[:, n:]
        more = A.T @ H @ step
        A, G, H = A @ step, G + A @ seen_later @ A.T, H + (more + more.T) / 2
        if np.abs(more).max() <= STEADY * np.abs(H).max():
            P = H * size * size[:, None]
            return np.linalg.solve(C @ P @ C.T + np.eye(len(C)), C @ P).T.astype(float)
    return np.full((n, len(C)), np.nan)


def radius(A: Array) -> float:
    """Return the spectral radius of a transition matrix (n, n); infinite where it is not finite."""
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) if np.all(np.isfinite(A)) else math.inf
