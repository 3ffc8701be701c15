"""A test signal to be flown: its samples and its maneuvers."""

import math
from collections.abc import Sequence
from dataclasses import field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from greybox.data.record import Record
from greybox.files.arrays import Array, Named, NamedArrays, NamedStrings, Values, frozen
from greybox.files.text_table import one_line

NOTHING: Values = MappingProxyType({})  # where no noise, limit or start is given


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


@frozen
class Excitation:
    """A test signal to be flown, or several at once.

    Attributes
    ----------
    time : (n,) array, s, from 0 and uniform
    signals : mapping of name to (n,) array
    units : mapping of name to str
    rate : float, Hz
    schedule : tuple of Maneuver
    settings : mapping
        Parameters of the signal; for a multisine also its ``harmonics`` (name to multiples of
        2π / ``period``).
    """

    time: Array
    signals: NamedArrays
    units: NamedStrings
    rate: float
    schedule: tuple[Maneuver, ...]
    settings: Named = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        # Plans and records share these arrays.
        for values in (self.time, *self.signals.values()):
            values.setflags(write=False)
        for name in ("signals", "units", "settings"):
            vars(self)[name] = MappingProxyType(dict(getattr(self, name)))

    def __getitem__(self, name: str) -> Array:
        if name not in self.signals:
            raise KeyError(
                f"the excitation has no signal {name!r}; it has {', '.join(self.signals)}."
            )
        return self.signals[name]

    @property
    def peak_factors(self) -> dict[str, float]:
        """Morelli's relative peak factors: peak to peak over 2√2 σ, so that a sine has 1."""
        return {
            name: float(np.ptp(v) / (2 * math.sqrt(2) * np.std(v)))
            for name, v in self.signals.items()
        }

    def record(self) -> Record:
        """Return the signals as a `Record`, e.g. for a simulation."""
        return Record(
            self.time,
            self.signals,
            self.units,
            name="excitation",
            metadata={"schedule": self.schedule},
        )

    def __repr__(self) -> str:
        return one_line(
            self, ", ".join(self.signals), f"{self.time.size / self.rate:.4g} s at {self.rate:g} Hz"
        )

    def __str__(self) -> str:
        kinds = sorted({maneuver.kind for maneuver in self.schedule})
        low, high = min(s.low for s in self.schedule), max(s.high for s in self.schedule)
        factors = ", ".join(f"{value:.2f}" for value in self.peak_factors.values())
        return (
            f"{', '.join(kinds)} on {', '.join(self.signals)}: {self.time.size / self.rate:.1f} s "
            f"at {self.rate:g} Hz, {low:.4g} to {high:.4g} rad/s, peak factor {factors}"
        )


def checked_band(omega: Sequence[float], rate: float) -> Array:
    """Return the frequencies, rad/s; ValueError if one is not above 0 and far below the rate."""
    values = np.asarray(omega, dtype=float)
    # With five samples per period a held signal has 94 % of the amplitude.
    limit = 2 * math.pi * rate / 5
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
