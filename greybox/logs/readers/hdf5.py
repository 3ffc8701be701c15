"""HDF5 files (.h5), and MATLAB 7.3 files, which are HDF5: groups of vectors with a time vector."""

from collections.abc import Collection, Mapping
from pathlib import Path

from greybox.data.record import Recording
from greybox.files.arrays import Array
from greybox.logs.readers import named_arrays


def read(
    path: str | Path,
    messages: Collection[str] | None = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Read every group that has a time vector into a record.

    A group has one record: a dataset ``time`` (or t, timestamp, time_ms ...; see
    `greybox.data.time_column`), and vectors of the same length. Matrices with one sample per row
    (as MATLAB shows them, in MATLAB's files) give one signal per column. Units are attributes
    ``unit`` or ``units`` of the datasets, followed by the word held or sampled if it is known how
    the signal runs between its samples. A record has the name of its group (``flight/ATT``), at the
    root that of the file.

    Parameters
    ----------
    path : str or Path
    messages : collection of str, optional
        Groups to read; all by default.
    stated : mapping of str to str, optional
        Columns of the only group by new name, see `greybox.logs.read`.
    rate : float, Hz, optional
        The sampling rate where there is no time vector.

    Returns
    -------
    Recording

    Raises
    ------
    ValueError
        If the file is damaged, or no group has a time vector.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    # MATLAB 7.3 puts a text before the HDF5 part of its files.
    with open(path, "rb") as file:
        matlab = file.read(6) == b"MATLAB"
    contents = named_arrays.read_contents("hdf5", path)
    rows = [
        variable._replace(values=_rows(variable.values, matlab)) for variable in contents.variables
    ]

    return named_arrays.recording(
        path, contents._replace(variables=rows), messages, None, stated, rate
    )


def _rows(values: Array, matlab: bool) -> Array:
    """Return an array with the samples in rows: MATLAB stores matrices transposed."""
    if values.ndim == 2 and 1 in values.shape:
        return values.ravel()
    return values.T if matlab else values
