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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number

HELD = math.inf
CONTINUOUS = 0.0

# Keys of `FrequencyResponse.about`: the response of the samples contains a hold of this many
# seconds, or a fit has divided it out.
HOLD = "hold of the input, s"
NO_HOLD = "hold divided out, s"
# Or nobody states how its input, with a sample in every so many seconds, ran between them.
UNSTATED_HOLD = "hold of the input not stated; sampling interval, s"
# And what that may do is in its variance, as an error that all frequencies have in common.
HOLD_IN_ERRORS = "unstated hold"
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
) -> Mapping[str, str]:
    """Return for how long values of the input of a response lasted, for `FrequencyResponse.about`.

    `sampled` are `Record.hold` and the step of what it was measured from. Where the records do not
    state it, or disagree, it is the longest step, as unstated. An output that is held as well, such
    as the control in a response to the setpoint, is as late as the input, as without a hold.
    """
    records = list(sampled)
    if any(hold.get(output) for hold, _ in records):
        return {HOLD: "0"}
    lasted = set()
    for hold, step in records:
        reading = intersample(hold.get(input, math.nan), step)
        lasted.add(f"{step if reading.held else 2 * reading.late:.6g}")
    if len(lasted) == 1 and all(input in hold for hold, _ in records):
        return {HOLD: lasted.pop()}
    return {UNSTATED_HOLD: f"{max((step for _, step in records), default=math.nan):.6g}"}


def described_unstated_hold(about: Mapping[str, str]) -> str:
    """Return what an unstated hold of a response means for its delays; empty if it is stated."""
    if UNSTATED_HOLD not in about:
        return ""
    late = number(500 * float(about[UNSTATED_HOLD]))
    return f"not stated; if the input is held between its samples, delays are {late} ms too long"


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
