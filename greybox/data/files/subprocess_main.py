"""Reads a file in a subprocess, with libraries that a damaged or crafted file can crash.

Run as a script: ``subprocess_main.py KIND FILE [TOPIC ...]`` with the kinds of `KINDS`. It writes a
line of JSON to standard output, ``{"items": [...], "findings": [...], "about": {...}}``, with the
path, the unit and the shape of every array, then the numbers of all arrays, 8 bytes each. It
imports nothing of greybox, which its path may not have.

`hdf5` is the one place where an HDF5 file is opened: it reaches nothing outside that file.
"""

import contextlib
import importlib
import io
import json
import math
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

# Bytes of arrays that are accepted from a log of any size, 16 MB.
SMALL = 2**24
# Bytes of arrays, at 8 a number, per byte of a log. Deflate reaches 1032, which turns a mail into
# gigabytes; compressed flights reach 10, and files of mostly constant signals stay below this.
EXPANSION = 100
MOST = 20_000  # arrays; even an empty one costs a header
LINKS = 50_000  # in all groups of a file
DEEPEST = 8  # structs within structs, groups within groups
HARD, SOFT = 0, 1  # types of links, H5L_type_t of the HDF5 library
# Groups of MATLAB 7.3 with the contents of its cells and objects, under numbers instead of names.
INNER = ("#refs#", "#subsystem#")
NUMBERS = (
    "double",
    "single",
    "logical",
    *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)),
)
REFUSED = 3  # the exit status for a file that names other files, or more than it can hold
# Seconds in the units of time of MATLAB's iddata.
TIME_UNITS = {
    "nanoseconds": 1e-9,
    "microseconds": 1e-6,
    "milliseconds": 1e-3,
    "seconds": 1.0,
    "minutes": 60.0,
    "hours": 3600.0,
}
# Scipy's stand-ins for timetable, timeseries, table and other objects.
OPAQUE = ("MatlabOpaque", "MatlabFunction")
PROBLEMS = (OSError, RuntimeError, ValueError, TypeError, KeyError, OverflowError, MemoryError)


class RefusedError(Exception):
    """The file has contents that no honest file has: the whole file is refused."""


