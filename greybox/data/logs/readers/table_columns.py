"""Makes messages of the columns of a table: units in headings, and the time column."""

from collections.abc import Mapping

import numpy as np

from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.wording import some
from greybox.data.headings import units_and_holds
from greybox.data.logs.readers.messages import Messages
from greybox.data.time_column import table_clock

# Columns of the widest matrix whose columns become signals: a convention that excludes images.
WIDEST = 64

MOST_DEVICES = 16  # of one kind on a vehicle
# Share of the rows whose number differs from the one before where devices log in turn. A current in
# whole amperes, which has the name I too, changes with half of the rows at most.
IN_TURN = 2 / 3


def table(
    name: str,
    columns: Mapping[str, Array],
    units: Mapping[str, str],
    rate: float | None = None,
    stated_time: str = "",
) -> tuple[Messages, tuple[str, ...]]:
    """Make messages of columns that share a time, and findings on those that were left out.

    Without a time column the samples are `rate` Hz apart, or ``Ts`` seconds where the table has
    this sampling interval, as in System Identification Toolbox. Without these, the messages have no
    time.

    Parameters
    ----------
    name : str
        Their name.
    columns : mapping of str to array
        Matrices with one sample per row give signals ``x[0]``, ``x[1]`` ..., one per column.
    units : mapping of str to str
        A word after the unit may state how the signal varies between its samples, ``1 held`` or
        ``rad sampled``.
    rate : float, Hz, optional
    stated_time : str
        The column that the user calls the time.
    """
    clock = table_clock(columns, units, stated_time)
    signals = {key: x for key, x in columns.items() if not clock or key not in clock.names}
    # MATLAB's iddata and many scripts store one interval instead of a vector of times.
    interval = columns.get("Ts", np.empty(0))
    size = max(map(len, signals.values()), default=0)
    time = None
    findings = ()
    if clock:
        size = len(columns[clock.names[0]])
        time, findings = clock.time, clock.findings
    elif rate or interval.size == 1:
        signals.pop("Ts", None)
        time = np.arange(size) * (1 / rate if rate else float(interval[0]))

    split = {}
    statements = {}
    for key, values in signals.items():
        parts = _split(key, values, size)
        split |= {part: x[clock.rows] if clock else x for part, x in parts.items()}
        statements |= dict.fromkeys(parts, units.get(key, ""))
    labels, hold = units_and_holds(statements)
    odd = [key for key, values in signals.items() if len(values) != size]
    if odd and time is not None:
        sentence = f"{name}: left out, because their length is not that of the time: "
        findings = (*findings, f"{sentence}{some(odd, 12)}.")

    order = np.arange(size if time is None else time.size)
    return Messages(name, order, time, split, {}, labels, hold=hold), findings


def devices(name: str, columns: Mapping[str, AnyArray]) -> dict[str, dict[str, AnyArray]]:
    """Return the columns of every device by its name, ``IMU[0]``, ``IMU[1]`` ...; or of the table.

    The column ``instance``, or ``I`` in logs of ArduPilot, has the number of the device that a row
    is of. It is no signal of the devices.
    """
    for key, numbers in columns.items():
        if _numbers_devices(key, numbers):
            shared = {k: x for k, x in columns.items() if k != key}
            return {
                f"{name}[{number:g}]": {
                    k: x[numbers == number] if len(x) == len(numbers) else x
                    for k, x in shared.items()
                }
                for number in np.unique(numbers)
            }
    return {name: dict(columns)}


def _numbers_devices(key: str, values: AnyArray) -> bool:
    """Return whether a column has the numbers of several devices."""
    if key not in ("I", "Instance", "instance") or values.ndim != 1:
        return False
    numbers = np.unique(values)
    if numbers.size < 2 or not np.isin(numbers, np.arange(MOST_DEVICES)).all():
        return False
    return key != "I" or bool(np.mean(np.diff(values) != 0) >= IN_TURN)


def _split(name: str, values: AnyArray, size: int) -> Mapping[str, Array]:
    """Return the signals of a variable of the right length, without those of other lengths."""
    return columns_of(name, values) if values.shape[:1] == (size,) else {}


def columns_of(name: str, values: AnyArray) -> Mapping[str, Array]:
    """Return the signals of a variable: itself, or the columns of a matrix, ``x[0]``, ``x[1]`` ...

    Images and arrays of more dimensions have none.
    """
    if values.ndim == 1:
        return {name: values}
    if values.ndim == 2 and values.shape[1] <= WIDEST:
        return {f"{name}[{i}]": column.astype(float) for i, column in enumerate(values.T)}
    return {}
