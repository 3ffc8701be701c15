"""Residuals and Jacobian of a frequency response, scaled for Gauss-Newton steps."""

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, complex_array, real_and_imaginary
from greybox.engine.compiled.response_part import ResponsePart
from greybox.modeling.cached_property import cached_property
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formulation.frequency_criteria import MaximumLikelihood
from greybox.modeling.one_thread import one_thread_at_a_time

# Added to the squared error |e|² under the root of a criterion that has a kink at a zero error. The
# slopes are then finite there, and equal those of the cost to nine digits where errors are above
# 1e-3.
SMOOTHING = 1e-16


class ResponseResiduals:
    """The residuals e of a response, two for each frequency, and their Jacobian J.

    For any criterion, JᵀJ is the information from which standard errors follow, and Jᵀe is the
    gradient of the cost. With given variances, e are the errors over their standard deviations.

    Attributes
    ----------
    part : ResponsePart
    """

    def __init__(self, part: ResponsePart) -> None:
        self.part = part

    @cached_property
    @one_thread_at_a_time
    def _score(self) -> ca.Function:
        """(response) -> derivatives of the cost, both as real and imaginary parts (2 n,)."""
        part = self.part
        symbols = ca.SX.sym("response", 2 * len(part.data))
        re, im = ca.vertsplit(symbols, len(part.data))
        cost = part.criterion.cost(Complex(re, im), part.data, SMOOTHING)
        return ca.Function("score", [symbols], [ca.gradient(cost, symbols)])

    @property
    def is_least_squares(self) -> bool:
        """Whether the cost is half the sum of the squares: for errors of given variances."""
        return isinstance(self.part.criterion, MaximumLikelihood)

    def jacobian(self, values: Array, free: int) -> Array:
        """Return the derivatives (2 n, p) by the first of all values (k,)."""
        part = self.part
        response = part.response(values)
        sensitivity = part.sensitivity(values)[:, :free]
        rows = part.criterion.jacobian(response, sensitivity, part.data)
        return np.sqrt(part.weight * self._bread(response)) * self._in_fixed_axes(rows, response)

    def at(self, values: Array) -> Array:
        """Return the residuals (2 n,) at all values (k,)."""
        part = self.part
        response = part.response(values)

        # Derivatives of the two residuals of a point by the real and imaginary part of its
        # response: the axes are point, residual, part.
        directions = np.array([[1.0, 1j]]).repeat(len(response), axis=0)
        columns = part.criterion.jacobian(response, directions, part.data)
        by_response = columns.reshape(2, -1, 2).transpose(1, 0, 2)

        # The gradient of the cost by the response, the score, is by_responseᵀ e. For a point
        # without weight, both are zero.
        score = self._score(real_and_imaginary(response)).full().reshape(2, -1).T
        errors = np.einsum("nab,na->bn", np.linalg.pinv(by_response), score).reshape(-1, 1)
        scale = np.sqrt(part.weight / self._bread(response))
        return scale * self._in_fixed_axes(errors, response).ravel()

    def _bread(self, response: ComplexArray) -> float:
        """Return the factor on JᵀJ, see `Criterion.spread`, for uncorrected noise."""
        correction = 1.0
        bread, _ = self.part.criterion.spread(response, self.part.data, correction)
        return bread

    def _in_fixed_axes(self, rows: Array, response: ComplexArray) -> Array:
        """Turn rows (2 n, k) along and across the response into the axes of the complex plane."""
        # The axes of least squares turn with the response, and thus with the parameters, so that
        # the Jacobian would not have the derivatives of the residuals. In fixed axes it has them.
        if not self.is_least_squares:
            return rows
        along, across = np.split(rows, 2)
        turned = complex_array(along, across) * np.exp(1j * np.angle(response))[:, None]
        return real_and_imaginary(turned)
