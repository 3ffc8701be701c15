"""Renames the columns of a table, and converts them to SI."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from greybox.data.record import Recording
from greybox.data.response_columns import find_column
from greybox.data.units import to_si

TIME = "time"


def with_columns(log: Recording, columns: Mapping[str, str]) -> Recording:
    """Return a log of one table with its columns under these names, in SI units, and no others.

    Raises
    ------
    ValueError
        If a column is not there, or its unit is not known.
    """
    if len(log) != 1:
        raise ValueError(
            f"{log.source} has {len(log)} messages, but `columns` names the columns of one table."
        )
    ((key, record),) = log.items()
    header = [
        f"{name} [{unit}]" if (unit := record.units.get(name)) else name for name in record.signals
    ]
    signals: dict[str, Any] = {}
    units: dict[str, str] = {}
    hold: dict[str, float] = {}
    for name, text in columns.items():
        if name == TIME and record.has_time and text.partition(":")[0] not in record.signals:
            continue  # the column that the reader took for the time
        try:
            place, unit = find_column(text, header)
            conversion = to_si(unit)
        except ValueError as error:
            sentence = str(error)
            joint = " " if sentence.startswith("has ") else f": {text}: "
            raise ValueError(f"{log.source}{joint}{sentence.rstrip('.')}.") from None
        column = [*record.signals][place]
        signals[name] = conversion.apply(record[column])
        units[name] = conversion.si
        hold |= {name: record.hold[column]} if column in record.hold else {}
    time = signals.pop(TIME, record.time if record.has_time else None)
    renamed = replace(record, time=time, signals=signals, units=units, hold=hold, has_time=True)
    return replace(log, records={key: renamed})