class Collector:
    """Collects the contents of a file, up to a plausible size."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.links = LINKS
        self.items: list[dict[str, Any]] = []
        self.arrays: list[np.ndarray] = []
        self.findings: list[str] = []
        self.unread: list[str] = []  # names of cells, texts and objects
        self.about: dict[str, Any] = {}

    def reserve(self, numbers: int) -> None:
        """Reserve the memory of this many numbers; ValueError if they do not fit."""
        if 8 * numbers > self.room or len(self.arrays) >= MOST:
            raise ValueError("its arrays are too large for the size of the file")
        self.room -= 8 * numbers

    def add(self, path: str, values: np.ndarray, unit: str) -> None:
        """Store an array."""
        self.arrays.append(values)
        self.items.append({"path": path, "unit": unit, "shape": values.shape})

    def write(self) -> None:
        """Write everything to standard output."""
        head = {
            "items": self.items,
            "findings": self.findings,
            "about": self.about,
        }
        out = sys.stdout.buffer
        out.write(json.dumps(head).encode() + b"\n")
        # Each array is released once it is written: the parent process holds its copy by then.
        while self.arrays:
            out.write(np.ascontiguousarray(self.arrays.pop(0), dtype="<f8").data)


def _unread(names: list[str]) -> Iterator[str]:
    """Yield one finding on all that has no numbers of its own."""
    if names:
        listed = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        yield (
            f"not read: {listed}. Cells, texts and MATLAB's objects (timetables?) are left out; "
            "save the numbers in them as vectors, or as fields of a struct."
        )


def hdf5(path: str, collector: Collector, _: list[str]) -> None:
    """Collect the numeric datasets of an HDF5 file, and the fields of tables, each once.

    Soft links are not followed, so there is no loop. Links to other files, datasets whose numbers
    are in other files (external storage, virtual datasets), and more links or levels than a file of
    measurements has are refused.
    """
    import h5py  # noqa: PLC0415 (only one of these libraries is needed)

    with h5py.File(path, "r") as file:
        # Hard links may lead back to a group above: each address is visited once.
        addresses: set[int] = set()
        waiting = [("", file["/"])]
        while waiting:
            name, item = waiting.pop()
            if isinstance(item, h5py.Group):
                # Reversed, since the last one is taken first: in the order of the file.
                waiting += reversed([*_members(name, item, collector, addresses)])
            elif isinstance(item, h5py.Dataset):
                # Reading such a dataset would open a file that the sender of this one names.
                created = item.id.get_create_plist()
                if created.get_layout() == h5py.h5d.VIRTUAL or created.get_external_count():
                    raise RefusedError(f"the data of {name} are stored in another file")
                try:
                    _keep_dataset(name, item, collector)
                except PROBLEMS:
                    text = f"{name}: it cannot be read, the file is damaged there."
                    collector.findings.append(text)
    collector.findings += _unread(collector.unread)


def _members(
    path: str, group: Any, collector: Collector, addresses: set[int]
) -> Iterator[tuple[str, Any]]:
    """Yield the targets of the hard links of a group, each address once."""
    collector.links -= len(group)
    if collector.links < 0:
        raise RefusedError(f"it has more than {LINKS} links")

    for name in group:
        if not path and name in INNER:
            continue
        place = f"{path}/{name}".lstrip("/")
        link = group.id.links.get_info(name.encode("utf-8", "surrogateescape"))
        if link.type not in (HARD, SOFT):
            raise RefusedError(f"{place} is a link to another file")
        if link.type == HARD and link.u not in addresses:
            addresses.add(link.u)
            if place.count("/") > DEEPEST:
                raise RefusedError(f"it has more than {DEEPEST} levels of groups")
            yield place, group[name]


def _stored(dataset: Any) -> int:
    """Return the memory that reading takes, in 8-byte numbers; a chunk is read as a whole."""
    largest = max(math.prod(dataset.shape), math.prod(dataset.chunks or ()))
    return math.ceil(largest * max(dataset.dtype.itemsize / 8, len(dataset.dtype.names or "1")))


def _keep_dataset(name: str, dataset: Any, collector: Collector) -> None:
    import h5py  # noqa: PLC0415

    kind = _text(dataset.attrs, "MATLAB_class")
    is_complex = kind and dataset.dtype.names
    # The fields of MATLAB's arrays of structs are references.
    is_reference = h5py.check_ref_dtype(dataset.dtype) is not None
    if (kind and kind not in NUMBERS) or is_complex or is_reference:
        collector.unread.append(name)
        return
    # MATLAB 7.3 stores the size of an empty array instead of its numbers.
    if dataset.shape is None or "MATLAB_empty" in dataset.attrs:
        return
    fields = dataset.dtype.names
    # A table is a vector of structs; images and other arrays of more dimensions are not signals.
    numeric = dataset.dtype.kind in "biuf" or (fields and dataset.ndim == 1)
    if not numeric or not 1 <= dataset.ndim <= 2 or not dataset.size:
        return
    collector.reserve(_stored(dataset))
    values = dataset[()]
    if not fields:
        unit = _text(dataset.attrs, "unit") or _text(dataset.attrs, "units")
        collector.add(name, _unpacked(values, dataset.attrs), unit)

    for field in fields or ():
        if values[field].dtype.kind in "biuf" and values[field].ndim == 1:
            collector.add(f"{name}/{field}", values[field], unit="")


def _unpacked(values: np.ndarray, attributes: Any) -> np.ndarray:
    """Return the numbers that a packed dataset means, by the attributes that netCDF defines."""
    fill = [_number(attributes, name) for name in ("_FillValue", "missing_value")]
    scale = _number(attributes, "scale_factor")
    offset = _number(attributes, "add_offset")
    missing = np.isin(values, [x for x in fill if x is not None])
    if scale is None and offset is None and not missing.any():
        return values

    unpacked = values * float(1 if scale is None else scale) + float(
        0 if offset is None else offset
    )
    unpacked[missing] = np.nan
    return unpacked


def _number(attributes: Any, name: str) -> float | None:
    """Return an attribute that is one number, None without it."""
    try:
        value = np.ravel(attributes[name])
        return value[0] if value.size == 1 and value.dtype.kind in "iuf" else None
    except PROBLEMS:
        return None


def _text(attributes: Any, name: str) -> str:
    """Return a text attribute, or an empty text."""
    try:
        value = np.ravel(attributes.get(name, ""))[0]
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        return value if isinstance(value, str) else ""
    except (*PROBLEMS, IndexError):
        return ""


def matlab(path: str, collector: Collector, _: list[str]) -> None:
    """Collect the numeric arrays of the workspace and of its structs, and the warnings of scipy."""
    from scipy.io import loadmat  # noqa: PLC0415 (only one of these libraries is needed)

    # scipy warns of duplicate and unreadable variables: the user must learn of these.
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        contents = loadmat(path, simplify_cells=True)
    collector.findings += sorted(
        {f"scipy says: {str(w.message).splitlines()[0]:.160}" for w in raised}
    )
    keep_struct("", contents, collector)
    collector.findings += _unread(collector.unread)


def keep_struct(group: str, contents: Mapping[str, Any], collector: Collector) -> None:
    """Collect the numeric vectors and matrices of a struct, and of the structs in it."""
    if {"ResponseData", "Frequency"} <= contents.keys():
        collector.findings.append(_response_remark(group.rstrip("/"), contents))
        return
    contents, units = _iddata(_labeled(contents))
    simulink = _simulink(contents)
    for key, value in {**contents, **simulink}.items():
        if key.startswith("__") or (simulink and key == "signals"):
            continue
        if key == "Ts" and isinstance(value, int | float):  # the sampling interval, s
            value = np.array([float(value)])  # noqa: PLW2901
        if isinstance(value, Mapping):
            if group.count("/") < DEEPEST:
                keep_struct(f"{group}{key}/", value, collector)
        elif type(value).__name__ in OPAQUE or _has_numbers(value):
            collector.unread.append(f"{group}{key}")
        elif (
            isinstance(value, np.ndarray)
            and value.dtype.kind in "biuf"
            and value.ndim in (1, 2)
            and value.size
        ):
            collector.reserve(value.size)
            collector.add(f"{group}{key}", value, unit=units.get(key, ""))


def _response_remark(name: str, contents: Mapping[str, Any]) -> str:
    """Return how to save the frequency response of an idfrd or frd object."""
    unit = "Hz" if "hz" in str(contents.get("FrequencyUnit", "")).lower() else "rad/s"
    # The name in the file is no part of the command: a crafted one would be run by MATLAB.
    return (
        f"{name or 'the workspace'} is a frequency response (idfrd, frd), which is read from a "
        "table. For one input and one output, as G in MATLAB: writetable(table(G.Frequency(:), "
        "real(G.ResponseData(:)), imag(G.ResponseData(:)), 'VariableNames', "
        f"{{'frequency [{unit}]', 'alpha', 'beta'}}), "
        "'G.csv')."
    )


def _iddata(contents: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the fields of a struct, or the signals of an iddata object by name, and their units.

    The fields are those that ``get(data)`` returns in MATLAB. Several experiments are in cells,
    which stay where they are.
    """
    roles = {"Input": "u", "Output": "y"}  # with MATLAB's names for signals that have none
    if not all(isinstance(contents.get(f"{role}Data"), np.ndarray) for role in roles):
        return contents, {}
    tick = TIME_UNITS.get(str(contents.get("TimeUnit", "seconds")) or "seconds")
    if tick is None:
        return contents, {}

    signals: dict[str, Any] = {}
    units: dict[str, str] = {}
    stamps = contents.get("SamplingInstants")
    if isinstance(stamps, np.ndarray) and stamps.size:
        signals["time"] = stamps * tick
        units["time"] = "s"
    elif isinstance(contents.get("Ts"), int | float):
        signals["Ts"] = contents["Ts"] * tick
    for role, letter in roles.items():
        values = contents[f"{role}Data"]
        columns = [values] if values.ndim == 1 else [*values.T]
        names = [str(name) for name in np.ravel(contents.get(f"{role}Name", ()))]
        labels = [str(unit) for unit in np.ravel(contents.get(f"{role}Unit", ()))]
        is_held = role == "Input" and contents.get("InterSample") == "zoh"
        for k, column in enumerate(columns):
            name = names[k] if k < len(names) else ""
            # A slash in a name would be one of a path.
            name = name.replace("/", "_") or f"{letter}{k + 1}"
            label = labels[k] if k < len(labels) else ""
            signals[name] = column
            units[name] = f"{label} held" if is_held else label
    return signals, units


