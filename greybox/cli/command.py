"""What the commands of the command line share: the form of an answer, exit statuses, and numbers in JSON."""

import math
from typing import Any

Answer = tuple[dict[str, Any], str, int]
"""The JSON object, the text for a person, and the exit status."""

USABLE, FAILED, BAD_INPUT = 0, 1, 2


def known(value: float) -> float | None:
    """Return a number as JSON has it: None for what is not finite."""
    return float(value) if math.isfinite(value) else None
