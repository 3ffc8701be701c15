"""Errors with bounded large values, so that outliers do not decide an estimate.

An estimate is robust if errors count as ψ(e), with Huber's ψ, which is linear up to a bound and
constant beyond it. Least squares on the *pseudo-values* model + ψ(e) / mean(ψ') have the same
estimate, and the covariance of that M-estimator. So everything made for least squares, including
correlated errors, works with outliers, too.

Source: Huber and Ronchetti (2009), Robust Statistics, 2nd ed., sections 7.4 and 7.8.
"""

from collections.abc import Sequence

import numpy as np

from greybox.files.arrays import Array


def robust_deviation(errors: Array) -> Array:
    """Return the standard deviations (k, 1) of errors (k, n), NaN if missing, by their medians."""
    # The median size of normal errors times 1.4826 is their standard deviation.
    deviation = 1.4826 * np.nanmedian(np.abs(errors), axis=1, keepdims=True)
    # Where more than half of all errors are zero, as in rounded signals, there is no scale.
    return np.where(deviation > 0, deviation, np.inf)


def bounded(stretches: Sequence[Array]) -> list[Array]:
    """Return ψ(e) / mean(ψ') of the errors (k, n) of several stretches, NaN if missing."""
    errors = np.hstack(stretches)
    # This bound is 95 % efficient for normal errors (Huber and Ronchetti).
    limit = 1.345 * robust_deviation(errors)
    beyond = np.sum(np.abs(errors) > limit, axis=1, keepdims=True)
    share = 1 - beyond / np.sum(np.isfinite(errors), axis=1, keepdims=True)
    return [np.clip(e, -limit, limit) / share for e in stretches]
