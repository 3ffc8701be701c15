"""Other gains against today's, number by number: which are better, which are worse."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.json_numbers import plain
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import listed
from greybox.workflows.experiment.sampled_loop import SampledLoop
from greybox.workflows.experiment.simulated_flights import FlightCounts

SMALL = 0.01  # change of a number below which nobody cares
# Units whose differences are shown, and not their ratios
ABSOLUTE = {"dB": " dB", "deg": " deg", "%": " points"}
JUDGEMENTS = ("better", "as good", "may be worse", "worse")
NOTHING_LEFT = 1e-12  # what rounding leaves of the response to an input without effect
ROUNDING = 1e-6  # of a ratio, with the same gains on both sides


@dataclass(frozen=True)
class GainChange:
    """A number of the loop with today's gains and with others.

    Attributes
    ----------
    name, unit : str
    today, today_low, today_high : float
        At the estimate, and the ends of its interval; infinite for an unstable loop. The ends are
        NaN if the data do not determine the number.
    changed, changed_low, changed_high : float
        The same with the other gains.
    worsening : float
        The factor by which the number gets worse, at the estimate: the changed number over
        today's, or the inverse for a number that should be large. Of decibels, the factor that
        they stand for; of an overshoot, that of the peak. NaN if today's loop is unstable.
    low, high : float
        Ends of the interval of this factor. Both numbers are those of the same plant, so that
        errors which the two loops share cancel. All intervals of a comparison hold together.
    """

    name: str
    unit: str
    today: float
    today_low: float
    today_high: float
    changed: float
    changed_low: float
    changed_high: float
    worsening: float
    low: float
    high: float

    @property
    def is_better(self) -> bool:
        """Whether the number is better at the estimate and in the whole interval."""
        return self.worsening < 1 - SMALL and self.high < 1 - SMALL

    @property
    def judgement(self) -> str:
        """Return "better", "as good", "may be worse" or "worse"."""
        if self.is_better:
            return "better"
        if self.worsening <= 1 + SMALL and self.high <= 1 + SMALL:
            return "as good"
        return "worse" if self.low > 1 + SMALL else "may be worse"

    @property
    def difference(self) -> str:
        """The change with its sign: in percent of today's number, or in dB, degrees or points."""
        if math.isinf(self.changed):
            return "infinite"
        if math.isinf(self.today):
            return "finite"
        if self.unit in ABSOLUTE:
            return _signed(self.changed - self.today, ABSOLUTE[self.unit])
        change = self.changed / self.today - 1 if self.today else math.nan
        return _signed(100 * change, " %")


