"""Records and responses as pandas data frames, and back; `pip install 'greybox-id[pandas]'`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.dates import OF_DAY, SINCE_1970, seconds_from_first, seconds_in_texts
from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.named_values import non_empty
from greybox.data.files.optional_package import required
from greybox.data.headings import Heading, heading, headings
from greybox.data.time_column import TableClock, seconds, table_clock

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


def table_of(
    frame: Frame, time: str | None, *, has_time: bool
) -> tuple[TableClock | None, dict[str, Array], dict[str, str]]:
    """Return the clock of a data frame, its other columns as numbers, and units, by name.

    The time is the index if it has dates or the name of a time, else that of a table, see
    `greybox.data.time_column`, else an index of floating-point numbers. The rows of the columns are
    those of the clock.

    Raises
    ------
    ValueError
        If neither a column nor the index is a time, or if a column does not contain numbers.
    """
    labels = list(map(str, frame.columns))
    if time is not None and time not in labels:
        raise ValueError(f"the data frame has no column {time!r}; it has {', '.join(labels)}.")
    # The names of a record that `to_pandas` wrote are whole.
    own = frame.attrs.get("units", {})
    named = [
        Heading(label, own[label]) if label in own else in_header
        for label, in_header in zip(labels, headings(labels), strict=True)
    ]
    columns = {}
    units = {}
    # By position: a name may be a number, and was made a text.
    for place, (name, unit) in enumerate(named):
        values, from_text = _as_numbers(frame.iloc[:, place])
        if values is not None:
            columns[name], units[name] = values, from_text or unit

    clock = None
    if has_time:
        stated = "" if time is None else named[labels.index(time)].name
        clock = _clock(frame.index, columns, units, stated)
    used = clock.names if clock else ()
    for label, (name, _) in zip(labels, named, strict=True):
        is_number = name in columns and units[name] not in (SINCE_1970, OF_DAY)
        if name not in used and not is_number:
            raise ValueError(
                f"the column {label!r} of the data frame does not contain numbers: drop or convert "
                "it."
            )
    rows = clock.rows if clock else slice(None)
    return clock, {n: x[rows] for n, x in columns.items() if n not in used}, units


def _clock(index: Any, columns: dict[str, Array], units: dict[str, str], stated: str) -> TableClock:
    """Return the clock of a data frame with this index and these columns."""
    heading_of_index = heading("" if index.name is None else str(index.name))
    values, from_text = _as_numbers(index)
    is_clock = from_text or seconds(*heading_of_index)
    of_columns = None if is_clock and not stated else table_clock(columns, units, stated)
    if of_columns:
        return of_columns
    # Whole numbers count the rows, as after a selection; they are not times.
    if values is None or not (is_clock or index.dtype.kind == "f"):
        raise ValueError(
            "the data frame has no time: name it, time='COLUMN', or its index, in s or as dates; "
            "or state that its rows have none, has_time=False."
        )
    name = heading_of_index.name or "the index"
    index_alone = {name: values, **{n: x for n, x in columns.items() if n != name}}
    # An index without the name of a clock is in s.
    unit = from_text or heading_of_index.unit or ("" if is_clock else "s")
    clock = table_clock(index_alone, {name: unit}, name)
    assert clock is not None
    return clock._replace(names=())


def _as_numbers(values: Any) -> tuple[Array | None, str]:
    """Return a column or an index as numbers, and `SINCE_1970` or `OF_DAY` for times, not else.

    Both are empty if it has neither numbers nor times.
    """
    if values.dtype.kind in "biuf":
        return values.to_numpy(dtype=float, na_value=np.nan), ""
    if values.dtype.kind in "mM":
        # The array of a column knows its time zone, the column itself does not.
        return seconds_from_first(getattr(values, "array", values)), SINCE_1970
    if values.dtype.kind == "O" and all(isinstance(value, str) for value in values):
        return seconds_in_texts(list(values)) or (None, "")
    return None, ""
