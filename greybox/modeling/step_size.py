"""How many equal substeps a fixed-step integrator takes: the one rule.

Stable steps lie within the region of the scheme: |λ| h ≤ reach for every pole λ, and |Im λ| h ≤
wave, so that an oscillation is followed (`stable_substeps`). Accuracy is judged by repeating the
steps with half their length (Richardson): for a scheme of order q, the error of n substeps falls as
n^-q, so the difference between n and 2n substeps is the error of n times a factor 1 - 2^-q, and
gives the number that meets a tolerance. Because the model is then run again, the growth per run is
limited (`substep_growth`).

Callers differ in the tolerance, its reference, and the largest number of substeps, which are
arguments.

Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 2nd ed., section II.4:
Richardson's error estimate (4.4), the step size that meets a tolerance, and limits of its change,
(4.12) to (4.13). Stability: volume II, section IV.2.
"""

import math

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, positive_or_one

# Substeps a sample. An explicit step follows poles up to `reach` per step, RK4 to 256 · 2.7 = 690
# per sample; a model with faster ones is stiff, and the implicit `Radau` takes fewer steps. A fit
# with these takes as long as one with 1400 explicit substeps for a motor of two states, and with
# 500 for a rod of 40.
MOST_SUBSTEPS = 256
# A repetition builds and runs everything anew, so it should at least halve the steps.
LEAST_GROWTH = 2
# From steps that are far too long, the error does not show how many are needed. (4.13) limits the
# change of a step by facmax, 1.5 to 5 for steps that are merely repeated; a repetition costs more
# here, so three halvings are allowed.
MOST_GROWTH = 8


def stable_substeps(
    poles: ComplexArray,
    step: float,
    *,
    reach: float,
    wave: float = math.inf,
    most: int = MOST_SUBSTEPS + 1,
) -> int:
    """Return the substeps (1 to `most`) of `step` s for the fastest of the poles (...) in rad/s.

    The default of `most` means that the model is too stiff for explicit steps.
    `reach` is the largest |λ| h, `wave` the largest |Im λ| h, of a substep h; see `Integrator`.
    """
    fastest = np.maximum(np.abs(poles) / reach, np.abs(poles.imag) / wave).max(initial=0.0)
    # The limit comes first, since infinity has no whole number.
    return max(math.ceil(min(fastest * step, most)), 1)


def substep_growth(error: float, tolerance: float, order: int) -> int:
    """Return the factor on the substeps where the error, perhaps infinite, is too large."""
    factor = (error / tolerance) ** (1 / order) if math.isfinite(error) else MOST_GROWTH
    return max(math.ceil(min(factor, MOST_GROWTH)), LEAST_GROWTH)


def relative_change(change: Array, *states: Array) -> float:
    """Return the largest change (n, samples) of any state over its size; NaN if one is.

    The size is the largest absolute value in `states` (n, samples), but no less than rounding.
    """
    size = np.max([np.abs(x).max(axis=1, initial=0.0) for x in states], axis=0)
    # A state this much smaller than the largest one may be rounding alone: changes of 1e-16 of the
    # largest state are then 1e-10 of it, far below all tolerances here.
    size = np.maximum(size, 1e-6 * size.max(initial=0.0))
    largest = np.abs(change).max(axis=1, initial=0.0) / positive_or_one(size)
    return float(largest.max(initial=0.0))
