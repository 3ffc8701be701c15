"""Profiles of a fit as values that print themselves; `profile` computes them."""

import math
from typing import Any, Literal

from greybox.data.files.arrays import Array, Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.json_numbers import plain
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed, one_line
from greybox.data.files.public import public
from greybox.data.files.spelling import alternatives
from greybox.data.files.text_table import titled

End = Literal["crossed", "bound", "flat", "failed"]


@frozen
class ProfileOf:
    """The profile of one parameter or derived quantity.

    Attributes
    ----------
    name, unit : str
    estimate, standard_error : float
        Values of the fit; the error is NaN if it is not known.
    values, costs, roots : (n,) arrays
        Values at which the quantity was held, increasing; the lowest cost at each, and the signed
        root of the likelihood ratio.
    others : (n, p) array
        All free parameters at these minima.
    interval : (float, float)
        Infinite on a side that the data leave open.
    ends : (End, End)
        How the profile ended below and above the estimate: it "crossed" the limit, reached the
        "bound" of the parameter first, is "flat" however far it goes, or "failed" to converge.
    bounds : (float, float)
    bias : float
        Bias of the estimate (`Quantity.bias`) in standard errors. The interval ends where the root
        plus the bias is -limit or limit.
    at_bound : (tuple of str, tuple of str)
        Other parameters at a bound where the profile crosses the limit, below and above. Such an
        end depends on the bound, not only on the data.
    connected : bool
        False when values inside the interval have a cost above the limit.
    """

    name: str
    unit: str
    estimate: float
    standard_error: float
    values: Array
    costs: Array
    roots: Array
    others: Array
    interval: Interval
    ends: tuple[End, End]
    bounds: Interval
    bias: float = 0.0
    at_bound: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    connected: bool = True

    def __str__(self) -> str:
        lower, upper = self.interval
        low = number(lower, 4)
        high = number(upper, 4)
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        # An open side is more important than the number on the other side, so it is written in
        # words.
        if math.isinf(lower) and math.isinf(upper):
            text = "not limited by the data on either side"
        elif math.isinf(upper):
            text = f"above {low}{unit}, no upper limit{self._reason(1, 'up')}"
        elif math.isinf(lower):
            text = f"below {high}{unit}, no lower limit{self._reason(0, 'down')}"
        else:
            text = f"{low} to {high}{unit}"

        for end, names in zip(("lower", "upper"), self.at_bound, strict=True):
            if names:
                bounds = "its bound" if len(names) == 1 else "their bounds"
                text += f", the {end} limit with {', '.join(names)} at {bounds}"
        return text if self.connected else f"{text}, in separate pieces"

    def _reason(self, side: int, direction: str) -> str:
        """Return why the interval is open below (side 0) or above (side 1); empty if it is flat."""
        reasons = {
            "bound": f" {direction} to the bound {self.bounds[side]:g}",
            "failed": " that could be found: solves failed beyond",
        }
        return reasons.get(self.ends[side], "")

    def __repr__(self) -> str:
        return one_line(self, self.name, str(self))


@public
@frozen
class Profiles(Printed):
    """Profiles of one fit. Printing them gives a line for each.

    Attributes
    ----------
    name : str
        Name of the problem.
    level : float
        Confidence level of the intervals.
    limit : mapping of name to float
        Limit of |r|: the quantile of Student's t.
    free : tuple of str
        The columns of `ProfileOf.others`.
    profiles : tuple of ProfileOf
    warnings : tuple of str

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> profiles = gb.profile(gb.fit(pitch_hover.problem(), starts=5), ["a1"])
    >>> low, high = profiles["a1"].interval
    >>> low < high
    True
    """

    name: str
    level: float
    limit: dict[str, float]
    free: tuple[str, ...]
    profiles: tuple[ProfileOf, ...]
    warnings: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> ProfileOf:
        for profile in self.profiles:
            if profile.name == name:
                return profile
        raise KeyError(
            f"{name!r} was not profiled; there are "
            f"{alternatives(name, [p.name for p in self.profiles])}"
        )

    @property
    def intervals(self) -> dict[str, Interval]:
        """The intervals by name; infinite on an open side."""
        return {profile.name: profile.interval for profile in self.profiles}

    def __str__(self) -> str:
        width = max((len(profile.name) for profile in self.profiles), default=0)
        lines = [f"{p.name:<{width}}  {number(p.estimate):>10}   {p}" for p in self.profiles]
        lines += [f"warning: {text}" for text in self.warnings]
        title = f"{self.name}: {100 * self.level:g} % intervals by profile likelihood"
        return titled(title, lines)

    def intervals_in_words(self) -> dict[str, Any]:
        """Return interval and text of every profile for JSON; None for an open side."""
        return plain(
            {
                p.name: {"low": p.interval[0], "high": p.interval[1], "text": str(p)}
                for p in self.profiles
            }
        )

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON; None for an open side."""
        words = self.intervals_in_words()
        profiles = {}
        for p in self.profiles:
            profiles[p.name] = {
                "estimate": p.estimate,
                "standard_error": p.standard_error,
                "ends": p.ends,
                "at_bound": p.at_bound,
                "connected": p.connected,
                "values": p.values,
                "costs": p.costs,
                "roots": p.roots,
                **words[p.name],
                "others": dict(zip(self.free, p.others.T, strict=True)),
            }
        return plain(
            {
                "problem": self.name,
                "level": self.level,
                "profiles": profiles,
                "limit": self.limit,
                "warnings": self.warnings,
            }
        )
