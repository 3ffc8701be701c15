"""Records and responses as pandas data frames, and back; `pip install 'greybox-id[pandas]'`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.checked_array import checked_array
from greybox.data.dates import seconds_from_first
from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.named_values import non_empty
from greybox.data.files.optional_package import required
from greybox.data.headings import heading, headings
from greybox.data.time_column import seconds, times_in_seconds

Frame = Any
"""A `pandas.DataFrame`; pandas is imported when it is first needed."""


def frame_of(
    columns: Mapping[str, Sequence[Any] | AnyArray],
    index: Any,
    index_name: str,
    attributes: Mapping[str, Any],
) -> Frame:
    """Return a data frame with an index of this name; copies of `attributes` are its `attrs`."""
    pd = required("pandas", "pandas", "to_pandas()")
    frame = pd.DataFrame(dict(columns), index=pd.Index(index, name=index_name))
    for name, value in non_empty(attributes).items():
        frame.attrs[name] = dict(value) if isinstance(value, Mapping) else value
    return frame


def require_frame(frame: Frame) -> None:
    """Raise TypeError for anything but a data frame."""
    # By its attributes, so that pandas need not be imported.
    if not hasattr(frame, "columns") or not hasattr(frame, "attrs"):
        raise TypeError(f"frame is {frame!r:.60}: give a pandas.DataFrame.")


def columns_of(
    frame: Frame, without: int | None = None
) -> tuple[Mapping[str, Array], Mapping[str, str]]:
    """Return the columns of a data frame as numbers, and units, by name, without that of the time.

    Raises
    ------
    ValueError
        If a column does not contain numbers.
    """
    columns = {}
    units = {}
    for place, (name, unit) in enumerate(headings(map(str, frame.columns))):
        if place == without:
            continue
        column = frame.iloc[:, place]
        if column.dtype.kind not in "biuf":
            raise ValueError(
                f"the column {str(frame.columns[place])!r} of the data frame does not contain "
                "numbers: drop or convert it."
            )
        columns[name] = column.to_numpy(dtype=float, na_value=np.nan)
        units[name] = unit

    return columns, units


def times_of(frame: Frame, time: str | None) -> tuple[Array, int | None, tuple[str, ...]]:
    """Return the times of a data frame in s, the place of their column, and findings.

    The time is the index if it has dates or the name of a time, else the column of such a name,
    else an index of floating-point numbers.

    Raises
    ------
    ValueError
        If neither a column nor the index is a time.
    """
    columns = headings(map(str, frame.columns))
    index = frame.index
    named = heading(str(index.name))
    place = None
    if time is not None:
        labels = list(map(str, frame.columns))
        if time not in labels:
            raise ValueError(f"the data frame has no column {time!r}; it has {', '.join(labels)}.")
        place = labels.index(time)
    elif index.dtype.kind not in "mM" and not seconds(*named):
        place = next((k for k, column in enumerate(columns) if seconds(*column)), None)
        # Whole numbers count the rows, as after a selection; they are not times.
        if place is None and index.dtype.kind != "f":
            raise ValueError(
                "the data frame has no time: name it, time='COLUMN', or its index, in s or as "
                "dates; or state that its rows have none, has_time=False."
            )

    values = index
    if place is not None:
        named = columns[place]
        values = frame.iloc[:, place]
        # The array of a column knows its time zone, the column itself does not.
        values = values.array if values.dtype.kind == "M" else values
    if values.dtype.kind in "mM":
        return seconds_from_first(values), place, ()

    times = checked_array(f"the time {str(named)!r} of the data frame", values.to_numpy())
    times, findings = times_in_seconds(*named, times)

    return times, place, findings
