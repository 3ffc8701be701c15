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
        Of a record, spectrum of the errors, enlarged for what the fit took from them; None where
        all residuals are zero.
    process_noise : function
        Returns -2 log of the evidence for other errors, less that for process noise: white, or
        gusts. Of a record only.
    slow_errors : function
        Returns 2 log of the evidence for slow errors of every output, not white ones, and the
        number of frequencies that show the parameters: (2, outputs). Of a record only.
    """

    meat: Array
    dof: float
    spectrum: ErrorSpectrum | None = None
    process_noise: Callable[[], float] = float
    slow_errors: Callable[[], Array] = lambda: NO_LINES


class CorrelatedPoints(ABC):
    """What the residuals of a response show of the correlation of its errors along frequency.

    Attributes
    ----------
    neighbors : NeighborCorrelation
        The correlation that this response, judged alone, shows.
    """

    neighbors: NeighborCorrelation

    @abstractmethod
    def averaged(self, errors: NeighborCorrelation) -> tuple[Array, float]:
        """Return the middle matrix (r, r) of the sandwich, and the degrees of freedom.

        `errors` is the correlation that all responses together show.
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
        Real numbers in the data that count as independent, less those that nuisance unknowns use
        up.
    reach : (k,) array
        Lengths of the columns of the Jacobian before the initial states were fitted too: if
        initial states compensate for a value, the rest of its column is rounding.
    initial : mapping of state to (stretches, k) array
        How the initial states follow the values, in changes that the data notice; empty without
        states.
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

    @abstractmethod
    def spread(self, correction: float) -> tuple[float, Array]:
        """Return the bread, a factor on JᵀJ, and a root L (m, k) of the meat M = LᵀL.

        Both with the noise larger by the correction, and errors taken as independent: the estimate
        has the covariance B⁻¹ M B⁻¹ of an M-estimator, see
        `greybox.modeling.formulation.frequency_criteria`. M itself has the squares of the singular
        values of L: of parameters that are hard to tell apart, it loses the digits that a root
        keeps.
        """

    def colored(self, root: Array) -> ColoredErrors | None:
        """Return what correlation in time, or unequal sizes over a spectrum, makes of the errors.

        `root` (p, r) is a root of B⁻¹: the covariance of the free parameters for white errors,
        times the weight of the part. Directions of unit variance keep their digits where parameters
        are hardly determined. None where errors count as white.
        """
        return None

    def correlated(self, correction: float, root: Array, dof: float) -> CorrelatedPoints | None:
        """Return what the residuals show of correlation along frequency; None where nothing.

        For a correction of the noise, a root (p, r) of B⁻¹, and the degrees of freedom.
        """
        return None

    def offset(self, correction: float) -> Array | None:
        """Return what noise adds to the residuals (rows,) in the mean; None for nothing.

        By the `gain_bias` of a criterion of responses, with the noise larger by the correction: the
        bias of the estimate is its least squares on the Jacobian.
        """
        return None