@public
@frozen
class GainComparison(Printed):
    """A set of gains against today's gains, with the same plants. It prints itself as a table.

    Attributes
    ----------
    gains : mapping of gain to float
    objective : GainChange
        What the gains should make small: its numbers are relative to today's estimate.
    changes : tuple of GainChange
        Margins, bandwidths, the peak of the sensitivity, the step of a setpoint, the response to a
        step moment and the noise at the actuator: of several flights, that in which the number is
        or may be worst.
    refusals : tuple of str
        Why the gains are not proposed; empty if they are.
    level : float
    flights, today_flights : FlightCounts, optional
        Simulated flights with these gains and with today's; None if none were flown.
    loops, today_loops : SampledLoop, optional
        The loops of the first flight, for figures: of the estimate, and of draws.
    signal : str
        Where they are broken.
    tracking, moment : (str, str)
        A setpoint or an input of the plant, and the signal that responds to it; the first may be
        empty.
    horizon : float, s
        Over which responses to a moment are compared.
    """

    gains: Values
    objective: GainChange
    changes: tuple[GainChange, ...]
    refusals: tuple[str, ...]
    level: float
    flights: FlightCounts | None = None
    today_flights: FlightCounts | None = None
    loops: SampledLoop | None = None
    today_loops: SampledLoop | None = None
    signal: str = ""
    tracking: tuple[str, str] | tuple[()] = ()
    moment: tuple[str, str] = ("", "")
    horizon: float = 0.0

    def __getitem__(self, name: str) -> GainChange:
        """Return a change by its name, such as "peak |S|"."""
        for change in self.changes:
            if change.name == name:
                return change
        raise KeyError(f"there is no {name!r}; there are {listed([c.name for c in self.changes])}.")

    @property
    def today_is_stable(self) -> bool:
        """Whether the estimates are stable with today's gains: if not, nothing can be compared."""
        return math.isfinite(self.objective.today)

    def judged(self, judgement: str) -> tuple[GainChange, ...]:
        """Return the changes with this judgement, such as "worse"."""
        return tuple(change for change in self.changes if change.judgement == judgement)

    @property
    def sentence(self) -> str:
        """What is better, what is worse, and what may be."""
        parts = []
        for judgement in ("better", "worse", "may be worse"):
            changes = self.judged(judgement)
            if changes:
                named = [f"{change.name} ({change.difference})" for change in changes]
                parts.append(f"{judgement}: {listed(named)}")
        return "; ".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values."""
        return {
            "gains": dict(self.gains),
            "objective": plain(self.objective),
            "changes": [
                {**plain(change), "judgement": change.judgement} for change in self.changes
            ],
            "refusals": [*self.refusals],
            "level": self.level,
            "flights": plain(self.flights),
            "today_flights": plain(self.today_flights),
        }

    def table(self) -> tuple[list[str], list[tuple[str, ...]]]:
        """Return the header and the rows of the table: every number before and after."""
        header = ["", "unit", "today", "refused" if self.refusals else "proposed", "change", ""]
        rows = []
        for change in self.changes:
            rows.append(
                (
                    change.name,
                    change.unit,
                    _with_ends(change.unit, change.today, change.today_low, change.today_high),
                    _with_ends(
                        change.unit, change.changed, change.changed_low, change.changed_high
                    ),
                    change.difference,
                    change.judgement,
                )
            )
        return header, rows

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the columns of the table mean, and what the simulated flights show."""
        level = f"{100 * self.level:g} %"
        lines = [
            f"In brackets: {level} intervals. Better, as good, worse: with the same plants, for "
            f"all rows together with {level} confidence."
        ]
        if self.flights and self.today_flights:
            lines.append(f"Simulated with these gains: {self.flights}")
            lines.append(f"Simulated with today's gains: {self.today_flights}")
        return tuple(lines)

    def __str__(self) -> str:
        header, all_rows = self.table()
        gains = ", ".join(f"{name} = {value:.4g}" for name, value in self.gains.items())
        # What is better comes first; the rows of one judgement stand together.
        rows = []
        for judgement in JUDGEMENTS:
            judged = [row[:-1] for row in all_rows if row[-1] == judgement]
            rows += [(f"{judgement}:", "", "", "", ""), *judged] if judged else []
        table = text_table(header[:-1], rows, left=(0, 1))
        return "\n".join([f"{header[3].capitalize()}: {gains}.", table, *self.remarks])


def _signed(value: float, unit: str) -> str:
    """Return a change with its sign; rounding errors are zero."""
    if math.isnan(value):
        return "-"
    rounded = value if math.isinf(value) else round(value, 1)
    return f"{'+' if rounded > 0 else ''}{number(rounded + 0.0, 3)}{unit}"


def _with_ends(unit: str, *numbers: float) -> str:
    """Return a value with its interval."""
    # Rounding errors of an overshoot are nothing.
    decimals = 3 if unit == "%" else 12
    shown = [v if math.isinf(v) or math.isnan(v) else round(v, decimals) for v in numbers]
    value, low, high = (number(v, 3) for v in shown)
    if math.isnan(numbers[1]):
        return f"{value} (not determined)"
    return f"{value} ({low} to {high})"


def linear(values: Array, unit: str) -> Array:
    """Return numbers whose ratios have a meaning: decibels as factors, an overshoot as a peak."""
    if unit == "dB":
        return 10 ** (values / 20)
    if unit == "%":
        return 1 + values / 100
    return values


@np.errstate(all="ignore")
def worsening(today: Array, changed: Array, unit: str, is_large_better: bool) -> Array:
    """Return the factors (plants,) by which numbers get worse; one if both are equal."""
    before, after = linear(today, unit), linear(changed, unit)
    if is_large_better:
        before, after = after, before
    is_same = (before == after) | (np.abs(after - before) < NOTHING_LEFT)
    return np.where(is_same, 1.0, after / before)


def worst_changes(flights: Sequence[Sequence[GainChange]]) -> tuple[GainChange, ...]:
    """Return the change of every number in the flight in which it is or may be worst."""
    by_name: dict[str, list[GainChange]] = {}
    for changes in flights:
        for change in changes:
            by_name.setdefault(change.name, []).append(change)
    return tuple(max(changes, key=_badness) for changes in by_name.values())


def _badness(change: GainChange) -> tuple[float, ...]:
    """Return a key that is larger for a worse change; a change that is unknown is the worst."""
    return tuple(math.inf if math.isnan(v) else v for v in (change.high, change.worsening))
