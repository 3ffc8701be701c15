"""An ODE with disturbances of first-order color on its derivatives, such as gusts."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from greybox.data.files.arrays import Interval
from greybox.modeling.added_terms import ExtendedModel
from greybox.modeling.model import Model, require_known
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace


class ColoredDisturbance(ExtendedModel):
    """An ODE whose derivatives have disturbances with states of their own.

    The disturbance ``gust_<state>`` adds to the derivative of the state, and to outputs that have
    this derivative in them, such as an acceleration. It follows
    T d' = -d + white noise, with the time constant ``T_gust_<state>``. White noise through a first
    order lag is the simplest spectrum of turbulence (Dryden's, along the flight path).

    Parameters
    ----------
    model : StateSpace
    disturbed : (state, (low, high))
        A tuple for each disturbed state, with the bounds of the time constant, s.

    Source: MIL-HDBK-1797, appendix A; Jategaonkar, Flight Vehicle System Identification, 2nd ed.,
    chapter 5.
    """

    def __init__(self, model: StateSpace, *disturbed: tuple[str, Interval]) -> None:
        self.disturbed = tuple(state for state, _ in disturbed)
        self.gusts = tuple(map(gust_on, self.disturbed))
        require_known(self.disturbed, model.states, "state", model.label)
        times = {
            f"T_{gust_on(state)}": gust_time(bounds, f"derivative of {state}")
            for state, bounds in disturbed
        }
        super().__init__(model, self.gusts, times)
        # A name of the model would be overwritten silently.
        for name in (*self.gusts, *times):
            if name in (*model.parameters, *model.states, *model.inputs):
                raise ValueError(f"{model.label} already has {name!r}: rename it there.")

    @property
    def label(self) -> str:
        """The model and which states are disturbed."""
        return f"{self.model.label}, disturbed {', '.join(self.disturbed)}"

    def additions(self, x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        """Return the disturbance of every derivative."""
        return {state: x[gust] for state, gust in zip(self.disturbed, self.gusts, strict=True)}

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the derivatives of the model's states, then those of the disturbances."""
        decays = [-x[gust] / p[f"T_{gust}"] for gust in self.gusts]
        return [*super().derivative(x, u, p), *decays]


def gust_time(bounds: Interval, place: str) -> Parameter:
    """Return the time constant of a disturbance on a derivative or an equation."""
    return Parameter(
        math.sqrt(math.prod(bounds)),
        bounds=bounds,
        unit="s",
        about=f"time constant of the disturbance on the {place}",
        scale="log",
    )


def gust_on(state: str) -> str:
    """Return the name of the disturbance on the derivative of a state."""
    return f"gust_{state}"


def undisturbed(model: Model) -> Model:
    """Return the model without colored disturbances."""
    return model.model if isinstance(model, ColoredDisturbance) else model
