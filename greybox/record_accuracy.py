"""What a record tells of the parameters: the Jacobian of its outputs with the initial states fitted along."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.output_error import PredictionError
from greybox.record_part import Path, Place, RecordPart
from greybox.residuals import colored_information

Array = NDArray[np.float64]


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
        Measured numbers less the unknown initial states.
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
    s, length, k, p = part.experiment.segments, part.experiment.segment, len(part.outputs), place.slope.shape[1]
    weighted, triangle, white = np.empty((s, length, k, p)), np.zeros((0, p)), np.zeros((p, p))
    for some in part.shooting.chunks(s):
        _, J, _ = part.shooting.sensitivities(path.states, place.q, place.data, some)
        root = weight @ ((J[..., :n] @ follow[some, None] + J[..., n:]) @ place.slope)
        rows = root.reshape(-1, p)
        triangle = np.linalg.qr(np.vstack([triangle, rows]), mode="r")
        white += rows.T @ rows
        weighted[some] = weight.T @ root
    numbers = int(part.shooting.counts.sum()) - part.unknown_initial
    if isinstance(part.criterion, PredictionError):
        return Information(triangle, white, numbers)
    residual = part.shooting.in_order(part.shooting.residuals(path.states, place.q, place.data))
    stretches = part.experiment.unpadded(np.moveaxis(weighted.reshape(s * length, k, p), 0, -1))
    return Information(triangle, colored_information(stretches, part.experiment.unpadded(residual)), numbers)
