"""Ordinary differential equations, x' = f(x, u, p), and static models, which have no states."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from greybox.data.files.argument_checks import is_finite_number
from greybox.modeling.declaration import require_signal_names
from greybox.modeling.model import Model, ParameterFormula, require_known


class StateSpace(Model):
    """An ODE ``x' = derivative(x, u, p)``, ``y = output(x, u, p)``, e.g. equation (4.23).

    A subclass declares `states`, `inputs` and `outputs`, `delays` (input name to the name of the
    parameter that delays it), its parameters, `derivative` and `output`, and, for records in other
    units to be refused, the `units` of its signals. With ``states = ()`` it is a static model and
    needs no derivative.

    It may declare ``trim(self, at, p)``, which returns the remaining states and inputs at the
    operating point `at` by name; without it they follow from ``derivative = 0``.

    `state_starts` (state to value, or to a function of the parameters) says where its states begin
    in a search, as ``starts`` does of a parameter: one for the first entry of a quaternion, a level
    above zero for a tank. Outputs that show a state, and initial states that a criterion knows,
    come first. By default a state begins at zero.

    A delayed input is known before the record only if it rests at the beginning. If it moves, a fit
    leaves out as many seconds there as the upper bound of its delay, so give delays tight upper
    bounds (see `TimeCriterion`).

    Examples
    --------
    >>> class Spring(gb.StateSpace):
    ...     states, inputs, outputs = ("x", "v"), ("F",), ("x",)
    ...     units = {"x": "m", "v": "m/s", "F": "N"}
    ...     k = gb.Parameter(9.0, bounds=(0.1, 100), unit="N/m")
    ...     d = gb.Parameter(0.5, bounds=(0, 10), unit="N s/m")
    ...
    ...     def derivative(self, x, u, p):
    ...         return x.v, u.F - p.k * x.x - p.d * x.v  # a mass of 1 kg
    ...
    ...     def output(self, x, u, p):
    ...         return (x.x,)
    >>> at_resonance = gb.frequency_response(Spring(), {"k": 4.0, "d": 0.5}, omega=[2.0])
    >>> abs(at_resonance.response).round(4)  # 1 / (d omega)
    array([1.])
    """

    states: Sequence[str] = ()
    inputs: Sequence[str] = ("u",)
    outputs: Sequence[str] = ("y",)
    delays: Mapping[str, str] = MappingProxyType({})
    state_starts: Mapping[str, float | ParameterFormula] = MappingProxyType({})

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Check the signal names of the declaration."""
        super().__init_subclass__(**kwargs)
        require_signal_names(cls, "states", "inputs", "outputs")

        # Neither formulas nor data could distinguish them.
        twice = {*cls.states, *cls.outputs} & set(cls.inputs)
        if twice:
            raise ValueError(
                f"{cls.__name__} has {twice.pop()!r} as input and as state or output: use two "
                "names."
            )

        require_known(cls.state_starts, cls.states, "state", f"{cls.__name__}.states")
        for name, value in cls.state_starts.items():
            if not (callable(value) or is_finite_number(value)):
                raise ValueError(
                    f"{cls.__name__}.state_starts[{name!r}] is {value!r}: give a finite number or "
                    "a function of the parameters, such as lambda p: p.h_0."
                )
        late = [name for name in cls.delays if name in cls.outputs]
        if late:
            y = late[0]
            raise ValueError(
                f"{cls.__name__}.delays delays inputs, and {y!r} is an output: for a late sensor, "
                f"add a state {y}_late with the derivative 2 * ({y} - x.{y}_late) / p.T, and give "
                f"2 * x.{y}_late - {y} as the output, where {y} is what the sensor shows without "
                "its latency p.T (a Padé approximation, for signals slower than 1 / p.T)."
            )
        require_known(cls.delays, cls.inputs, "input", f"{cls.__name__}.inputs")
        require_known(cls.delays.values(), cls.parameters, "parameter", cls.__name__)
        if cls.states and cls.derivative is StateSpace.derivative:
            raise TypeError(
                f"{cls.__name__} has states but no derivative(self, x, u, p): declare it."
            )

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the time derivative of every state, in the order of `states`."""
        return ()

    @abstractmethod
    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return every output, in the order of `outputs`."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.states)

    @property
    def resting_signals(self) -> tuple[str, ...]:
        """States, then inputs."""
        return (*self.states, *self.inputs)

    @property
    def is_static(self) -> bool:
        """True for a model without states and delays."""
        return not self.states and not self.delays

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.outputs)


def input_delays(model: StateSpace, p: Mapping[str, Any]) -> dict[str, Any]:
    """Return the delay of every input, s, at parameters by name; zero where it has none."""
    return {i: p[model.delays[i]] if i in model.delays else 0.0 for i in model.inputs}
