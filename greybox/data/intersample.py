"""How a signal runs between its samples: held, as the output of a controller, or sampled from a continuous one.

The samples alone do not tell: a control that is held acts half a sample later than one that is
interpolated, which a delay or a lag of the model takes up without a trace in the residuals. So a
record states it for its signals, by the time for which each value lasts. Between both extremes lies
a log at a lower rate than that of the controller: the values between its samples are not known, but
lasted for less than a step of the log. Such a signal is interpolated, and half of that time later.

Source: Åström and Wittenmark, Computer-Controlled Systems, 3rd ed., chapter 2 (sampling of a system
with a zero-order hold); Ljung, System Identification, 2nd ed., section 13.3 (intersample behavior).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

HELD = math.inf
CONTINUOUS = 0.0

# Of a step, from which a value lasts until the next sample. A log has every value of the
# controller, or every second, third ...: holds are whole steps or at most half a one, but for the
# jitter of time stamps.
WHOLE = 0.75


@dataclass(frozen=True)
class Intersample:
    """How the samples of a signal are read: held until the next one, or interpolated and `late` seconds later."""

    held: bool
    late: float = 0.0

    def __str__(self) -> str:
        if self.held:
            return "held until its next sample"
        return f"interpolated, {1e3 * self.late:.3g} ms late" if self.late else "interpolated"


def intersample(hold: float, step: float) -> Intersample:
    """Return how samples at every `step` seconds are read whose values lasted `hold` seconds."""
    return Intersample(True) if hold > WHOLE * step else Intersample(False, hold / 2)


def checked_hold(name: str, seconds: Any) -> float:
    """Return how long each value of a signal lasted; raise ValueError for what is no time."""
    if (
        isinstance(seconds, (int, float, np.number))
        and not isinstance(seconds, bool)
        and seconds >= 0
    ):
        return float(seconds)
    raise ValueError(
        f"hold gives {name!r} the value {seconds!r:.40}: give math.inf for a signal that is held until its next "
        "sample, 0 for one that is interpolated, or how many seconds each value lasted."
    )
