"""One form for every model in the time domain: an ODE driven by delayed inputs."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.modeling.model import Model
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import pade_rows, pade_steady, pade_step
from greybox.modeling.parameter import start_values
from greybox.modeling.rational import Rational, as_rational
from greybox.modeling.state_space import StateSpace, input_delays
from greybox.modeling.symbolic_reading import (
    as_column,
    parameter_names,
    require_no_nan,
    state_starts,
    symbols,
    traced,
    traced_column,
)
from greybox.modeling.transfer_function import TransferFunction


@frozen
class Dynamics:
    """``x' = derivative(x, u(t - delay), p)``, ``y = output(x, u(t - delay), p)``.

    Attributes
    ----------
    states, inputs, outputs, parameters : tuple of str
        Names, in the order of the vectors. States of a Padé delay are named after their input,
        states of a realized transfer function after its output.
    derivative : casadi.Function
        (x, u, p) -> derivatives of the states (n,).
    output : casadi.Function
        (x, u, p) -> outputs (k,).
    delay : casadi.Function
        (p) -> the delay of every input (m,), s; zero if states approximate it.
    starts : casadi.Function
        (p) -> initial states (n,) at which a search begins, by default zero.
    undelayed : Dynamics or None
        The model that the delayed inputs drive, if states with an exact solution approximate the
        delays. Its states come first.
    delay_step : casadi.Function
        (states of delays, inputs (m,) at the beginning of a step, their slopes, p, step) -> states
        of delays at the end of the step, delayed inputs, and their slopes, see `pade_step`.
    delay_rest : casadi.Function
        (inputs) -> the states of delays after inputs that have always been constant.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    derivative: ca.Function
    output: ca.Function
    delay: ca.Function
    starts: ca.Function
    undelayed: "Dynamics | None" = None
    delay_step: ca.Function = ca.Function()
    delay_rest: ca.Function = ca.Function()

    @property
    def symbols(self) -> list[ca.SX]:
        """Symbols of states (n,), inputs (m,) and parameters."""
        return self.output.sx_in()

    @property
    def delayed(self) -> bool:
        """True if some input has a delay."""
        return not self.delay(self.symbols[2]).is_zero()

    @one_thread_at_a_time
    def slopes(self, x: Array, u: Array, p: Array) -> Array:
        """Return the slopes of derivatives and outputs, (n + k, p + m, samples).

        They are the partial derivatives by the parameters, then by the inputs. All arguments have
        samples last, or one column for all samples.
        """
        symbols = self.symbols
        formulas = ca.vertcat(self.derivative(*symbols), self.output(*symbols))
        _, inputs, parameters = symbols
        slopes = ca.jacobian(formulas, ca.vertcat(parameters, inputs))
        # Only the nonzero entries are evaluated: most are always zero, and to evaluate them would
        # take most of the time.
        values = ca.Function("slopes", symbols, [ca.vec(slopes.nz[:])])(x, u, p).full()
        result = np.zeros((*slopes.shape, values.shape[1]))
        result[tuple(slopes.sparsity().get_triplet())] = values
        return result

    def observed(self, outputs: tuple[str, ...]) -> "Dynamics":
        """Return the same dynamics with only these outputs."""
        rows = [self.outputs.index(name) for name in outputs]
        values = self.output(*self.symbols)[rows]
        return replace(self, outputs=outputs, output=ca.Function("output", self.symbols, [values]))

    def later(self, seconds: Sequence[float]) -> "Dynamics":
        """Return the same dynamics with inputs that act later by these times (m,), s."""
        # The same object has the same functions, which are then compiled only once.
        if not any(seconds):
            return self
        _, _, p = self.symbols
        return replace(
            self, delay=ca.Function("delay", [p], [self.delay(p) + ca.DM(list(seconds))])
        )


@one_thread_at_a_time
def dynamics(model: Model, pade: int | None = None) -> Dynamics:
    """Return the dynamics of a model; with an order `pade`, states approximate the delays.

    A transfer function is realized in observer canonical form, in a unit of time that follows from
    its poles at the start values.

    Raises
    ------
    ValueError
        If a transfer function has no rational form (a loop around an exact delay), or is improper.
    """
    z, p = symbols(model)
    if isinstance(model, TransferFunction):
        whole = _realized(model, p, pade)
        # A delay in series with a rational function has states of its own, with an exact solution.
        # A delay inside a loop has not, and raises ValueError.
        with suppress(ValueError):
            cascade = _with_pade_states(_realized(model, p, None), pade)
            # A product of two delays has more states: each delay is approximated, and not the sum.
            if len(cascade.states) == len(whole.states):
                return cascade
        return whole

    assert isinstance(model, StateSpace)
    # `vertsplit` instead of slices: an empty slice of a single symbol would have one row.
    x, u = ca.vertsplit(z, [0, len(model.states), z.numel()])
    values = parameter_names(model, p)
    delays = input_delays(model, values).values()
    f = traced_column(model, "derivative", z, p)

    return _with_pade_states(
        Dynamics(
            states=model.state_names,
            inputs=model.input_names,
            outputs=model.output_names,
            parameters=tuple(model.parameters),
            **_functions(x, u, p, f, traced_column(model, "output", z, p), ca.vertcat(*delays)),
            starts=ca.Function("starts", [p], [as_column(state_starts(model, values))]),
        ),
        pade,
    )