def _has_numbers(value: Any) -> bool:
    """Return whether a value is a cell with arrays of numbers in it."""
    cells = value if isinstance(value, list) else []
    if isinstance(value, np.ndarray) and value.dtype == object:
        cells = list(value.ravel())
    return any(isinstance(cell, np.ndarray) and cell.dtype.kind in "biuf" for cell in cells)


def _labeled(contents: Mapping[str, Any]) -> dict[str, Any]:
    """Return variables of which matrices with labels, as Mission Planner writes them, are structs.

    ``ATT_label`` names the columns of ``ATT``.
    """
    variables = dict(contents)
    for key, values in contents.items():
        labels = [str(label).strip() for label in np.ravel(contents.get(f"{key}_label", ()))]
        is_matrix = isinstance(values, np.ndarray) and values.ndim == 2
        if is_matrix and len(set(labels)) == len(labels) == values.shape[1]:
            variables[key] = dict(zip(labels, values.T, strict=True))
            del variables[f"{key}_label"]
    return variables


def _simulink(contents: Mapping[str, Any]) -> dict[str, Any]:
    """Return the signals of a "structure with time" by their labels."""
    signals = contents.get("signals") if "time" in contents else None
    columns = {}
    for i, signal in enumerate(np.array(signals, object).ravel()):
        if isinstance(signal, Mapping) and isinstance(signal.get("values"), np.ndarray):
            label = signal.get("label", "")
            columns[label if isinstance(label, str) and label else f"signal{i + 1}"] = signal[
                "values"
            ]

    return columns


