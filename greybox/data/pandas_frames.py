"""Records and responses as pandas data frames, and back; `pip install 'greybox-id[pandas]'`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array
from greybox.files.optional_package import required

SECOND = np.timedelta64(1, "s")

Frame = Any
"""A `pandas.DataFrame`; pandas is imported when it is first needed."""


def pandas(what: str) -> Any:
    """Return the package, or raise ModuleNotFoundError with the extra that installs it; `what` needs it."""
    return required("pandas", "pandas", what)


def frame_of(
    columns: Mapping[str, Sequence[Any] | NDArray[Any]],
    index: Any,
    index_name: str,
    attributes: Mapping[str, Any],
) -> Frame:
    """Return a data frame with an index of this name; what pandas has no place for stands in its `attrs`."""
    pd = pandas("to_pandas()")
    frame = pd.DataFrame(dict(columns), index=pd.Index(index, name=index_name))
    frame.attrs.update({name: value for name, value in attributes.items() if value})
    return frame


def columns_of(frame: Frame) -> dict[str, Array]:
    """Return the columns of a data frame as numbers, by name.

    Raises
    ------
    TypeError
        If it is no data frame.
    ValueError
        If two columns have one name, or a column is not one of numbers.
    """
    if not hasattr(frame, "columns") or not hasattr(frame, "attrs"):
        raise TypeError(f"frame is {frame!r:.60}: give a pandas.DataFrame.")
    names = [str(name) for name in frame.columns]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"the data frame has two columns {twice[0]!r}: rename or drop one.")
    result = {}
    for position, name in enumerate(names):
        try:
            result[name] = frame.iloc[:, position].to_numpy(dtype=float, na_value=np.nan)
        except (TypeError, ValueError):
            raise ValueError(
                f"the column {name!r} of the data frame is not one of numbers: drop or convert it."
            ) from None
    return result


def seconds_of(index: Any, name: str) -> Array:
    """Return an index as times in s: numbers are seconds, dates and time differences count from the first.

    Raises
    ------
    ValueError
        For anything else.
    """
    values = np.asarray(index)
    if np.issubdtype(values.dtype, np.datetime64) or np.issubdtype(values.dtype, np.timedelta64):
        return (values - values[:1]) / SECOND
    if getattr(index, "tz", None) is not None:  # dates with a time zone are objects in numpy
        return seconds_of(index.tz_convert("UTC").tz_localize(None), name)
    try:
        return values.astype(float)
    except (TypeError, ValueError):
        raise ValueError(
            f"the {name} of the data frame holds no times: give seconds, or dates."
        ) from None
