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
        rows = np.ix_(part.first, part.known_states)
        follow[rows] = place.initial_slope[part.known_states]
    s, length, k = part.experiment.segments, part.experiment.segment, len(part.outputs)
    slope = np.empty((s, length, k, place.slope.shape[1]))
    for some in part.shooting.chunks(s):
        _, J, _ = part.shooting.sensitivities(path.states, place.q, place.data, some)
        slope[some] = -(J[..., :n] @ follow[some, None] + J[..., n:]) @ place.slope
    slope = slope.reshape(s * length, k, -1)
    residual = part.shooting.in_order(part.shooting.residuals(path.states, place.q, place.data))
    root = weight @ slope
    numbers = int(part.shooting.counts.sum()) - part.unknown_initial
    if isinstance(part.criterion, PredictionError):
        meat = np.tensordot(root, root, ((0, 1), (0, 1)))
    else:
        weighted = np.moveaxis(weight.T @ root, 0, -1)
        stretches = [np.moveaxis(w, -1, 0) for w in part.experiment.unpadded(weighted)]
        meat = colored_information(stretches, part.experiment.unpadded(residual))
    triangle = np.linalg.qr(root.reshape(-1, root.shape[2]), mode="r")
    return Information(triangle, meat, numbers)
