"""Numbers for JSON, which has neither NaN nor infinity."""

import math
from collections.abc import Mapping


def finite(value: float) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def all_finite(values: Mapping[str, float]) -> dict[str, float | None]:
    """Return numbers by name for JSON."""
    return {name: finite(value) for name, value in values.items()}
