"""The linearization of records beyond their segments: steady filters, known initial states."""

import math

import numpy as np

from greybox.compiled.riccati import SteadyFilter
from greybox.compiled.segments import Linearization
from greybox.files.arrays import Array, BoolArray, IntArray


def with_filter_covariance(
    b: Linearization, steady: SteadyFilter, weight: Array, products: Array, count: int
) -> Linearization:
    """Add what the covariance of a steady filter contributes over `count` samples."""
    rows = filter_information(steady, weight, count, b.parameter_hessian.shape[1])
    # Zero where the residuals have the covariance that the filter predicts.
    excess = (np.eye(len(weight)) - weight @ products @ weight.T / count).ravel()
    return b._replace(
        parameter_hessian=b.parameter_hessian + rows.T @ rows,
        parameter_gradient=b.parameter_gradient + math.sqrt(count / 2) * rows.T @ excess,
    )


def filter_information(steady: SteadyFilter, weight: Array, count: int, active: int) -> Array:
    """Return J (k², active); JᵀJ is the information of the prediction errors' covariance S.

    The Fisher information on the parameters is n/2 tr(S⁻¹ dS S⁻¹ dS), beside that of the mean.
    """
    change = weight @ np.moveaxis(steady.covariance_slope, -1, 0) @ weight.T
    rows = math.sqrt(count / 2) * change.reshape(len(change), -1).T
    return np.pad(rows, ((0, 0), (0, active - len(change))))


def without_known_states(
    b: Linearization, known: BoolArray, initial_slope: Array, records: IntArray
) -> Linearization:
    """Return the linearization, changed in place: `known` states (s, n) follow the parameters.

    x = x' + (dx/dq) dq, with x' constant. `initial_slope` is dx/dq, (n, q) or one for every record.
    """
    for k in np.flatnonzero(known.any(axis=1)):
        record, is_known = records[k], known[k]
        slope = initial_slope if initial_slope.ndim == 2 else initial_slope[record]
        follow = np.where(is_known[:, None], slope, 0.0)
        mixed = follow.T @ b.cross_hessian[k]
        b.parameter_hessian[record] += mixed + mixed.T + follow.T @ b.node_hessian[k] @ follow
        b.parameter_gradient[record] += follow.T @ b.node_gradient[k]
        b.cross_hessian[k] += b.node_hessian[k] @ follow
        b.parameter_sensitivity[k] += b.transition[k] @ follow

        # The ridge of the elimination holds states that nothing moves.
        b.node_hessian[k, is_known, :] = 0
        b.node_hessian[k, :, is_known] = 0
        b.cross_hessian[k, is_known] = 0
        b.node_gradient[k, is_known] = 0
        b.transition[k, :, is_known] = 0

    return b
