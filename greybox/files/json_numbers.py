"""Numbers as JSON has them, in which there is no NaN and no infinity."""

import math
from collections.abc import Mapping


def finite(value: float) -> float | None:
    """Return a number as JSON has it: None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def all_finite(values: Mapping[str, float]) -> dict[str, float | None]:
    """Return numbers by name as JSON has them."""
    return {name: finite(value) for name, value in values.items()}