def _realized(model: TransferFunction, p: ca.SX, pade: int | None) -> Dynamics:
    """Return a transfer function as states, with Padé approximations of this order inside loops."""
    s = Rational([1.0, 0.0], pade=pade)
    formula = traced(f"{model.label}.response", model.response, s, parameter_names(model, p))
    rational = as_rational(formula)
    n = len(rational.denominator) - 1
    improper = len(rational.numerator) - 1
    if improper > n:
        raise ValueError(
            f"{model.label} is improper (its numerator has degree {improper}, its "
            f"denominator {n}), which no ODE can represent: fit the integral of its output, or add "
            "the lag of the measurement."
        )

    # Time is measured in a unit that makes the poles about one. In seconds, the coefficients of a
    # fast system of order n, and so its states, would differ by the n-th power of its poles. Any
    # unit is correct; this one is the geometric mean of the poles at the start values.
    values = ca.Function("a", [p], [ca.vertcat(*rational.denominator)])
    coefficients = values(start_values(model.parameters)).full().ravel()
    poles = np.abs(np.roots(coefficients)) if all_finite(coefficients) else np.zeros(0)
    # Smaller poles are integrators, apart from rounding errors of the roots.
    poles = poles[poles > 1e-9]
    scale = float(np.exp(np.mean(np.log(poles)))) if poles.size else 1.0
    unit = rational.denominator[0] * scale ** np.arange(n + 1)
    a = ca.vertcat(*rational.denominator) / unit
    b = ca.vertcat(ca.SX.zeros(n - improper), *rational.numerator) / unit
    # The states of the observer canonical form are always observable. Source: Kailath (1980),
    # Linear Systems, section 2.1.
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", 1)
    y = (x[0] if n else 0) + b[0] * u
    f = scale * (ca.vertcat(x, 0)[1:, 0] - a[1:, 0] * y + b[1:, 0] * u)
    for expression in (f, y):
        require_no_nan(f"{model.label}.response", ca.SX(expression))

    return Dynamics(
        states=tuple(f"{model.output}_{k}" for k in range(n)),
        inputs=(model.input,),
        outputs=(model.output,),
        parameters=tuple(model.parameters),
        **_functions(x, u, p, f, y, ca.SX(rational.delay)),
        starts=ca.Function("starts", [p], [ca.SX.zeros(n)]),
    )


def _functions(
    x: ca.SX, u: ca.SX, p: ca.SX, derivative: ca.SX, output: ca.SX, delay: ca.SX
) -> dict[str, Any]:
    """Return the functions of `Dynamics` by name, from their expressions in x, u and p."""
    return {
        "derivative": ca.Function("derivative", [x, u, p], [derivative]),
        "output": ca.Function("output", [x, u, p], [output]),
        "delay": ca.Function("delay", [p], [delay]),
    }


def _with_pade_states(exact: Dynamics, pade: int | None) -> Dynamics:
    """Return the dynamics with states of Padé approximations in place of delays.

    Without an order `pade`, or without delays, they are unchanged.
    """
    if pade is None or not exact.delayed:
        return exact
    x, u, p = exact.symbols
    slope, h = ca.SX.sym("slope", u.numel()), ca.SX.sym("step")
    delays = ca.vertsplit(exact.delay(p))
    names = list(exact.states)
    states = []
    rests = []
    derivatives = []
    delayed_inputs = []
    # Of every input: states of its delay after a step, the delayed input, and its slope.
    steps: list[tuple[Any, Any, Any]] = []
    for k, name in enumerate(exact.inputs):
        # An input without a delay needs no states.
        if delays[k].is_zero():
            delayed_inputs.append(u[k])
            steps.append((ca.SX(0, 1), u[k], slope[k]))
            continue
        state = ca.SX.sym(f"delay_{name}", pade)
        delayed_input, derivative = pade_rows(ca.vertsplit(state), u[k], delays[k], pade)
        names += [f"{name}_delay_{i}" for i in range(pade)]
        states.append(state)
        rests += pade_steady(u[k], pade)
        derivatives += derivative
        delayed_inputs.append(delayed_input)
        steps.append(pade_step(state, u[k], slope[k], delays[k], h))

    full = ca.vertcat(x, *states)
    delayed = ca.vertcat(*delayed_inputs)
    next_states, next_inputs, next_slopes = map(ca.vertcat, *steps)
    delay_step = ca.Function(
        "delay_step",
        [ca.vertcat(*states), u, slope, p, h],
        [next_states, next_inputs, next_slopes],
    )
    initial_states = ca.vertcat(exact.starts(p), ca.SX.zeros(len(derivatives)))
    return replace(
        exact,
        states=tuple(names),
        **_functions(
            full,
            u,
            p,
            ca.vertcat(exact.derivative(x, delayed, p), *derivatives),
            exact.output(x, delayed, p),
            ca.SX.zeros(u.numel()),
        ),
        starts=ca.Function("starts", [p], [initial_states]),
        # Beyond order 6, rounding errors of `pade_step` exceed 1e-7 for a delay of 8000 steps.
        undelayed=exact if pade <= 6 else None,
        delay_step=delay_step,
        delay_rest=ca.Function("delay_rest", [u], [ca.vertcat(*rests)]),
    )
