"""Errors that different responses share: wind moves all outputs of a flight at the same time.

Each response alone shows only its own errors. The estimate follows the sum of the scores of all of
them, and scores at the same frequency that add up make it vary more. Their covariance is estimated
from the products of the residuals of different responses, over bins of frequency as wide as their
points are apart, with the lag window of Bartlett over neighboring bins: no spectrum of the errors
is assumed, and the phase between two responses may change along frequency. Residuals that are
shifted along frequency, each response by another number of points, show what chance adds up.

Of parameters of a simulated aircraft whose six responses were measured in the same gusts, standard
errors without this were up to 2.2 times too small.

Sources: Newey and West (1987), Econometrica 55 (the window); Driscoll and Kraay (1998), Review of
Economics and Statistics 80 (the same for many series).
"""

from collections.abc import Sequence

import numpy as np

from greybox.files.arrays import Array, frozen

# Shifts of the residuals. What exceeds all of them happens by chance in 2 to 5 % of fits.
SHIFTS = 49
# Points of a response below which the shifts hardly differ.
FEWEST = 8


@frozen
class PointScores:
    """The errors of a response by frequency, and how the estimate follows them.

    Attributes
    ----------
    omega : (n,) array, rad/s
    errors : (2, n) array
        Real and imaginary parts of the residuals, of mean square one.
    slopes : (2, n, r) array
        Scores by errors of mean square one.
    """

    omega: Array
    errors: Array
    slopes: Array


def shared_covariance(responses: Sequence[PointScores]) -> tuple[Array, float] | None:
    """Return the covariance (r, r) of scores that responses share, and its degrees of freedom.

    It has only the directions in which scores add up to more than by chance. None without such.
    """
    responses = [each for each in responses if each.omega.size >= FEWEST]
    if len(responses) < 2:
        return None
    logarithms = [np.log(each.omega) for each in responses]
    spacing = np.median(np.concatenate([*map(np.diff, logarithms)]))
    lowest = min(row[0] for row in logarithms)
    bins = [np.rint((row - lowest) / spacing).astype(int) for row in logarithms]
    count, random = 1 + max(row[-1] for row in bins), np.random.default_rng(0)

    def added(shifts: Sequence[int]) -> Array:
        sums = np.zeros((len(responses), count, responses[0].slopes.shape[2]))
        for row, places, each, shift in zip(sums, bins, responses, shifts, strict=True):
            errors = np.roll(each.errors, shift, axis=1)
            np.add.at(row, places, np.einsum("cn,cnr->nr", errors, each.slopes))
        return _windowed(sums.sum(axis=0)) - sum(map(_windowed, sums))

    def apart() -> list[int]:
        # Two responses that are shifted alike would show what they share.
        places = random.permutation(len(responses)) + random.uniform(0.25, 0.75, len(responses))
        share = places / len(responses)
        return [int(s * each.omega.size) for s, each in zip(share, responses, strict=True)]

    by_chance = [np.linalg.eigvalsh(added(apart()))[-1] for _ in range(SHIFTS)]
    values, vectors = np.linalg.eigh(added([0] * len(responses)))
    kept = values > max(by_chance)
    if not kept.any():
        return None
    return (vectors[:, kept] * values[kept]) @ vectors[:, kept].T, float(count)


def _windowed(scores: Array) -> Array:
    """Return the covariance (r, r) of the sum of scores (bins, r), by that of neighbors."""
    beside = scores[1:].T @ scores[:-1]
    return scores.T @ scores + (beside + beside.T) / 2
