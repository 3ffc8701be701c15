"""A frequency response with its model: cost, exact derivatives, and real residuals."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, complex_array, real_and_imaginary
from greybox.data.files.frozen_values import frozen
from greybox.data.files.rebuilt import Rebuilt
from greybox.engine.compiled.data_input import INCLUDED, data_numbers
from greybox.engine.compiled.information import Information
from greybox.engine.compiled.part import NO_NODES, SMOOTHING, Elsewhere, Part, Trajectory
from greybox.engine.compiled.response_information import response_information
from greybox.engine.compiled.shared_response import SharedSystem
from greybox.modeling.cached_property import cached_property
from greybox.modeling.formulation.frequency_criteria import Criterion, MaximumLikelihood
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import input_symbols
from greybox.statistics.neighbor_correlation import NeighborCorrelation, neighbor_correlation


@frozen
class ResponseFunctions(Rebuilt):
    """The functions of a frequency response, whatever its data.

    Attributes
    ----------
    objective : casadi.Function
        (z, smoothing, data) -> cost, unweighted, and real and imaginary parts of the model's
        response, stacked (2 n,).
    response : casadi.Function
        (all values x) -> the same response.
    system : SharedSystem or None
        The state space of a large problem, in numpy, at all values x: it takes a quarter of the
        time of CasADi's functions, and its derivatives need not be built.
    """

    objective: ca.Function
    response: ca.Function
    system: SharedSystem | None = None

    @cached_property
    @one_thread_at_a_time
    def slope(self) -> ca.Function:
        """(all values x) -> derivatives of the response."""
        [x] = input_symbols(self.response)
        return ca.Function("slope", [x], [ca.jacobian(self.response(x), x)])

    @cached_property
    @one_thread_at_a_time
    def derivatives(self) -> ca.Function:
        """(z, smoothing, data) -> gradient and Hessian of the cost."""
        z, *others = input_symbols(self.objective)
        hessian, gradient = ca.hessian(self.objective(z, *others)[0], z)
        return ca.Function("derivatives", [z, *others], [gradient, hessian])


class ResponsePart(Part):
    """One frequency response of a problem.

    Attributes
    ----------
    criterion : Criterion
    data : FrequencyResponse
    magnitude : (n,) array
        Magnitude of the measured response, above zero.
    functions : ResponseFunctions
    inputs : (g,) array
        The `data` of the functions, see `CompiledProblem`.
    is_open : bool
        Whether these include the data of this part: a user's criterion may accept only numbers.
    """

    def __init__(
        self, problem: Problem, functions: ResponseFunctions, inputs: Array, is_open: bool
    ) -> None:
        super().__init__(problem)
        assert isinstance(problem.criterion, Criterion)
        self.criterion = problem.criterion
        self.data = problem.response
        self.numbers = 2 * len(self.data)
        self.functions = functions
        self.inputs = inputs
        self.is_open = is_open
        self._results: dict[str, tuple[Array, Any]] = {}
        size = np.abs(self.data.response)
        # Points that are nearly zero must not dominate the signature of a run.
        self.magnitude = np.maximum(size, 1e-12 * size.max() + 1e-150)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out a criterion of the user's too: its cost is compiled."""
        state = super().__getstate__()
        return state if self.travels_whole else state | {"criterion": Elsewhere()}

    @property
    def travels_whole(self) -> bool:
        """True with one of the included criteria."""
        return type(self.criterion) in INCLUDED

    @property
    def error_model(self) -> Criterion:
        """The criterion with the sizes of the errors: of given variances, whatever is minimized."""
        return self.criterion if self.data.variance is None else MaximumLikelihood()

    def response(self, values: Array) -> ComplexArray:
        """Return the model's response (n,) at all values x (k,)."""
        return self._response(values).copy()

    def scaled_response(self, z: Any) -> Any:
        """Return real and imaginary parts of the model's response at z (p,), stacked (2 n,)."""
        return self.functions.objective(z, 0.0, self.inputs)[1]

    def objective(self, z: Any, smoothing: float) -> Any:
        """Return the cost at z (p,), unweighted."""
        return self.functions.objective(z, smoothing, self.inputs)[0]

    def numbers_of(self, response: ComplexArray) -> Array:
        """Return the inputs of this part with another measured response (n,)."""
        return data_numbers(self.data, response) if self.is_open else np.zeros(0)

    def sensitivity(self, values: Array) -> ComplexArray:
        """Return the derivatives of the response by all values x (k,): (n, k)."""
        if self.functions.system is not None:
            _, (slopes,) = self._of_system(values)
            return slopes.T.reshape(-1, len(values))

        def compute() -> ComplexArray:
            return complex_array(*self.functions.slope(values).full().reshape(2, -1))

        return self.stored("slope", values, compute).reshape(-1, len(values))

    def _response(self, values: Array) -> ComplexArray:
        if self.functions.system is not None:
            (response,), _ = self._of_system(values)
            return response.T

        def compute() -> ComplexArray:
            return complex_array(*self.functions.response(values).full().reshape(2, -1))

        return self.stored("response", values, compute)

    def _of_system(self, values: Array) -> Any:
        """Return the response of a state space in numpy, and its derivatives, for one column."""
        system = self.functions.system
        assert system is not None
        return self.stored("both", values, lambda: system.responses(values[:, None]))

    def stored(self, name: str, values: Array, compute: Callable[[], Any]) -> Any:
        """Return a result at all values x (k,), computed again only at other values."""
        # Covariance, outliers and misfit are evaluated at one point.
        point, _ = self._results.get(name, (None, None))
        if point is None or not np.array_equal(values, point):
            self._results[name] = values.copy(), compute()
        return self._results[name][1]

    def noise_ratio(self, trajectory: Trajectory) -> float:
        """Return the squared residuals over the given variances, or else their mean."""
        re, im = trajectory.detail.reshape(2, -1)
        return self.criterion.noise_ratio(re + 1j * im, self.data)

    # --- for Gauss-Newton

    def trajectory(
        self, z: Array, nodes: Array | None = None, *, simulated: bool = False
    ) -> Trajectory:
        """Return the point z, without nodes; its cost may not be finite."""
        # Smoothed already, because every iteration asks for this cost and rarely for another.
        outputs = self.functions.objective(z, SMOOTHING, self.inputs)
        cost, response = [matrix.full() for matrix in outputs]
        return Trajectory(z, NO_NODES, NO_NODES, NO_NODES, cost, simulated=True, detail=response)

    def cost(self, trajectory: Trajectory, smoothing: float) -> float:
        """Return the cost."""
        if smoothing == SMOOTHING:
            return trajectory.products.item()
        return float(self.objective(trajectory.z, smoothing))

    def linearize(self, trajectory: Trajectory, weight: Array) -> tuple[Array, Array]:
        """Return gradient (p,) and Hessian (p, p) with positive eigenvalues."""
        derivatives = self.functions.derivatives(trajectory.z, SMOOTHING, self.inputs)
        gradient, hessian = [matrix.full() for matrix in derivatives]
        # Away from a minimum the Hessian may be indefinite; a descent needs positive curvature.
        values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
        return gradient.ravel(), (vectors * np.abs(values)) @ vectors.T

    def signature(self, trajectory: Trajectory) -> Array:
        """Return the model's response over the measured magnitude: real, imaginary parts (2 n,)."""
        return trajectory.detail.ravel() / np.tile(self.magnitude, 2)

    # --- for the covariance of the estimate

    def information(
        self,
        names: tuple[str, ...],
        values: Array,
        uncertain: tuple[int, ...],
        trajectory: Trajectory | None,
        dz_dx: Array,
    ) -> Information:
        """Return the information on the values (k,)."""
        return response_information(self, values)

    def neighbors(
        self, values: Array, root: Array, correction: float
    ) -> NeighborCorrelation | None:
        """Return the correlation of neighboring errors at all values (k,); None if not known.

        The fit has removed errors along the columns of `root` (p, r), directions of the first
        values. `correction` scales the noise for the number of estimated parameters.
        """
        criterion, data = self.criterion, self.data
        response = self.response(values)
        size = criterion.error_size(response, data)
        order = np.argsort(data.omega, kind="stable")
        # A point with an error of size zero has no relative error, and so no correlation.
        if not np.all(size > 0):
            return None
        # Turned by the phase of the model: errors along and across it are then comparable.
        turned = (np.exp(-1j * np.angle(response)) / size)[order]
        moved = self.sensitivity(values)[:, : len(root)] @ root
        if data.common_errors is not None:  # known, and accounted for elsewhere
            moved = np.column_stack([moved, data.common_errors.T])
        design = turned[:, None] * moved[order]
        inflation = (
            criterion.noise_ratio(response, data) * correction**2 if criterion.known_noise else None
        )
        return neighbor_correlation(
            turned * (data.response - response)[order], real_and_imaginary(design), inflation
        )
