"""Logs with only some passes of the control loop, and how much these differ from all passes.

The gyro has a clock of its own: at 1 kHz and 400 passes a second, passes see two and three samples
in turn. The D term divides the change of the gyro by a constant interval, so it alternates by ±20 %
after its filter, and the newest sample is older in one pass than in the next. The logged passes,
say every second one, then differ on average from those that drove the motors, and noise hides the
difference.

PX4 runs its loop on the samples of the gyro, so that all passes are alike. But noise and steps
above half the rate of a thinned log alias into its band, and this too depends on which passes were
logged: in virtual flights with steps of the setpoint, a 500 Hz loop that was logged at 125 Hz had
gains that were 1 to 2 % off in the median over the band, at 62 Hz 2 to 4 %. The size is not known
from the log.

Sources: AC_PID.cpp and AP_InertialSensor.cpp (wait_for_sample) of ArduPilot; mode_systemid.cpp for
what is logged in System Identification mode; SCHED_LOOP_RATE, INS_GYRO_RATE, LOG_BITMASK and
LOG_FILE_RATEMAX at https://ardupilot.org/copter/docs/parameters.html; IMU_GYRO_RATEMAX and
SDLOG_PROFILE at https://docs.px4.io/main/en/advanced_config/parameter_reference.
"""

import math

import numpy as np

from greybox.data.clock import median_step
from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.logs.ardupilot.filters import CONTROLLERS
from greybox.data.record import Recording

PX4_LOOP = "IMU_GYRO_RATEMAX"
GYRO_RATE = 1000.0  # Hz; the sampling rate of the gyro is GYRO_RATE * 2**INS_GYRO_RATE
FAST, MEDIUM = 1, 2  # bits of LOG_BITMASK for attitude
IDENTIFICATION = 8  # bit of SDLOG_PROFILE for every pass of PX4's rate controller

# The number of phases between the clocks of gyro and loop for which the differences are computed.
PHASES = 20

# The number of passes in the averages, divisible by every stride from 2 to 6.
PASSES = 240

# The root mean square of an error of size 1 whose sign changes during a test. The error changes its
# sign when the clocks of gyro and loop have drifted by half a gyro sample, 0.5 ms at 1 kHz: the
# logged and the other passes then swap roles. Crystals differ by up to 30 ppm, which is 0.75 ms in
# a test of 25 s, or one and a half times 0.5 ms. The mean of a square wave of random phase over up
# to one and a half of its half periods has the mean square 1/2.
DRIFTING = math.sqrt(1 / 2)


@frozen
class Thinning:
    """A log that contains only every `stride`-th pass of the control loop.

    Attributes
    ----------
    loop, logged : float, Hz
        Rate of the control loop, and rate of the logged passes.
    stride : int
        Number of passes per logged pass.
    count : float
        Root mean square, over the phases of the two clocks, of the difference between the mean
        number of gyro samples per logged pass and that per pass, relative to the latter; NaN if
        unknown.
    age : float, s
        Root mean square of the same difference for the age of the newest gyro sample.
    cure : str
        Instruction to log every pass.
    """

    loop: float
    logged: float
    stride: int
    count: float
    age: float
    cure: str

    def __str__(self) -> str:
        rates = f"{self.logged:.4g} of {self.loop:g} Hz"
        ordinal = {2: "second", 3: "third"}.get(self.stride, f"{self.stride}th")
        return f"every {ordinal} pass of the control loop was logged ({rates})"


def thinning(recording: Recording, signal: str, start: float, end: float) -> Thinning | None:
    """Return how a signal was thinned from `start` to `end`, s; None if it was not, or unknown."""
    parameters = recording.parameters
    is_px4 = parameters.get(PX4_LOOP, 0) > 0
    loop = parameters.get(PX4_LOOP if is_px4 else "SCHED_LOOP_RATE", 0)
    record, _ = recording.locate(signal)
    time = record.time[record.during(start, end)]
    if loop <= 0 or time.size < 3 or not (is_px4 or "INS_GYRO_FILTER" in parameters):
        return None
    logged = 1 / median_step(time)
    # Every pass was logged if the rates are similar: the rate of the loop varies by up to 10 %.
    if loop < 1.25 * logged:
        return None
    # The ratio is rounded, because the loop logs every second pass, every third, and so on, while
    # the times of a log jitter.
    stride = round(loop / logged)
    if is_px4:
        profile = int(parameters.get("SDLOG_PROFILE", 1))
        cure = f"set SDLOG_PROFILE {profile | IDENTIFICATION} (system identification)"
        if profile & IDENTIFICATION:
            cure = "log to a faster card, or lower IMU_GYRO_RATEMAX"
        return Thinning(loop, logged, stride, math.nan, math.nan, cure)
    gyro = GYRO_RATE * 2 ** int(parameters.get("INS_GYRO_RATE", 0))
    count, age = _differences(gyro / loop, stride)
    mode = next(
        (name for moment, name in reversed(recording.metadata.get("modes", ())) if moment <= start),
        "",
    )

    return Thinning(loop, logged, stride, count, age / gyro, _cure(parameters, mode))


