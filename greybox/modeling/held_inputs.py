"""The exact solution of a linear system over a time in which its inputs are constant.

Source: Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic
Control 23 (1978) 395-404.
"""

import numpy as np
from numpy.typing import ArrayLike

from greybox.files.arrays import AnyArray


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
