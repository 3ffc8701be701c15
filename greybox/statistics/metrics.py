"""Measures of fit of residuals, or of measured and predicted values.

Missing values are NaN.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.arrays import Array


def rms(error: Array) -> float:
    """Return the root mean square; NaN without any value."""
    e = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(e**2))) if e.size else math.nan


def fit_percent(measured: ArrayLike, predicted: ArrayLike) -> float:
    """Return 100 (1 - |y - ŷ| / |y - mean y|), the fit of MATLAB's `compare`."""
    y, p = np.asarray(measured, dtype=float).ravel(), np.asarray(predicted, dtype=float).ravel()
    if y.size != p.size:
        raise ValueError(
            f"there are {y.size} measured and {p.size} predicted values: give as many of both."
        )
    y, p = np.array([y, p])[:, np.isfinite(y) & np.isfinite(p)]
    spread = float(np.linalg.norm(y - y.mean())) if y.size else 0.0
    return 100 * (1 - float(np.linalg.norm(y - p)) / spread) if spread > 0 else math.nan


def is_resolved(residuals: Array, measured: Array) -> bool:
    """Return whether residuals (n,) of measured values (n,) are more than rounding.

    Rounding follows the signal, unlike noise.
    Source: Widrow and Kollár (2008), Quantization Noise, chapters 3 and 9.
    """
    present = np.isfinite(measured)
    steps = np.diff(np.unique(measured[present]))
    steps = steps[steps > 1e-6 * steps.sum()]  # closer values are the same
    # Rounding alone leaves 0.29 of a step (rms), and half a step beside so much noise that its
    # errors no longer follow the signal.
    return rms(residuals[present]) > 0.5 * float(steps.min(initial=np.inf))
