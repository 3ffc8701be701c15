"""Derivatives of a sample with many operations, substep by substep.

One function of all substeps repeats every operation of the model for every substep and every
direction. A substep has a Jacobian as sparse as the model, for one function serves all substeps and
columns; products with block-diagonal sparse matrices carry the derivatives from one to the next.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep
from greybox.compiled.vectorized import Columns
from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time


class SubstepDerivatives:
    """Derivatives of the next state and an output, as one function of a sample would give them.

    They are those by the state and the `active` parameters, of the residual or, with `simulated`,
    of the simulated output.
    """

    @one_thread_at_a_time
    def __init__(
        self, step: SampleStep, active: Sequence[int], *, simulated: bool, shared: tuple[int, ...]
    ) -> None:
        x, q, d = step.measurement.sx_in()
        corrected, mean, change, residual, output = step.measurement(x, q, d)
        slope_of, h = output if simulated else residual, d[-1] / step.substeps
        parameters = ca.vertcat(ca.SX(0, 1), *(q[i] for i in active))
        place = ca.SX.sym("place")
        u, p = mean + change * place, q[: len(step.system.parameters)]
        end = step.substep(x, u, change / d[-1], p, h)

        by_free = ca.densify(ca.jacobian(slope_of, ca.vertcat(x, parameters)))
        self._n, self._substeps, self._active = x.numel(), step.substeps, len(active)
        begin, self._corrected = _with_slopes(corrected, x, parameters)
        further, self._following = _with_slopes(end, x, parameters)
        # A state that no residual corrects has the derivative of itself.
        self._is_corrected = not ca.is_equal(corrected, x)
        options = {"cse": True}
        self._begin = Columns(
            ca.Function("begin", [x, q, d], [*begin, by_free, residual], options), shared
        )
        self._substep = Columns(
            ca.Function("substep", [x, q, d, place], [*further], options), (*shared, 3)
        )

    def __call__(self, states: Array, q: Array, data: Array) -> Sequence[Array]:
        """Return the derivatives (n v, columns) and (k v, columns), and the residuals."""
        n, columns = self._n, states.shape[1]
        slopes = np.zeros((columns, n, n + self._active))
        slopes[:, range(n), range(n)] = 1
        x, values, by_parameters, by_free, residual = self._begin(states, q, data)
        if self._is_corrected:
            slopes = _following(self._corrected, values, by_parameters, slopes)
        for k in range(self._substeps):
            place = np.array([k / self._substeps - 0.5])
            x, values, by_parameters = self._substep(x, q, data, place)
            slopes = _following(self._following, values, by_parameters, slopes)

        return [slopes.transpose(2, 1, 0).reshape(-1, columns), by_free, residual]


def _with_slopes(
    value: ca.SX, x: ca.SX, parameters: ca.SX
) -> tuple[tuple[ca.SX, ca.SX, ca.SX], ca.Sparsity]:
    """Return the value, its derivatives by x, row by row without zeros, and by the parameters.

    The pattern is that of the transposed derivatives by x.
    """
    by_state = ca.jacobian(value, x).T
    by_parameters = ca.densify(ca.jacobian(value, parameters))
    values: Any = ca.vec(by_state.nz[:])
    return (value, values, by_parameters), by_state.sparsity()


def _following(pattern: ca.Sparsity, values: Array, by_parameters: Array, slopes: Array) -> Array:
    """Return the derivatives (columns, n, v) after a function with these derivatives."""
    from scipy.sparse import csr_matrix  # noqa: PLC0415  (most models do not need the import)

    columns, n, v = slopes.shape
    block = np.arange(columns)[:, None]
    ends = (np.array(pattern.colind()[1:]) + pattern.nnz() * block).ravel()
    places = (np.array(pattern.row(), dtype=int) + n * block).ravel()
    matrix = csr_matrix(
        (values.T.ravel(), places, np.append(0, ends)), shape=(n * columns, n * columns)
    )
    result = np.asarray(matrix @ slopes.reshape(n * columns, v)).reshape(slopes.shape)
    result[:, :, n:] += by_parameters.reshape(v - n, n, columns).transpose(2, 1, 0)
    return result
