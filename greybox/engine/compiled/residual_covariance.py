"""The covariance of the residuals in time: given, or estimated by maximum likelihood."""

import math
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array, IntArray, all_finite, diagonal, positive_or_one
from greybox.data.files.frozen_values import frozen
from greybox.data.files.wording import listed
from greybox.modeling.formulation.time_criterion import TimeCriterion


def require_independent(outputs: tuple[str, ...], measured: Array) -> None:
    """Check that the measured outputs (k, samples) are independent.

    Otherwise their full covariance cannot be inverted.

    Raises
    ------
    ValueError
        If one output follows from others: so do the residuals of any model that fits.
    """
    complete = measured[:, np.isfinite(measured).all(axis=0)]
    moving = np.flatnonzero(complete.std(axis=1) > 0)
    # So few samples are always linearly dependent.
    if complete.shape[1] <= len(outputs) or moving.size < 2:
        return
    values, directions = np.linalg.eigh(np.corrcoef(complete[moving]))
    if values[0] > 1e-12:  # logs have single precision
        return
    share = np.abs(directions[:, 0])
    names = [outputs[k] for k in moving[share > 1e-3 * share.max()]]
    raise ValueError(
        f"{listed(names)} are exactly dependent in the record, one following from the other"
        f"{'s' if len(names) > 2 else ''}, so that their full covariance is singular: "
        "use noise='diagonal', or leave one of them out."
    )


# Numbers of an output for a variance of its own: with 8 in each of 6 or 20 records, intervals of
# 95 % held in 89 %, and with 12 in 97 %.
FEWEST = 12


@frozen
class ResidualCovariance:
    """The covariance that turns sums of residual products (..., k, k) into a cost.

    The sums run over `counts` (..., k) samples.

    Leading axes are records, whose costs add. The cost is the negative logarithm of the likelihood
    of normal errors. With an estimated covariance it is that of the concentrated likelihood, n/2
    log det R + constant, R the covariance of the residuals. It is `known` (k, k), or None. One that
    is `predicted` (k, k), by a filter, is that of a single record. Where errors of several outputs
    are `correlated`, all outputs have the same samples.
    """

    counts: IntArray
    spread: Array
    known: Array | None
    correlated: bool
    predicted: Array | None = None

    def few(self, lost: float = 0.0) -> IntArray:
        """Return samples of outputs (..., k) that are too few for their own variance, else zero.

        Other unknowns use up `lost` of them.
        """
        is_estimated = self.known is None and not self.correlated
        return np.where(is_estimated & (self.counts - lost < FEWEST), self.counts, 0)

    @property
    def unknowns(self) -> int:
        """Number of variances and covariances that are estimated."""
        if self.known is not None:
            return 0
        # A covariance matrix is symmetric: half of its entries, with the diagonal.
        k = self.spread.shape[-1]
        return k * (k + 1) // 2 if self.correlated else k

    def covariance(self, products: Array) -> Array:
        """Return the covariance (k, k): given, predicted, or estimated from these products."""
        if self.predicted is not None:
            return self.predicted
        if self.known is not None:
            return np.broadcast_to(self.known, products.shape)
        # A perfect fit has no residuals, and without a floor of rounding its cost would be minus
        # infinity.
        floor = (1e-9 * self.spread) ** 2
        count = np.maximum(self.counts, 1)
        if not self.correlated:
            return diagonal(np.maximum(np.linalg.diagonal(products) / count, floor))

        return products / count.max(axis=-1)[..., None, None] + diagonal(floor)

    def cost(self, products: Array) -> float:
        """Return the negative log-likelihood; infinite where the products are not finite."""
        if not all_finite(products):
            return math.inf
        covariance = self.covariance(products)
        if self.predicted is not None or self.correlated:
            logarithms = np.linalg.slogdet(math.tau * covariance)[1] * self.counts.max(axis=-1)
            squares = self.counts.sum()
            if self.predicted is not None or self.known is not None:
                squares = np.linalg.solve(covariance, products).trace(axis1=-2, axis2=-1).sum()
            return float(np.sum(logarithms) + squares) / 2

        variance = np.linalg.diagonal(covariance)
        squares = np.linalg.diagonal(products) / variance if self.known is not None else self.counts
        return float(0.5 * np.sum(squares + self.counts * np.log(math.tau * variance)))

    def weight(self, products: Array) -> Array:
        """Return W (k, k) with WᵀW the inverse of the covariance.

        It is the symmetric root of the inverse correlations, over the deviations: standard errors
        would follow the order of the outputs by a triangular root, and their units by another one.
        """
        root = np.linalg.cholesky(self.covariance(products))
        deviations = np.linalg.norm(root, axis=-1, keepdims=True)
        directions, sizes, _ = np.linalg.svd(root / deviations)
        whitening = directions / sizes[..., None, :] @ directions.mT
        return whitening / deviations.mT

    def along(self, measured: Array) -> "ResidualCovariance":
        """Return the covariance for other measured values (k, samples) of the same outputs."""
        counts, spread = _counts_and_spread(measured)
        return replace(self, counts=counts, spread=spread)


def residual_covariance_of(
    criterion: TimeCriterion, outputs: tuple[str, ...], measured: Array
) -> ResidualCovariance:
    """Return the residual covariance that the criterion asks for; measured outputs (k, samples)."""
    errors = criterion.error_covariance
    known = errors.covariance_of(outputs)
    if errors.is_correlated and known is None:
        require_independent(outputs, measured)
    return ResidualCovariance(*_counts_and_spread(measured), known, errors.is_correlated)


def _counts_and_spread(measured: Array) -> tuple[IntArray, Array]:
    """Return the number of values and the standard deviation of each output (k, samples)."""
    present = np.isfinite(measured)
    rows = [row[finite] for row, finite in zip(measured, present, strict=True)]
    # The scale of a constant output is its size.
    spread = np.array([(np.std(row) or np.abs(row).max()) if row.size else 0.0 for row in rows])
    return present.sum(axis=1), positive_or_one(spread)
