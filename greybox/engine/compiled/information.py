"""The information of a part of a problem, for the covariance of an estimate.

Each kind of data has a class of its own: `record_information`, `response_information`,
`transient_information`. `greybox.engine.covariance.covariance` asks all of them the same questions.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.error_spectrum import ErrorSpectrum
from greybox.statistics.neighbor_correlation import NeighborCorrelation

# Evidence for slow errors where none was computed.
NO_LINES = np.zeros((0, 0))


@frozen
class ColoredErrors:
    """The effect of errors that are correlated in time on the accuracy of an estimate.

    Attributes
    ----------
    meat : (r, r) array
        Middle matrix of the sandwich, for the given directions.
    dof : float
        Degrees of freedom of the variances that follow.
    spectrum : ErrorSpectrum or None
        Spectrum of the errors of a record, corrected for the part of the errors that the fit
        explained. None where all residuals are zero, and for data other than records.
    process_noise : function
        Returns twice the logarithm of the ratio of evidences: process noise (white, or gusts)
        against other errors. Zero for data other than records.
    slow_errors : function
        Returns a (2, outputs) array. The first row is twice the logarithm of the ratio of
        evidences, slow errors of each output against white ones. The second row is the number of
        frequencies with information on the parameters. Empty for data other than records.
    """

    meat: Array
    dof: float
    spectrum: ErrorSpectrum | None = None
    process_noise: Callable[[], float] = float  # a call returns 0.0
    slow_errors: Callable[[], Array] = lambda: NO_LINES


class CorrelatedPoints(ABC):
    """Correlation of the errors of a response along frequency, estimated from its residuals.

    Attributes
    ----------
    neighbors : NeighborCorrelation
        The correlation estimated from this response alone.
    """

    neighbors: NeighborCorrelation

    @abstractmethod
    def averaged(self, errors: NeighborCorrelation) -> tuple[Array, float]:
        """Return the middle matrix (r, r) of the sandwich, and the degrees of freedom.

        `errors` is the correlation estimated from all responses together.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class Information(ABC):
    """The information of a part on all values x (k,), the free ones first.

    Attributes
    ----------
    part : Part
    jacobian : (rows, k) array
        Derivatives of the real residuals, or a triangular factor of them.
    numbers : int
        Effective number of observations: the independent real numbers in the data, less the number
        of nuisance unknowns.
    reach : (k,) array
        Norms of the columns of the Jacobian before the initial states were eliminated. They set the
        level of rounding: if initial states compensate for a value, its remaining column is
        rounding only.
    initial : mapping of state to (stretches, k) array
        Sensitivity of the initial states to the values, in units of the change of a state that is
        visible in the data; empty without states.
    errors : (n,) array, rad/s, and (2 n,) array, or None
        The residuals of a frequency response in the rows of the Jacobian, and their frequencies;
        None where errors are independent.
    disturbed : bool
        Whether the errors of a manoeuvre look like those of turbulence, or of a missing term.
    noise_ratio : float or None
        Squared residuals of a frequency response over its given variances; None without these.
    """

    part: Any
    jacobian: Array
    numbers: int
    reach: Array
    initial: Mapping[str, Array] = field(default_factory=dict)
    errors: tuple[Array, Array] | None = None
    disturbed: bool = False
    noise_ratio: float | None = None

    @property
    def common_errors(self) -> int:
        """Number of errors that all rows have in common, the last rows of the root of the meat."""
        return 0

    @abstractmethod
    def spread(self, correction: float) -> tuple[float, Array]:
        """Return the bread, a factor on JᵀJ, and a root L (m, k) of the meat M = LᵀL.

        The noise is larger by the correction, and errors count as independent. With the bread B,
        the estimate has the covariance B⁻¹ M B⁻¹ of an M-estimator, see
        `greybox.modeling.formulation.frequency_criteria`. The method returns the root L, because M
        has the squares of its singular values: digits would be lost for nearly collinear
        parameters.
        """

    def colored(self, root: Array) -> ColoredErrors | None:
        """Return the effect of colored errors on the covariance; None where errors count as white.

        Errors are colored if they are correlated in time, or of unequal size over a spectrum.
        `root` (p, r) is a root of B⁻¹: the covariance of the free parameters for white errors,
        times the weight of the part. Its columns are directions of unit variance, in which no
        digits are lost where parameters are poorly determined.
        """
        return None

    def correlated(self, correction: float, root: Array, dof: float) -> CorrelatedPoints | None:
        """Return the correlation of the errors along frequency; None if they are independent.

        `root` (p, r) is a root of B⁻¹, and `dof` the degrees of freedom; the noise is larger by the
        correction.
        """
        return None

    def offset(self, correction: float) -> Array | None:
        """Return the expected bias of the residuals (rows,) from noise; None without a bias.

        It follows from the `gain_bias` of a criterion of responses, with the noise larger by the
        correction. Its least-squares solution with the Jacobian is the bias of the estimate.
        """
        return None
