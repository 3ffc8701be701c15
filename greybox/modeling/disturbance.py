"""Disturbances of a model: dynamics that white noise drives, and that add to a derivative."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from greybox.data.files.arrays import Interval
from greybox.modeling.parameter import Parameter, Parameters

# The time constant of a first-order gust.
GUST_TIME = "T_gust"


class Disturbance(ABC):
    """What white noise drives, and what adds to the derivative of a state, such as a gust.

    A subclass is a frozen dataclass with its settings as fields. It uses short names; those in the
    model end in the disturbed state: on ``q``, the state ``gust`` is ``gust_q``, the parameter
    ``T_gust`` is ``T_gust_q``, and the intensity of the white noise is ``w_gust_q``.

    Attributes
    ----------
    states : tuple of str
        Its states.
    driven : tuple of str
        Those whose derivatives have white noise, each of an intensity that is estimated.
    """

    states: ClassVar[tuple[str, ...]]
    driven: ClassVar[tuple[str, ...]]

    @abstractmethod
    def parameters(self, state: str, times: Interval) -> Parameters:
        """Return its parameters by short name, for the derivative of a state.

        `times` are the sample and the duration of the record, s: faster color is white noise, and
        slower color than the record cannot be seen.
        """

    @abstractmethod
    def derivative(self, x: Any, p: Any) -> Sequence[Any]:
        """Return the derivatives of its states without noise, from states and parameters."""

    def addition(self, x: Any, p: Any) -> Any:
        """Return what adds to the derivative of the disturbed state: the first of its states."""
        return x[self.states[0]]


@dataclass(frozen=True)
class FirstOrderGust(Disturbance):
    """White noise through a first-order lag, T d' = -d + noise.

    The simplest spectrum of turbulence (Dryden's, along the flight path). Source: MIL-HDBK-1797,
    appendix A; Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5.
    """

    states: ClassVar[tuple[str, ...]] = ("gust",)
    driven: ClassVar[tuple[str, ...]] = ("gust",)

    def parameters(self, state: str, times: Interval) -> Parameters:
        """Return the time constant, ``T_gust``."""
        return {GUST_TIME: gust_time(times, f"derivative of {state}")}

    def derivative(self, x: Any, p: Any) -> Sequence[Any]:
        """Return the decay of the gust."""
        return [-x["gust"] / p[GUST_TIME]]


def gust_time(bounds: Interval, place: str) -> Parameter:
    """Return the time constant of a disturbance on a derivative or an equation."""
    return Parameter(
        math.sqrt(math.prod(bounds)),
        bounds=bounds,
        unit="s",
        about=f"time constant of the disturbance on the {place}",
        scale="log",
    )


DISTURBANCES: dict[str, Disturbance] = {"colored": FirstOrderGust()}
"""The included disturbances by name."""


def disturbance(stated: str | Disturbance) -> Disturbance:
    """Return the disturbance that a criterion states, by name or itself."""
    return DISTURBANCES[stated] if isinstance(stated, str) else stated


def stated_disturbance(given: Any) -> str | Disturbance:
    """Return how a criterion states a disturbance: an included one by name.

    Both statements are then equal and can be stored. Raises ValueError for what is neither.
    """
    for name, included in DISTURBANCES.items():
        if given in (name, included):
            return name
    if isinstance(given, Disturbance):
        return given
    raise ValueError(
        f"disturbance gives {given!r:.60}: give 'colored' or a gb.formulation.Disturbance."
    )
