"""The Padé approximant of a Taylor series by its definition.

A second way to the coefficients of a delay.
"""

import numpy as np
from numpy.polynomial import Polynomial


def pade(taylor, order):
    """Return p and q with q(0) = 1, of this order each, so that p/q has the first 2 order + 1
    coefficients."""
    c = np.asarray(taylor)
    columns = np.array(
        [[c[k - j] for j in range(1, order + 1)] for k in range(order + 1, 2 * order + 1)]
    )
    q = np.concatenate([[1.0], np.linalg.solve(columns, -c[order + 1 : 2 * order + 1])])
    p = np.convolve(q, c)[: order + 1]
    return Polynomial(p), Polynomial(q)
