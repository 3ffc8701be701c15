"""Readers of flight logs: one format a file, chosen by the contents of the file, then by its suffix.

Begin here, with `FORMATS` and `read`. A reader is a module with ``read(path, messages=None) ->
Recording``. It is imported when a file of its format is read, so that `greybox.logs.readers` itself
loads neither pymavlink nor h5py nor scipy.

Formats
    `dataflash` (ArduPilot, binary), with `dataflash_index` (finds the messages in a file),
    `dataflash_units` and `imu_batches` (raw samples of the IMU); `dataflash_text` (ArduPilot,
    text); `telemetry` (MAVLink), with `telemetry_packets` (finds the packets in a file) and
    `telemetry_metadata`; `ulog` (PX4); `csv_table`, with `betaflight` (of its blackbox); `hdf5`;
    `matlab`.
Shared by several
    `mapped_file` (files that are mapped into memory), `messages` (messages of one type, and the
    records made of them), `time_stamps` (clock restarts, impossible and repeated stamps),
    `table_columns` (units in headings, the time column), `ardupilot_metadata` (vehicle, firmware,
    parameters, modes, arming), `controller_outputs` (which signals a controller holds),
    `named_arrays` (records of the groups in HDF5, MATLAB and PX4 files, which
    `greybox.files.subprocess_reader` reads in a subprocess).
"""

from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import NamedTuple

from greybox.data.record import Recording
from greybox.files.safe_files import require_file
from greybox.files.text_table import printable
from greybox.logs.named_columns import with_columns

HEAD = 4096  # bytes by which a format is recognized
HDF5 = b"\x89HDF\r\n\x1a\n"  # at byte 0, 512, 1024, 2048 ... (a MATLAB 7.3 file has it at 512)
YEAR_2000, YEAR_2100 = (
    946_684_800_000_000,
    4_102_444_800_000_000,
)  # µs since 1970, the stamps of telemetry logs


class Format(NamedTuple):
    """One format: its module, its name, its usual suffixes, and a test of a file's first bytes."""

    module: str
    about: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[bytes], bool]


def _is_dataflash(head: bytes) -> bool:
    return head.startswith(b"\xa3\x95")


def _is_ulog(head: bytes) -> bool:
    return head.startswith(b"ULog\x01\x12\x35")


def _is_hdf5(head: bytes) -> bool:
    return any(head[at : at + 8] == HDF5 for at in (0, 512, 1024, 2048))


def _is_matlab(head: bytes) -> bool:
    return head.startswith(b"MATLAB 5.0 MAT-file")


def _is_telemetry(head: bytes) -> bool:
    """Tell whether it starts with a time of this century in µs, then a MAVLink packet (version 1 or 2)."""
    return (
        len(head) > 8
        and YEAR_2000 < int.from_bytes(head[:8], "big") < YEAR_2100
        and head[8] in b"\xfe\xfd"
    )


def _is_dataflash_text(head: bytes) -> bool:
    return b"FMT," in head and b"\0" not in head


def _is_csv(head: bytes) -> bool:
    """Tell whether it is text with at least two lines and a separator in the first that is no comment."""
    if b"\0" in head or not head.strip():
        return False
    lines = [
        line for line in head.splitlines() if line.strip() and not line.startswith((b"#", b"%"))
    ]
    enough = len(lines) > 1 or (len(lines) == 1 and len(head) == HEAD)
    return enough and any(separator in lines[0] for separator in b",;\t") and _is_text(head)


def _is_text(head: bytes) -> bool:
    return not any(byte < 9 or 13 < byte < 32 for byte in head)


FORMATS = (
    Format("dataflash", "ArduPilot DataFlash, binary", (".bin",), _is_dataflash),
    Format("ulog", "PX4 ULog", (".ulg",), _is_ulog),
    Format("hdf5", "HDF5 or MATLAB 7.3", (".h5", ".hdf5", ".hdf"), _is_hdf5),
    Format("matlab", "MATLAB", (".mat",), _is_matlab),
    Format("telemetry", "MAVLink telemetry", (".tlog",), _is_telemetry),
    Format("dataflash_text", "ArduPilot DataFlash, text", (".log",), _is_dataflash_text),
    Format(
        "csv_table", "a table with a header line", (".csv", ".txt", ".tsv", ".dat", ".asc"), _is_csv
    ),
)


def read(
    path: str | Path,
    messages: Collection[str] | None = None,
    columns: Mapping[str, str] | None = None,
) -> Recording:
    """Read a flight log or a table of measured signals, whatever its format.

    Parameters
    ----------
    path : str or Path
        ArduPilot DataFlash (.BIN, text .log), MAVLink telemetry (.tlog), PX4 (.ulg), CSV, HDF5 or
        MATLAB (.mat). The contents decide; the suffix only where they are ambiguous.
    messages : collection of str, optional
        Read only these, e.g. ``("ATT", "RATE")``; all by default.
    columns : mapping of str to str, optional
        Of a table whose own names do not say what is in it, by new name: the column and, behind a
        colon, its unit, ``{"time": "t:ms", "theta": "pitch:deg"}``. Columns without names, in a
        file without a header line or in the one matrix of a MATLAB file, go by their numbers:
        ``{"time": "1", "u": "2", "theta": "3:deg"}``.

    Returns
    -------
    Recording
        A `Record` for every kind of message: times in s, values and units as in the log.

    Raises
    ------
    FileNotFoundError, OSError
        If there is no such file, or it cannot be opened.
    ValueError
        If it is of no known format, or nothing in it can be read.
    """
    path = Path(path)
    wanted = (messages,) if isinstance(messages, str) else messages
    reader = import_module(f"greybox.logs.readers.{_format(path).module}")
    try:
        if columns is None:
            return reader.read(path, wanted)
        numbered = {"numbered": True} if "numbered" in signature(reader.read).parameters else {}
        return with_columns(reader.read(path, wanted, **numbered), columns)
    except ValueError as refused:
        raise ValueError(printable(str(refused))) from None  # it may quote the file


def _format(path: Path) -> Format:
    head = _head(path)
    for known in FORMATS:
        if known.recognizes(head):
            return known
    for known in FORMATS:
        if path.suffix.lower() in known.suffixes:
            return known
    kinds = "; ".join(f"{known.about} ({', '.join(known.suffixes)})" for known in FORMATS)
    raise ValueError(f"{path} {_looks(head)}, which greybox does not read; supported are: {kinds}.")


def _head(path: Path) -> bytes:
    """Return the first bytes of a file that has some."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: give the log file in it.")
    require_file(path)
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except OSError as problem:
        raise OSError(
            f"{path} cannot be opened ({problem.strerror}): check its permissions."
        ) from None
    if not head:
        raise ValueError(
            f"{path} is empty: logging never started, or the copy failed; copy it again."
        )
    return head


def _looks(head: bytes) -> str:
    """Say in words what a file looks like."""
    known = {
        b"PK": "a zip archive",
        b"\x1f\x8b": "a gzip archive",
        b"%PDF": "a PDF",
        b"\x89PNG": "a PNG image",
    }
    for start, what in known.items():
        if head.startswith(start):
            return f"looks like {what}"
    if _is_text(head):
        return f"looks like text that starts with {head[:30].decode('utf-8', 'replace').strip()!r}"
    return f"looks like binary data that start with {head[:4].hex(' ')}"
