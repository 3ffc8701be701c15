"""Values for JSON, which has neither NaN nor infinity; values of JSON, bounded in memory."""

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any


def finite(value: float) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def plain(value: Any) -> Any:
    """Return a value for JSON: dataclasses by stored field, arrays as lists, None for NaN."""
    if isinstance(value, str | int | Path | None):  # most values
        return str(value) if isinstance(value, Path) else value
    if isinstance(value, float):
        return finite(value)
    if is_dataclass(value):
        stored = [field.name for field in fields(value) if field.metadata.get("stored", True)]
        return {name: plain(getattr(value, name)) for name in stored}
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if hasattr(value, "tolist"):  # numpy, which help and version do not import
        return plain(value.tolist())
    return [*map(plain, value)] if isinstance(value, list | tuple) else value


# Values of JSON for every byte that they take in a file, and of small files. Fits that are stored
# compressed have at most 0.3. An object takes 250 bytes of memory at most, see SECURITY.md.
DENSITY, FEW = 1.0, 1000


def parsed(text: bytes, stored: int) -> Any:
    """Return the values of a JSON text that takes `stored` bytes of a file.

    Raises
    ------
    ValueError
        If it is no JSON, or has more values than a text of this size may have: as objects of
        Python they would take any memory.
    """
    # Before anything is parsed: every value but the first follows a comma or an opening bracket.
    # The commas of texts are counted, too, and are few.
    count = 1 + sum(map(text.count, (b",", b"[", b"{")))
    if count > DENSITY * stored + FEW:
        raise ValueError(f"it has {count} values in {stored} bytes, which is too many")
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deep") from None
