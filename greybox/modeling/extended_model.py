"""An ODE with the states of another one and more, such as those of its sensors or of gusts."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace


class ExtendedModel(StateSpace):
    """An ODE that contains another one, with its inputs and outputs.

    Parameters
    ----------
    model : StateSpace
    states, parameters : sequence of str, mapping of name to Parameter
        Those that the model does not have.
    """

    def __init__(
        self, model: StateSpace, states: Sequence[str], parameters: Mapping[str, Parameter]
    ) -> None:
        self.model = model
        self.inputs, self.outputs = tuple(model.inputs), tuple(model.outputs)
        self.delays, self.units = model.delays, model.units
        self.states = (*model.states, *states)
        self.parameters = {**model.parameters, **parameters}
        # A name of the model would be overwritten silently.
        for name in (*states, *parameters):
            if name in (*model.parameters, *model.states, *model.inputs):
                raise ValueError(f"{model.label} already has {name!r}: rename it there.")

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Derived quantities of the model."""
        return self.model.derived
