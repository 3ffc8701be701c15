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
        Values that it keeps from one sample to the next.
    inputs : sequence of str
        Measured signals.
    setpoints : sequence of str
        Commands. A setpoint is zero unless an excitation or an earlier controller provides it.
    outputs : sequence of str
        Controls, and other signals for the log.
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
        The name in the loop for a name in the class, if they differ: with
        ``{"theta": "phi", "q": "p"}`` a pitch controller controls roll.
    initial : mapping of state name to float, optional
        States at the first sample; by default zero.

    Raises
    ------
    ValueError
        For names that the declaration does not have, or numbers that are not finite.

    Examples
    --------
    >>> class Hold(gb.Controller):
    ...     'Holds an angle.'
    ...
    ...     inputs, outputs = ("theta", "q"), ("u",)
    ...     K = gb.Parameter(4.0, bounds=(0, 100), unit="1", about="control per error")
    ...     D = gb.Parameter(1.0, bounds=(0, 100), unit="s", about="control per rate")
    ...
    ...     def update(self, x, u, p):
    ...         return (), (p.K * (u.reference - u.theta) - p.D * u.q,)
    >>> Hold({"K": 5.0}, rate=100).rate
    100.0
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
        values = values or {}
        initial = initial or {}
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
            {
                name: float(values.get(name, parameter.start))
                for name, parameter in self.parameters.items()
            },
            label,
        )
        self.initial = tuple(float(initial.get(name, 0.0)) for name in self.states)

    @abstractmethod
    def update(self, x: Any, u: Any, p: Any) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the states of the next sample and the outputs of this one, in the declared order.

        `x` has the states, `u` the inputs and setpoints, and `p` the parameter values, all by name.
        Use `gb.minimum`, `gb.where` and similar functions in the formula.
        """

    def outside(self, name: str) -> str:
        """Return the name in the loop of a signal of this controller."""
        return self.signals.get(name, name)

    @property
    def truth(self) -> dict[str, Any]:
        """Everything on which a flight with this controller depends, for the record's metadata."""
        return {
            "controller": type(self).__name__,
            "rate": self.rate,
            "values": dict(self.values),
            "signals": dict(self.signals),
            "initial": dict(zip(self.states, self.initial, strict=True)),
        }

    def __repr__(self) -> str:
        changed_values = {
            name: value
            for name, value in self.values.items()
            if value != self.parameters[name].start
        }
        arguments = []
        if changed_values:
            arguments.append(f"{changed_values}")
        if self.rate != type(self).rate:
            arguments.append(f"rate={self.rate:g}")
        if self.signals:
            arguments.append(f"signals={dict(self.signals)}")
        return f"{type(self).__name__}({', '.join(arguments)})"


# One controller, or several in the order in which they run.
Controllers = Controller | Sequence[Controller]


def updated(controller: Controller, x: ca.SX, u: Mapping[str, Any]) -> tuple[ca.SX, ca.SX]:
    """Return the next states (n,) and the outputs (m,) of a controller as expressions.

    `x` (n,) are its states, and `u` its inputs and setpoints by name.

    Raises
    ------
    ValueError
        If the formula cannot be compiled, or returns another number of values.
    """
    label = type(controller).__name__
    states = Names(entries_by_name(controller.states, x), f"{label}.states")
    signals = Names(u, f"{label}.inputs and setpoints")
    returned = traced(f"{label}.update", controller.update, states, signals, controller.values)
    pair = returned if isinstance(returned, tuple) and len(returned) == 2 else ((), ())
    next_states, outputs = (part if isinstance(part, Sequence) else () for part in pair)
    if (len(next_states), len(outputs)) != (len(controller.states), len(controller.outputs)):
        raise ValueError(
            f"{label}.update returns {returned!r:.60}: return two tuples, the next states "
            f"({', '.join(controller.states) or 'none'}) and the outputs "
            f"({', '.join(controller.outputs)})."
        )
    return column(f"{label}.update", next_states), column(f"{label}.update", outputs)


def outside_names(controllers: Sequence[Controller], *kinds: str) -> list[str]:
    """Return the names in the loop of all signals of these kinds, such as "setpoints"."""
    names = []
    for controller in controllers:
        for kind in kinds:
            names += map(controller.outside, getattr(controller, kind))
    return names


def connected(stated: Controllers | None, plant: str, system: Dynamics) -> tuple[Controller, ...]:
    """Return the controllers of a loop as a tuple, once they fit the plant and each other.

    Raises
    ------
    ValueError
        If nothing takes the outputs of a controller, if two signals have the same name, if the
        order is wrong, or if the rates differ.
    TypeError
        For anything but controllers.
    """
    cure = "an instance, as AttitudeController() or LinearLaw(control.tf(...), rate=400)"
    controllers = checked_items(
        "the controller", () if stated is None else stated, Controller, cure
    )
    inputs = system.inputs
    driven_by_plant = {*system.outputs, *system.states}
    driven: set[str] = set()
    for k, controller in enumerate(controllers):
        label = type(controller).__name__
        first = controllers[0]
        if controller.rate != first.rate:
            raise ValueError(
                f"{label} runs at {controller.rate:g} Hz, {type(first).__name__} at "
                f"{first.rate:g} Hz: use one rate."
            )

        provides = {*map(controller.outside, controller.outputs)}
        commanded = {*map(controller.outside, controller.setpoints)}
        read_next = outside_names(controllers[k + 1 :], "inputs", "setpoints")
        if not provides & {*inputs, *read_next}:
            raise ValueError(
                f"{label} gives {', '.join(map(controller.outside, controller.outputs))}, but "
                f"{plant} takes {', '.join(inputs) or 'none'}: connect them, "
                f"signals={{{controller.outputs[0]!r}: {(*inputs, 'u')[0]!r}}}."
            )

        # If two sources provided a signal, one would be overwritten without notice.
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
    """Run controllers in their order, and return the next states of each.

    Their outputs are added to `signals`, from which later controllers take inputs and setpoints.

    Parameters
    ----------
    controllers : sequence of Controller
    memory : sequence of (n,) expressions
        The states of each.
    measured : mapping of name to expression
        Signals of sensors.
    signals : dict of name to expression
        Other signals of the loop; changed in place. A setpoint that is not among them is zero.
    added : mapping of name to expression
        The excitation, which is added to outputs of the same name.
    """
    next_states = []
    for controller, state in zip(controllers, memory, strict=True):
        available = {**signals, **measured}
        u = {}
        for name in controller.inputs:
            u[name] = available[controller.outside(name)]
        for name in controller.setpoints:
            u[name] = signals.get(controller.outside(name), ca.SX(0))
        next_state, outputs = updated(controller, state, u)
        next_states.append(next_state)
        for k, name in enumerate(map(controller.outside, controller.outputs)):
            signals[name] = outputs[k] + added.get(name, 0)
    return next_states


def sensors_of(controllers: Sequence[Controller]) -> tuple[str, ...]:
    """Return the signals that controllers read from the plant.

    These are the inputs that no controller provides.
    """
    provided = outside_names(controllers, "outputs")
    names = outside_names(controllers, "inputs")
    return unique(name for name in names if name not in provided)
