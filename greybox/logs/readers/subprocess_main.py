"""The part of the HDF5, MATLAB and PX4 readers that runs in a subprocess; see `subprocess_reader`.

Run as a script: ``subprocess_main.py hdf5 FILE``, ``subprocess_main.py matlab FILE`` or ``subprocess_main.py ulog FILE
[TOPIC ...]``. It writes a line of JSON to standard output, ``{"items": [{"path", "shape", "unit"}, ...], "findings":
[...], "about": {...}}``, then the numbers of all items, 8 bytes each. It imports nothing of greybox.
"""

import contextlib
import io
import json
import os
import sys
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

SMALL = 2**24  # bytes: arrays of 16 MB together are accepted from a file of any size
COMPRESSION = 1000  # bytes of arrays per byte of file: deflate reaches 1032, more is damage
MEMORY = 2**32  # bytes that the process may use, in addition to `COMPRESSION` times the file
MOST = 20_000  # arrays, each of which costs a header even when it is empty
DEEPEST = 8  # structs within structs: bounds the recursion
OPAQUE = ("MatlabOpaque", "MatlabFunction")  # scipy's stand-ins for timetable, timeseries, table and other objects
PROBLEMS = (OSError, RuntimeError, ValueError, TypeError, KeyError, OverflowError, MemoryError)


class Collector:
    """Numeric arrays of a file by path, as far as their size is plausible."""

    def __init__(self, size: int) -> None:
        self.room = max(SMALL, COMPRESSION * size)
        self.items: list[dict[str, Any]] = []
        self.arrays: list[np.ndarray] = []
        self.findings: list[str] = []
        self.about: dict[str, Any] = {}

    def reserve(self, numbers: int) -> bool:
        """Tell whether there is room for so many numbers, and take it."""
        fits = 8 * numbers <= self.room and len(self.items) < MOST
        self.room -= 8 * numbers if fits else 0
        return fits

    def add(self, path: str, values: np.ndarray, unit: str = "") -> None:
        """Keep an array."""
        self.arrays.append(np.ascontiguousarray(values, dtype="<f8"))
        self.items.append({"path": path, "shape": values.shape, "unit": unit})

    def write(self) -> None:
        """Write everything to standard output."""
        head = {"items": self.items, "findings": self.findings, "about": self.about}
        out = sys.stdout.buffer
        out.write(json.dumps(head).encode() + b"\n")
        for array in self.arrays:
            out.write(array.tobytes())


def hdf5(path: str, found: Collector, _: list[str]) -> None:
    """Collect the numeric datasets, and the fields of tables; links to other files are not followed."""
    import h5py  # noqa: PLC0415 (only one of these libraries is needed)

    def visit(name: str, thing: Any) -> None:
        if isinstance(thing, h5py.Dataset):
            try:
                _keep_dataset(name, thing, found)
            except PROBLEMS:
                found.findings.append(f"{name}: it cannot be read, the file is damaged there.")

    with h5py.File(path, "r") as file:
        file.visititems(visit)


def _keep_dataset(name: str, dataset: Any, found: Collector) -> None:
    fields = dataset.dtype.names
    numeric = dataset.dtype.kind in "biuf" or (fields and dataset.ndim == 1)
    if not numeric or not 1 <= dataset.ndim <= 2 or not dataset.size:
        return
    if not found.reserve(dataset.size * len(fields or "1")):
        raise ValueError
    values = dataset[()]
    if not fields:
        found.add(name, values, _text(dataset.attrs, "unit") or _text(dataset.attrs, "units"))
    for field in fields or ():
        if values[field].dtype.kind in "biuf" and values[field].ndim == 1:
            found.add(f"{name}/{field}", values[field])


def _text(attributes: Any, name: str) -> str:
    """Return a text attribute; empty if there is none, or it is something else."""
    try:
        value = attributes.get(name, "")
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    except PROBLEMS:
        return ""


