"""An ODE with outputs that are measured late (vanes, filters, air data): delays or lags."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from greybox.modeling.extended_model import ExtendedModel
from greybox.modeling.model import Names, require_known
from greybox.modeling.pade_delay import pade_rows, pade_steady
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import as_list

ORDER = 2  # of the Padé approximation: half a degree of phase at one radian, 7° at two
NOTHING: Mapping[str, tuple[float, float]] = MappingProxyType({})


class LateSensors(ExtendedModel):
    """An ODE with late sensors, see `late_sensors`.

    Parameters
    ----------
    model : StateSpace
    sensors : (output, "delay" or "lag", (low, high))
        A tuple for each late output, with the bounds of the parameter ``<output>_delay`` or
        ``<output>_lag`` in s.
    """

    def __init__(self, model: StateSpace, *sensors: tuple[str, str, tuple[float, float]]) -> None:
        self.late: dict[str, tuple[str, tuple[str, ...]]] = {}
        parameters: dict[str, Parameter] = {}
        for output, kind, (low, high) in sensors:
            require_known([output], model.outputs, "output", model.label)
            if output in self.late:
                raise ValueError(f"{output!r} has a delay and a lag: give one of them.")
            if not 0 < low < high < math.inf:
                raise ValueError(
                    f"the {kind} of {output!r} has the bounds {(low, high)}: give 0 < low < high, "
                    "in s."
                )
            name = f"{output}_{kind}"
            # The geometric mean is equally far, in ratio, from both bounds.
            parameters[name] = Parameter(
                math.sqrt(low * high),
                bounds=(low, high),
                unit="s",
                about=f"{kind} of the sensor of {output}",
            )
            added = tuple(f"{name}_{k}" for k in range(1 if kind == "lag" else ORDER))
            self.late[output] = name, added
        states = [state for _, added in self.late.values() for state in added]
        super().__init__(model, states, parameters)

    @property
    def label(self) -> str:
        """The model and which sensors are late."""
        return f"{self.model.label}, late {', '.join(self.late)}"

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the derivatives of the model's states, then those of the sensors' states."""
        rows = as_list(self.model.derivative(x, u, p)) if self.model.states else []
        return rows + [row for _, rates in self._sensors(x, u, p).values() for row in rates]

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return what the sensors show."""
        return [measured for measured, _ in self._sensors(x, u, p).values()]

    @property
    def trim(self) -> Any:  # type: ignore[override]
        """The trim of the model, if it has one, with sensors at rest."""
        return None if self.model.trim is None else self._trim

    def _trim(self, at: Any, p: Any) -> Mapping[str, Any]:
        # At rest, every sensor shows the true output.
        assert self.model.trim is not None
        point = {**dict.fromkeys((*self.states, *self.inputs), 0.0), **self.model.trim(at, p), **at}
        true = as_list(self.model.output(Names(point), Names(point), p))
        for output, value in zip(self.outputs, true, strict=True):
            states = self.late.get(output, ("", ()))[1]
            steady = [value] if len(states) == 1 else pade_steady(value, ORDER)
            point |= dict(zip(states, steady, strict=False))
        return {name: value for name, value in point.items() if name not in at}

    def _sensors(self, x: Any, u: Any, p: Any) -> dict[str, tuple[Any, list[Any]]]:
        """Return what every sensor shows, and the derivatives of its states."""
        sensors: dict[str, tuple[Any, list[Any]]] = {}
        for output, true in zip(self.outputs, as_list(self.model.output(x, u, p)), strict=True):
            name, states = self.late.get(output, ("", ()))
            inside = [x[state] for state in states]
            if not states:
                sensors[output] = true, []
            elif len(states) == 1:
                sensors[output] = inside[0], [(true - inside[0]) / p[name]]
            else:
                sensors[output] = pade_rows(inside, true, p[name], ORDER)

        return sensors


def late_sensors(
    model: StateSpace,
    *,
    delays: Mapping[str, tuple[float, float]] = NOTHING,
    lags: Mapping[str, tuple[float, float]] = NOTHING,
) -> LateSensors:
    """Return a model some of whose outputs are measured late, for records and responses alike.

    Parameters
    ----------
    model : StateSpace
    delays, lags : mapping of output to (low, high)
        The bounds, in s, of a delay, a Padé approximation of second order, or of the time constant
        of a lag of first order. They are the parameters ``<output>_delay`` and ``<output>_lag``; a
        problem may fix them, or tie those of two vanes. A parameter in `StateSpace.delays` is the
        delay of an input.

    Raises
    ------
    ValueError
        For outputs that the model does not have, and bounds that are not above zero.
    """
    sensors = [
        (output, kind, (float(low), float(high)))
        for kind, bounds in (("delay", delays), ("lag", lags))
        for output, (low, high) in bounds.items()
    ]
    return LateSensors(model, *sensors)
