"""Errors that different responses share: wind moves all outputs of a flight at the same time.

Each response alone shows only its own errors. The estimate depends on the sum of the scores of all
responses, and errors that several responses share at one frequency make this sum vary more. The
covariance of the shared scores is estimated from the products of the residuals of different
responses in bins of frequency, which are as wide as the spacing of the points. No spectrum of the
errors is assumed, and the phase between two responses may change along frequency. The products of
residuals that are shifted along frequency, each response by another number of points, are due to
chance.

For the parameters of a simulated aircraft, whose six responses were measured in the same gusts,
standard errors without this were up to 2.2 times too small.

Sources: Liang and Zeger (1986), Longitudinal data analysis using generalized linear models,
Biometrika 73 (scores summed over clusters); Driscoll and Kraay (1998), Review of Economics and
Statistics 80 (clusters of what happens at the same time).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import Array

# Number of random shifts. Products that exceed those of all shifts happen by chance in 2 to 5 % of
# fits.
SHIFTS = 49

# Fewest different frequencies of a response. With fewer, the shifts hardly differ.
FEWEST_FREQUENCIES = 8


class _ScaledResponse(NamedTuple):
    """A response in the order of frequency.

    Attributes
    ----------
    log_omega : (n,) array
    errors : (2, n) array
        Residuals, scaled so that their scores have the right variance.
    slopes : (2, n, r) array
        Derivatives of the residuals.
    """

    log_omega: Array
    errors: Array
    slopes: Array


def shared_covariance(
    responses: Iterable[tuple[Array, Array, Array, float]], size: int
) -> tuple[Array, float]:
    """Return the covariance (r, r) of scores that responses share, and its degrees of freedom.

    It has only the directions in which scores add up to more than by chance.

    Parameters
    ----------
    responses : iterable of tuples
        For every response: frequencies (n,) in rad/s, residuals (2 n,), their derivatives (2 n, r),
        real parts first, and the sum of the variances of its scores.
    size : int
        The number r of parameters.
    """
    scaled = []
    for omega, errors, slopes, variance in responses:
        if np.unique(omega).size >= FEWEST_FREQUENCIES:
            scaled.append(_scaled(omega, errors, slopes, variance))
    k = len(scaled)
    if k < 2:
        return np.zeros((size, size)), 1.0
    rows = [response.log_omega for response in scaled]
    spacing = np.median([np.ptp(row) / (row.size - 1) for row in rows])
    lowest = min(row[0] for row in rows)
    bins_of_points = [np.rint((row - lowest) / spacing) for row in rows]
    bins = np.arange(1 + max(row[-1] for row in bins_of_points))

    # The first shift is none. Among the others, two responses that are shifted alike would show
    # what they share: a permutation keeps their shifts apart.
    random = np.random.default_rng(0)
    shifts = [np.zeros(k)]
    for _ in range(SHIFTS):
        shifts.append((random.permutation(k) + random.uniform(0.25, 0.75, k)) / k)
    total = np.zeros(())
    own_products = np.zeros(())
    for response, places, shift in zip(scaled, bins_of_points, np.array(shifts).T, strict=True):
        scores = _scores_in_bins(response, places, bins, shift)
        total = total + scores
        own_products = own_products + scores.mT @ scores

    # The products of different responses remain.
    products = total.mT @ total - own_products
    by_chance = np.linalg.eigvalsh(products[1:]).max()
    values, vectors = np.linalg.eigh(products[0])
    is_shared = values > by_chance
    return (vectors * values * is_shared) @ vectors.T, float(bins.size)


def _scaled(omega: Array, errors: Array, slopes: Array, variance: float) -> _ScaledResponse:
    """Return a response in the order of frequency, with scores of this variance."""
    order = np.argsort(omega, kind="stable")
    # The squared scores of independent errors of this size add up to the variance, on average.
    norm = np.linalg.norm(errors) * np.linalg.norm(slopes) / errors.size**0.5
    scale = np.sqrt(variance) / (norm or 1.0)
    scaled_errors = scale * errors.reshape(2, -1)
    point_slopes = slopes.reshape(2, omega.size, slopes.shape[1])
    return _ScaledResponse(np.log(omega[order]), scaled_errors[:, order], point_slopes[:, order])


def _scores_in_bins(response: _ScaledResponse, places: Array, bins: Array, shifts: Array) -> Array:
    """Return the sums of scores (s, bins, r) of a response for s shifts of its residuals.

    The points are in the bins `places` (n,). A shift of one moves the residuals once around.
    """
    n = places.size
    moved = response.errors[:, np.arange(n) - (shifts[:, None] * n).astype(int)]
    scores = np.einsum("csn,cnr->snr", moved, response.slopes)
    return (places == bins[:, None]) @ scores
