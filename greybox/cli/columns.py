"""The option `--columns`: what the columns of somebody's table are, and in which units."""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from greybox.cli.options import UsageError
from greybox.data.record import Recording
from greybox.data.response_columns import find_column
from greybox.data.units import to_si

TIME = "time"


def add_columns_option(parser: argparse.ArgumentParser, where: str = "") -> None:
    """Declare the option; `where` begins its help."""
    parser.add_argument(
        "--columns",
        nargs="+",
        default=[],
        metavar="NAME=COLUMN[:UNIT]",
        help=f"{where}the columns of a table that names them otherwise. A response: frequency=f:Hz magnitude=mag:dB "
        "phase=ph:deg coherence=coh, or alpha and beta; a record: time=t:ms and the model's signals, theta=pitch:deg",
    )


def stated_columns(options: argparse.Namespace) -> dict[str, str]:
    """Return what the option says: by name the column, with its unit behind a colon.

    Raises
    ------
    UsageError
        For a word of another form, or a name that is there twice.
    """
    columns: dict[str, str] = {}
    for word in options.columns:
        name, _, column = word.partition("=")
        if not (name and column):
            raise UsageError(f"--columns {word!r} is not understood: write NAME=COLUMN:UNIT, e.g. frequency=f:Hz.")
        if name in columns:
            raise UsageError(f"--columns names {name} twice: {columns[name]} and {column}.")
        columns[name] = column
    return columns


def with_columns(log: Recording, columns: Mapping[str, str]) -> Recording:
    """Return a log of one table with its columns under these names, in SI units, and no others.

    Raises
    ------
    ValueError
        If a column is not there, or its unit is not known.
    """
    if len(log) != 1:
        raise ValueError(f"{log.source} has {len(log)} messages, and --columns names the columns of one table.")
    ((key, record),) = log.items()
    header = [f"{name} [{unit}]" if (unit := record.units.get(name)) else name for name in record.signals]
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
        own = [*record.signals][place]
        signals[name] = conversion.apply(record[own])
        units[name] = conversion.si
        hold |= {name: record.hold[own]} if own in record.hold else {}
    time = signals.pop(TIME, record.time if record.has_time else None)
    kept = replace(record, time=time, signals=signals, units=units, hold=hold, has_time=True)
    return replace(log, records={key: kept})
