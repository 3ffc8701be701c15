"""Whether errors are larger in a part of the band."""

import math

import numpy as np

from greybox.data.files.arrays import Array, sum_of_squares


def size_test(squares: Array, dof: Array | float) -> float:
    """Return the probability that chance makes errors so much larger in a part of the band.

    A variance that is a parabola over the points is judged by its score, by the likelihood of
    circular normal errors, or of Student's t. Ranks found a third or less of such errors of 8 to 12
    points.

    Parameters
    ----------
    squares : (n,) array
        Squared magnitudes of errors over their sizes, by frequency.
    dof : (n,) array or float
        Degrees of freedom of sizes that are estimates, else infinite.

    Source: Cook and Weisberg (1983), Diagnostics for heteroscedasticity in regression, Biometrika
    70.
    """
    squares = squares / (np.mean(squares) or 1.0)
    score = (squares - 1) / (1 + 2 * squares / dof) * np.sqrt(1 + 4 / dof)
    trends, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, len(squares)), 3, increasing=True))
    # The statistic has the chi-squared distribution with two degrees of freedom.
    return math.exp(-sum_of_squares(score @ trends[:, 1:]) / 2)
