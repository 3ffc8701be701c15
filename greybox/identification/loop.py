"""Open or closed loop: what a log shows of a controller, and what the direct estimate would give in its loop.

In a loop u = C (r - y), y = P u + v, the direct estimate S_uy / S_uu tends to P where r dominates,
and to -1/C where the noise v does, however high the coherence of u and y is. The joint input-output
estimate S_ry / S_ru has no such bias, as r knows nothing of v.

Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., section 5.7;
Ljung (1999), System Identification, 2nd ed., section 13.4.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.logs.flight_controllers import AXES, axis_of
from greybox.logs.segment_detection import SETPOINTS
from greybox.spectral.composite_windows import spectral_response

# Messages and columns that only a controller's log has, whatever the axis; of PX4 and of MAVLink.
CONTROLLER_MESSAGES = (
    "vehicle_attitude_setpoint",
    "vehicle_rates_setpoint",
    "ATTITUDE_TARGET",
    "PID_TUNING",
)


@dataclass(frozen=True)
class DirectDifference:
    """By how much the direct estimate differs from the joint one, as a share of it: median, and largest and where."""

    median: float
    largest: float
    omega: float
    standard_errors: (
        float  # the largest, in standard errors of the joint estimate; NaN where they are not known
    )

    def __str__(self) -> str:
        errors = (
            ""
            if math.isnan(self.standard_errors)
            else f" ({self.standard_errors:.1f} standard errors)"
        )
        return (
            f"the two differ by {100 * self.median:.3g} % in the median, and by {100 * self.largest:.3g} % at most, at "
            f"{self.omega:.3g} rad/s{errors}"
        )


def controller_in(recording: Recording, controls: Sequence[str], measured: Sequence[str]) -> str:
    """Return the signal or message that shows a controller of the axis of a control at work; empty without one.

    What is `measured` as an output is no setpoint: a column r may be a setpoint or a yaw rate.
    """
    axes = [axis_of(control) for control in controls]
    for names in chain.from_iterable([AXES[axis]] if axis else AXES.values() for axis in axes):
        for signal in (*names.setpoints, *names.terms):
            message, _, field = signal.rpartition(".")
            if (
                signal not in measured
                and message in recording
                and field in recording[message].signals
            ):
                return signal
    table = set(next(iter(recording.values())).signals) if len(recording) == 1 else set()
    known = [
        name
        for name in (*CONTROLLER_MESSAGES, *SETPOINTS)
        if name in recording.records or name in table
    ]
    return next((name for name in known if name not in measured), "")


def direct_difference(
    joint: FrequencyResponse, pieces: Sequence[Record], input: str, output: str
) -> DirectDifference | None:
    """Estimate directly in the same band, and return the difference; None where that cannot be done."""
    try:
        direct = spectral_response(
            pieces, input, output, band=(joint.omega.min(), joint.omega.max())
        )
    except ValueError:
        return None
    here = np.flatnonzero((joint.omega >= direct.omega.min()) & (joint.omega <= direct.omega.max()))
    if not here.size:
        return None
    # The two have their points at other frequencies: between them, magnitude and phase are
    # interpolated.
    at, known = np.log(joint.omega[here]), np.log(direct.omega)
    magnitude = np.interp(at, known, np.log(np.abs(direct.response)))
    phase = np.interp(at, known, np.unwrap(np.angle(direct.response)))
    difference = np.abs(np.exp(magnitude + 1j * phase) - joint.response[here])
    share = difference / np.maximum(np.abs(joint.response[here]), 1e-300)
    worst = int(share.argmax())
    errors = (
        math.nan
        if joint.variance is None
        else float(difference[worst] / np.sqrt(joint.variance[here][worst]))
    )
    return DirectDifference(
        float(np.median(share)), float(share[worst]), float(joint.omega[here][worst]), errors
    )
