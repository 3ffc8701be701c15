"""Makes messages of the columns of a table: units in headings, and the time column."""

from collections.abc import Mapping

import numpy as np

from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.wording import some
from greybox.data.headings import units_and_holds
from greybox.data.logs.readers.messages import Messages
from greybox.data.time_column import seconds, tick, times_in_seconds

# Columns of the widest matrix whose columns become signals: a convention that excludes images.
WIDEST = 64


def table(
    name: str, columns: Mapping[str, Array], units: Mapping[str, str], rate: float | None = None
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
    """
    timer = time_column(columns, units)
    signals = {key: values for key, values in columns.items() if key != timer}
    # MATLAB's iddata and many scripts store one interval instead of a vector of times.
    interval = columns.get("Ts", np.empty(0))
    size = len(columns[timer]) if timer else max(map(len, signals.values()), default=0)
    time = None
    assumed = ()
    if timer:
        time, assumed = times_in_seconds(timer, units.get(timer, ""), columns[timer])
    elif rate or interval.size == 1:
        signals.pop("Ts", None)
        time = np.arange(size) * (1 / rate if rate else float(interval[0]))

    split = {}
    statements = {}
    for key, values in signals.items():
        parts = _split(key, values, size)
        split |= parts
        statements |= dict.fromkeys(parts, units.get(key, ""))
    labels, hold = units_and_holds(statements)
    odd = [key for key, values in signals.items() if len(values) != size]
    left_out = (
        (f"{name}: left out, because their length is not that of the time: {some(odd, 12)}.",)
        if odd and time is not None
        else ()
    )

    return Messages(name, np.arange(size), time, split, {}, labels, hold=hold), (
        *assumed,
        *left_out,
    )


def time_column(columns: Mapping[str, AnyArray], units: Mapping[str, str]) -> str:
    """Return the name of the time: a vector of this name, or a first one that is a clock."""
    vectors = [key for key, values in columns.items() if values.ndim == 1 and values.size]
    timer = next((key for key in vectors if seconds(key, units.get(key, ""))), "")
    # Without such a name, a first column that increases and has a unit of time.
    first = next(iter(columns), "")
    is_clock = first in vectors and tick(units.get(first, ""))
    return timer or (first if is_clock and np.all(np.diff(columns[first]) > 0) else "")


def _split(name: str, values: AnyArray, size: int) -> Mapping[str, Array]:
    """Return the signals of a variable of the right length: itself, or the columns of a matrix."""
    if values.shape[:1] != (size,):
        return {}
    if values.ndim == 1:
        return {name: values}
    if values.ndim == 2 and values.shape[1] <= WIDEST:
        return {f"{name}[{i}]": column.astype(float) for i, column in enumerate(values.T)}
    return {}
