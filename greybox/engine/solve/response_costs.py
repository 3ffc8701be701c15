"""The cost of frequency responses at any points, with its exact derivatives."""

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.vectorized import Columns
from greybox.engine.solve.point_costs import PointCosts
from greybox.engine.solve.response_residuals import SMOOTHING, ResponseResiduals
from greybox.modeling.cached_property import cached_property
from greybox.modeling.one_thread import one_thread_at_a_time


class ResponseCosts(PointCosts):
    """The cost of a problem whose data are frequency responses alone."""

    is_exact = True

    def __init__(self, nlp: CompiledProblem) -> None:
        """Take a compiled problem without states."""
        self.nlp = nlp
        self._program = nlp.programs[-1]
        self._residuals = [ResponseResiduals(part) for part in nlp.parts_of(ResponsePart)]

    @property
    def is_least_squares(self) -> bool:
        """Whether all errors have given variances."""
        return all(residuals.is_least_squares for residuals in self._residuals)

    def costs(self, x: Array) -> Array:
        """Return the costs (r,) at x (r, p)."""
        costs = self.nlp.costs(x)
        return np.where(np.isfinite(costs), costs, np.inf)

    def gradients(self, x: Array) -> Array:
        """Return the gradients (r, p) by z, at x (r, p)."""
        _, gradients = self._program.first_order(*self._inputs(x))
        return self._program.unit * gradients.T

    def hessians(self, x: Array) -> Array:
        """Return the Hessians (r, p, p) by z, at x (r, p), exact ones."""
        count, p = x.shape
        *_, hessians = self._program.whole_second_order(*self._inputs(x))
        return self._program.unit * hessians.reshape(p, p, count).transpose(2, 1, 0)

    def _inputs(self, x: Array) -> list[Array]:
        """Return the inputs of the derivatives at x (r, p), a column for each point."""
        ones = np.ones((1, len(x)))
        inputs = [self.nlp.scaling.to_solver(x).T, SMOOTHING * ones, self.nlp.data[:, None] * ones]
        if self._roots is not None:
            inputs.append(self._roots(inputs[0], inputs[2])[0])
        return inputs

    @cached_property
    @one_thread_at_a_time
    def _roots(self) -> Columns | None:
        roots = self._program.roots
        return None if roots is None else Columns(roots)

    def residuals(self, x: Array) -> Array:
        """Return the residuals (m,) at x (p,)."""
        values = self.nlp.all_values(x)
        return np.concatenate([residuals.at(values) for residuals in self._residuals])

    def jacobian(self, x: Array) -> Array:
        """Return the Jacobian (m, p) at x (p,), by the parameters."""
        values = self.nlp.all_values(x)
        return np.vstack([each.jacobian(values, len(x)) for each in self._residuals])
