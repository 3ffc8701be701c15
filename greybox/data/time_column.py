"""The grammar of clocks: which columns of a table are its time, and in which unit they count.

| columns | their time |
| --- | --- |
| ``time``, ``timestamp``, ``elapsed_s``, ``__time`` ... (`FULL`) | this one, wherever it stands |
| ``t``, ``T`` | if there is no full name |
| a first column that increases, in a unit of time | if there is no such name |
| ``stamp.sec`` and ``stamp.nanosec``; ``Date`` and ``Time`` | both together |
| ``hour``, ``minute`` and ``second`` | the three together, if there is no full name |
| ``timestamp_sample``, ``SampleUS`` | this one, if it increases, before the clock of the rows |

A unit is stated in brackets, at the end of the name, or by a counter's name, such as ``TimeUS``.
Dates and times of day, 10:00:01.25, state theirs. Without a statement, the numbers must show it: by
their size (times since 1970, days of a spreadsheet), or because only one unit gives a log of a
plausible rate and length: seconds, or what a counter such as ``timestamp`` may count. Otherwise the
column is refused: a wrong unit makes every time constant wrong by a factor of 1000. Findings state
what was concluded.

A counter that starts again at its largest number runs on; what becomes of rows that are not in the
order of their times is in `greybox.data.row_order`.
"""

import math
import re
import shlex
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from greybox.data.dates import OF_DAY, SINCE_1970
from greybox.data.files.arrays import AnyArray, Array, IntArray
from greybox.data.files.control_characters import printable
from greybox.data.files.numbers_in_text import number
from greybox.data.headings import Heading
from greybox.data.row_order import ordered_rows
from greybox.data.units import known_unit

# Names of clocks without their units, in lower case and without blanks and marks.
FULL = frozenset(
    "time timestamp timestamps tout second seconds elapsed elapsedtime timeelapsed datetime "
    "timedate datenum stamp headerstamp fieldheaderstamp timeboot timesinceboot timesincestart "
    "systemtime systime logtime rostime simtime simulationtime unixtime epochtime gpstime".split()
)
SHORT = "t"
# Clocks of samples, beside which a log has the clock of its rows.
OF_SAMPLES = ("timestampsample", "sampleus")
# As ArduPilot's and PX4's tools and Arduino's functions name them.
COUNTERS = {"timeus": "us", "timems": "ms", "micros": "us", "millis": "ms"} | dict.fromkeys(
    OF_SAMPLES, "us"
)
# Names that loggers give to their counters; a person who calls a column time means seconds.
STAMPS = ("timestamp", "stamp", "headerstamp", "fieldheaderstamp")
# Units at the end of a name. Others are not clear: t_h may be the time of a hold.
SUFFIXES = (
    "s sec secs seconds ms msec millis milliseconds us usec µs micros microseconds ns nsec "
    "nanoseconds minutes hours"
).split()

# The second one of two columns counts fractions of the first one's seconds.
WHOLE = ("sec", "secs", "second", "seconds", "s")
FRACTIONS = {
    **dict.fromkeys("nsec nsecs nanosec nanosecs nanosecond nanoseconds ns".split(), 1e-9),
    **dict.fromkeys("usec usecs microsec microsecs microsecond microseconds us".split(), 1e-6),
    **dict.fromkeys("msec msecs millisec millisecs millisecond milliseconds ms".split(), 1e-3),
}

OF_DAY_BY_NAME = {"hour": 3600.0, "minute": 60.0, "second": 1.0}  # s

# Ticks from 1970 to 2001; until 2100 there are 4.1 times as many.
EPOCHS = {"ns": 1e18, "µs": 1e15, "ms": 1e12, "s": 1e9}
# Days from 2000 to 2100 in spreadsheets, since 1900, and in MATLAB, since year 0.
CALENDARS = ((36526, 73050), (730486, 767011))
DAY, WEEK = 86400.0, 604800.0  # s

# Hz; no logger of flights or of motor stands is slower or faster, but a wrong unit is.
PLAUSIBLE = (1e-3, 1e5)
# Rates in Hz of a counter's log, its shortest length and its latest end after the start, in s.
# Between units, which differ by 1000, these leave one for most logs: `benchmarks/clock_units.py`
# shows what a tenth and ten times their values do.
USUAL = (0.1, 5e4)
SHORTEST = 0.3
LATEST = 12 * 3600.0

COUNTS = tuple(2.0**bits for bits in (16, 24, 31, 32))  # after which counters start again
# In usual steps: rows that are lost where a counter starts again.
LOST = 10


