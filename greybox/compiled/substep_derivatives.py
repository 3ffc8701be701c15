"""Derivatives of a sample with many operations, substep by substep.

One function of all substeps repeats every operation of the model for every substep and every
direction. A substep has a Jacobian as sparse as the model, for one function evaluates all substeps
and columns; products with block-diagonal sparse matrices carry the derivatives from one to the
next.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep
from greybox.compiled.vectorized import CHUNK, Columns
from greybox.files.arrays import Array, Arrays
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import dense_jacobian


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
        parameters = ca.vertcat(ca.SX(0, 1), *(q[i] for i in active))
        place = ca.SX.sym("place")
        p = q[: len(step.system.parameters)]
        end = step.substep(x, mean + change * place, change / d[-1], p, d[-1] / step.substeps)

        compared = output if simulated else residual
        by_free = dense_jacobian(compared, ca.vertcat(x, parameters))
        self._substeps, self._active = step.substeps, len(active)
        begin, self._corrected = _with_slopes(corrected, x, parameters)
        further, self._following = _with_slopes(end, x, parameters)
        self._begin, self._advance, self._substep = (
            Columns(ca.Function("substep", inputs, outputs, {"cse": True}), shared)
            for inputs, outputs in (
                ([x, q, d], [*begin, by_free, residual]),
                ([x, q, d, place], [end]),
                ([x, q, d, place], [*further]),
            )
        )

    def __call__(self, states: Array, q: Array, data: Array) -> Arrays:
        """Return the derivatives (n v, columns) and (k v, columns), and the residuals."""
        n, columns = states.shape
        slopes = np.tile(np.eye(n, n + self._active), (columns, 1, 1))
        x, values, by_parameters, by_free, residual = self._begin(states, q, data)
        slopes = _following(self._corrected, values, by_parameters, slopes)
        # The states of some substeps come first: an operation on the columns of all of them takes
        # hardly longer than on those of one.
        rows = np.tile(np.arange(self._substeps)[:, None, None] / self._substeps - 0.5, columns)
        most = CHUNK // (columns + 1) + 1
        for group in np.split(rows, range(most, len(rows), most)):
            begins, count = [x[:, -columns:]], len(group)
            for place in group[:-1]:
                begins += self._advance(begins[-1], q, data, place)
            x, *parts = self._substep(
                np.hstack(begins),
                q if q.ndim == 1 else np.tile(q, count),
                np.tile(data, count),
                group.reshape(1, -1),
            )
            for values, by_parameters in zip(
                *(np.split(part, count, axis=1) for part in parts), strict=True
            ):
                slopes = _following(self._following, values, by_parameters, slopes)

        return [slopes.T.reshape(-1, columns), by_free, residual]


def _with_slopes(
    value: ca.SX, x: ca.SX, parameters: ca.SX
) -> tuple[tuple[ca.SX, ca.SX, ca.SX], ca.Sparsity]:
    """Return the value and its derivatives: by x, row by row without zeros, and by the parameters.

    The pattern is that of the transposed derivatives by x.
    """
    by_state = ca.jacobian(value, x).T
    by_parameters = dense_jacobian(value, parameters)
    return (value, ca.vec(by_state.nz[:]), by_parameters), by_state.sparsity()


def _following(pattern: ca.Sparsity, values: Array, by_parameters: Array, slopes: Array) -> Array:
    """Return the derivatives (columns, n, v) after a function with these derivatives."""
    from scipy.sparse import csr_matrix  # noqa: PLC0415  (most models do not need the import)

    columns, n, v = slopes.shape
    block = np.arange(columns)[:, None]
    ends = (np.array(pattern.colind()[1:]) + pattern.nnz() * block).ravel()
    places = (np.array(pattern.row(), dtype=int) + n * block).ravel()
    matrix = csr_matrix((values.T.ravel(), places, np.append(0, ends)), shape=2 * (n * columns,))
    result = (matrix @ slopes.reshape(-1, v)).reshape(slopes.shape)
    result[..., n:] += by_parameters.reshape(v - n, n, columns).T
    return result
