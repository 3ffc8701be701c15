"""Recognizes the time column of a table by its name, and its clock by the size of the numbers.

Loggers write times in s, ms, µs or ns, often without stating which: ROS counts ns since 1970, PX4's
``ulog2csv`` µs and Crazyflie ms since the start. A wrong unit makes every time constant wrong by a
factor of 1000. So a column without a unit is taken for seconds only if the rate is then plausible,
and a finding states the assumption.
"""

import math
import re

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.control_characters import printable
from greybox.data.units import known_unit

# Names of a time column, in lower case and without a unit.
TIMES = ("time", "t", "timestamp", "timestamps", "tout", "second", "seconds")
# As ArduPilot's tools, MAVLink's messages and Arduino's functions name them.
COUNTERS = {"timeus": "us", "timems": "ms", "time_boot_ms": "ms", "time_usec": "us"}
COUNTERS |= {"micros": "us", "millis": "ms"}
SUFFIXED = re.compile(rf"(?:{'|'.join(TIMES)})(?: in)?[_ /:](s|sec|ms|us|ns)")
# Ticks from 1970 to 2001; until 2100 there are 4.1 times as many.
EPOCHS = {"ns": 1e18, "µs": 1e15, "ms": 1e12, "s": 1e9}
# Hz: no logger of flights or of motor stands is slower or faster, but a wrong unit is.
PLAUSIBLE = (1e-3, 1e5)
CURE = (
    "state its unit, as 'time [ms]' in the header or 'time=COLUMN:ms' among the columns, or leave "
    "the column out and give a rate."
)


def seconds(name: str, unit: str = "") -> float | None:
    """Return the length of a tick in s if this is the name of a time column, else None.

    Names are time, t, timestamp, tout and second, in capitals or not, with a unit or a suffix as in
    ``time_ms`` (else in seconds), and those of counters such as TimeUS and millis.
    """
    # A unit in the name takes precedence over one in brackets.
    suffix = unit_of_clock(name)
    return tick(suffix or unit or "s") if suffix or name.lower() in TIMES else None


def unit_of_clock(name: str) -> str:
    """Return the unit in the name of a clock, as in ``t_ms`` and ``TimeUS``; empty without one."""
    match = SUFFIXED.fullmatch(name.lower())
    return match[1] if match else COUNTERS.get(name.lower(), "")


def tick(unit: str) -> float | None:
    """Return a unit of time in s; None for any other unit."""
    conversion = known_unit(unit.lower())
    return conversion.factor if conversion and conversion.si == "s" else None


def times_in_seconds(name: str, unit: str, times: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the times of a column (n,) in s, and a finding if its unit had to be assumed.

    Times since 1970 count from the first sample.

    Raises
    ------
    ValueError
        If the unit is not stated and seconds would be implausible.
    """
    finite = times[np.isfinite(times)]
    if unit or name.lower() not in TIMES or finite.size < 2:
        return times * (seconds(name, unit) or tick(unit) or 1.0), ()

    name = printable(name)
    step = float(np.median(np.diff(finite)))
    # The absolute time decides first: it shows the unit at any rate.
    for ticks, first in EPOCHS.items():
        if first <= finite[0] < 4.1 * first:
            text = f"{name} has dates or {ticks} since 1970: times are from the first sample."
            return (times - finite[0]) * (tick(ticks) or 1.0), (text,)

    # Ticks of a counter are whole; seconds since the start rarely are.
    is_whole = np.all(finite == np.round(finite))
    if name.lower().startswith("timestamp") and is_whole and step >= 1:
        if np.all(np.diff(finite) == 1):
            raise ValueError(
                f"{name} counts by one without a unit: it may count samples, ms or s: {CURE}"
            )
        # A step of 1000 is 1 ms at 1 kHz in µs, or a second in ms, and logs are rarely that slow.
        ticks = "ns" if step >= 1e6 else "µs" if step >= 1e3 else "ms"
        return times * (tick(ticks) or 1.0), (f"{name} has no unit and was taken for {ticks}.",)

    rate = 1 / step if step > 0 else math.inf
    if step > 0 and not PLAUSIBLE[0] <= rate <= PLAUSIBLE[1]:
        raise ValueError(f"{name} has no unit, and in s the rate would be {rate:.3g} Hz: {CURE}")
    assumed = (f"{name} has no unit and was taken for s, {rate:.3g} Hz.",) if rate < 1 else ()
    return times, assumed
