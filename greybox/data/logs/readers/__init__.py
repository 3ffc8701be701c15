"""Readers of flight logs, one file for each format; the contents of a log choose, then its suffix.

Begin with `FORMATS` and `read` below. A reader is a module with ``read(path, messages=None) ->
Recording``. It is imported when a file of its format is read, so that `greybox.data.logs.readers`
itself loads neither pymavlink nor h5py nor scipy.

| file | contents |
| --- | --- |
| `dataflash` | ArduPilot logs, binary |
| `dataflash_index` | positions of the messages in an ArduPilot log |
| `dataflash_layout`, `dataflash_units` | layouts and units of its messages |
| `dataflash_text` | ArduPilot logs, text |
| `ardupilot_metadata` | vehicle, firmware, parameters and modes of ArduPilot logs |
| `telemetry` | MAVLink telemetry logs |
| `telemetry_packets`, `telemetry_metadata` | their packets; vehicle, parameters and modes |
| `ulog` | PX4 logs |
| `crazyflie` | logs of a Crazyflie's memory card |
| `csv_table` | tables as text |
| `betaflight` | tables of Betaflight's blackbox |
| `named_arrays` | HDF5 and MATLAB files, and records of the groups in them and in PX4 logs |
| `table_columns` | the time column, the units and the holds of a table |
| `messages` | messages of one type, and the records made of them |
| `time_stamps` | clock restarts, impossible and repeated stamps, gaps |
| `controller_outputs` | signals that a controller holds |
| `other_formats` | files of other kinds, and what makes a table of them |
| `sample_times` | when a sensor was sampled, where a log has this time |
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import NamedTuple

from greybox.data.clock import Gaps, require_gaps
from greybox.data.files.argument_checks import is_finite_number
from greybox.data.files.escapes import in_sentences
from greybox.data.files.public import public
from greybox.data.files.safe_files import require_file
from greybox.data.logs.readers.other_formats import other_format
from greybox.data.record import Recording

HEAD = 4096  # bytes by which a format is recognized


class Format(NamedTuple):
    """One format: its module, its name, its usual suffixes, and a test of a file's first bytes."""

    module: str
    about: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[bytes], bool]

    def __str__(self) -> str:
        return f"{self.about} ({', '.join(self.suffixes)})" if self.suffixes else self.about


def _is_telemetry(head: bytes) -> bool:
    """Return whether a time of this century in µs comes first, then a MAVLink packet."""
    microseconds = int.from_bytes(head[:8], "big")
    is_this_century = 946_684_800_000_000 < microseconds < 4_102_444_800_000_000
    return len(head) > 8 and is_this_century and head[8] in b"\xfe\xfd"


def _is_csv(head: bytes) -> bool:
    """Return whether it is text of two lines or more, with a separator in the first."""
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
    Format(
        "dataflash", "ArduPilot DataFlash, binary", (".bin",), lambda h: h.startswith(b"\xa3\x95")
    ),
    Format("ulog", "PX4 ULog", (".ulg",), lambda h: h.startswith(b"ULog\x01\x12\x35")),
    # The card's files have no suffix. Its version is 1 or 2, in 2 bytes.
    Format(
        "crazyflie",
        "the card log of a Crazyflie",
        (),
        lambda h: h.startswith((b"\xbc\x01\0", b"\xbc\x02\0")),
    ),
    Format(
        "named_arrays",
        "HDF5 or MATLAB",
        (".h5", ".hdf5", ".hdf", ".mat"),
        # MATLAB 7.3 has a text before the signature of HDF5.
        lambda h: b"\x89HDF\r\n\x1a\n" in h or h.startswith(b"MATLAB 5.0 MAT-file"),
    ),
    Format("telemetry", "MAVLink telemetry", (".tlog",), _is_telemetry),
    Format(
        "dataflash_text",
        "ArduPilot DataFlash, text",
        (".log",),
        lambda h: b"FMT," in h and b"\0" not in h,
    ),
    Format(
        "csv_table", "a table with a header line", (".csv", ".txt", ".tsv", ".dat", ".asc"), _is_csv
    ),
)


@public
@in_sentences
def read(
    path: str | Path,
    messages: Collection[str] | None = None,
    columns: Mapping[str, str] | None = None,
    rate: float | None = None,
    gaps: Gaps = "auto",
) -> Recording:
    """Read a flight log or a table of measured signals, whatever its format.

    Parameters
    ----------
    path : str or Path
        ArduPilot DataFlash (.BIN, text .log), MAVLink telemetry (.tlog), PX4 (.ulg),
        Crazyflie (card log), CSV, HDF5 or MATLAB (.mat). The contents decide; the suffix only where
        they are ambiguous.
    messages : collection of str, optional
        Read only these, e.g. ``("ATT", "RATE")``; all by default.
    columns : mapping of str to str, optional
        Columns of a table whose own names do not say what is in it: by new name, the column and,
        after a colon, its unit, ``{"time": "t:ms", "theta": "pitch:deg"}``. These signals are in SI
        then; the others stay as they are, see `Record.in_si`. A column that has another name in
        another file has both, ``"pitch:deg,Theta:rad"``. The columns of a file without a header
        line go by their numbers: ``{"time": "1", "u": "2", "theta": "3:deg"}``.
    rate : float, Hz, optional
        The sampling rate of a table without a time.
    gaps : "auto", "bridge" or "cut", optional
        What long steps of the clock are: "bridge" where the inputs are known across them, "cut"
        where rows are lost, see `Record`.

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

    Examples
    --------
    >>> from greybox.problems import sitl_pitch
    >>> log = gb.read(sitl_pitch.LOG)  # a part of a simulated flight, included with greybox
    >>> log
    <Recording 'sitl_pitch.BIN', 7 messages, MODE, ATT, RATE, EV, ARM, VER, SINE>
    """
    if rate is not None and not (is_finite_number(rate) and rate > 0):
        raise ValueError(f"rate={rate!r} must be a number of Hz above 0.")
    require_gaps(gaps)
    path = require_file(path)
    names = (messages,) if isinstance(messages, str) else messages
    kind = _format(path)
    reader = import_module(f"greybox.data.logs.readers.{kind.module}")
    if not columns and rate is None:
        table_options = {}
    elif "stated" in signature(reader.read).parameters:
        table_options = {"stated": columns, "rate": rate}
    else:
        raise ValueError(f"{path} is a log ({kind.about}): columns and rate are those of a table.")
    log = reader.read(path, names, **table_options)
    if gaps != "auto":
        log = replace(log, records={n: replace(record, gaps=gaps) for n, record in log.items()})
    if not columns:
        return log
    # The readers of tables refuse more than one when columns are named, apart from its instances.
    in_si = {}
    for name, record in log.items():
        in_si[name] = record.in_si([key for key in columns if key in record.signals])
    return replace(log, records=in_si)


def _format(path: Path) -> Format:
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

    if other := other_format(path, head):
        raise ValueError(f"{path} {other}")
    # The contents decide: logs are renamed and sent around.
    suited = [format_ for format_ in FORMATS if format_.recognizes(head)]
    suited += [format_ for format_ in FORMATS if path.suffix.lower() in format_.suffixes]
    if suited:
        return suited[0]
    kinds = "; ".join(map(str, FORMATS))
    raise ValueError(f"{path} {_looks(head)}, which greybox does not read; supported are: {kinds}.")


def _looks(head: bytes) -> str:
    """Return a description of a file's contents."""
    if _is_text(head):
        return f"looks like text that starts with {head[:30].decode('utf-8', 'replace').strip()!r}"

    return f"looks like binary data that start with {head[:4].hex(' ')}"
