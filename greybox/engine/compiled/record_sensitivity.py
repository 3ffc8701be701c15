"""Derivatives of the weighted residuals by the parameters, with the initial states fitted too."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from greybox.data.files.arrays import Array, real_root
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.condensing import solve_continuity
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.segmented_part import Placed, SegmentedPart, filter_information
from greybox.engine.compiled.segments import Linearization
from greybox.statistics.column_space import triangle_of
from greybox.statistics.residual_spectrum import LONGEST_CORRECTED


@frozen
class Sensitivity:
    """Derivatives of the weighted residuals of a record by p parameters.

    Attributes
    ----------
    triangle : (p, p) array
        A triangular factor of the Jacobian J.
    by_covariance : (c, p) array
        The rows of J that the covariance of the prediction errors of a filter contributes.
    weighted : (k, p, samples) array
        WᵀJ.
    by_initial : (k, m, samples) array
        The same by m directions of unit variance of the initial states of every stretch, at known
        parameters; by none (m = 0) of records of more than `LONGEST_CORRECTED` samples, whose
        spectra are not corrected for them.
    shocks : function
        Returns (k, s, samples), the residuals of the longest stretch after unit jumps of s states.
    reach : (p,) array
        Lengths of the columns of J if contributions of states and parameters could not cancel.
    initial : mapping of state to (stretches, p) array
        Derivatives of the unknown initial states, in changes that the data notice.
    """

    triangle: Array
    by_covariance: Array
    weighted: Array
    by_initial: Array
    shocks: Callable[[], Array]
    reach: Array
    initial: Mapping[str, Array]


def sensitivity(part: SegmentedPart, trajectory: Trajectory, weight: Array) -> Sensitivity:
    """Return how the residuals times `weight` follow the parameters along a trajectory."""
    data, segments, n = part.data, part.segments, part.states
    placed: Placed = trajectory.detail
    linearization = part.linearize(trajectory, weight)
    by_nodes = part.condense(linearization, trajectory).node_sensitivity
    initial_directions = _initial_directions(part, linearization)
    noticed = real_root(np.linalg.diagonal(linearization.node_hessian).sum(axis=0))
    del linearization  # for a long record, a tenth of the memory
    known = part.known_states
    by_nodes = np.where(known[:, :, None], placed.initial_slope @ placed.slope, by_nodes)

    s = data.segments
    length = data.segment_length
    k = len(part.outputs)
    m = initial_directions.shape[2]
    p = trajectory.z.size
    by_initial, weighted = np.empty((k, m, s, length)), np.empty((k, p, s, length))
    triangle, squares = np.zeros((0, p)), np.zeros(p)
    for batch in segments.batches():
        _, J = segments.sensitivities(trajectory.course, batch, weight)
        by_states = J[..., :n] @ by_nodes[batch]
        by_parameters = J[..., n:-1] @ placed.slope
        for columns in (by_states, by_parameters):
            squares += np.einsum("crp,crp->p", columns, columns)
        root = by_states + by_parameters
        # The Jacobian of a long record does not fit into memory, and JᵀJ alone has half of the
        # digits.
        triangle = triangle_of(np.vstack([triangle, root.reshape(-1, p)]))
        directions = J[..., :n] @ initial_directions[batch]
        for result, columns in ((weighted, root), (by_initial, directions)):
            by_output = weight.T @ columns.reshape(len(J), length, k, -1)
            result[:, :, batch] = by_output.transpose(2, 3, 0, 1)

    by_covariance = np.zeros((0, p))
    if placed.filter is not None:
        active = len(part.model.active)
        rows = filter_information(placed.filter, weight, part.compared_samples, active)
        by_covariance = rows @ placed.slope
        squares += (by_covariance**2).sum(axis=0)
        triangle = triangle_of(np.vstack([triangle, by_covariance]))

    first = by_nodes[data.begins_stretch] * noticed[:, None]
    by_initial = by_initial.reshape(k, m, s * length)
    return Sensitivity(
        triangle=triangle,
        by_covariance=by_covariance,
        weighted=weighted.reshape(k, p, s * length),
        by_initial=by_initial,
        shocks=partial(_shocks, data, initial_directions, by_initial, weight),
        reach=np.sqrt(squares),
        initial={
            name: first[:, i] for i, name in enumerate(part.system.states) if not known[:, i].any()
        },
    )


def _initial_directions(part: SegmentedPart, b: Linearization) -> Array:
    """Return how the nodes (s, n, m) follow the m directions of the stretches' initial states.

    The directions are those of unit variance, for white errors and known parameters. The covariance
    K⁻¹ of the nodes of a stretch has the rank of its initial states. A few columns X = K⁻¹ R
    determine it: it is X (Rᵀ X)⁻¹ Xᵀ. That holds for unstable models too, whose nodes do not follow
    from the first one.
    """
    data, s, n = part.data, part.data.segments, part.states
    if not n or data.samples > LONGEST_CORRECTED:
        return np.zeros((s, n, 0))
    given = part.known_states
    # Any R of full rank is suitable; a fixed one makes the result reproducible.
    R = np.random.default_rng(0).normal(size=(s, n, n))
    R[given] = 0
    X, _ = solve_continuity(b.node_hessian, b.transition, data.coupled, R, np.zeros_like(R))
    X[given] = 0

    directions = np.zeros_like(X)
    starts = np.flatnonzero(data.begins_stretch)
    for rows in np.split(np.arange(s), starts[1:]):
        values, vectors = np.linalg.eigh(np.einsum("snm,snl->ml", R[rows], X[rows]))
        unknown = values > 1e-12 * values[-1]  # directions of less variance count as known
        axes = vectors[:, unknown] / np.sqrt(values[unknown])
        directions[rows, :, : unknown.sum()] = X[rows] @ axes

    return directions


def _shocks(data: SampledData, directions: Array, by_initial: Array, weight: Array) -> Array:
    """Return the residuals (k, n, samples) of the longest stretch after unit jumps of the states.

    From the `directions` (s, n, m) of the initial states and what follows from these, WᵀW dy (k, m,
    samples). States whose jumps no output shows are left out, and those after which the outputs
    grow without end: then process noise has no spectrum. If they grow by 12 decades, the data
    determine where they begin, and no direction leads there.
    """
    longest = np.argmax([len(stretch) for stretch in data.stretches])
    begins = directions[data.begins_stretch][longest]
    scale = np.abs(begins).max(axis=1, initial=0.0)
    begins, scale = begins[scale > 0], scale[scale > 0, None]
    moved = np.linalg.pinv(begins / scale, rcond=1e-12) / scale.T
    moved = moved[:, np.diag(begins @ moved) > 1 - 1e-6]
    noise = np.linalg.inv(weight.T @ weight)
    shocks = np.tensordot(noise, data.unpadded(by_initial)[longest], 1)
    shocks = np.einsum("kmt,mn->knt", shocks, moved)

    samples = np.arange(shocks.shape[2])
    for response, measured in zip(shocks, data.stretches[longest].outputs, strict=True):
        present = np.isfinite(measured)
        if present.any():  # missing samples have no sensitivity
            for row in response:
                row[:] = np.interp(samples, samples[present], row[present])

    power = (shocks**2).sum(axis=0)
    # The power of the last quarter over that of the whole is 2.3 for two integrators, and 3.8 for
    # an unstable mode over three time constants.
    last = power[:, 3 * len(samples) // 4 :].mean(axis=1)
    return shocks[:, last < 2.5 * power.mean(axis=1)]
