"""A test signal to be flown: its samples and its maneuvers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, NamedTuple

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.data.record import NOT_STORED, Record


class Maneuver(NamedTuple):
    """One sine, sweep or multisine of an excitation, as planned.

    `start`, `settled` and `end` are times in s; the analysis begins at `settled`. `low` and `high`
    are angular frequencies in rad/s, `amplitude` and `offset` are in the unit of the signal.
    """

    signal: str
    kind: str
    start: float
    settled: float
    end: float
    low: float
    high: float
    amplitude: float
    offset: float


@public
@frozen
class Excitation(Record):
    """A test signal to be flown, or several at once: a `Record` with its schedule.

    Attributes
    ----------
    schedule : tuple of Maneuver
    settings : mapping
        Parameters of the signal; for a multisine also its ``harmonics`` (name to multiples of
        2π / ``period``).
    """

    schedule: tuple[Maneuver, ...] = field(default=(), metadata=NOT_STORED)
    settings: Mapping[str, Any] = field(default_factory=dict, metadata=NOT_STORED)

    @property
    def peak_factors(self) -> dict[str, float]:
        """Morelli's relative peak factors: peak to peak over 2√2 σ, so that a sine has 1."""
        factors = {}
        for name, values in self.signals.items():
            factors[name] = float(np.ptp(values) / (2 * math.sqrt(2) * np.std(values)))
        return factors

    def __str__(self) -> str:
        kinds = sorted({maneuver.kind for maneuver in self.schedule})
        low = min(maneuver.low for maneuver in self.schedule)
        high = max(maneuver.high for maneuver in self.schedule)
        factors = ", ".join(f"{value:.2f}" for value in self.peak_factors.values())
        return (
            f"{', '.join(kinds)} on {', '.join(self.signals)}: {self.time.size / self.rate:.1f} s "
            f"at {self.rate:g} Hz, {low:.4g} to {high:.4g} rad/s, peak factor {factors}"
        )


def checked_band(omega: Sequence[float], rate: float) -> Array:
    """Return the frequencies, rad/s; ValueError if one is not above 0 and far below the rate."""
    values = np.asarray(omega, dtype=float)
    # With five samples per period a held signal has 94 % of the amplitude.
    limit = math.tau * rate / 5
    bad = values[~((values > 0) & (values <= limit))]
    if values.size == 0 or bad.size:
        raise ValueError(
            f"omega is {f'{bad[0]:g} rad/s' if bad.size else 'empty'}: give frequencies above 0 "
            f"and up to {limit:.4g} rad/s, a fifth of the sampling rate of {rate:g} Hz, or raise "
            "the rate."
        )
    return values


def round_up(value: float) -> int:
    """Round up, except for rounding errors."""
    return math.ceil(value - 1e-9)
