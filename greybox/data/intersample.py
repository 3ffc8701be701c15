"""Signals between their samples: held, like the output of a controller, or continuous.

The samples alone do not show which. A held control acts half a sample later than an interpolated
one, and a delay or a lag of the model absorbs the difference without a trace in the residuals. So a
record states how long each value of a signal lasts. A log at a lower rate than the controller lies
between both extremes: each value lasted for less than a step of the log, and the values between the
samples are unknown. Such a signal is interpolated, and delayed by half of the time for which a
value lasted.

Source: Åström and Wittenmark, Computer-Controlled Systems, 3rd ed., chapter 2 (sampling of a system
with a zero-order hold); Ljung, System Identification, 2nd ed., section 13.3 (intersample behavior).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.files.arrays import Array, ComplexArray, NamedStrings, Values

HELD = math.inf
CONTINUOUS = 0.0

# Keys of `FrequencyResponse.about`: the response of the samples contains a hold of this many
# seconds, or a fit has divided it out.
HOLD = "hold of the input, s"
NO_HOLD = "hold divided out, s"
# Key of a response from a sweep or noise.
SPACING = "spacing of the spectral lines, rad/s"
# Key of a response that was multiplied by a function of frequency: it is not that of samples.
MULTIPLIED = "multiplied to"


@dataclass(frozen=True)
class Intersample:
    """A signal between its samples: held until the next one, or interpolated and `late` s later."""

    held: bool
    late: float = 0.0

    def __str__(self) -> str:
        if self.held:
            return "held until the next sample"
        return f"interpolated, {1e3 * self.late:.3g} ms late" if self.late else "interpolated"


def intersample(hold: float, step: float) -> Intersample:
    """Return how a signal varies between samples `step` s apart if its values lasted `hold` s."""
    # A log has every value of the controller, or every second, third ...: apart from the jitter of
    # time stamps, a value lasts for a whole step or at most half of one.
    return Intersample(True) if hold > 0.75 * step else Intersample(False, hold / 2)


def hold_of_response(
    input: str, output: str, sampled: Iterable[tuple[Values, float]]
) -> NamedStrings:
    """Return for how long values of the input of a response lasted, for `FrequencyResponse.about`.

    `sampled` are `Record.hold` and the step of what it was measured from. Nothing where the records
    do not state it, or disagree. An output that is held as well, such as the control in a response
    to the setpoint, is as late as the input.
    """
    lasted = set()
    for hold, step in sampled:
        reading = intersample(hold.get(input, math.nan), step)
        seconds = step if reading.held else 2 * reading.late
        lasted.add("" if hold.get(output) or math.isnan(seconds) else f"{seconds:.6g}")
    return {HOLD: lasted.pop()} if len(lasted) == 1 and "" not in lasted else {}


def response_of_hold(omega: Array, seconds: float) -> ComplexArray:
    """Return the response (n,) of a hold of `seconds`: the mean of exp(-jωt) over this time."""
    half = omega * seconds / 2
    response: Any = np.exp(-1j * half) * np.sinc(half / np.pi)
    return response


def checked_hold(name: str, seconds: Any) -> float:
    """Return for how long each value of a signal lasted; ValueError if that is not a time."""
    if (
        isinstance(seconds, int | float | np.number)
        and not isinstance(seconds, bool)
        and seconds >= 0
    ):
        return float(seconds)
    raise ValueError(
        f"hold gives {name!r} the value {seconds!r:.40}: give math.inf for a signal that is held "
        "until its next sample, 0 for one that is interpolated, or how many seconds each value "
        "lasted."
    )
