"""Filters of ArduPilot by the parameters of a log: gyro, notches, rate controllers.

Sources: INS_GYRO_FILTER, INS_HNTCH_*, ATC_RAT_*_FLTD, FLTT and FLTE at
https://ardupilot.org/copter/docs/parameters.html; LowPassFilter2p.cpp, NotchFilter.cpp,
HarmonicNotchFilter.cpp and AC_PID.cpp of the firmware, for what they mean; the messages FTN and
FTNS at https://ardupilot.org/copter/docs/logmessages.html.
"""

import math
from collections.abc import Iterator

import numpy as np

from greybox.data.files.named_values import Values
from greybox.data.logs.known_filters import FirstOrderLowPass, KnownFilters, LowPass, Notch
from greybox.data.record import Recording

# Fields that are logged behind the filters of the gyro.
GYRO_RATES = {
    "RATE": ("R", "P", "Y"),
    "IMU": ("GyrX", "GyrY", "GyrZ"),
    "PIDR": ("Act",),
    "PIDP": ("Act",),
    "PIDY": ("Act",),
}

# Axes as named by the parameters of rate controllers.
CONTROLLERS = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}
CONTROLLER_FILTERS = {"d-term-filter": "FLTD", "target-filter": "FLTT", "error-filter": "FLTE"}

# INS_HNTCH_MODE; in other modes the notch follows sensors, and only FTN or FTNS has its frequency.
FIXED, THROTTLE = 0, 1
DOUBLE, TRIPLE = 1, 16  # bits of INS_HNTCH_OPTS
KEYS = ("MODE", "FREQ", "BW", "ATT", "HMNCS", "REF", "OPTS")  # of a harmonic notch


def named_filters(recording: Recording, axis: str = "") -> KnownFilters:
    """Return the known filters of the gyro and of the rate controller of an axis, by name."""
    parameters = recording.parameters
    filters: KnownFilters = {}
    if parameters.get("INS_GYRO_FILTER", 0) > 0:
        filters["gyro-filter"] = (LowPass(parameters["INS_GYRO_FILTER"]),)
        notches = tuple(_harmonic_notches(recording))
        filters |= {"gyro-notch": notches} if notches else {}
    controller = CONTROLLERS.get(axis, "")
    for name, end in CONTROLLER_FILTERS.items():
        cutoff = parameters.get(f"ATC_RAT_{controller}_{end}", 0)
        filters |= {name: (FirstOrderLowPass(cutoff),)} if cutoff > 0 else {}

    return filters


def _harmonic_notches(recording: Recording) -> Iterator[Notch]:
    parameters = recording.parameters
    for number, begin in enumerate(("INS_HNTCH_", "INS_HNTC2_")):
        if parameters.get(f"{begin}ENABLE", 0) > 0:
            yield from _one_harmonic_notch(
                recording, number, {k: parameters.get(f"{begin}{k}", 0) for k in KEYS}
            )
    if parameters.get("INS_NOTCH_ENABLE", 0) > 0:  # the static notch of firmware before 4.1
        center, width, depth = (parameters.get(f"INS_NOTCH_{k}", 0) for k in ("FREQ", "BW", "ATT"))
        if center > width / 2 > 0:
            yield Notch(center, _quality(center, width), depth)


def _one_harmonic_notch(recording: Recording, number: int, setting: Values) -> list[Notch]:
    """Return the notches of all harmonics; empty if their frequency is unknown."""
    center, width = setting["FREQ"], setting["BW"]
    base = _logged_center(recording, number) or _set_center(recording, setting)
    if not (center > width / 2 > 0 and base):
        return []
    # A double or triple notch consists of two or three narrower ones around the center.
    parts = 3 if int(setting["OPTS"]) & TRIPLE else 2 if int(setting["OPTS"]) & DOUBLE else 1
    spread = width / (32 * center)
    offsets = {1: (0.0,), 2: (-spread, spread), 3: (-spread, 0.0, spread)}[parts]
    quality = _quality(center, width / parts)
    # A bit mask; firmware without it has the first harmonic alone.
    harmonics = [k + 1 for k in range(16) if int(setting["HMNCS"] or 1) >> k & 1]

    return [
        Notch(k * base * (1 + offset), quality, setting["ATT"])
        for k in harmonics
        for offset in offsets
    ]


def _quality(center: float, width: float) -> float:
    """Return Q of a notch that is `width` wide, Hz: NotchFilter::calculate_A_and_Q."""
    ratio = (center / (center - width / 2)) ** 2
    return math.sqrt(ratio) / (ratio - 1)


def _logged_center(recording: Recording, number: int) -> float:
    """Return the median of the logged centers, Hz; 0 if they were not logged."""
    # FTNS has the notch of a single source, FTN those of several motors.
    for message, field in (("FTNS", "NF"), ("FTN", "NF1")):
        record = recording.records.get(
            f"{message}[{number}]", None if number else recording.records.get(message)
        )
        if record is not None and field in record.signals:
            values = record[field]
            values = values[np.isfinite(values) & (values > 0)]
            return float(np.median(values)) if values.size else 0.0
    return 0.0


def _set_center(recording: Recording, setting: Values) -> float:
    if setting["MODE"] == FIXED or setting["REF"] <= 0:
        return setting["FREQ"]
    # The center follows the root of the throttle, as thrust grows with the square of the speed.
    if setting["MODE"] == THROTTLE and "RATE" in recording and "AOut" in recording["RATE"].signals:
        throttle = recording["RATE"]["AOut"]
        flying = throttle[throttle > 0]
        median = float(np.median(flying)) if flying.size else 0.0
        return setting["FREQ"] * math.sqrt(max(1.0, median / setting["REF"]))
    return 0.0
