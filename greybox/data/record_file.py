"""Records in a group of an HDF5 file."""

from typing import Any

import numpy as np

from greybox.data.record import Record

Node = Any
TEXTS = ("name", "source", "checksum")


def write_record(group: Node, record: Record) -> None:
    """Write times, signals in their order, units, hold, name, source and checksum; not metadata, filters, findings.

    Of rows without a time, their numbers, and that they have none.
    """
    for name in TEXTS:
        group.attrs[name] = getattr(record, name)
    group["time"] = record.time
    if not record.has_time:
        group.attrs["has_time"] = False
    signals = group.create_group("signals", track_order=True)
    for name, values in record.signals.items():
        dataset = signals.create_dataset(escaped(name), data=values)
        dataset.attrs["unit"] = record.units.get(name, "")
        if name in record.hold:
            dataset.attrs["hold"] = record.hold[name]


def read_record(group: Node) -> Record:
    """Read what `write_record` wrote."""
    signals = {}
    units = {}
    hold = {}
    for key, dataset in group["signals"].items():
        name = unescaped(key)
        signals[name] = np.asarray(dataset[()], dtype=float)
        if dataset.attrs["unit"]:
            units[name] = str(dataset.attrs["unit"])
        if "hold" in dataset.attrs:
            hold[name] = float(dataset.attrs["hold"])
    texts: dict[str, Any] = {name: str(group.attrs[name]) for name in TEXTS}
    has_time = bool(group.attrs.get("has_time", True))
    return Record(group["time"][()], signals, units, hold=hold, has_time=has_time, **texts)


def escaped(name: str) -> str:
    """Return a name without the slash, which HDF5 reads as a path."""
    return name.replace("%", "%25").replace("/", "%2F")


def unescaped(key: str) -> str:
    """Return the name that was escaped."""
    return key.replace("%2F", "/").replace("%25", "%")
