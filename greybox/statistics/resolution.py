"""Whether residuals exceed the steps of a sensor: rounding follows the signal, unlike noise.

Source: Widrow and Kollár (2008), Quantization Noise, chapters 3 and 9.
"""

import numpy as np

from greybox.files.arrays import Array
from greybox.statistics.metrics import rms

ROUNDING = 1e-6  # of the range of a signal, within which values are the same

# Steps of a sensor that residuals must exceed (rms). Rounding alone leaves 0.29 of them, and half a
# step beside so much noise that its errors no longer follow the signal.
RESOLVED = 0.5


def is_resolved(residuals: Array, measured: Array) -> bool:
    """Return whether residuals (n,) of measured values (n,) are more than rounding."""
    present = np.isfinite(measured)
    steps = np.diff(np.unique(measured[present]))
    steps = steps[steps > ROUNDING * steps.sum()]
    return rms(residuals[present]) > RESOLVED * float(steps.min(initial=np.inf))