def matlab(path: str, found: Collector, _: list[str]) -> None:
    """Collect the numeric vectors and matrices of the workspace and of the structs in it; scipy's warnings too."""
    from scipy.io import loadmat  # noqa: PLC0415 (only one of these libraries is needed)

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        contents = loadmat(path, simplify_cells=True)
    found.findings += sorted({f"scipy says: {str(w.message).splitlines()[0]:.160}" for w in said})
    _keep_struct("", contents, found)


def _keep_struct(group: str, contents: Mapping[str, Any], found: Collector) -> None:
    simulink = _simulink(contents)
    for key, value in {**contents, **simulink}.items():
        if key.startswith("__") or (simulink and key == "signals"):
            continue
        if isinstance(value, Mapping):
            if group.count("/") < DEEPEST:
                _keep_struct(f"{group}{key}/", value, found)
        elif type(value).__name__ in OPAQUE:
            found.findings.append(f"{key}: only MATLAB can read this object (a timetable?); save it as a struct.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2) and value.size:
            if not found.reserve(value.size):
                raise ValueError("its arrays are too large for its size")
            found.add(f"{group}{key}", value)


def _simulink(contents: Mapping[str, Any]) -> dict[str, Any]:
    """Return the signals of a "structure with time": ``signals`` holds one or several of ``values`` and ``label``."""
    signals = contents.get("signals") if "time" in contents else None
    several = [signals] if isinstance(signals, Mapping) else signals if isinstance(signals, list | np.ndarray) else []
    columns = {}
    for i, signal in enumerate(several):
        if isinstance(signal, Mapping) and isinstance(signal.get("values"), np.ndarray):
            label = signal.get("label", "")
            columns[label if isinstance(label, str) and label else f"signal{i + 1}"] = signal["values"]
    return columns


def ulog(path: str, found: Collector, topics: list[str]) -> None:
    """Collect the topics of a PX4 log, their fields and what the log says about the vehicle."""
    from pyulog import ULog  # noqa: PLC0415 (only one of these libraries is needed)

    with contextlib.redirect_stdout(io.StringIO()):
        log = ULog(path, topics or None)
    several = {topic.name for topic in log.data_list if topic.multi_id}
    for topic in log.data_list:
        name = f"{topic.name}[{topic.multi_id}]" if topic.name in several else topic.name
        for field, values in topic.data.items():
            if not found.reserve(values.size):
                raise ValueError("its arrays are too large for its size")
            found.add(f"{name}/{field}", values, "us" if field == "timestamp" else "")
    parameters = {**log.initial_parameters, **{name: value for _, name, value in log.changed_parameters}}
    found.about = {
        "parameters": parameters,
        "defaults": log.get_default_parameters(0),
        "texts": [(line.timestamp, line.message) for line in log.logged_messages],
        "info": {key: value for key, value in log.msg_info_dict.items() if isinstance(value, str | int | float)},
    }

    if log.file_corruption:
        found.findings.append("parts of the file are damaged and were skipped.")
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) / 1e3
        found.findings.append(f"the logger lost data {len(log.dropouts)} times, {lost:.2f} s in total.")


def _limit_memory(size: int) -> None:
    """Let a damaged file fail with a MemoryError, where the system supports a limit."""
    try:
        import resource  # noqa: PLC0415 (not on Windows)
    except ImportError:
        return
    most = MEMORY + COMPRESSION * size
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def main() -> None:
    """Write the contents of a file to standard output, or exit with the reason why not."""
    kind, path, *wanted = sys.argv[1:]
    size = os.path.getsize(path)
    _limit_memory(size)
    found = Collector(size)
    try:
        {"hdf5": hdf5, "matlab": matlab, "ulog": ulog}[kind](path, found, wanted)
    except Exception as problem:  # the libraries raise whatever their parsers stumble over
        sys.exit(f"{type(problem).__name__}: {problem}")
    found.write()


if __name__ == "__main__":
    main()
