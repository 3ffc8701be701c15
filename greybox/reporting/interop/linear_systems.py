"""A model and its values as polynomials in s, as matrices, and as an ODE with numbers in it."""

import warnings
from typing import Any

import casadi as ca
import numpy as np

from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.modeling.linearization import linearize
from greybox.modeling.model import Model, require_operating_point
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.rational import rational
from greybox.modeling.realization import Dynamics, dynamics


@frozen
class GivenModel:
    """What is converted: a model with the values of its parameters.

    Attributes
    ----------
    model : Model
    values : mapping of name to float
    at : mapping of name to float
        The operating point of its linearization.
    name : str
        Name of the fit, empty without one.
    """

    model: Model
    values: Values
    at: Values
    name: str = ""

    def polynomials(
        self, pade: int | None, input: str, output: str
    ) -> tuple[list[float], list[float]]:
        """Return numerator and denominator, highest power of s first."""
        # Order 0 leaves the delay out: the ratio is then exact for the model without delay.
        ratio = rational(
            self.model, self.values, input=input, output=output, at=self.at, pade=pade or None
        )
        if pade != 0:
            self._require_no_delay({input: float(ratio.delay)})

        return ratio.numerator, ratio.denominator

    @one_thread_at_a_time
    def matrices(self, pade: int | None) -> tuple[Dynamics, list[Array]]:
        """Return the ODE, with states for delays if `pade` is an order, and its A, B, C, D."""
        system, p = self.ode(pade)
        point = dict.fromkeys((*system.states, *system.inputs), 0.0)
        if self.at and {*self.at} == {*self.model.resting_signals}:
            require_operating_point(self.model, self.at)
            point |= {name: float(value) for name, value in self.at.items()}
            self._warn_of_motion(system, p, point)
        elif self.model.resting_signals:
            point |= linearize(self.model, self.values, self.at).point  # type: ignore[arg-type]
        if not system.delay_rest.is_null():
            # At rest the delayed input equals the input. Other states of the delay would make this
            # another operating point, with other Jacobians.
            rest = system.delay_rest([point[name] for name in system.inputs]).full().ravel()
            point |= dict(zip(system.states[-rest.size :], rest.tolist(), strict=True))

        x, u, _ = system.symbols
        formulas = (system.derivative(x, u, p), system.output(x, u, p))
        jacobians = [ca.jacobian(formula, z) for formula in formulas for z in (x, u)]
        at_point = [[point[name] for name in names] for names in (system.states, system.inputs)]
        return system, [
            matrix.full() for matrix in ca.Function("linear", [x, u], jacobians)(*at_point)
        ]

    def _warn_of_motion(self, system: Dynamics, p: Array, point: Values) -> None:
        """Warn that the matrices are about a motion if the point is no equilibrium."""
        own = self.model.state_names
        x = [point[name] for name in system.states]
        rates = np.asarray(system.derivative(x, [point[n] for n in system.inputs], p), dtype=float)
        moving = {n: r for n, r in zip(own, rates.ravel().tolist(), strict=False) if abs(r) > 1e-9}
        if moving:
            name, rate = max(moving.items(), key=lambda item: abs(item[1]))
            warnings.warn(
                f"{self.model.label} does not rest at this point (the derivative of {name!r} is "
                f"{rate:.3g}): the matrices are for small deviations from its motion there. Leave "
                "out states or inputs of `at` to get the equilibrium.",
                stacklevel=5,
            )

    def ode(self, pade: int | None) -> tuple[Dynamics, Array]:
        """Return the ODE, with states for delays of order `pade`, and its parameters (p,)."""
        # Without an order the delays stay outside the ODE, and are checked below.
        system = dynamics(self.model, pade or None)
        p = np.array([*self.values.values()], dtype=float)
        delays = system.delay(p).full().ravel().tolist()
        if pade is None:
            self._require_no_delay(dict(zip(system.inputs, delays, strict=True)))
        return system, p

    def _require_no_delay(self, delays: Values) -> None:
        for name, delay in delays.items():
            if delay:
                raise ValueError(
                    f"{self.model.label} delays {name} by {delay:.4g} s, which the result cannot "
                    "hold: give pade=3 for a Padé approximation of that order, or pade=0 to leave "
                    "it out."
                )


def given_model(thing: Any, values: Values | None, at: Values | None, part: int = 0) -> GivenModel:
    """Return the model of a `Fit` at its estimate, or a model with values of its parameters.

    Raises
    ------
    TypeError
        For anything else, and for values given with a fit.
    ValueError, LookupError
        If the fit has no estimate, or is loaded and does not know its model.
    """
    if isinstance(thing, Fit):
        if values is not None:
            raise TypeError(
                "values were given with a Fit, which has its own: leave them out, or give the "
                "model."
            )
        thing.require_estimate()
        model = thing.model_of(part)
        fitted = thing.parts[part]
        values = {name: thing.estimate[fitted.outside(name)] for name in model.parameters}
        return GivenModel(model, values, fitted.at if at is None else at, thing.name)

    if isinstance(thing, Model):
        return GivenModel(thing, dict(thing.values(values)), at or {})
    raise TypeError(
        f"{thing!r:.60} cannot be converted: give a Fit, a model with its values, or a "
        "FrequencyResponse."
    )
