"""An ODE with states, parameters or terms that its declaration does not have."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from greybox.modeling.parameter import Parameter
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import as_list

Formula = Callable[[Any, Any, Any], Any]
"""A term as a function of states, inputs and parameters, ``lambda x, u, p: ...``."""


class ExtendedModel(StateSpace):
    """An ODE with further states and parameters."""

    def __init__(
        self, model: StateSpace, states: Sequence[str], parameters: Mapping[str, Parameter]
    ) -> None:
        self.model, self.derived = model, model.derived  # type: ignore[misc]
        self.states = (*model.states, *states)
        self.inputs, self.outputs = tuple(model.inputs), tuple(model.outputs)
        self.delays, self.units = model.delays, model.units
        self.parameters = {**model.parameters, **parameters}

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the outputs of the model."""
        return self.model.output(x, u, p)


class AddedTerms(ExtendedModel):
    """An ODE whose derivatives get terms, and outputs that have these derivatives in them.

    Parameters
    ----------
    model : StateSpace
    terms : mapping of parameter to (state, Formula, mapping of str to float, float)
        The factor of each term, in which derivative it is, how often it is in outputs, such as
        accelerations, and the size of the factor: starts are drawn up to twice it.
    """

    def __init__(
        self,
        model: StateSpace,
        terms: Mapping[str, tuple[str, Formula, Mapping[str, float], float]],
    ) -> None:
        self.terms = terms
        factors = {
            name: Parameter(0.0, starts=(-2 * abs(size), 2 * abs(size)))
            for name, (*_, size) in terms.items()
        }
        super().__init__(model, (), factors)

    @property
    def label(self) -> str:
        """The model and what is added."""
        return f"{self.model.label} with {', '.join(self.terms)}"

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the derivatives of the model with the terms."""
        rates = dict(zip(self.states, as_list(self.model.derivative(x, u, p)), strict=True))
        for name, (state, formula, *_) in self.terms.items():
            rates[state] = rates[state] + p[name] * formula(x, u, p)
        return [*rates.values()]

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the outputs of the model with the terms."""
        outputs = dict(zip(self.outputs, as_list(super().output(x, u, p)), strict=True))
        for parameter, (_, formula, factors, _) in self.terms.items():
            for name, factor in factors.items():
                outputs[name] = outputs[name] + factor * p[parameter] * formula(x, u, p)
        return [*outputs.values()]
