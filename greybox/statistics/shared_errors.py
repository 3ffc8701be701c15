"""Errors that different responses share: wind moves all outputs of a flight at the same time.

Each response alone shows only its own errors. The estimate follows the sum of the scores of all of
them, and scores at the same frequency that add up make it vary more. Their covariance is estimated
from the products of the residuals of different responses in bins of frequency as wide as their
points are apart: no spectrum of the errors is assumed, and the phase between two responses may
change along frequency. Residuals that are shifted along frequency, each response by another number
of points, show what chance adds up.

Of parameters of a simulated aircraft whose six responses were measured in the same gusts, standard
errors without this were up to 2.2 times too small.

Sources: Liang and Zeger (1986), Longitudinal data analysis using generalized linear models,
Biometrika 73 (scores summed over clusters); Driscoll and Kraay (1998), Review of Economics and
Statistics 80 (clusters of what happens at the same time).
"""

from collections.abc import Iterable

import numpy as np

from greybox.files.arrays import Array

# Shifts of the residuals. What exceeds all of them happens by chance in 2 to 5 % of fits.
SHIFTS = 49
# Frequencies of a response below which the shifts hardly differ.
FEWEST = 8


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
        r.
    """
    logarithms, rows = [], []
    for omega, errors, slopes, variance in responses:
        if np.unique(omega).size >= FEWEST:
            order = np.argsort(omega, kind="stable")
            # The errors get a mean square of one, then the variance of the response.
            norm = np.linalg.norm(errors) * np.linalg.norm(slopes) / errors.size**0.5
            scale = np.sqrt(variance) / (norm or 1.0)
            logarithms.append(np.log(omega[order]))
            rows.append(
                (
                    scale * errors.reshape(2, -1)[:, order],
                    slopes.reshape(2, omega.size, size)[:, order],
                )
            )
    if len(rows) < 2:
        return np.zeros((size, size)), 1.0
    spacing = np.median([np.ptp(row) / (row.size - 1) for row in logarithms])
    lowest = min(row[0] for row in logarithms)
    bins = [np.rint((row - lowest) / spacing).astype(int) for row in logarithms]
    count, random = 1 + max(row[-1] for row in bins), np.random.default_rng(0)

    def added(shifts: Array) -> Array:
        sums = np.zeros((len(rows), count, size))
        for row, at, (errors, slopes), shift in zip(sums, bins, rows, shifts, strict=True):
            shifted = np.roll(errors, int(shift * len(at)), axis=1)
            np.add.at(row, at, np.einsum("cn,cnr->nr", shifted, slopes))
        total = sums.sum(axis=0)
        return total.T @ total - np.einsum("pbr,pbs->rs", sums, sums)

    # Two responses that are shifted alike would show what they share.
    shifts = (
        (random.permutation(len(rows)) + random.uniform(0.25, 0.75, len(rows))) / len(rows)
        for _ in range(SHIFTS)
    )
    by_chance = max(np.linalg.eigvalsh(added(each))[-1] for each in shifts)
    values, vectors = np.linalg.eigh(added(np.zeros(len(rows))))
    return (vectors * values * (values > by_chance)) @ vectors.T, float(count)
