"""Dates and times of day as seconds."""

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array

# What a column of text holds, in place of a unit.
SINCE_1970 = "s since 1970"
OF_DAY = "s of the day"

# 10:00:01.25 and 10:00:01,25 and 10:00:01:250, 00:01.5, 1:05:00 PM, 0 days 00:00:01
TIME = re.compile(
    r"(?:(?P<days>\d{1,6}) days?,? )?"
    r"(?:(?P<hours>\d{1,6}):)?(?P<minutes>\d{1,2}):(?P<seconds>\d{1,2})"
    r"(?:[.,:](?P<fraction>\d{1,15}))?(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
)
OFFSET = re.compile(r"(Z| ?UTC| ?[+-]\d\d:?\d\d)$")
DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})")


def seconds_from_first(values: Any) -> Any:
    """Return dates and time differences in s from the first one; anything else as it is."""
    if getattr(values, "tz", None) is not None:  # numpy has dates with a time zone as objects
        values = values.tz_convert("UTC").tz_localize(None)
    if getattr(getattr(values, "dtype", None), "kind", "") not in ("M", "m"):
        return values
    array = np.asarray(values)
    # A slice, because an empty array has no first value.
    return (array - array[:1]) / np.timedelta64(1, "s")


def seconds_in_texts(cells: Sequence[str]) -> tuple[Array, str] | None:
    """Return times (n,) in s from texts, and `SINCE_1970` or `OF_DAY`; None for other texts.

    Dates are those of ISO 8601, also with slashes, or day.month.year. Empty texts are NaN.
    """
    filled = [cell.strip() for cell in cells if cell.strip()]
    if not filled or not filled[0][0].isdigit():
        return None
    if all(map(TIME.fullmatch, filled)):
        # 10:05 alone may be hours and minutes, or minutes and seconds.
        if all(re.fullmatch(r"\d+:\d+", cell) for cell in filled):
            return None
        values = [_of_day(cell.strip()) if cell.strip() else np.nan for cell in cells]
        return np.array(values), OF_DAY

    offsets = {match[0] if (match := OFFSET.search(cell[10:])) else "" for cell in filled}
    if len(offsets) > 1:
        return None
    texts = [OFFSET.sub("", cell.strip()) if cell[10:] else cell.strip() for cell in cells]
    texts = [DAY_FIRST.sub(_year_first, text).replace("/", "-").replace(",", ".") for text in texts]
    with warnings.catch_warnings():
        # numpy warns of what looks like a time zone in other texts.
        warnings.simplefilter("error")
        try:
            dates = np.array([text or "NaT" for text in texts], "datetime64[ns]")
        except (ValueError, UserWarning):
            return None
    return np.where(np.isnat(dates), np.nan, dates.astype(np.int64) / 1e9), SINCE_1970


def _of_day(text: str) -> float:
    match = TIME.fullmatch(text)
    assert match is not None
    hours = int(match["hours"] or 0)
    if match["half"]:
        hours = hours % 12 + 12 * (match["half"].lower() == "p")
    minutes = 24 * 60 * int(match["days"] or 0) + 60 * hours + int(match["minutes"])
    return 60 * minutes + float(f"{match['seconds']}.{match['fraction'] or 0}")


def _year_first(match: re.Match[str]) -> str:
    return f"{match[3]}-{int(match[2]):02d}-{int(match[1]):02d}"
