"""The covariance of the errors of one sample: estimated with the parameters, or known."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from greybox.data.files.argument_checks import is_finite_number
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import Values, array_of
from greybox.data.files.wording import counted


class ErrorCovariance(ABC):
    """How accurate the outputs of a record are, and whether their errors belong together.

    A subclass is a frozen dataclass with its settings as fields. One of your own is known: the
    covariances of a calibration, or those that follow from a data sheet.

    Attributes
    ----------
    description : str
        Words that follow the rule of a criterion, such as "given variances".
    is_correlated : bool
        Whether errors of several outputs are correlated. Then only samples with all outputs count.
    """

    description: ClassVar[str]
    is_correlated: ClassVar[bool] = False

    @abstractmethod
    def known(self, outputs: Sequence[str]) -> Array | None:
        """Return the known covariance (k, k) of these outputs; None if it is estimated.

        Raises
        ------
        ValueError
            If it does not say how accurate one of them is.
        """

    def covariance_of(self, outputs: Sequence[str]) -> Array | None:
        """Return the known covariance (k, k) of these outputs, checked; None if it is estimated.

        Raises
        ------
        ValueError
            If one of them has none, or the matrix is no covariance.
        """
        known = self.known(outputs)
        if known is None:
            return None
        known, k = np.asarray(known, dtype=float), len(outputs)
        rounding = 1e-9 * np.abs(known).max(initial=0.0)
        is_symmetric = known.shape == (k, k) and np.all(np.abs(known - known.T) <= rounding)
        if not (is_symmetric and np.linalg.eigvalsh(known)[0] > 0):
            raise ValueError(
                f"{self} gives {known.tolist()!r:.60} for {', '.join(outputs)}: give a symmetric "
                "covariance matrix with positive eigenvalues."
            )
        if not self.is_correlated and np.any(np.abs(known - np.diag(np.diag(known))) > rounding):
            raise ValueError(
                f"{self} gives covariances of {', '.join(outputs)}, and says that their errors are "
                "independent: set is_correlated = True."
            )
        return known


@dataclass(frozen=True)
class EstimatedVariances(ErrorCovariance):
    """A variance of each output is estimated; errors of several outputs are independent."""

    description: ClassVar[str] = "estimated variances"

    def known(self, outputs: Sequence[str]) -> None:
        """Return None."""


@dataclass(frozen=True)
class EstimatedCovariance(ErrorCovariance):
    """The whole covariance of the outputs is estimated."""

    description: ClassVar[str] = "estimated covariance"
    is_correlated: ClassVar[bool] = True

    def known(self, outputs: Sequence[str]) -> None:
        """Return None."""


@dataclass(frozen=True)
class KnownDeviations(ErrorCovariance):
    """Standard deviations of the outputs are known, and their errors independent.

    Parameters
    ----------
    deviations : mapping of output to float
        In the units of the outputs.

    Raises
    ------
    ValueError
        For anything but one finite number above zero for each output.
    """

    deviations: Values
    description: ClassVar[str] = "given variances"

    def __post_init__(self) -> None:
        """Check the deviations."""
        for name, sigma in self.deviations.items():
            if np.ndim(sigma) > 0:
                raise ValueError(
                    f"noise gives {name!r} {counted(np.size(sigma), 'number')}, and an output "
                    "has one standard deviation: for samples of different accuracy, declare an "
                    f"input with their standard deviations, divide the formula of {name!r} and "
                    f"its samples by it, and give noise={{{name!r}: 1.0}}."
                )
            if not is_finite_number(sigma) or sigma <= 0:
                raise ValueError(
                    f"noise gives {name!r} the value {sigma!r}: give a standard deviation above 0."
                )

    def known(self, outputs: Sequence[str]) -> Array:
        """Return the squares of the deviations on the diagonal."""
        for name in outputs:
            if name not in self.deviations:
                raise ValueError(
                    f"noise gives no standard deviation for {name!r}: add it, or use "
                    "noise='diagonal'."
                )
        return np.diag(array_of(self.deviations, outputs) ** 2)


ESTIMATED: dict[str, ErrorCovariance] = {
    "diagonal": EstimatedVariances(),
    "full": EstimatedCovariance(),
}
"""What is estimated, by name."""


def error_covariance(noise: Any) -> ErrorCovariance:
    """Return the covariance that a name, deviations by output, or an object states.

    Raises
    ------
    ValueError
        For anything else.
    """
    if isinstance(noise, ErrorCovariance):
        return noise
    if isinstance(noise, Mapping):
        return KnownDeviations(noise)
    # An array has no truth value, with which a word could be compared.
    if isinstance(noise, str) and noise in ESTIMATED:
        return ESTIMATED[noise]
    raise ValueError(
        f"noise {noise!r:.60} is not known: use 'diagonal', 'full', {{output: standard deviation}} "
        "or an ErrorCovariance."
    )


def stated_noise(noise: ErrorCovariance) -> Any:
    """Return the name or the deviations that state an included covariance, else the object.

    Equal statements are then equal values, and can be stored.
    """
    if isinstance(noise, KnownDeviations):
        return noise.deviations
    names = [name for name, included in ESTIMATED.items() if included == noise]
    return names[0] if names else noise


def is_estimated(stated: Any) -> bool:
    """Return whether the noise that a fit stores is estimated: one of your own is known."""
    return isinstance(stated, str) and stated in ESTIMATED


def is_included(stated: Any) -> bool:
    """Return whether the noise that a fit stores is of greybox: one of your own is a text there."""
    return isinstance(stated, Mapping) or is_estimated(stated)
