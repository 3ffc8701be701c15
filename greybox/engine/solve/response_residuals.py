"""Residuals of a frequency response: what its gradient is made of, in standard deviations."""

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, complex_array, real_and_imaginary
from greybox.engine.compiled.response_part import ResponsePart
from greybox.modeling.cached_property import cached_property
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formulation.frequency_criteria import MaximumLikelihood
from greybox.modeling.one_thread import one_thread_at_a_time

# Under the root of |e|², where a criterion has a kink at a zero error: its slopes are finite there,
# and equal those of the cost to nine digits where errors are above 1e-3.
SMOOTHING = 1e-16


class ResponseResiduals:
    """The residuals of a response, two for each frequency, with the scale of its information.

    JᵀJ is the information with which standard errors are computed, and Jᵀe the gradient of the
    cost, for any criterion: of given variances, e are the errors over their deviations.
    """

    def __init__(self, part: ResponsePart) -> None:
        """Take the part."""
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
        response, sensitivity = part.response(values), part.sensitivity(values)[:, :free]
        bread, _ = part.criterion.spread(response, part.data, 1.0)
        rows = part.criterion.jacobian(response, sensitivity, part.data)
        return np.sqrt(part.weight * bread) * self._turned(rows, response)

    def at(self, values: Array) -> Array:
        """Return the residuals (2 n,) at all values (k,)."""
        part = self.part
        response = part.response(values)
        bread, _ = part.criterion.spread(response, part.data, 1.0)

        # How the two residuals of a point follow real and imaginary part of its response.
        directions = np.array([[1.0, 1j]]).repeat(len(response), axis=0)
        columns = part.criterion.jacobian(response, directions, part.data)
        by_response = columns.reshape(2, -1, 2).transpose(1, 0, 2)

        # The gradient is by_responseᵀ e. A point without weight has neither.
        score = self._score(real_and_imaginary(response)).full().reshape(2, -1).T
        errors = np.einsum("nab,na->bn", np.linalg.pinv(by_response), score).reshape(-1, 1)
        return np.sqrt(part.weight / bread) * self._turned(errors, response).ravel()

    def _turned(self, rows: Array, response: ComplexArray) -> Array:
        """Return rows (2 n, k) along and across a response in the axes of the complex plane."""
        # The response turns with the parameters. In fixed axes, differences from the data are
        # functions of which the Jacobian has the derivatives.
        if not self.is_least_squares:
            return rows
        turned = complex_array(*np.split(rows, 2)) * np.exp(1j * np.angle(response))[:, None]
        return real_and_imaginary(turned)
