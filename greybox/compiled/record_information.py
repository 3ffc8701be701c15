"""How many independent numbers a record counts for where its residuals are correlated in time.

J is the Jacobian of the weighted residuals by p directions of the parameters, the initial states fitted along; e are
the residuals. For errors with the autocorrelation of the residuals, Jᵀe has the covariance M (the *meat*); for white
ones it is JᵀJ.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Of the largest eigenvalue in units in which every parameter has curvature one: below is rounding.
RANK = 1e-12

# Degrees of freedom that correlation leaves, at least: twice as many as Student's t needs for a finite variance.
FEWEST = 4


def correlation_factor(white: Array, meat: Array) -> float:
    """Return how many times more of the residuals the parameters take than they would of white ones, at least 1.

    Of n residuals with covariance Σ, p parameters take tr(JᵀΣJ (JᵀJ)⁻¹), which is p σ² where they are white.

    Parameters
    ----------
    white : (p, p) array
        JᵀJ times the variance of the weighted residuals.
    meat : (p, p) array
    """
    size = 1 / np.sqrt(np.where(np.diag(white) > 0, np.diag(white), 1.0))
    values, vectors = np.linalg.eigh(white * size * size[:, None])
    visible = values > RANK * max(values.max(initial=0.0), 1e-300)
    basis = size[:, None] * vectors[:, visible] / np.sqrt(values[visible])
    taken = float(np.trace(basis.T @ meat @ basis))
    return max(taken / max(int(visible.sum()), 1), 1.0) if np.isfinite(taken) else 1.0


def independent_numbers(measured: int, initial_states: int, parameters: int, factor: float) -> float:
    """Return as how many independent numbers the measured ones count, given the `correlation_factor`."""
    most = measured / (initial_states + parameters + FEWEST)
    return max(measured / min(factor, max(most, 1.0)), initial_states + 0.5)
