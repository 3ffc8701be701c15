"""An ODE with states, parameters or terms that its declaration does not have."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, sum_of_squares
from greybox.modeling.parameter import Parameter, Parameters, start_values
from greybox.modeling.realization import dynamics
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import as_list
from greybox.modeling.traced_once import once

# A term as a function of states, inputs and parameters, ``lambda x, u, p: ...``.
Formula = Callable[[Any, Any, Any], Any]

POINTS = 8  # at which formulas are compared: at one of them, slopes may be zero by chance


class ExtendedModel(StateSpace):
    """An ODE with further states and parameters, which add to its derivatives.

    A term that adds to a derivative also adds to the outputs that contain it, such as
    accelerations.
    """

    def __init__(self, model: StateSpace, states: Sequence[str], parameters: Parameters) -> None:
        self.model, self.derived = model, model.derived  # type: ignore[misc]
        self.states = (*model.states, *states)
        self.inputs, self.outputs = tuple(model.inputs), tuple(model.outputs)
        self.delays = model.delays
        self.units = model.units
        self.parameters = {**model.parameters, **parameters}

    def additions(self, x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        """Return what adds to derivatives of the model, by state."""
        return {}

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the derivatives of the model with what adds to them."""
        more = self.additions(x, u, p)
        rates = as_list(self.model.derivative(x, u, p))
        return [
            rate + more.get(state, 0.0)
            for state, rate in zip(self.model.states, rates, strict=True)
        ]

    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the outputs of the model with what adds to the derivatives in them."""
        more = self.additions(x, u, p)
        outputs = as_list(self.model.output(x, u, p))
        for state, column in zip(self.model.states, _factors(self.model).T.tolist(), strict=True):
            if state in more:
                outputs = [y + k * more[state] for y, k in zip(outputs, column, strict=True)]
        return outputs


def factors_of_derivatives(derivatives: Array, outputs: Array) -> Array:
    """Return the factors (k, n) with which outputs have derivatives of states in them.

    An output has a derivative in it if all parameters and inputs of the derivative change both
    alike.

    Parameters
    ----------
    derivatives : (n, m, s) array
        Slopes of the derivatives with respect to m parameters and inputs, at s points.
    outputs : (k, m, s) array
        Slopes of the outputs, likewise.
    """
    factors = np.zeros((len(outputs), len(derivatives)))
    for i, slopes in enumerate(derivatives):
        used = slopes.any(axis=1)
        rate, changes = slopes[used], outputs[:, used]
        factor = np.einsum("cs,kcs->k", rate, changes) / max(sum_of_squares(rate), 1e-300)
        difference = np.abs(changes - factor[:, None, None] * rate).max(axis=2)
        alike = np.all(difference <= 1e-9 * np.abs(changes).max(axis=2), axis=1)
        factors[:, i] = np.where(alike, np.round(factor, 12), 0.0)
    return factors


@once
def _factors(model: StateSpace) -> Array:
    random = np.random.default_rng(0)
    n = len(model.states)
    start = start_values(model.parameters)
    near = random.uniform(0.9, 1.1, (len(start), POINTS)) * start[:, None]
    x, u = np.split(random.normal(size=(n + len(model.inputs), POINTS)), [n])
    slopes = dynamics(model).slopes(x, u, near)
    # A formula may have no value at some of the points, as a root has none below zero.
    slopes = slopes[..., np.isfinite(slopes).all(axis=(0, 1))]
    return factors_of_derivatives(slopes[:n], slopes[n:])


class AddedTerms(ExtendedModel):
    """An ODE whose derivatives get terms.

    Parameters
    ----------
    model : StateSpace
    terms : mapping of parameter to (state, Formula, float)
        The factor of each term, in which derivative it is, and the size of the factor: starts are
        drawn up to twice it.
    """

    def __init__(self, model: StateSpace, terms: Mapping[str, tuple[str, Formula, float]]) -> None:
        self.terms = terms
        factors = {
            name: Parameter(0.0, starts=(-2 * abs(size), 2 * abs(size)))
            for name, (_, _, size) in terms.items()
        }
        super().__init__(model, (), factors)

    @property
    def label(self) -> str:
        """The model and what is added."""
        return f"{self.model.label} with {', '.join(self.terms)}"

    def additions(self, x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        """Return the terms of every derivative."""
        sums: dict[str, Any] = {}
        for name, (state, formula, _) in self.terms.items():
            sums[state] = sums.get(state, 0.0) + p[name] * formula(x, u, p)
        return sums
