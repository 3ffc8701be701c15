"""An ODE with disturbances on its derivatives that have states of their own, such as gusts."""

from collections.abc import Mapping, Sequence
from typing import Any

from greybox.data.files.arrays import Interval
from greybox.modeling.added_terms import ExtendedModel
from greybox.modeling.disturbance import DISTURBANCES, Disturbance, disturbance
from greybox.modeling.formula_arguments import Names
from greybox.modeling.model import Model, require_known
from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace


class ColoredDisturbance(ExtendedModel):
    """An ODE whose derivatives have disturbances with states of their own.

    A disturbance adds to the derivative of its state, and to outputs that have this derivative in
    them, such as an acceleration.

    Parameters
    ----------
    model : StateSpace
    disturbed : (state, (low, high))
        A tuple for each disturbed state, with the sample and the duration of the record, s.
    own : mapping of state to Disturbance, optional
        The disturbances that are not first-order gusts.
    """

    def __init__(
        self,
        model: StateSpace,
        *disturbed: tuple[str, Interval],
        own: Mapping[str, Disturbance] | None = None,
    ) -> None:
        self.disturbances: dict[str, Disturbance] = {
            state: (own or {}).get(state, DISTURBANCES["colored"]) for state, _ in disturbed
        }
        require_known([*self.disturbances], model.states, "state", model.label)
        self._parameters_of = {
            state: self.disturbances[state].parameters(state, times) for state, times in disturbed
        }
        states, parameters = list[str](), dict[str, Parameter]()
        for state, color in self.disturbances.items():
            states += [named(name, state) for name in color.states]
            for name, parameter in self._parameters_of[state].items():
                parameters[named(name, state)] = parameter

        super().__init__(model, states, parameters)
        # A name of the model would be overwritten silently.
        for name in (*states, *parameters):
            if name in (*model.parameters, *model.states, *model.inputs):
                raise ValueError(f"{model.label} already has {name!r}: rename it there.")

    @property
    def label(self) -> str:
        """The model and which states are disturbed."""
        return f"{self.model.label}, disturbed {', '.join(self.disturbances)}"

    def additions(self, x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        """Return what each disturbance adds to the derivative of its state."""
        return {
            state: color.addition(*self._short(state, x, p))
            for state, color in self.disturbances.items()
        }

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the derivatives of the model's states, then those of the disturbances."""
        rates = [*super().derivative(x, u, p)]
        for state, color in self.disturbances.items():
            rates += color.derivative(*self._short(state, x, p))
        return rates

    def _short(self, state: str, x: Any, p: Any) -> tuple[Names, Names]:
        """Return the states and parameters of a disturbance by their short names."""
        states = {name: x[named(name, state)] for name in self.disturbances[state].states}
        values = {name: p[named(name, state)] for name in self._parameters_of[state]}
        return Names(states), Names(values)


def named(name: str, state: str) -> str:
    """Return the name in the model of a state or parameter of the disturbance of a state."""
    return f"{name}_{state}"


def driven_by(stated: Mapping[str, str | Disturbance]) -> tuple[str, ...]:
    """Return the states of disturbances that white noise drives."""
    return tuple(
        named(name, state) for state, color in stated.items() for name in disturbance(color).driven
    )


def undisturbed(model: Model) -> Model:
    """Return the model without colored disturbances."""
    return model.model if isinstance(model, ColoredDisturbance) else model
