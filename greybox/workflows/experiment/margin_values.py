"""The margins of a loop as values, and their tables."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.folded_text import folded
from greybox.data.files.frozen_values import frozen
from greybox.data.files.json_numbers import plain
from greybox.data.files.named_values import attributes
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import capitalized
from greybox.data.frequency_response import FrequencyResponse
from greybox.workflows.experiment.drawn_loops import DRAWN
from greybox.workflows.experiment.sampled_loop import SampledLoop

UNITS = {
    "phase margin": "deg",
    "gain margin": "dB",
    "gain reduction margin": "dB",
    "delay margin": "s",
    "modulus margin": "",
    "crossover": "rad/s",
    "disturbance rejection bandwidth": "rad/s",
    "disturbance rejection peak": "dB",
    "bandwidth": "rad/s",
    "-180 deg frequency": "rad/s",
    "ADS-33 gain bandwidth": "rad/s",
    "ADS-33 phase bandwidth": "rad/s",
    "ADS-33 bandwidth": "rad/s",
    "phase delay": "s",
    "bandwidth above the boundary": "rad/s",
    "overshoot": "%",
    "rise time": "s",
    "settling time": "s",
    "damping ratio": "",
    "natural frequency": "rad/s",
}

ORDER = "closest_observation"  # of quantiles: interpolation between infinite values is undefined
MAIN = ("phase margin", "gain margin", "delay margin", "crossover")  # of a table of many loops


@dataclass(frozen=True)
class Margin:
    """One number of a loop.

    Attributes
    ----------
    name, unit : str
    value : float
        Infinite if no change of this kind makes the loop unstable.
    low, high : float
        Ends of the confidence interval; NaN where there is none.
    omega : float, rad/s
        Where it is found.
    is_extrapolated : bool
        Whether that is outside the frequencies of the fitted data.
    group : str
        The loop or the response that it describes.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    omega: float
    is_extrapolated: bool = False
    group: str = ""


