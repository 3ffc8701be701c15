"""What a record tells of the parameters: the Jacobian of its outputs with the initial states fitted along."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.record_part import Path, Place, RecordPart
from greybox.statistics.residual_autocorrelation import colored_information

Array = NDArray[np.float64]
SEEN = 1e-12  # of the largest eigenvalue in units in which all parameters are seen alike
FEWEST = 4  # degrees of freedom that color may leave


@dataclass(frozen=True, eq=False)
class Information:
    """Of one record, for p directions of its point z.

    Attributes
    ----------
    jacobian : (p, p) array
        A triangular factor of JᵀJ, J the weighted derivatives of all outputs.
    meat : (p, p) array
        Covariance of Jᵀe, for errors with the autocorrelation of the residuals.
    numbers : int
        Measured numbers, as many as independent ones would tell as much, less the unknown initial states.
    """

    jacobian: Array
    meat: Array
    numbers: int


def information(part: RecordPart, path: Path, place: Place) -> Information:
    """Return what the record tells along a path that is the best one."""
    weight = part.noise.weight(path.products)
    blocks = part.linearize(path, place, weight)
    reduced = part.reduce(blocks, place, np.zeros_like(path.nodes), np.zeros(part.states))
    follow, n = reduced.follow.copy(), part.states
    if part.known_states.any():
        rows = np.ix_(part.begins, part.known_states)
        follow[rows] = place.initial_slope[part.known_states]
    del blocks, reduced  # of a long record, a tenth of what fits into memory
    s, length, k, p = part.experiment.segments, part.experiment.segment, len(part.outputs), place.slope.shape[1]
    weighted, triangle, white = np.empty((s, length, k, p)), np.zeros((0, p)), np.zeros((p, p))
    for some in part.shooting.chunks(s):
        _, J, _ = part.shooting.sensitivities(path.states, place.q, place.data, some)
        root = weight @ ((J[..., :n] @ follow[some, None] + J[..., n:]) @ place.slope)
        rows = root.reshape(-1, p)
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, rows]), mode="r"))
        white += rows.T @ rows
        weighted[some] = weight.T @ root
    if part.criterion.errors_are_white:
        return _corrected(part, triangle, white, 1.0)
    residual = part.shooting.in_order(part.shooting.residuals(path.states, place.q, place.data))
    stretches = part.experiment.unpadded(np.moveaxis(weighted.reshape(s * length, k, p), 0, -1))
    meat = colored_information(stretches, part.experiment.unpadded(residual))
    assumed = weight @ path.products @ weight.T / np.maximum(part.shooting.counts, 1)
    return _corrected(part, triangle, meat, _color(white * np.trace(assumed) / k, meat))


def _color(white: Array, meat: Array) -> float:
    """Return how many times more of the residuals the parameters take than they would of white ones, at least 1.

    Of n residuals with covariance Σ, p parameters take tr(JᵀΣJ (JᵀJ)⁻¹), which is p σ² where they are white.
    """
    size = 1 / np.sqrt(np.where(np.diag(white) > 0, np.diag(white), 1.0))
    values, vectors = np.linalg.eigh(white * size * size[:, None])
    seen = values > SEEN * max(values.max(initial=0.0), 1e-300)
    basis = size[:, None] * vectors[:, seen] / np.sqrt(values[seen])
    taken = float(np.trace(basis.T @ meat @ basis))
    return max(taken / max(int(seen.sum()), 1), 1.0) if np.isfinite(taken) else 1.0


def _corrected(part: RecordPart, triangle: Array, meat: Array, color: float) -> Information:
    """Count the numbers and widen the variance by what the initial states take of them."""
    measured, initial = int(part.shooting.counts.sum()), part.unknown_initial
    left = measured / (initial + meat.shape[0] + FEWEST)
    numbers = max(measured / min(color, max(left, 1.0)), initial + 0.5)
    return Information(triangle, meat * numbers / (numbers - initial), round(numbers) - initial)
