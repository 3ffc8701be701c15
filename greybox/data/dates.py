"""Dates as seconds."""

from typing import Any

import numpy as np


def seconds_from_first(values: Any) -> Any:
    """Return dates and time differences in s from the first one; anything else as it is."""
    if getattr(values, "tz", None) is not None:  # numpy has dates with a time zone as objects
        values = values.tz_convert("UTC").tz_localize(None)
    if getattr(getattr(values, "dtype", None), "kind", "") not in ("M", "m"):
        return values
    array = np.asarray(values)
    # A slice, because an empty array has no first value.
    return (array - array[:1]) / np.timedelta64(1, "s")