@public
@frozen
class Margins(Printed):
    """The margins of a loop broken at one signal. It prints itself, the verdict first.

    Attributes
    ----------
    plant, signal : str
        The name of the fit or of the model, and where its loop is broken.
    setpoint, response : str
        Input and output of the closed loop.
    margins : tuple of Margin
        Every number, in groups. Empty for a loop that is not stable.
    is_stable : bool
        At the estimate.
    instability : float
        Probability that the loop is unstable, from the errors of the parameters.
        NaN without errors.
    level : float
        NaN without errors.
    loop : SampledLoop
        At the estimate, and at the draws.
    notes : tuple of str
        Why an interval is missing, and what the fit warns of.
    points : tuple of FrequencyResponse
        The same loop as it was measured, for figures.
    """

    plant: str
    signal: str
    setpoint: str
    response: str
    margins: tuple[Margin, ...]
    is_stable: bool
    instability: float
    level: float
    loop: SampledLoop | None
    notes: tuple[str, ...] = ()
    points: tuple[FrequencyResponse, ...] = ()

    def __getitem__(self, name: str) -> Margin:
        """Return a margin by its name, such as "phase margin"."""
        for margin in self.margins:
            if margin.name == name:
                return margin
        raise KeyError(
            f"there is no {name!r}; there are {', '.join(m.name for m in self.margins)}."
        )

    @property
    def is_safe(self) -> bool:
        """Whether the loop is stable, at the estimate and at this level."""
        return self.is_stable and not self.instability > (1 - self.level) / 2

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        loop = f"the loop of {self.plant}{f', broken at {self.signal},' if self.signal else ''}"
        if not self.is_stable:
            return f"{loop} is unstable: no margin exists."
        if not self.is_safe:
            return (
                f"{loop} is unstable with a probability of {100 * self.instability:.1f} %: "
                "the data do not show that it is safe."
            )
        beyond = "; the crossover is extrapolated" if self["crossover"].is_extrapolated else ""
        phase, gain = (_stated(self[name]) for name in MAIN[:2])
        return f"{loop} has {phase} and {gain}{beyond}."

    def require_loop(self) -> SampledLoop:
        """Return the loop; ValueError for margins of a measured response."""
        if self.loop is None:
            raise ValueError(
                f"the margins of {self.plant} are measured, and cannot be evaluated elsewhere: "
                "use those of a model."
            )
        return self.loop

    def uncertainty(self, omega: Array) -> Array:
        """Return the relative error (n,) of the broken loop at `omega` (n,), rad/s.

        It is the radius of the disk around the estimate that holds the share `level` of the draws:
        a multiplicative weight for robust design. NaN without errors.
        """
        gain = self.require_loop().broken_at(self.signal, omega)
        if len(gain) == 1:
            return np.full(len(omega), np.nan)
        return np.quantile(np.abs(gain[DRAWN] / gain[0] - 1), self.level, axis=0)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; None where unknown or infinite."""
        return plain(
            attributes(self, "verdict", "plant", "setpoint", "response", "level", "notes")
            | {
                "broken_at": self.signal,
                "stable": self.is_stable,
                "probability_unstable": self.instability,
                "margins": {m.name: m for m in self.margins},
            }
        )

    def __str__(self) -> str:
        return self.beside()

    def beside(self, *measured: "Margins") -> str:
        """Return the text of these margins, with a column for each of the same loop, measured."""
        columns = [{m.name: m for m in answer.margins} for answer in (self, *measured)]
        rows, group = [], ""
        for margin in filter(self._is_told, self.margins):
            # Every group begins with its name.
            if margin.group != group:
                group = margin.group
                rows.append((f"{group}:", *[""] * (len(columns) + 2)))
            values = [
                with_interval(by_name[margin.name]) if margin.name in by_name else "-"
                for by_name in columns
            ]
            place = number(margin.omega, 3) + (" *" if margin.is_extrapolated else "")
            rows.append((margin.name, *values, margin.unit, place))
        interval = "" if math.isnan(self.level) else f" ({100 * self.level:g} %)"
        names = ["measured" if len(measured) == 1 else answer.plant for answer in measured]
        first = "of the model" if measured else "value"
        header = ("", f"{first}{interval}", *names, "unit", "rad/s")
        table = [text_table(header, rows)] if rows else []
        lines = [capitalized(self.verdict), *table, *self.notes]
        return folded("\n".join(lines))

    def _is_told(self, margin: Margin) -> bool:
        """Return whether a margin at one of several crossings is not a main one once more."""
        if not margin.name[-1].isdigit():
            return True
        main = (m for m in self.margins if not m.name[-1].isdigit())
        return all(m.omega != margin.omega or abs(m.value) != abs(margin.value) for m in main)


@public
def margin_table(answers: Sequence[tuple[str, Margins]]) -> str:
    """Return a table of the main margins of loops with labels, such as operating points."""
    rows = []
    for label, answer in answers:
        numbers = {margin.name: with_interval(margin) for margin in answer.margins}
        risk = number(100 * answer.instability, 2) if answer.is_stable else "100"
        rows.append((label, answer.signal, *(numbers.get(name, "-") for name in MAIN), risk))
    header = ("", "broken at", *(f"{name}, {UNITS[name]}" for name in MAIN), "unstable, %")
    return text_table(header, rows)


def _stated(margin: Margin) -> str:
    if math.isnan(margin.value):
        return f"an unmeasured {margin.name}"
    return f"a {margin.name} of {with_interval(margin)} {margin.unit}"


def with_interval(margin: Margin) -> str:
    """Return the value of a margin, and its interval in brackets."""
    if not math.isfinite(margin.value):
        return "infinity" if margin.value > 0 else "unknown"
    if not math.isfinite(margin.low):
        return number(margin.value, 3)
    if not math.isfinite(margin.high):
        return f"{number(margin.value, 3)} (above {number(margin.low, 3)})"
    return f"{number(margin.value, 3)} ({number(margin.low, 3)} to {number(margin.high, 3)})"
