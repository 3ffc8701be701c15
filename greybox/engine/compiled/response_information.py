"""The information of a frequency response: an M-estimator whose errors neighbors may share."""

from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, complex_array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.information import CorrelatedPoints, Information
from greybox.statistics.neighbor_correlation import NeighborCorrelation, averaged_meat

# Share of the information on its best direction with which a response counts for another one. The
# residuals lack errors along the directions that this part determines. With many parts, each has a
# small share in most directions, and its residuals keep these errors. With half of the information,
# 20 of 90 white responses of a helicopter that are judged alone count as correlated, with a tenth
# 17, with all directions 36.
DETERMINED = 0.1


@frozen
class ResponseInformation(Information):
    """The information of a frequency response.

    Attributes
    ----------
    values : (k,) array
        All values.
    response : (n,) complex array
        The model's response at these.
    common : (rows, c) array
        Errors that are common to all points, in the units of the residuals.
    independent : float or (rows,) array
        Share of the variance that is independent from point to point.
    """

    values: Array
    response: ComplexArray
    common: Array
    independent: float | Array

    @property
    def common_errors(self) -> int:
        """Number of errors that all points have in common."""
        return self.common.shape[1]

    def spread(self, correction: float) -> tuple[float, Array]:
        """Return the bread and a root of the meat, see `Information`."""
        bread, meat = self.part.criterion.spread(self.response, self.part.data, correction)
        own = np.sqrt(self.independent * meat)[:, None] * self.jacobian
        return bread, np.vstack([own, bread * self.common.T @ self.jacobian])

    def correlated(self, correction: float, root: Array, dof: float) -> CorrelatedPoints | None:
        """Return what the residuals show of correlation along frequency."""
        if self.errors is None:
            return None
        directions = self.jacobian[:, : len(root)] @ root
        _, sizes, turns = np.linalg.svd(directions, full_matrices=False)
        own = root @ turns[sizes**2 > DETERMINED * sizes[:1] ** 2].T
        neighbors = self.part.neighbors(self.values, own, correction)
        return neighbors and CorrelatedResponse(neighbors, self, correction, directions, dof)

    def offset(self, correction: float) -> Array:
        """Return what noise adds to the residuals in the mean."""
        criterion, data = self.part.criterion, self.part.data
        noise = criterion.noise(self.response, data, correction)
        along = criterion.jacobian(self.response, self.response[:, None], data)[:, 0]
        return criterion.gain_bias(noise, len(data)) * along


@frozen
class CorrelatedResponse(CorrelatedPoints):
    """What the residuals of a response show of correlation, in directions (rows, r)."""

    neighbors: NeighborCorrelation
    information: ResponseInformation
    correction: float
    directions: Array
    dof: float

    def averaged(self, errors: NeighborCorrelation) -> tuple[Array, float]:
        """Return the middle matrix of the sandwich, and the degrees of freedom."""
        information, part = self.information, self.information.part
        bread, meat = part.criterion.spread(information.response, part.data, self.correction)
        # Neighbors in frequency are neighbors in correlation: the order matters here alone.
        order = np.argsort(part.data.omega, kind="stable")
        scaled = np.sqrt(information.independent * meat)[:, None] * self.directions
        middle, dof = averaged_meat(
            complex_array(*np.split(scaled, 2))[order],
            errors,
            part.criterion.score_correlation,
            self.dof,
        )
        shift = bread * information.common.T @ self.directions
        return part.weight**2 * (middle + shift.T @ shift), dof


def response_information(part: Any, values: Array) -> ResponseInformation:
    """Return the information of a response at all values (k,)."""
    criterion, data = part.criterion, part.data
    response = part.response(values)
    jacobian = criterion.jacobian(response, part.sensitivity(values), data)

    common = np.zeros((len(jacobian), 0))
    if data.common_errors is not None:
        common = criterion.jacobian(response, data.common_errors.T, data)
    # A given variance includes the common errors. A noise estimated from residuals does not,
    # because the fit follows these errors.
    independent = np.tile(data.independent_share, 2) if criterion.known_noise else 1.0

    errors = None
    if not data.has_independent_errors:
        residuals = (data.response - response)[:, None]
        errors = data.omega, criterion.jacobian(response, residuals, data)[:, 0]

    return ResponseInformation(
        values,
        response,
        common,
        independent,
        part=part,
        jacobian=jacobian,
        numbers=len(jacobian),
        reach=np.linalg.norm(jacobian, axis=0),
        errors=errors,
        noise_ratio=criterion.noise_ratio(response, data) if criterion.known_noise else None,
    )
