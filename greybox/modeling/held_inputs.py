"""Inputs that are constant from sample to sample: the exact step, and what samples of outputs show.

Source: Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic
Control 23 (1978) 395-404; Åström and Wittenmark, Computer-Controlled Systems, 3rd ed., section 2.6
(the modified z-transform of systems with delays).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.arrays import AnyArray
from greybox.modeling.functions import ceil, exp, tanh, where

# The distance from a whole number of samples, in samples, at which a corner is rounded. Corners
# stopped 4 % of fits of simulated responses with such delays. Rounding changes what is folded back
# by less than a tenth.
ROUNDED = 0.05


def held_response(A: AnyArray, B: AnyArray, time: ArrayLike) -> tuple[AnyArray, AnyArray]:
    """Return exp(A t) and its integral times B, the effect of inputs that are held over `time`.

    A (..., n, n), B (..., n, m) and `time` (...), s, may be stacks.
    """
    from scipy.linalg import expm  # noqa: PLC0415  (takes a tenth of a second to import)

    n, m = B.shape[-2:]
    # A held input is a state without a derivative: one exponential has both results, and A may be
    # singular.
    augmented = np.zeros((*A.shape[:-2], n + m, n + m), np.result_type(A, B))
    augmented[..., :n, :n] = A
    augmented[..., :n, n:] = B
    result = np.asarray(expm(augmented * np.asarray(time)[..., None, None]))
    return result[..., :n, :n], result[..., :n, n:]


def first_terms(response: Callable[[float], Any], hold: float) -> tuple[Any, Any]:
    """Return D and M hold of D + M / s, a response without its delay far beyond the sampling rate.

    The response at two real s gives both: poles up to the sampling rate are slow there.
    """
    near, far = response(1e2 / hold), response(2e2 / hold)
    return 2 * far - near, 2e2 * (near - far)


def folded_back(x: Any, late: Any) -> tuple[Any, Any, Any]:
    """Return what sampling adds to the responses 1 and 1 / x to a held input, x = s hold.

    They are `late` holds late; the results are without this delay. The last one is the derivative
    of the second by `late`. Each value of a held input begins a step of the first response and a
    ramp of the second, of which the samples are geometric series; the response of the hold is
    divided out. A step that begins at a sample is seen after it, so that the first jumps where
    `late` is whole. The second has a corner there, which is rounded, since no search ends in one.
    """
    fraction = late - ceil(late) + 1  # of a hold, above 0 and at most 1
    series = 1 / (exp(x) - 1)
    step = x * series * exp(x * fraction)
    ramp = step * (1 + series - fraction) - 1 / x
    slope = x * ramp - step + 1

    # The corner is x/2 times this distance.
    side = where(fraction < 0.5, 1.0, -1.0)
    near = fraction - (1 - side) / 2
    bend = tanh(near / ROUNDED)
    bent = bend + near / ROUNDED * (1 - bend**2)
    return step - 1, ramp + x / 2 * near * (bend - side), slope + x / 2 * (bent - side)
