"""MATLAB files (.mat) up to version 7: vectors with a time, and structs of them. 7.3 is HDF5."""

from collections.abc import Collection, Mapping
from pathlib import Path

from greybox.data.record import Recording
from greybox.logs.readers import named_arrays


def read(
    path: str | Path,
    messages: Collection[str] | None = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Read every struct that has a time into a record, and the workspace if it has one.

    The time is named time, t, tout or timestamp, or has its unit in the name (``time_ms``), see
    `greybox.data.time_column`; without it, ``Ts`` is the sampling interval, s. Matrices with one
    sample per row give one signal per column. A record has the name of its struct (``flight/att``),
    that of the workspace the name of the file. Simulink's "structure with time" is read, too. Units
    are unknown.

    Parameters
    ----------
    path : str or Path
    messages : collection of str, optional
        Structs to read; all by default.
    stated : mapping of str to str, optional
        Variables of the only struct by new name, see `greybox.logs.read`.
    rate : float, Hz, optional
        The sampling rate where there is neither a time vector nor an interval ``Ts``.

    Returns
    -------
    Recording
        The findings name the timetables and other objects, which only MATLAB can read: save them as
        structs.

    Raises
    ------
    ValueError
        If the file is damaged, or nothing in it has a time vector.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    contents = named_arrays.read_contents("matlab", path)
    return named_arrays.recording(path, contents, messages, None, stated, rate)
