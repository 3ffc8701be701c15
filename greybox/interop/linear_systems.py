"""A model and its values as polynomials in s, as matrices, and as an ODE with numbers in it."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.estimate.result import Fit
from greybox.files.arrays import Array, ArrayPair, Values, by_name
from greybox.modeling.linearization import LinearSystem, linearize
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import pade_steady
from greybox.modeling.rational import rational
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.state_space import StateSpace


@dataclass(frozen=True)
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

    def converted(
        self, kind: str | None, pade: int | None, input: str, output: str
    ) -> ArrayPair | LinearSystem:
        """Return the polynomials of a "transfer-function", or the matrices of a "state-space"."""
        # As declared: a conversion would lose the meaning of states, or the form of a ratio.
        default = "state-space" if isinstance(self.model, StateSpace) else "transfer-function"
        if kind not in (None, "transfer-function", "state-space"):
            raise ValueError(f"kind is {kind!r:.40}: give 'transfer-function' or 'state-space'.")
        if (kind or default) == "state-space":
            return self.matrices(pade)
        return self.polynomials(pade, input, output)

    def polynomials(self, pade: int | None, input: str, output: str) -> ArrayPair:
        """Return numerator and denominator, highest power of s first."""
        input, output = pick_signals(self.model, input, output)
        # Order 0 leaves the delay out: the ratio is then exact for the model without delay.
        order = pade or None
        ratio = rational(
            self.model, self.values, input=input, output=output, at=self.at, pade=order
        )
        if pade != 0:
            self._require_no_delay({input: float(ratio.delay)})

        return np.array(ratio.numerator, dtype=float), np.array(ratio.denominator, dtype=float)

    @one_thread_at_a_time
    def matrices(self, pade: int | None) -> LinearSystem:
        """Return the linearized system, with states for delays if `pade` is an order."""
        system, p = self.ode(pade)
        point = dict.fromkeys((*system.states, *system.inputs), 0.0)
        if self.model.resting_signals:
            point |= linearize(self.model, self.values, self.at).point  # type: ignore[arg-type]

        for name in system.inputs:
            if f"{name}_delay_0" in system.states:
                # At rest the delayed input equals the input. Other states of the delay would make
                # this another operating point, with other Jacobians.
                for k, value in enumerate(pade_steady(point[name], pade or 0)):
                    point[f"{name}_delay_{k}"] = value

        x, u, _ = system.symbols
        formulas = (system.derivative(x, u, p), system.output(x, u, p))
        jacobians = [ca.jacobian(formula, z) for formula in formulas for z in (x, u)]
        at_point = [[point[name] for name in names] for names in (system.states, system.inputs)]
        return LinearSystem(
            *(e.full() for e in ca.Function("linear", [x, u], jacobians)(*at_point)),
            states=system.states,
            inputs=system.inputs,
            outputs=system.outputs,
            delays=system.delay(p).full().ravel(),
            point=point,
        )

    def ode(self, pade: int | None) -> tuple[Dynamics, Array]:
        """Return the ODE, with states for delays of order `pade`, and its parameters (p,)."""
        # Without an order the delays stay outside the ODE, and are checked below.
        system = dynamics(self.model, pade or None)
        p = np.array([*self.values.values()], dtype=float)
        delays = system.delay(p).full().ravel().tolist()
        if pade is None:
            self._require_no_delay(by_name(system.inputs, delays))
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
        estimate = thing.at_estimate(part=part)
        fitted = thing.parts[part]
        model = thing.model_of(part)
        values = {
            name: float(v)
            for name, v in zip(estimate.names, estimate.q, strict=True)
            if name in model.parameters
        }
        if at is None:
            at = dict(fitted.at)
        return GivenModel(model, values, at, thing.name)

    if isinstance(thing, Model):
        return GivenModel(thing, dict(thing.values(values)), at or {})
    raise TypeError(
        f"{thing!r:.60} cannot be converted: give a Fit, a model with its values, or a "
        "FrequencyResponse."
    )
