"""Values for JSON, which has neither NaN nor infinity."""

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
