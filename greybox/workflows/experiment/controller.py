"""Sampled controllers, declared like models: named signals, parameters with units, equations."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import casadi as ca

from greybox.data.files.argument_checks import checked_items, is_finite_number
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import ByName, Values
from greybox.data.files.public import public
from greybox.modeling.declaration import declared_parameters, require_signal_names, require_usable
from greybox.modeling.formula_arguments import Names
from greybox.modeling.model import require_known
from greybox.modeling.parameter import Parameters
from greybox.modeling.realization import Dynamics
from greybox.modeling.symbolic_reading import column, entries_by_name, traced


@public
class Controller(ABC):
    r"""A controller in discrete time, $x_{k+1}, y_k = update(x_k, u_k, p)$.

    It runs `rate` times per second. A subclass declares its signals, its parameters and
    `update`, e.g. proportional control of a rate::

        class RateDamper(gb.Controller):
            inputs, setpoints, outputs = ("q",), ("reference",), ("u",)
            K = gb.Parameter(0.1, bounds=(0, 1), unit="s", about="control per rate error")

            def update(self, x, u, p):
                return (), (p.K * (u.reference - u.q),)

    Attributes
    ----------
    states : sequence of str
        What it carries from one sample to the next.
    inputs : sequence of str
        What it measures.
    setpoints : sequence of str
        Commands; each is zero unless an excitation or a controller before it provides it.
    outputs : sequence of str
        Controls, and whatever else is to be logged.
    units : mapping of signal name to str
    rate : float, Hz
    parameters : mapping of name to `Parameter`
        Collected from the class body, in the order of declaration.

    Parameters
    ----------
    values : mapping of parameter name to float, optional
        Gains other than the declared starts.
    rate : float, Hz, optional
    signals : mapping of str to str, optional
        Own name to the name outside, where they differ: ``{"theta": "phi", "q": "p"}`` makes a
        pitch controller control roll.
    initial : mapping of state name to float, optional
        States at the first sample, where they are not zero.

    Raises
    ------
    ValueError
        For names that the declaration does not have, or numbers that are not finite.
    """

    states: Sequence[str] = ()
    inputs: Sequence[str] = ()
    setpoints: Sequence[str] = ("reference",)
    outputs: Sequence[str] = ("u",)
    units: ClassVar[Mapping[str, str]] = MappingProxyType({})
    parameters: ClassVar[Parameters] = MappingProxyType({})
    rate: float = 400.0

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Collect the parameters of the class and of the classes above it, and check the names."""
        super().__init_subclass__(**kwargs)
        parameters = declared_parameters(cls)
        cls.parameters = MappingProxyType(ByName(parameters))
        require_usable(parameters, cls.__name__, Controller)
        require_signal_names(cls, "states", "inputs", "setpoints", "outputs")
        twice = {*cls.inputs} & {*cls.setpoints}
        if twice:
            raise ValueError(
                f"{cls.__name__} has {twice.pop()!r} both as input and as setpoint: use two names."
            )

    def __init__(
        self,
        values: Values | None = None,
        *,
        rate: float | None = None,
        signals: Mapping[str, str] | None = None,
        initial: Values | None = None,
    ) -> None:
        label = type(self).__name__
        values, initial = values or {}, initial or {}
        rate = self.rate if rate is None else rate
        self.signals = MappingProxyType(dict(signals or {}))
        require_known(values, self.parameters, "parameter", label)
        require_known(self.signals, (*self.inputs, *self.setpoints, *self.outputs), "signal", label)
        require_known(initial, self.states, "state", label)
        for name, value in {**values, **initial, "rate": rate}.items():
            if not is_finite_number(value):
                raise ValueError(
                    f"{name} = {value!r} is not a finite number: give a value for {label}."
                )
        self.rate = float(rate)
        if not self.rate > 0:
            raise ValueError(
                f"{label} cannot run {self.rate:g} times per second: give a rate above 0, in Hz."
            )
        self.values = Names(
            {n: float(values.get(n, p.start)) for n, p in self.parameters.items()}, label
        )
        self.initial = tuple(float(initial.get(name, 0.0)) for name in self.states)

    @abstractmethod
    def update(self, x: Any, u: Any, p: Any) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the states of the next sample and the outputs of this one, in the order declared.

        `x` holds the states, `u` the inputs and setpoints, `p` the parameter values, all by name;
        write the formula with `gb.minimum`, `gb.where` and friends.
        """

    def outside(self, name: str) -> str:
        """Return the name of an own signal in the loop."""
        return self.signals.get(name, name)

    @property
    def truth(self) -> dict[str, Any]:
        """Everything that a flight with it depends on, for the metadata of its record."""
        return {
            "controller": type(self).__name__,
            "rate": self.rate,
            "values": dict(self.values),
            "signals": dict(self.signals),
            "initial": dict(zip(self.states, self.initial, strict=True)),
        }

    def __repr__(self) -> str:
        values = {n: v for n, v in self.values.items() if v != self.parameters[n].start}
        arguments = [f"{values}"] if values else []
        arguments += [f"rate={self.rate:g}"] if self.rate != type(self).rate else []
        arguments += [f"signals={dict(self.signals)}"] if self.signals else []
        return f"{type(self).__name__}({', '.join(arguments)})"


Controllers = Controller | Sequence[Controller]  # in the order in which they run


def updated(controller: Controller, x: ca.SX, u: Mapping[str, Any]) -> tuple[ca.SX, ca.SX]:
    """Evaluate `update` on expressions: the next states (n,) and the outputs (m,).

    `u` maps the controller's own inputs and setpoints to expressions.

    Raises
    ------
    ValueError
        With the cure, if the formula cannot be compiled or returns another number of values.
    """
    label = type(controller).__name__
    states = Names(entries_by_name(controller.states, x), f"{label}.states")
    signals = Names(u, f"{label}.inputs and setpoints")
    returned = traced(f"{label}.update", controller.update, states, signals, controller.values)
    pair = returned if isinstance(returned, tuple) and len(returned) == 2 else ((), ())
    following, outputs = (v if isinstance(v, Sequence) else () for v in pair)
    if (len(following), len(outputs)) != (len(controller.states), len(controller.outputs)):
        raise ValueError(
            f"{label}.update returns {returned!r:.60}: return two tuples, the next states "
            f"({', '.join(controller.states) or 'none'}) and the outputs "
            f"({', '.join(controller.outputs)})."
        )
    return column(f"{label}.update", following), column(f"{label}.update", outputs)


def outside_names(controllers: Sequence[Controller], *kinds: str) -> list[str]:
    """Return the names in the loop of signals of these kinds, such as "setpoints"."""
    return [c.outside(name) for c in controllers for kind in kinds for name in getattr(c, kind)]


def connected(
    controller: Controllers | None, plant: str, system: Dynamics
) -> tuple[Controller, ...]:
    """Return the controllers of a loop, if they fit the system of this plant and one another.

    Raises
    ------
    ValueError
        If a controller drives nothing, if a signal is driven twice or has the name of an output
        or a state, if the order is wrong, or if the rates differ.
    TypeError
        If one is not a controller.
    """
    cure = "an instance, as AttitudeController() or LinearLaw(control.tf(...), rate=400)"
    given = () if controller is None else controller
    controllers = checked_items("the controller", given, Controller, cure)
    inputs = system.inputs
    driven_by_plant = {*system.outputs, *system.states}
    driven: set[str] = set()
    for k, c in enumerate(controllers):
        label = type(c).__name__
        first = controllers[0]
        if c.rate != first.rate:
            raise ValueError(
                f"{label} runs at {c.rate:g} Hz, {type(first).__name__} at {first.rate:g} Hz: use "
                "one rate."
            )

        provides = {*map(c.outside, c.outputs)}
        commanded = {*map(c.outside, c.setpoints)}
        read_next = outside_names(controllers[k + 1 :], "inputs", "setpoints")
        if not provides & {*inputs, *read_next}:
            raise ValueError(
                f"{label} gives {', '.join(map(c.outside, c.outputs))}, but {plant} takes "
                f"{', '.join(inputs) or 'none'}: connect them, "
                f"signals={{{c.outputs[0]!r}: {(*inputs, 'u')[0]!r}}}."
            )

        # A signal of two sources would be overwritten without notice.
        twice = provides & driven | (provides | commanded) & driven_by_plant
        if twice:
            raise ValueError(
                f"two signals are called {min(twice)!r}: rename that of {label}, "
                "signals={'own': 'other'}."
            )

        late = commanded & {*outside_names(controllers[k:], "outputs")}
        if late:
            raise ValueError(
                f"{label} takes {min(late)!r} from itself or a later controller: list that one "
                "first."
            )
        driven |= provides
    return controllers


def run_controllers(
    controllers: Sequence[Controller],
    memory: Sequence[ca.SX],
    measured: Mapping[str, Any],
    signals: dict[str, Any],
    added: Mapping[str, Any],
) -> list[ca.SX]:
    """Run controllers in their order, and return their next states.

    Their outputs, with what is `added`, go to `signals`, where the next ones find their setpoints;
    a setpoint that is not there is zero.
    """
    following = []
    for controller, state in zip(controllers, memory, strict=True):
        u = {n: {**signals, **measured}[controller.outside(n)] for n in controller.inputs}
        u |= {n: signals.get(controller.outside(n), ca.SX(0)) for n in controller.setpoints}
        next_state, outputs = updated(controller, state, u)
        following.append(next_state)
        for k, name in enumerate(map(controller.outside, controller.outputs)):
            signals[name] = outputs[k] + added.get(name, 0)
    return following


def sensors_of(controllers: Sequence[Controller]) -> tuple[str, ...]:
    """Return what controllers read from the plant: inputs that no controller provides."""
    provided = outside_names(controllers, "outputs")
    names = outside_names(controllers, "inputs")
    return unique(name for name in names if name not in provided)
