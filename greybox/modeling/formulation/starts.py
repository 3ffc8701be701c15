"""Starts of the runs: Sobol points, or a list."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from greybox.data.files.argument_checks import is_finite_number, require_whole
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import Values
from greybox.data.files.normalization import normalize
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.modeling.parameter import Parameters

# Starts of a rule: a million of ten parameters take 80 MB, and their runs ten times as much.
MOST = 2**20


class Starts(ABC):
    """A rule for the starts of a search; `seed` is None if it draws no random numbers.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> sobol = gb.solve.Sobol(5, seed=1)
    >>> isinstance(sobol, gb.Starts), gb.fit(pitch_hover.problem(), sobol).converged
    (True, True)
    """

    seed: int | None = None

    @abstractmethod
    def draw(self, parameters: Parameters) -> Array:
        """Return the starts, (number, p), for the free parameters in their order."""

    @abstractmethod
    def __str__(self) -> str: ...


@public
@dataclass(frozen=True)
class Sobol(Starts):
    """Scrambled Sobol points, spread over the boxes of the parameters.

    More of them with the same seed begin with the same points.

    Parameters
    ----------
    number : int
        Number of starts.
    seed : int
    """

    number: int
    seed: int = 0  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Check number and seed."""
        require_whole("number of starts", self.number, 1)
        require_whole("seed of starts", self.seed, 0)

    def __str__(self) -> str:
        return f"{self.number} by Sobol, seed {self.seed}"

    def draw(self, parameters: Parameters) -> Array:
        """Return the points, spread over the boxes."""
        # Not before: in a study, too large a number is the failure of this member alone.
        if self.number > MOST:
            raise ValueError(f"{self.number} Sobol points are too many: give at most {MOST}.")
        for name, parameter in parameters.items():
            low, high = parameter.box
            if not (math.isfinite(low) and math.isfinite(high)):
                raise ValueError(
                    f"random starts for {name!r} need finite bounds and these are ({low:g}, "
                    f"{high:g}): declare finite ones, or a start box, in its Parameter; or give "
                    "the starts as a list."
                )

        shares = sobol_shares(self.number, len(parameters), self.seed)
        pairs = zip(parameters.values(), shares.T, strict=True)
        return np.column_stack([parameter.in_box(share) for parameter, share in pairs])


def sobol_shares(number: int, dimensions: int, seed: int) -> Array:
    """Return scrambled Sobol points (number, dimensions) between 0 and 1."""
    from scipy.stats import qmc  # noqa: PLC0415  (takes a third of a second to import)

    # A sequence is balanced at powers of two; scipy warns otherwise.
    sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
    return sequence.random_base2((number - 1).bit_length())[:number]


@public
@dataclass(frozen=True)
class Listed(Starts):
    """Starts as mappings of name to value; other parameters begin at their declared start."""

    points: Sequence[Values] = ({},)

    @property
    def number(self) -> int:
        """Number of starts."""
        return len(self.points)

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.points), "point"))

    def __str__(self) -> str:
        is_declared = list(self.points) == [{}]
        return "the declared values" if is_declared else f"{len(self.points)} listed"

    def draw(self, parameters: Parameters) -> Array:
        """Return the listed points, (number, p)."""
        if not self.points:
            raise ValueError(
                "the list of starts is empty: give at least one, Listed([{}]) for the declared one."
            )

        for name, value in chain.from_iterable(point.items() for point in self.points):
            if not is_finite_number(value):
                raise ValueError(
                    f"a listed start gives {name!r} the value {value!r}: give a finite number."
                )
            if name not in parameters:
                raise ValueError(
                    f"a listed start names {name!r}, which is not free; free are "
                    f"{', '.join(parameters)}."
                )
            low, high = parameters[name].bounds
            if not low <= value <= high:
                raise ValueError(
                    f"a listed start gives {name!r} the value {value:g}, outside its bounds "
                    f"({low:g}, {high:g}): move the start or widen the bounds."
                )

        return np.array(
            [[point.get(name, p.start) for name, p in parameters.items()] for point in self.points],
            float,
        )


@dataclass(frozen=True)
class Chained(Starts):
    """The starts of several rules in order; `seed` is that of the first rule that has one."""

    rules: tuple[Starts, ...]

    @property
    def number(self) -> int:
        """Number of starts; a rule without a number counts one."""
        return sum(getattr(rule, "number", 1) for rule in self.rules)

    def __post_init__(self) -> None:
        """Take over the seed."""
        seeds = (rule.seed for rule in self.rules if rule.seed is not None)
        normalize(self, seed=next(seeds, None))

    def __repr__(self) -> str:
        return one_line(self, str(self))

    def __str__(self) -> str:
        return " + ".join(map(str, self.rules))

    def draw(self, parameters: Parameters) -> Array:
        """Return the starts of every rule in turn."""
        return np.concatenate([rule.draw(parameters) for rule in self.rules])


AnyStarts = int | Starts | Sequence[Values | Starts]
"""A number of starts, a rule, or a list of points and rules."""


def as_starts(starts: AnyStarts, seed: int | None = None) -> Starts:
    """Return the rule for a number of starts, a rule, or a list of points and rules.

    A number means the declared values, which are often a good guess, and then Sobol points.

    Raises
    ------
    TypeError
        For anything else.
    ValueError
        For a seed together with a rule, which has its own.
    """
    if isinstance(starts, float) and starts.is_integer():  # 1e3 in a study file
        starts = int(starts)
    if isinstance(starts, int | np.integer) and not isinstance(starts, bool):
        drawn = Sobol(int(starts), seed or 0)
        declared = Listed()
        return Chained((declared, Sobol(starts - 1, drawn.seed))) if starts > 1 else declared
    if seed is not None:
        raise ValueError(
            f"seed = {seed} goes with a number of starts: give it to the rule, e.g. Sobol(200, "
            f"seed={seed})."
        )
    if isinstance(starts, Starts):
        return starts

    # A text is a sequence, too: its letters are neither mappings nor rules.
    if isinstance(starts, Sequence) and starts:
        points: Sequence[Any] = starts
        if all(isinstance(item, Mapping) for item in points):
            return Listed(tuple(points))
        if all(isinstance(item, Mapping | Starts) for item in points):
            return Chained(
                tuple(item if isinstance(item, Starts) else Listed((item,)) for item in points)
            )

    raise TypeError(
        f"starts is {starts!r:.80}: give a number, a rule such as Sobol(200), or a list "
        "of {name: value}."
    )
