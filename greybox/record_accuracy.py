"""What a record tells of the parameters: the Jacobian of its outputs with the initial states fitted along."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.gauss_newton import Profile
from greybox.output_error import PredictionError
from greybox.record_part import Place, RecordPart
from greybox.residuals import colored_information

Array = NDArray[np.float64]
CHUNK = 2000  # segments whose sensitivities are in memory at once


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


def information(part: RecordPart, nodes: Array, place: Place, products: Array) -> Information:
    """Return what the record tells at nodes that are the best ones."""
    weight = part.noise.weight(products)
    reduced = part.reduce(part.linearize(nodes, place, weight), np.zeros_like(nodes), np.zeros(part.states))
    follow = reduced.follow.copy()
    n, segment = part.states, part.experiment.segment
    if part.known_states.any():
        rows = np.ix_(part.first, part.known_states)
        follow[rows] = place.initial_slope[part.known_states]
    slopes = []
    for at in range(0, len(nodes), CHUNK):
        some = slice(at, at + CHUNK)
        data = place.data[:, at * segment : (at + len(nodes[some])) * segment]
        raw = part.shooting.sensitivities(nodes[some], place.q, data)
        by_node = np.repeat(follow[some], segment, axis=0)
        slopes.append(raw[:, :, :n] @ by_node + raw[:, :, n:] @ place.slope)
    slope = np.concatenate(slopes)
    measured = part.experiment.measured
    present = np.isfinite(measured)
    _, outputs = part.shooting.simulate(nodes, place.q, place.data)
    residual = np.where(present, np.nan_to_num(measured) - outputs, 0.0)
    slope[~present.T] = 0
    root = np.einsum("ij,njp->nip", weight, slope)
    numbers = int(present.sum()) - part.unknown_initial
    if isinstance(part.criterion, PredictionError):
        meat = np.einsum("nip,niq->pq", root, root)
    else:
        weighted = np.einsum("ji,njp->nip", weight, root)
        stretches = [np.moveaxis(w, -1, 0) for w in part.experiment.unpadded(np.moveaxis(weighted, 0, -1))]
        meat = colored_information(stretches, part.experiment.unpadded(residual))
    triangle = np.linalg.qr(root.reshape(-1, root.shape[2]), mode="r")
    return Information(triangle, meat, numbers)


def profile_of(profile: Profile, k: int) -> tuple[Array, Place, Array]:
    """Return nodes, place and residual products of the k-th record."""
    return profile.nodes[k], profile.places[k], profile.products[k]
