"""Units of clocks that state none: how often they are right, asked for, or wrong.

python benchmarks/clock_units.py

A table has a column `timestamp` or `time`, which counts s, ms, µs or ns at 0.2 Hz to 1 kHz for 1 s
to 20 minutes, from the start of the log or some time after the logger was switched on. Seconds
have digits behind the point, other ticks are whole. Then each constant of the rule has a tenth and
ten times its value.
"""

import itertools
import sys
from collections import Counter
from datetime import date
from importlib.metadata import version

import numpy as np

from greybox.data import time_column

TICKS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
RATES = (0.2, 1, 5, 10, 25, 50, 100, 250, 1000)  # Hz
LENGTHS = (1, 3, 10, 30, 100, 300, 1200)  # s
STARTS = (0, 3, 20, 112, 600, 5000)  # s after the logger was switched on
CONSTANTS = {
    "USUAL, lowest": lambda factor: {"USUAL": (factor * 0.1, 5e4)},
    "USUAL, highest": lambda factor: {"USUAL": (0.1, factor * 5e4)},
    "SHORTEST": lambda factor: {"SHORTEST": factor * 0.3},
    "LATEST": lambda factor: {"LATEST": factor * 12 * 3600.0},
}


def outcomes(name: str) -> Counter[str]:
    """Return how many clocks of this name are right, asked for and wrong."""
    counts = Counter[str]()
    for rate, length, start, unit in itertools.product(RATES, LENGTHS, STARTS, TICKS):
        exact = start + np.arange(0.0, length, 1 / rate)
        if exact.size < 3:
            continue
        stamps = TICKS[unit] * exact if unit == "s" else np.round(TICKS[unit] * exact)
        # Rows at equal times are another question.
        if not np.all(np.diff(stamps) > 0):
            continue
        try:
            time, _ = time_column.times_in_seconds(name, "", stamps)
        except ValueError:
            counts["asked for"] += 1
            continue
        is_right = abs(np.ptp(time) / np.ptp(exact) - 1) < 0.1
        counts["right" if is_right else "wrong"] += 1
    return counts


def line(label: str) -> str:
    """Return the outcomes of both names in words."""
    parts = [f"{label:26}"]
    for name in ("timestamp", "time"):
        counts = outcomes(name)
        shares = [f"{counts[key]:4d} {key}" for key in ("right", "asked for", "wrong")]
        parts.append(f"{name} {', '.join(shares)}")
    return "   ".join(parts)


def main() -> None:
    """Print the outcomes, with the constants as they are and with others."""
    python = ".".join(map(str, sys.version_info[:3]))
    print(f"{date.today()}, greybox-id {version('greybox-id')}, python {python}")
    print(line("as it is"))
    for label, changed in CONSTANTS.items():
        for factor in (0.1, 10.0):
            before = {name: getattr(time_column, name) for name in changed(factor)}
            vars(time_column).update(changed(factor))
            print(line(f"{label}, times {factor:g}"))
            vars(time_column).update(before)


if __name__ == "__main__":
    main()