class TableClock(NamedTuple):
    """The time of a table.

    Attributes
    ----------
    names : tuple of str
        The columns that hold it.
    time : (n,) array, s
        Of the rows below; it may start again and have damaged values.
    rows : (n,) int array
        The rows of the table that are used, in their order in time.
    findings : tuple of str
    """

    names: tuple[str, ...]
    time: Array
    rows: IntArray
    findings: tuple[str, ...]


def seconds(name: str, unit: str = "") -> float | None:
    """Return the length of a tick in s if this is the name of a time column, else None.

    A name without any unit counts in seconds.
    """
    clock, suffix = _clock_and_unit(name)
    # A unit in the name takes precedence over one in brackets.
    return tick(suffix or unit or "s") if clock else None


def is_clock_name(name: str) -> bool:
    """Return whether this is the full name of a time column, whatever its unit is."""
    return _clock_and_unit(name)[0] not in ("", SHORT)


def stands_still(values: Array) -> bool:
    """Return whether a column (n,) never changes: as a clock it shows nothing."""
    return values.size > 1 and bool(np.ptp(values) == 0)


def unit_of_clock(name: str) -> str:
    """Return the unit in the name of a clock, as in ``t_ms`` and ``TimeUS``; empty without one."""
    return _clock_and_unit(name)[1]


def tick(unit: str) -> float | None:
    """Return a unit of time in s, also of "days since 2020-01-01"; None for any other unit."""
    if unit == OF_DAY:
        return 1.0
    conversion = known_unit(unit.lower().partition(" since ")[0])
    return conversion.factor if conversion and conversion.si == "s" else None


def table_clock(
    columns: Mapping[str, AnyArray], units: Mapping[str, str], stated: str = ""
) -> TableClock | None:
    """Return the clock of a table with the samples in its rows; None without a clock.

    Parameters
    ----------
    columns : mapping of str to array
    units : mapping of str to str
    stated : str
        The column that the user calls the time.

    Raises
    ------
    ValueError
        If the unit of the time is neither stated nor shown by its numbers.
    """
    names = (stated,) if stated in columns else clock_names(columns, units)
    if not names:
        return None
    findings: tuple[str, ...] = ()
    if len(names) == 3:
        parts = zip(names, OF_DAY_BY_NAME.values(), strict=True)
        time, _ = _running_on(np.sum([columns[n] * ticks for n, ticks in parts], axis=0), (DAY,))
    elif len(names) == 2:
        time = _sum(names[0], names[1], columns, units)
    else:
        time, findings = times_in_seconds(names[0], units.get(names[0], ""), columns[names[0]])
    signals = [x for name, x in columns.items() if name not in names and len(x) == time.size]
    time, rows, texts = ordered_rows(time, signals)
    sentences = [f"{printable(names[0])} {text}." for text in texts]

    return TableClock(names, time, rows, (*findings, *sentences))


