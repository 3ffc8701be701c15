"""An ODE some of whose outputs are measured late: vanes, filters, air data, by a delay or a lag that is estimated."""

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from greybox.modeling.model import Names
from greybox.modeling.pade_delay import pade_rows, pade_steady
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import as_list

ORDER = 2  # of the Padé approximation: half a degree of phase at one radian, 7° at two
NOTHING: Mapping[str, tuple[float, float]] = MappingProxyType({})


class LateSensors(StateSpace):
    """An ODE with late sensors, see `late_sensors`.

    Parameters
    ----------
    model : StateSpace
    sensors : (output, "delay" or "lag", (low, high))
        One for each late output, with the bounds of the parameter ``<output>_delay`` or
        ``<output>_lag`` in s.
    """

    def __init__(self, model: StateSpace, *sensors: tuple[str, str, tuple[float, float]]) -> None:
        """Add states and parameters."""
        self.model = model
        self.inputs, self.outputs, self.delays = (
            tuple(model.inputs),
            tuple(model.outputs),
            dict(model.delays),
        )
        self.units = model.units
        self.parameters = dict(model.parameters)
        self.states = tuple(model.states)
        self.late: dict[str, tuple[str, tuple[str, ...]]] = {}
        for output, kind, bounds in sensors:
            low, high = bounds
            if output not in self.outputs:
                raise ValueError(
                    f"{model.label} has no output {output!r}; it has {', '.join(self.outputs)}."
                )
            if output in self.late:
                raise ValueError(f"{output!r} has a delay and a lag: give one of them.")
            if not 0 < low < high < math.inf:
                raise ValueError(
                    f"the {kind} of {output!r} has the bounds {bounds}: give 0 < low < high, in s."
                )
            name = f"{output}_{kind}"
            added = tuple(f"{name}_{k}" for k in range(1 if kind == "lag" else ORDER))
            for new in (name, *added):
                if new in (*self.parameters, *self.states, *self.inputs):
                    raise ValueError(
                        f"{model.label} already has {new!r}, the name of the {kind} of {output!r}: rename it."
                    )
            self.parameters[name] = Parameter(
                math.sqrt(low * high),
                bounds=(low, high),
                unit="s",
                about=f"{kind} of the sensor of {output}",
            )
            self.states += added
            self.late[output] = name, added

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Those of the model."""
        return self.model.derived

    @property
    def label(self) -> str:
        """The model and which sensors are late."""
        return f"{self.model.label}, late {', '.join(self.late)}"

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return that of the model, then those of the sensors."""
        true = self._true(x, u, p)
        rows = as_list(self.model.derivative(x, u, p)) if self.model.states else []
        for output, (name, states) in self.late.items():
            rows += self._sensor(true[output], [x[state] for state in states], p[name])[1]
        return rows

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return what the sensors show."""
        outputs = self._true(x, u, p)
        for output, (name, states) in self.late.items():
            late = self._sensor(outputs[output], [x[state] for state in states], p[name])
            outputs[output] = late[0]
        return list(outputs.values())

    @property
    def trim(self) -> Any:  # type: ignore[override]
        """That of the model, where it has one, with sensors at rest."""
        return None if self.model.trim is None else self._trim

    def _trim(self, at: Any, p: Any) -> Mapping[str, Any]:
        assert self.model.trim is not None
        point = {**dict.fromkeys((*self.states, *self.inputs), 0.0), **self.model.trim(at, p), **at}
        true = self._true(Names(point), Names(point), p)
        for output, (_, states) in self.late.items():
            steady = [true[output]] if len(states) == 1 else pade_steady(true[output], ORDER)
            point |= dict(zip(states, steady, strict=True))
        return {name: value for name, value in point.items() if name not in at}

    def _true(self, x: Any, u: Any, p: Any) -> dict[str, Any]:
        return dict(zip(self.outputs, as_list(self.model.output(x, u, p)), strict=True))

    @staticmethod
    def _sensor(true: Any, x: list[Any], time: Any) -> tuple[Any, list[Any]]:
        """Return what a sensor shows, and the derivatives of its states."""
        if len(x) == 1:
            return x[0], [(true - x[0]) / time]
        return pade_rows(x, true, time, ORDER)


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
