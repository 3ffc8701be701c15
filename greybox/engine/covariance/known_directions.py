"""What the data determine of the parameters, also where they leave directions open."""

from collections.abc import Sequence

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, real_root
from greybox.data.files.frozen_values import frozen

BLIND = 1e-5  # share of an invisible direction above which a quantity has no standard error


@frozen
class KnownDirections:
    """The information of the data on parameters, also where they leave directions open.

    Attributes
    ----------
    covariance : (p, p) array
        Covariance of the estimate within the directions that the data determine, without NaN.
    unseen : (p, b) array
        Directions, in multiples of `size`, on which the data contain no information.
    size : (p,) array
        The change of each parameter that the data notice.
    at : (p,) array
        The estimate.
    elsewhere : KnownDirections or None
        The same of the free parameters at a point near the estimate, if a direction is unseen. It
        distinguishes a product from a sum, whose derivatives agree where both factors are equal.
    """

    covariance: Array
    unseen: Array
    size: Array
    at: Array
    elsewhere: "KnownDirections | None" = None

    def of(self, places: Sequence[int]) -> "KnownDirections":
        """Return the directions of the parameters at these places alone.

        `elsewhere` is None if one of them is fixed or tied: it has the free parameters only, which
        come first.
        """
        beside = self.elsewhere
        if beside is not None:
            are_free = max(places, default=0) < len(beside.at)
            beside = beside.of(places) if are_free else None
        return KnownDirections(
            self.covariance[np.ix_(places, places)],
            self.unseen[places],
            self.size[places],
            self.at[places],
            beside,
        )

    @property
    def is_known(self) -> BoolArray:
        """Whether each value counts as exact (p,): constants, and parameters that a bound holds."""
        return (np.diag(self.covariance) == 0) & ~self.unseen.any(axis=1)

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p); NaN for a parameter without a standard error."""
        errors = self.errors(np.eye(len(self.at)))
        errors = np.where(errors > 0, errors, np.nan)
        return self.covariance / np.outer(errors, errors)

    @property
    def matrix(self) -> Array:
        """The inverse covariance in multiples of size; zero along unseen directions."""
        scaled = self.covariance / np.outer(self.size, self.size)
        values, vectors = np.linalg.eigh(scaled)
        lost = np.linalg.matrix_rank(self.unseen) if self.unseen.size else 0
        # Directions without information have the smallest eigenvalues: zero except for rounding.
        seen = vectors[:, lost:]
        return (seen / np.maximum(values[lost:], 1e-300)) @ seen.T

    def errors(self, gradients: Array) -> Array:
        """Return the standard errors (m,) of quantities by their gradients (m, p); NaN if open."""
        variance = np.einsum("ij,jk,ik->i", gradients, self.covariance, gradients)
        scaled = gradients * self.size
        lost = np.abs(scaled @ self.unseen) > BLIND * np.linalg.norm(scaled, axis=1)[:, None]
        return np.where(lost.any(axis=1), np.nan, real_root(variance))

    def gradients(self, rows: Array, is_product: BoolArray) -> Array:
        """Return gradients (m, p) of logarithms of products of powers `rows` (m, p), or of sums."""
        return rows / np.where(is_product[:, None] & (self.at != 0), self.at, 1.0)
