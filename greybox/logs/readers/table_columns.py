"""Makes messages of the columns of a table: units in headings, and the time column."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.intersample import CONTINUOUS, HELD
from greybox.data.record import Record
from greybox.data.time_column import seconds, times_in_seconds
from greybox.files.arrays import Array
from greybox.files.text_table import some
from greybox.logs.readers.messages import Messages

BETWEEN = {"held": HELD, "sampled": CONTINUOUS}
# Columns of the widest matrix whose columns become signals: a convention that excludes images.
WIDEST = 64


def table(
    name: str, columns: Mapping[str, Array], units: Mapping[str, str], rate: float | None = None
) -> tuple[Messages | None, tuple[str, ...]]:
    """Make messages of columns that share a time; None without a time or without signals.

    Without a time column the samples are `rate` Hz apart, or ``Ts`` seconds where the table has
    this sampling interval, as in System Identification Toolbox.

    Parameters
    ----------
    name : str
        Their name.
    columns : mapping of str to array
        As read, in any real type; matrices with one sample per row give signals ``x[0]``, ``x[1]``
        ..., one per column.
    units : mapping of str to str
        A word behind the unit may state how the signal runs between its samples, ``1 held`` or
        ``rad sampled``.

    Returns
    -------
    messages : Messages or None
    findings : tuple of str
        Columns that were left out.
    """
    timer = next(
        (key for key in columns if seconds(key, units.get(key, "")) and columns[key].ndim == 1), ""
    )
    # MATLAB's iddata and many scripts store one interval instead of a vector of times.
    interval = np.ravel(columns.get("Ts", np.empty(0)))
    if timer and columns[timer].size:
        time, assumed = times_in_seconds(timer, units.get(timer, ""), columns[timer])
    elif rate or interval.size == 1:
        columns = {key: values for key, values in columns.items() if key != "Ts"}
        count = max((len(values) for values in columns.values()), default=0)
        step = 1 / rate if rate else float(interval[0])
        time, assumed = np.arange(count, dtype=float) * step, ()
    else:
        return None, (
            f"{name or 'the file'}: {len(columns)} variables without a time were left out.",
        )

    signals = {}
    labels = {}
    hold = {}
    wrong_length = []
    for key, values in columns.items():
        if key == timer:
            continue
        unit, seconds_held = _unit_and_hold(units.get(key, ""))
        for label, column in _split(key, values, time.size):
            signals[label] = column
            labels[label] = unit
            if seconds_held is not None:
                hold[label] = seconds_held
        if values.shape[:1] != time.shape:
            wrong_length.append(key)

    findings = [*assumed]
    if wrong_length:
        findings.append(
            f"{name}: left out, because their length is not that of the time: "
            f"{some(wrong_length, 12)}."
        )
    messages = (
        Messages(name, np.arange(time.size), time, signals, {}, labels, hold=hold)
        if signals
        else None
    )

    return messages, tuple(findings)


def of_rows(
    name: str, columns: Mapping[str, Array], units: Mapping[str, str], **about: Any
) -> Record:
    """Return a record of rows without a time; `about` are its source, checksum and findings."""
    named = {key: _unit_and_hold(units.get(key, ""))[0] for key in columns}
    stated = {key: unit for key, unit in named.items() if unit}
    return Record(None, columns, stated, name, **about)  # type: ignore[arg-type]


def _unit_and_hold(text: str) -> tuple[str, float | None]:
    """Split ``1 held`` into the unit and the time for which a value lasts, s, or None."""
    unit, _, word = text.strip().rpartition(" ")
    hold = BETWEEN.get(word.lower())
    return (text, None) if hold is None else (unit.strip(), hold)


def _split(name: str, values: NDArray[np.generic], size: int) -> list[tuple[str, Array]]:
    """Return the signals of a variable of the right length: itself, or the columns of a matrix."""
    if values.shape[:1] != (size,):
        return []
    if values.ndim == 1:
        return [(name, values.astype(float, copy=False))]
    if values.ndim == 2 and values.shape[1] <= WIDEST:
        return [(f"{name}[{i}]", values[:, i].astype(float)) for i in range(values.shape[1])]
    return []
