"""Whether other gains make a loop worse than today's: sensitivity, moments and noise."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import listed

ROUNDING = 1e-6  # of a ratio, with the same gains on both sides
SENSITIVITY = "peak |S|"


@dataclass(frozen=True)
class GainChange:
    """A number of the loop that should be small, with today's gains and with others.

    Attributes
    ----------
    name : str
    today, changed : float
        At the estimate; infinite for an unstable loop.
    ratio : float
        Of the changed number over today's, at the estimate. NaN if today's loop is unstable.
    low, high : float
        Ends of the interval of the ratio. Both numbers of a ratio are those of the same plant, so
        that errors which the two loops share cancel. NaN if the data do not determine the ratio.
    """

    name: str
    today: float
    changed: float
    ratio: float
    low: float
    high: float

    @property
    def is_not_worse(self) -> bool:
        """Whether the number is at most today's, at the estimate and in the whole interval."""
        return self.ratio <= 1 + ROUNDING and self.high <= 1 + ROUNDING

    @property
    def judgement(self) -> str:
        """Return "worse", "may be worse" or "not worse"."""
        if self.is_not_worse:
            return "not worse"
        return "worse" if self.low > 1 else "may be worse"


@frozen
class GainComparison(Printed):
    """A set of gains against today's gains, with the same plants. It prints itself as a table.

    Attributes
    ----------
    gains : mapping of gain to float
    bandwidth, today_bandwidth : float, rad/s
        The lowest disturbance rejection bandwidth of the estimates; NaN where an estimate does not
        meet the requirements.
    changes : tuple of GainChange
        Peak of the sensitivity (a factor), peak response to a step moment, and noise at the
        actuator: of several flights, that with the highest end of the interval.
    level : float
    """

    gains: Values
    bandwidth: float
    today_bandwidth: float
    changes: tuple[GainChange, ...]
    level: float

    def __getitem__(self, name: str) -> GainChange:
        """Return a change by its name, such as "peak |S|"."""
        for change in self.changes:
            if change.name == name:
                return change
        raise KeyError(f"there is no {name!r}; there are {listed([c.name for c in self.changes])}.")

    @property
    def today_is_stable(self) -> bool:
        """Whether the estimates are stable with today's gains: if not, nothing can be compared."""
        return all(math.isfinite(change.today) for change in self.changes)

    @property
    def worse(self) -> tuple[str, ...]:
        """What is worse than today, or may be."""
        return tuple(change.name for change in self.changes if not change.is_not_worse)

    def __str__(self) -> str:
        rows = [_printed(change) for change in self.changes]
        pair = [number(value, 3) for value in (self.today_bandwidth, self.bandwidth)]
        rows.append(("disturbance rejection bandwidth, rad/s", *pair, "", ""))
        label = ", ".join(f"{name} = {value:.4g}" for name, value in self.gains.items())
        kind = "refused" if self.worse else "proposed"
        header = (label, "today", kind, f"change ({100 * self.level:g} % interval)", "")
        return text_table(header, rows, left=(0, 4))


def _printed(change: GainChange) -> tuple[str, ...]:
    """Return a row: the peak of the sensitivity in dB, other numbers relative to today's."""
    is_sensitivity = change.name == SENSITIVITY
    shown = [change.ratio, change.low, change.high]
    if is_sensitivity:
        shown = [_decibels(value) for value in shown]
        pair = [number(_decibels(value), 3) for value in (change.today, change.changed)]
    else:
        shown = [100 * (value - 1) for value in shown]
        pair = ["1", number(change.ratio, 3)]
    # Equal numbers differ by rounding, of which nobody wants to read three digits.
    shown = [v if math.isinf(v) or math.isnan(v) else round(v, 4) for v in shown]
    value, low, high = (f"{'+' if v > 0 else ''}{number(v + 0.0, 3)}" for v in shown)
    unit = "dB" if is_sensitivity else "%"
    interval = f"({low} to {high})" if not math.isnan(change.high) else "(not determined)"
    name = f"{change.name}, {'dB' if is_sensitivity else 'relative'}"
    return (name, *pair, f"{value} {unit} {interval}", change.judgement)


def _decibels(factor: float) -> float:
    if factor == 0:
        return -math.inf
    return 20 * math.log10(factor)


def worst_changes(flights: Sequence[Sequence[GainChange]]) -> tuple[GainChange, ...]:
    """Return the change of every number in the flight in which it is or may be worst."""
    by_name: dict[str, list[GainChange]] = {}
    for change in (change for changes in flights for change in changes):
        by_name.setdefault(change.name, []).append(change)
    return tuple(max(changes, key=_badness) for changes in by_name.values())


def _badness(change: GainChange) -> tuple[float, ...]:
    return tuple(math.inf if math.isnan(v) else v for v in (change.high, change.ratio))