def thinning_error(
    thinned: Thinning, recording: Recording, axis: str, response: FrequencyResponse
) -> ComplexArray:
    """Return the relative errors (2, n) of a response from a control to an angle or a rate.

    The first row is due to the D term, whose share of the control follows from the gains of the
    rate controller and from the response itself; the second, due to the age of the newest sample,
    is a delay. Each row is the effect of one standard deviation. It is common to all frequencies,
    because the clocks of gyro and loop drift slowly against each other during a flight, whatever
    frequency is flown.
    """
    parameters = recording.parameters
    s = 1j * response.omega
    gain = _of_controller(parameters, axis, "D")
    cutoff = _of_controller(parameters, axis, "FLTD")
    share = gain * s * response.response * low_pass(1, cutoff, response.omega)
    # The D term acts on the angular rate after the gyro filter. If the output is an angle, its
    # derivative is the rate.
    if response.units.get(response.output) == "rad":
        share = share * s * low_pass(2, parameters["INS_GYRO_FILTER"], response.omega)

    return DRIFTING * np.array(
        [
            share * thinned.count * remaining_alternation(parameters, axis, thinned.loop),
            s * thinned.age,
        ]
    )


def _differences(per_pass: float, stride: int) -> tuple[float, float]:
    """Return the relative rms difference of the sample counts, and that of the ages.

    Both compare the logged passes with all passes, see `Thinning`. The age is in gyro samples, of
    which each pass has `per_pass` on average.
    """
    # The clocks are not synchronized, so all phases between them are equally likely. Times are in
    # gyro samples, one row for each phase.
    pass_times = np.arange(PASSES + 1) * per_pass
    times = pass_times + np.arange(PHASES)[:, None] / PHASES
    counts = np.diff(np.floor(times + 1e-9), axis=1)
    ages = (times - np.floor(times + 1e-9))[:, 1:]
    return _rms_difference(counts, stride) / per_pass, _rms_difference(ages, stride)


def _rms_difference(values: Array, stride: int) -> float:
    """Return the rms over the rows of the difference between the means of logged and all passes."""
    differences = values[:, ::stride].mean(axis=1) - values.mean(axis=1)
    return float(np.sqrt(np.mean(differences**2)))


def remaining_alternation(parameters: Values, axis: str, loop: float) -> float:
    """Return the gain of the D term's filter for a signal that alternates from pass to pass."""
    cutoff = _of_controller(parameters, axis, "FLTD")
    # It is the gain of a discrete first-order low-pass filter at half of the loop rate.
    alpha = 1 / (1 + loop / (math.tau * cutoff)) if cutoff > 0 else 1.0
    return alpha / (2 - alpha)


def low_pass(order: int, cutoff: float, omega: Array) -> ComplexArray:
    """Return the response of a Butterworth filter, cutoff in Hz, at omega, rad/s; 1 without it."""
    from scipy.signal import butter, freqs  # noqa: PLC0415  (0.33 s to import)

    if cutoff <= 0:
        return np.ones(omega.size, dtype=complex)
    return freqs(*butter(order, math.tau * cutoff, analog=True), omega)[1]  # type: ignore[arg-type]


def _of_controller(parameters: Values, axis: str, name: str) -> float:
    """Return a parameter of ArduPilot's rate controller of an axis; 0 if it is not in the log."""
    return parameters.get(f"ATC_RAT_{CONTROLLERS.get(axis, '')}_{name}", 0)


def _cure(parameters: Values, mode: str) -> str:
    """Return the instruction to log every pass."""
    if parameters.get("LOG_FILE_RATEMAX", 0) > 0:
        return f"set LOG_FILE_RATEMAX 0 (it is {parameters['LOG_FILE_RATEMAX']:g} Hz)"
    mask = int(parameters.get("LOG_BITMASK", 0))
    # The firmware logs at full rate in this mode only if both bits are set.
    needed = mask | FAST
    bits = "fast attitude"
    if mode == "SYSTEMID":
        needed |= MEDIUM
        bits = "fast and medium attitude: System Identification mode needs both"
    if needed == mask:
        return "log to a faster card, or lower SCHED_LOOP_RATE"
    return f"set LOG_BITMASK {needed} ({bits})"
