"""The probability that terms explain so much of noise."""

from typing import Any

import numpy as np

TINY = 1e-300


def chance(left: Any, remaining: Any, terms: Any = 1) -> Any:
    """Return the probability that terms leave at most such a share of the squares of noise.

    `remaining` is the count of numbers that the terms and parameters do not use up.
    """
    from scipy.special import betainc  # noqa: PLC0415  (takes a tenth of a second to import)

    # 1 - I_x(a, b) = I_(1 - x)(b, a), which keeps its digits where it is small.
    return betainc(np.maximum(remaining, TINY) / 2, terms / 2, left)
