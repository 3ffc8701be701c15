"""Records and responses as pandas data frames, and back; `pip install 'greybox-id[pandas]'`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.checked_array import checked_array
from greybox.data.dates import seconds_from_first
from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.column_headings import heading
from greybox.data.files.named_values import non_empty
from greybox.data.files.optional_package import required
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
    """Raise TypeError for anything but a data frame, ValueError for equal column names."""
    # By its attributes, so that pandas need not be imported.
    if not hasattr(frame, "columns") or not hasattr(frame, "attrs"):
        raise TypeError(f"frame is {frame!r:.60}: give a pandas.DataFrame.")
    names = list(map(str, frame.columns))
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"the data frame has two columns {twice[0]!r}: rename or drop one.")


def columns_of(frame: Frame, without: str = "") -> Mapping[str, Array]:
    """Return the columns of a data frame as numbers, by name, without the time column.

    Raises
    ------
    ValueError
        If a column does not contain numbers.
    """
    result = {}
    # By position: a name may be a number, and was made a text.
    for position, name in enumerate(map(str, frame.columns)):
        if name == without:
            continue
        column = frame.iloc[:, position]
        if column.dtype.kind not in "biuf":
            raise ValueError(
                f"the column {name!r} of the data frame does not contain numbers: drop or convert "
                "it."
            )
        result[name] = column.to_numpy(dtype=float, na_value=np.nan)

    return result


def times_of(frame: Frame, time: str | None) -> tuple[Array, str, tuple[str, ...]]:
    """Return the times of a data frame in s, the column that they come from, and findings.

    The index is the time if it has dates, the name of a time column, or floating-point numbers.

    Raises
    ------
    ValueError
        If neither a column nor the index is a time.
    """
    names = list(map(str, frame.columns))
    if time is not None and time not in names:
        raise ValueError(f"the data frame has no column {time!r}; it has {', '.join(names)}.")
    # Whole numbers count the rows, as after a selection; they are not times.
    index = frame.index
    is_time = index.dtype.kind in "mMf" or seconds(*heading(str(index.name)))
    column = time or next((name for name in names if seconds(*heading(name))), "")
    if time is None and is_time:
        values = index
        name = str(index.name)
        column = ""
    elif column:
        values = frame.iloc[:, names.index(column)]
        name = column
        # The array of a column knows its time zone, the column itself does not.
        values = values.array if values.dtype.kind == "M" else values
    else:
        raise ValueError(
            "the data frame has no time: name it, time='COLUMN', or its index, in s or as dates; "
            "or state that its rows have none, has_time=False."
        )
    if values.dtype.kind in "mM":
        return seconds_from_first(values), column, ()

    times = checked_array(f"the time {name!r} of the data frame", values.to_numpy())
    label, unit = heading(name)
    times, findings = times_in_seconds(label, unit, times)

    return times, column, findings
