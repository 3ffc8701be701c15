"""Logs with only some passes of the control loop, and how much these differ from all passes.

The gyro has a clock of its own: at 1 kHz and 400 passes a second, passes see two and three samples
in turn. The D term divides the change of the gyro by a constant interval, so that it alternates by
±20 % behind its filter, and the newest sample is older in one pass than in the next. The logged
passes, say every second one, then differ in the mean from those that drove the motors, and noise
hides it.

Sources: AC_PID.cpp and AP_InertialSensor.cpp (wait_for_sample) of ArduPilot; mode_systemid.cpp for
what is logged in System Identification mode; SCHED_LOOP_RATE, INS_GYRO_RATE, LOG_BITMASK and
LOG_FILE_RATEMAX at https://ardupilot.org/copter/docs/parameters.html.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Recording
from greybox.logs.ardupilot.filters import CONTROLLERS, named_filters

Complex = NDArray[np.complexfloating]

GYRO_RATE = 1000.0  # Hz, of INS_GYRO_RATE 0; 1, 2, 3 double it as often
# Passes per sample below which the log has all passes: the rate of the loop varies by up to 10 %.
EVERY_PASS = 1.25
FAST, MEDIUM = 1, 2  # bits of LOG_BITMASK for attitude
# Phases to try between gyro and loop, and passes in the mean, a multiple of 2 to 6.
PHASES, PASSES = 20, 240

# Factor on an error of known size and unknown sign. Logged passes and the others change their roles
# as the clocks of gyro and loop drift, at 1 kHz by half a ms. Crystals differ by up to 30 ppm, 0.75
# ms in a test of 25 s: the mean of a square wave of random phase over up to one and a half of its
# half periods has the mean square 1/2.
DRIFTING = math.sqrt(1 / 2)


@dataclass(frozen=True)
class Thinning:
    """A log of every `kept`-th pass.

    Attributes
    ----------
    loop, logged : float, Hz
    kept : int
    count : float
        Root mean square of the difference in gyro samples between the logged passes and all, as a
        share of their number.
    age : float, s
        The same for the age of the newest sample.
    cure : str
        Instruction to log every pass.
    """

    loop: float
    logged: float
    kept: int
    count: float
    age: float
    cure: str

    def __str__(self) -> str:
        rates = f"{self.logged:.4g} of {self.loop:g} Hz"
        return f"every {_ordinal(self.kept)} pass of the control loop was logged ({rates})"


def thinning(recording: Recording, signal: str, start: float, end: float) -> Thinning | None:
    """Return how a signal was thinned from `start` to `end`, s; None if it was not, or unknown."""
    parameters = recording.metadata.get("parameters", {})
    loop = float(parameters.get("SCHED_LOOP_RATE", 0))
    record, _ = recording.locate(signal)
    time = record.time[(record.time >= start) & (record.time <= end)]
    if loop <= 0 or time.size < 3 or "INS_GYRO_FILTER" not in parameters:
        return None
    logged = 1 / float(np.median(np.diff(time)))
    if loop < EVERY_PASS * logged:
        return None
    # The rate of the log jitters, while the loop logs every pass, every second, every third ...
    kept = round(loop / logged)
    gyro = GYRO_RATE * 2 ** int(parameters.get("INS_GYRO_RATE", 0))
    count, age = _differences(gyro / loop, kept)
    mode = next(
        (name for moment, name in reversed(recording.metadata.get("modes", ())) if moment <= start),
        "",
    )

    return Thinning(loop, logged, kept, count, age / gyro, _cure(parameters, mode))


def thinning_error(
    found: Thinning, recording: Recording, axis: str, response: FrequencyResponse
) -> Complex:
    """Return the relative errors (2, n) of a response from a control to an angle or a rate.

    The first row is due to the D term, whose share of the control follows from the gains of the
    rate controller and from the response itself; the second, due to the age of the newest sample,
    is a delay. A row is one standard deviation, common to all frequencies: the clocks of gyro and
    loop drift through a flight from one phase to the next, whatever frequency is flown.
    """
    parameters = recording.metadata.get("parameters", {})
    s = 1j * response.omega
    gain = float(parameters.get(f"ATC_RAT_{CONTROLLERS.get(axis, '')}_D", 0))
    share = (
        gain
        * s
        * response.response
        * first_order(named_filters(recording, axis).get("d-term-filter", ()), s)
    )
    # The D term acts on the rate, behind the filter of the gyro.
    if response.units.get(response.output) == "rad":
        share = share * s * second_order(float(parameters["INS_GYRO_FILTER"]), s)

    return DRIFTING * np.array(
        [share * found.count * remaining_alternation(parameters, axis, found.loop), s * found.age]
    )


def _differences(per_pass: float, kept: int) -> tuple[float, float]:
    """Return how logged passes differ from all, in the number of gyro samples and in their age."""
    # The clock of the gyro runs free: all phases between the two clocks are equally likely.
    j = np.arange(PASSES + 1) * per_pass
    times = j + np.arange(PHASES)[:, None] / PHASES
    counts = np.diff(np.floor(times + 1e-9), axis=1)
    ages = (times - np.floor(times + 1e-9))[:, 1:]
    return tuple(  # type: ignore[return-value]
        float(np.sqrt(np.mean((values[:, ::kept].mean(axis=1) - values.mean(axis=1)) ** 2)) / scale)
        for values, scale in ((counts, per_pass), (ages, 1.0))
    )


def remaining_alternation(parameters: Mapping[str, float], axis: str, loop: float) -> float:
    """Return the share of an alternation from pass to pass that the filter of the D term leaves."""
    cutoff = float(parameters.get(f"ATC_RAT_{CONTROLLERS.get(axis, '')}_FLTD", 0))
    # The gain of a first-order low-pass filter at half of the rate of the loop.
    alpha = 1 / (1 + loop / (2 * math.pi * cutoff)) if cutoff > 0 else 1.0
    return alpha / (2 - alpha)


def first_order(filters: tuple, s: Complex) -> Complex:
    """Return the response of first-order low-pass filters in series at s, 1/s, (n,)."""
    result = np.ones_like(s)
    for filter_ in filters:
        result = result / (1 + s / (2 * math.pi * filter_.cutoff))
    return result


def second_order(cutoff: float, s: Complex) -> Complex:
    """Return the response of a second-order Butterworth filter, cutoff in Hz, at s, 1/s, (n,)."""
    x = s / (2 * math.pi * cutoff)
    return 1 / (x**2 + math.sqrt(2) * x + 1)


def _cure(parameters: Mapping[str, float], mode: str) -> str:
    """Return how to log every pass."""
    if parameters.get("LOG_FILE_RATEMAX", 0) > 0:
        return f"set LOG_FILE_RATEMAX 0 (it is {parameters['LOG_FILE_RATEMAX']:g} Hz)"
    mask = int(parameters.get("LOG_BITMASK", 0))
    # The firmware logs at full rate in this mode only if both bits are set.
    if mode == "SYSTEMID":
        needed, bits = (
            mask | FAST | MEDIUM,
            "fast and medium attitude: System Identification mode needs both",
        )
    else:
        needed, bits = mask | FAST, "fast attitude"

    return (
        f"set LOG_BITMASK {needed} ({bits})"
        if needed != mask
        else "log to a faster card, or lower SCHED_LOOP_RATE"
    )


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")