def clock_names(columns: Mapping[str, AnyArray], units: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the columns that are the time: one to three, or none."""
    vectors = {name: x for name, x in columns.items() if x.ndim == 1 and x.size}
    by_word = {name.strip().lower().removesuffix("s"): name for name in vectors}
    of_day = ()
    if by_word.keys() >= OF_DAY_BY_NAME.keys():
        of_day = tuple(by_word[word] for word in OF_DAY_BY_NAME)
    pair = next(_pairs(vectors, units), ())
    ranks = {}
    for name, values in vectors.items():
        base = Heading(name, "").base
        clock, suffix = _clock_and_unit(base)
        is_stated = bool(suffix or units.get(name))
        is_part = name in pair or name in of_day
        has_unit = bool(seconds(base, units.get(name, "")))
        is_clock = has_unit and not (is_part or stands_still(values))
        is_of_samples = clock in OF_SAMPLES
        # T may be a temperature or a thrust, and the times of samples may be unset.
        is_doubtful = base == "T" and not is_stated
        if is_of_samples:
            is_clock = np.all(np.diff(values) > 0)
        if is_clock and (not is_doubtful or _increases(values)):
            ranks[name] = (clock == SHORT, not is_stated, not is_of_samples)
    best = min(ranks, key=ranks.__getitem__, default="")
    # The time of day is often that of a receiver, in whole seconds.
    if of_day and not (best and is_clock_name(Heading(best, "").base)):
        return of_day
    if best and not (pair and any(ranks[best][:2])):
        return (best,)
    if pair:
        return pair

    # Without such a name, texts of times, or a first column that is a clock.
    for name in vectors:
        if units.get(name) in (SINCE_1970, OF_DAY):
            return (name,)
    first = next(iter(columns), "")
    is_clock = first in vectors and tick(units.get(first, ""))
    return (first,) if is_clock and _increases(vectors[first]) else ()


def times_in_seconds(name: str, unit: str, times: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the times of a column (n,) in s, and findings on what was concluded.

    Times since 1970 count from the first sample.

    Raises
    ------
    ValueError
        If the unit is no unit of time, or neither stated nor shown by the numbers.
    """
    findings = []
    finite = times[np.isfinite(times)]
    if finite.size and np.all(finite == np.round(finite)):
        times, again = _running_on(times, COUNTS)
        findings += [f"{printable(name)} {again}."] if again else []
        finite = times[np.isfinite(times)]

    stated = unit_of_clock(Heading(name, "").base) or unit
    if stated and not tick(stated):
        raise ValueError(
            f"{printable(name)} is in {unit!r}, which is no unit of time: {_cure(name, 'ms')}"
        )
    if not stated:
        # Seconds of a day or a week are clear where they start again.
        times, again = _running_on(times, (DAY, WEEK))
        findings += [f"{printable(name)} {again}."] if again else []
        finite = times[np.isfinite(times)]
    if stated or finite.size < 2:
        in_seconds = times * (tick(stated) or 1.0)
        if " since " in stated:
            in_seconds = in_seconds - finite[:1]
    else:
        in_seconds, text = _by_evidence(name, times, finite)
        findings += [f"{printable(name)} {text}."] if text else []
    in_seconds, again = _running_on(in_seconds, (DAY, WEEK))
    findings += [f"{printable(name)} {again}."] if again else []
    return in_seconds, tuple(findings)


def _clock_and_unit(name: str) -> tuple[str, str]:
    """Return the name of a clock without its unit, in lower case, and the unit; else two empty."""
    words = _words(name)
    suffix = words.pop() if len(words) > 1 and words[-1] in SUFFIXES else ""
    if suffix and words[-1] == "in" and len(words) > 1:
        words.pop()
    clock = "".join(words)
    if clock in COUNTERS and not suffix:
        return clock, COUNTERS[clock]
    return (clock, suffix) if clock in FULL or clock == SHORT else ("", "")


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[\W_]+", name.lower()) if word]


def _increases(values: AnyArray) -> bool:
    """Return whether values (n,) never fall and do not stay."""
    steps = np.diff(values)
    return bool(np.all(steps >= 0) and np.any(steps > 0))


def _pairs(vectors: Mapping[str, AnyArray], units: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of columns that are a time together: sec and nanosec, Date and Time."""
    kinds = {units.get(name): name for name in reversed([*vectors])}
    if SINCE_1970 in kinds and OF_DAY in kinds:
        dates = vectors[kinds[SINCE_1970]]
        if np.all(dates[np.isfinite(dates)] % DAY == 0):
            yield kinds[SINCE_1970], kinds[OF_DAY]

    wholes = [name for name in vectors if _is_part(name, WHOLE)]
    for part in [name for name in vectors if _is_part(name, FRACTIONS)]:
        in_second = vectors[part] * FRACTIONS[_words(part)[-1]]
        for whole in wholes:
            is_whole = np.all(vectors[whole] == np.round(vectors[whole]))
            is_fraction = np.all((in_second >= 0) & (in_second < 1))
            if _words(whole)[:-1] == _words(part)[:-1] and is_whole and is_fraction:
                yield whole, part


def _is_part(name: str, ends: Collection[str]) -> bool:
    """Return whether a name is one of the ends, alone or behind the word stamp or time."""
    *before, end = _words(name) or [""]
    return end in ends and (not before or before[-1] in ("stamp", "time", "timestamp"))


def _sum(whole: str, part: str, columns: Mapping[str, AnyArray], units: Mapping[str, str]) -> Array:
    """Return the sum (n,), s, of whole seconds or dates and of fractions or times of day."""
    start = columns[whole][0]
    is_date = units.get(whole) == SINCE_1970
    in_seconds = columns[part] * (1.0 if is_date else FRACTIONS[_words(part)[-1]])
    # Of seconds since 1970, the digits behind the microseconds would be lost.
    is_date = is_date or start >= EPOCHS["s"]
    return in_seconds + (columns[whole] - start if is_date else columns[whole])


def _running_on(times: Array, largest: tuple[float, ...]) -> tuple[Array, str]:
    """Return times (n,) that run on where they start again after one of these numbers, in words.

    Time that was lost there is short.
    """
    finite = np.flatnonzero(np.isfinite(times))
    values = times[finite]
    steps = np.diff(values)
    if not (steps < 0).any() or values.min() < 0 or not (steps > 0).any():
        return times, ""
    usual = float(np.median(steps[steps > 0]))
    for number_of_ticks in largest:
        back = steps < -number_of_ticks / 2
        lost = steps[back] + number_of_ticks
        if back.any() and np.all((lost >= 0) & (lost <= LOST * usual)):
            turns = np.concatenate([[0], np.cumsum(back)])
            running = times.copy()
            running[finite] = values + number_of_ticks * turns
            return running, f"starts again after {number_of_ticks:.0f}: the times run on"
    return times, ""


def _by_evidence(name: str, times: Array, finite: Array) -> tuple[Array, str]:
    """Return the times (n,) of a column without a unit in s, and the conclusion in words."""
    # The absolute time decides first: no other unit gives a usual log then.
    for unit, first in EPOCHS.items():
        if first <= finite[0] < 4.1 * first and USUAL[0] <= _rate(unit, finite) <= USUAL[1]:
            text = f"has dates or {unit} since 1970: times are from the first sample"
            return (times - finite[0]) * (tick(unit) or 1.0), text

    is_whole = bool(np.all(finite == np.round(finite)))
    is_counter = is_whole and _clock_and_unit(name)[0] in STAMPS
    if is_counter and np.all(np.diff(finite) == 1):
        raise ValueError(
            f"{printable(name)} counts by one without a unit: it may count samples, ms or s: "
            f"{_cure(name, 'ms')}"
        )
    readings = [unit for unit in _possible_units(finite) if _is_usual(unit, finite, is_counter)]
    # What a person calls a time is in seconds or asks: ticks of any length may count it.
    is_certain = len(readings) == 1 and (is_counter or readings[0] in ("s", "days"))
    if not is_certain:
        texts = [f"in {unit} {_in_words(unit, finite)}" for unit in readings or ["s"]]
        raise ValueError(
            f"{printable(name)} has no unit, which may be {' or '.join(readings) or 'any'}, "
            f"{', '.join(texts)}: {_cure(name, (readings or ['ms'])[-1])}"
        )

    (unit,) = readings
    in_seconds = times * (tick(unit) or 1.0)
    text = f"has no unit and was taken for {unit}, {_in_words(unit, finite)}"
    if unit == "days":
        return (times - finite[0]) * DAY, f"{text}: times are from the first sample"
    # In a slow table, seconds are less certain.
    is_slow = np.ptp(finite) > finite.size
    return in_seconds, text if unit != "s" or is_slow else ""


def _possible_units(finite: Array) -> list[str]:
    """Return the units in which a clock may count so, apart from its rate and length."""
    # Counters are whole; seconds since the start rarely are, but at low rates.
    if np.all(finite == np.round(finite)):
        return ["s", "ms", "µs", "ns"]
    units = ["s", "ms"] if np.ptp(finite) > finite.size else ["s"]
    is_date = any(first <= finite[0] <= last for first, last in CALENDARS)
    return [*units, "days"] if is_date else units


def _is_usual(unit: str, finite: Array, is_counter: bool) -> bool:
    """Return whether times (n,) in a unit are those of a usual log."""
    rate = _rate(unit, finite)
    # What people call a time they measure as slowly as they like.
    if unit == "s" and not is_counter:
        return PLAUSIBLE[0] <= rate <= PLAUSIBLE[1]
    length, end = (x * (tick(unit) or 1.0) for x in (np.ptp(finite), np.abs(finite).max()))
    is_recent = unit == "days" or end <= LATEST
    return bool(USUAL[0] <= rate <= USUAL[1] and length >= SHORTEST and is_recent)


def _rate(unit: str, finite: Array) -> float:
    """Return the mean rate in Hz of times (n,) in a unit; infinite where all are equal."""
    length = float(np.ptp(finite)) * (tick(unit) or 1.0)
    return (finite.size - 1) / length if length else math.inf


def _in_words(unit: str, finite: Array) -> str:
    length = float(np.ptp(finite)) * (tick(unit) or 1.0)
    return f"{number(_rate(unit, finite), 3)} Hz for {number(length, 3)} s"


def _cure(name: str, unit: str) -> str:
    # Shells cut names at their blanks.
    column = shlex.quote(f"time={name}:{unit}")
    return (
        f"state its unit, columns={column}, or 'time [{unit}]' in the header, or leave the column "
        "out and give a rate."
    )
