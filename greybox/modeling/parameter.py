"""One unknown of a model: its start, bounds, unit and meaning."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.files.argument_checks import is_finite_number, require_kind
from greybox.data.files.arrays import Array, Interval
from greybox.data.files.numbers_in_text import number
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.frequency_band import number_pair


@public
@dataclass(frozen=True)
class Parameter:
    """An unknown (or a declared constant) of a model.

    Parameters
    ----------
    start : float
        Start of a single run, and the value of a fixed parameter.
    bounds : (float, float)
        Interval of the estimate; infinite ends are allowed.
    unit : str
        SI unit as text, e.g. ``"1/s²"``; dimensionless is ``"1"``.
    about : str
        The meaning of the parameter.
    fixed : bool
        True for a constant; `Problem(..., free=("name",))` frees it.
    starts : (float, float), optional
        The box in which random starts are drawn; by default the bounds.
    scale : "linear" or "log"
        "log" optimizes the logarithm and draws starts evenly in it, for positive parameters that
        span decades.
    prior : (float, float), optional
        Mean and standard deviation of a-priori knowledge, see `Problem`.
    has_computed_bounds : bool
        Whether the model computed the bounds, so that they say nothing to a reader.

    Raises
    ------
    ValueError
        If a number is not finite where it must be, bounds are reversed, or a start lies outside
        them.
    TypeError
        If unit or meaning is not a text, or `fixed` is neither True nor False.

    Examples
    --------
    >>> K = gb.Parameter(50.0, bounds=(0, 500), unit="1/s", about="rate per control")
    >>> K.start, K.bounds, K.unit
    (50.0, (0, 500), '1/s')
    >>> gb.Parameter(0.0042, fixed=True, unit="s").fixed
    True
    """

    start: float
    bounds: Interval = (-math.inf, math.inf)
    unit: str = "1"
    about: str = ""
    fixed: bool = False
    starts: Interval | None = None
    scale: str = "linear"
    prior: tuple[float, float] | None = None
    has_computed_bounds: bool = False

    def __post_init__(self) -> None:
        """Check the types, and the numbers against one another."""
        require_kind("unit", self.unit, str, "a text")
        require_kind("about", self.about, str, "a text")
        require_kind("fixed", self.fixed, bool | np.bool_, "True or False")
        low, high = number_pair(self.bounds, "bounds")
        if not low < high:
            raise ValueError(
                f"bounds {self.bounds} are reversed or empty: give (low, high) with low < high."
            )
        if not is_finite_number(self.start):
            raise ValueError(
                f"start {self.start!r} is not a finite number: give a value inside bounds "
                f"{self.bounds}."
            )

        if not low <= self.start <= high:
            raise ValueError(
                f"start {self.start:g} lies outside bounds ({low:g}, {high:g}): move the start or "
                "widen them."
            )
        if self.scale not in ("linear", "log"):
            raise ValueError(f"scale {self.scale!r} is not known: use 'linear' or 'log'.")
        if self.scale == "log" and low <= 0:
            raise ValueError(
                f"scale 'log' needs positive bounds, not ({low:g}, {high:g}): raise the lower "
                "bound above 0."
            )

        if self.starts is not None:
            first, last = number_pair(self.starts, "starts")
            if not (math.isfinite(first) and math.isfinite(last) and first <= last):
                raise ValueError(
                    f"starts {self.starts} must be two finite numbers (low, high) with low <= high."
                )
            if first < low or last > high:
                raise ValueError(
                    f"starts ({first:g}, {last:g}) reach outside bounds ({low:g}, {high:g}): "
                    "narrow the start box or widen the bounds."
                )

        if self.prior is not None:
            normal_prior(self.prior, "prior")

    @property
    def box(self) -> Interval:
        """The interval in which random starts are drawn: `starts`, else the bounds."""
        return self.starts if self.starts is not None else self.bounds

    def in_box(self, share: Any) -> Any:
        """Return the values at shares (0 to 1, any shape) of a finite box, on its scale."""
        return self._between(*self.box, share)

    def draw(self, random: np.random.Generator) -> float:
        """Draw a value from the box.

        An open end is taken at ten times the size of the start, at least ten, from it.
        """
        low, high = self.box
        # An open end has no scale but that of the start.
        reach = 10.0 * max(abs(self.start), 1.0)
        low = low if math.isfinite(low) else min(self.start, high) - reach
        high = high if math.isfinite(high) else max(self.start, low) + reach
        return float(self._between(low, high, random.random()))

    def _between(self, low: float, high: float, share: Any) -> Any:
        if self.scale == "log":
            values = np.exp(np.log(low) + share * (np.log(high) - np.log(low)))
        else:
            values = low + share * (high - low)
        # Rounding may lead beyond the ends.
        return np.clip(values, low, high)


Parameters = Mapping[str, Parameter]  # by name


def start_values(parameters: Parameters) -> Array:
    """Return the declared starts of parameters, (p,)."""
    return np.array([parameter.start for parameter in parameters.values()], dtype=float)


def lower_and_upper(parameters: Iterable[Any]) -> Array:
    """Return the lower and upper bounds (2, p) of parameters, or of what else has `bounds`."""
    return np.array([parameter.bounds for parameter in parameters], dtype=float).reshape(-1, 2).T


def parameter_table(parameters: Parameters) -> str:
    """Return the declarations of parameters as a table of text."""
    rows = []
    for name, p in parameters.items():
        bounds = f"[{p.bounds[0]:g}, {p.bounds[1]:g}]"
        rows.append([name, number(p.start), bounds, p.unit, "fixed" if p.fixed else "", p.about])
    header = ["parameter", "start", "bounds", "unit", "", "meaning"]
    return text_table(header, rows, (0, 3, 4, 5))


def normal_prior(value: object, what: str) -> tuple[float, float]:
    """Return mean and standard deviation; ValueError for anything else."""
    mean, sigma = number_pair(value, what)
    if not (math.isfinite(mean) and math.isfinite(sigma) and sigma > 0):
        raise ValueError(
            f"{what} {value!r} must be two finite numbers (mean, standard deviation above 0)."
        )
    return mean, sigma