def ulog(path: str, collector: Collector, topics: list[str]) -> None:
    """Collect the topics of a PX4 log, their fields and what the log says about the vehicle."""
    from pyulog import ULog  # noqa: PLC0415 (only one of these libraries is needed)

    with contextlib.redirect_stdout(io.StringIO()):
        # pyulog prints about damage; standard output belongs to the answer.
        log = ULog(path, topics or None)
    repeated = {topic.name for topic in log.data_list if topic.multi_id}
    for topic in log.data_list:
        name = f"{topic.name}[{topic.multi_id}]" if topic.name in repeated else topic.name
        for field, values in topic.data.items():
            collector.reserve(values.size)
            collector.add(f"{name}/{field}", values, unit="us" if field == "timestamp" else "")

    collector.about = {
        "initial": log.initial_parameters,
        "changes": log.changed_parameters,
        "texts": [(line.timestamp, line.message) for line in log.logged_messages],
        "vehicle": log.msg_info_dict.get("sys_name"),
        "firmware": [log.get_version_info_str(), log.msg_info_dict.get("ver_sw")],
    }

    if log.file_corruption:
        collector.findings.append("parts of the file are damaged and were skipped.")
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) / 1e3
        collector.findings.append(
            f"the logger lost data {len(log.dropouts)} times, {lost:.2f} s in total."
        )


def limit_resources(size: int, room: int) -> None:
    """Limit processor time by the size of the file, and memory by that of its arrays."""
    try:
        import resource  # noqa: PLC0415 (not on Windows)
        import signal  # noqa: PLC0415
    except ImportError:
        return
    # A crash leaves no image of the memory on the disk.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Processor time, at 4 MB/s: HDF5 and MATLAB files of arrays run at 200 MB/s, compressed ones
    # and those of many small objects at 10 MB/s.
    signal.setitimer(signal.ITIMER_PROF, 0.6 + size / 4e6)
    # Beside its libraries, the process has 128 MB of its own. An array is in memory as it is
    # stored, as it is written, and once more on the way.
    most = _memory() + 2**27 + 3 * room
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def _memory() -> int:
    """Return the address space of this process, bytes; outside of Linux, an upper limit."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 2**32


KINDS = {
    "hdf5": ("h5py", hdf5),
    "matlab": ("scipy.io", matlab),
    "ulog": ("pyulog", ulog),
}


def main() -> None:
    """Write the contents of a file to standard output, or exit with the reason of the failure."""
    kind, path, *topics = sys.argv[1:]
    library, collect = KINDS[kind]
    size = os.path.getsize(path)
    collector = Collector(max(SMALL, EXPANSION * size))
    try:
        # The library comes first: its own time and memory do not depend on the file.
        importlib.import_module(library)
        limit_resources(size, collector.room)
        collect(path, collector, topics)
        collector.write()
    except RefusedError as reason:
        sys.stderr.write(str(reason))
        sys.exit(REFUSED)
    except Exception as problem:  # the libraries raise whatever their parsers stumble over
        sys.exit(f"{type(problem).__name__}: {problem}")


if __name__ == "__main__":
    main()
