"""The operating point of an ODE, where its derivative is zero, as a function of the parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.argument_checks import is_finite_number
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.modeling.formula_arguments import Names
from greybox.modeling.model import Model, require_operating_point
from greybox.modeling.parameter import start_values
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import (
    column,
    derivative_function,
    input_symbols,
    parameter_names,
    state_starts,
    symbols,
    traced,
)
from greybox.modeling.traced_once import once

TOLERANCE = 1e-9  # on the derivative at an operating point, relative to its states and inputs


@frozen
class Trimmed:
    """A function that depends on an operating point, in two steps.

    Only the first step, which finds the operating point, is an iteration.

    Attributes
    ----------
    root : casadi.Function or None
        (p) -> the unknown states and inputs w, from ``derivative = 0`` by Newton's method. None
        without unknowns; w is then empty.
    function : casadi.Function
        (p, w, ...) -> the result, an SX function or one mapped over frequencies. Its first and
        second derivatives by p, with w held constant, are those at the operating point, because it
        contains two further steps of Newton's method: one step from a root has the first
        derivatives of the root, a second step also the second ones. This takes a fraction of the
        time of CasADi's derivatives through its root finder.
    """

    root: ca.Function | None
    function: ca.Function

    def closed(self) -> ca.Function:
        """Return the function of (p, ...), which finds the operating point itself."""
        symbols: Any = self.function.mx_in() if self.root else input_symbols(self.function)
        p, w, *arguments = symbols
        w = w if self.root is None else self.root(p)
        results = self.function.call([p, w, *arguments])
        return ca.Function(self.function.name(), [p, *arguments], results)


@once
def trim_of(model: Model, at: Values) -> Trimmed:
    """Return states and inputs at the operating point `at` as functions of the parameters.

    A transfer function has no states; its input is zero. The point of an ODE is the first of these
    that applies:

    1. the result of the model's own `trim`;
    2. the origin, or the states where the model declares that they begin, if this is an equilibrium
       for all parameter values. A hover, where ``C_x |v| v = 0`` has a double root, then has finite
       derivatives;
    3. the solution of ``derivative = 0``, differentiated by the implicit function theorem.

    Raises
    ------
    ValueError
        For a name in `at` that is neither a state nor an input, or if these values do not determine
        an operating point.
    """
    require_operating_point(model, at)
    for name, value in at.items():
        if not is_finite_number(value):
            raise ValueError(f"at[{name!r}] is {value!r}: give a finite number.")

    p = ca.SX.sym("p", len(model.parameters))
    if model.trim is not None:
        return _own_trim(model, at, p)
    if not isinstance(model, StateSpace) or not model.states:
        return _closed_form(model, p, [at.get(name, 0.0) for name in model.input_names])

    starts = dict(zip(model.states, state_starts(model, parameter_names(model, p)), strict=True))
    point = [at.get(name, starts.get(name, 0.0)) for name in model.resting_signals]
    at_rest = _closed_form(model, p, point)
    if _is_equilibrium(model, at_rest):
        return at_rest

    return _implicit_trim(model, at)


def _is_equilibrium(model: StateSpace, trim: Trimmed) -> bool:
    """Return whether a point is an equilibrium for all parameters, judged by eight random draws."""
    derivative = derivative_function(model)
    random = np.random.default_rng(0)
    for _ in range(8):
        values = [parameter.draw(random) for parameter in model.parameters.values()]
        point = ca.vertcat(*trim.function(values, []))
        if not np.all(np.abs(derivative(point, values).full()) < 1e-12):
            return False
    return True


def _closed_form(model: Model, p: ca.SX, point: Sequence[Any]) -> Trimmed:
    """Return a point, states and then inputs as expressions of p, as an operating point."""
    n = len(model.state_names)
    owner = f"{model.label}.trim"
    return Trimmed(
        None,
        ca.Function("trim", [p, ca.SX(0, 1)], [column(owner, point[:n]), column(owner, point[n:])]),
    )


def _own_trim(model: Model, at: Values, p: ca.SX) -> Trimmed:
    """Return the operating point that the model's own `trim` states, and check it at the starts."""
    assert model.trim is not None
    returned = traced(f"{model.label}.trim", model.trim, Names(at, "at"), parameter_names(model, p))
    if not isinstance(returned, Mapping):
        raise ValueError(
            f"{model.label}.trim returns {returned!r:.60}: return the other states and inputs by "
            "name."
        )

    require_operating_point(model, returned)
    values = {**returned, **at}
    trim = _closed_form(model, p, [values.get(name, 0.0) for name in model.resting_signals])
    start = start_values(model.parameters)
    point = ca.vertcat(*trim.function(start, []))
    derivative = np.asarray(derivative_function(model)(point, start)).ravel()
    # Constants in the user's formula may be rounded.
    tolerance = 1e-6 * (1 + np.abs(np.asarray(point)).max(initial=0))
    if not np.all(np.abs(derivative) < tolerance):
        worst = np.argmax(np.abs(np.nan_to_num(derivative, nan=np.inf)))
        raise ValueError(
            f"{model.label}.trim at {dict(at)} is not an equilibrium: the derivative of "
            f"{model.state_names[worst]!r} is {derivative[worst]:.3g} there; correct the trim."
        )

    return trim


def _implicit_trim(model: StateSpace, at: Values) -> Trimmed:
    """Return the operating point where the derivative is zero, by Newton's method."""
    names = model.resting_signals
    z, p = symbols(model)
    derivative = derivative_function(model)(z, p)
    # A signal on which no derivative depends cannot be solved for; it rests at zero.
    unknown = [
        k for k, name in enumerate(names) if name not in at and ca.depends_on(derivative, z[k])
    ]
    excess = len(unknown) - len(model.states)
    if excess > 0:
        raise ValueError(
            f"the operating point of {model.label} is not determined by at={dict(at)}: give "
            f"{excess} more of {', '.join(names[k] for k in unknown)}."
        )

    w = ca.SX.sym("w", len(unknown))
    point = ca.SX([at.get(name, 0.0) for name in names])
    point[unknown] = w
    derivative = ca.substitute(derivative, z, point)
    residual = ca.Function("derivative", [w, p], [derivative, ca.jacobian(derivative, w)])
    guess, rows = _presolve(model, at, residual, [names[k] for k in unknown])
    options = {"error_on_fail": False, "abstol": 1e-12, "max_iter": 50, "show_eval_warnings": False}
    equations = ca.vertcat(*[derivative[k] for k in rows])
    newton = ca.rootfinder("newton", "newton", {"x": w, "p": p, "g": equations}, options)
    size = ca.sqrt(ca.sumsqr(derivative)) / (1 + ca.sqrt(ca.sumsqr(w)))
    is_root = ca.Function("is_root", [w, p], [size < TOLERANCE])

    parameters = ca.MX.sym("p", p.numel())
    direct = newton(x0=guess, p=parameters)["x"]
    start = ca.DM(start_values(model.parameters))
    # If this fails, the parameters move from their start values in ten steps (continuation).
    root = ca.MX(ca.DM(guess))
    for step in range(1, 11):
        root = newton(x0=root, p=start + (parameters - start) * step / 10)["x"]

    in_steps = ca.Function("in_steps", [parameters], [root])
    root = ca.if_else(is_root(direct, parameters), direct, in_steps(parameters), True)

    # Two more steps have the derivatives of the root, see `Trimmed`. If there is no root, the point
    # becomes infinite, so that a run fails instead of using it.
    step = ca.Function("step", [w, p], [w - ca.solve(ca.jacobian(equations, w), equations)])
    full = ca.substitute(point, w, step(step(w, p), p)) / is_root(w, p)
    n = len(model.states)
    return Trimmed(
        ca.Function("root", [parameters], [root]),
        ca.Function("trim", [p, w], [full[:n], full[n:]], {"cse": True}),
    )


def _presolve(
    model: StateSpace, at: Values, residual: ca.Function, unknown: Sequence[str]
) -> tuple[Array, list[int]]:
    """Return the operating point at the start values, and the equations that determine it.

    These are the unknown states and inputs w (size,), and the numbers of as many independent rows
    of the derivative. `residual` is (w, p) -> the derivative and its Jacobian by w.
    """
    start = start_values(model.parameters)
    size = residual.size1_in(0)
    random = np.random.default_rng(0)
    # Zero is no guess: kinks and roots have no slope there.
    plain = [np.full(size, value) for value in (0.1, 1.0, -0.1, -1.0, 10.0)]
    guesses = [*plain, *random.normal(0, 3, (15, size))]
    # If the model declares where states begin, the plain guesses are first tried with these.
    values = model.values(None)
    starts = dict(zip(model.states, state_starts(model, Names(values, model.label)), strict=True))
    declared = [k for k, name in enumerate(unknown) if name in model.state_starts]
    if declared:
        with_starts = np.array(plain)
        with_starts[:, declared] = [float(starts[unknown[k]]) for k in declared]
        guesses = [*with_starts, *guesses]

    for guess in guesses:
        root = guess
        # At a double root a Newton step only halves the distance: 60 steps are enough to reach
        # rounding. Steps are not longer than the size of the point, so that they lead to the
        # nearest root.
        for _ in range(60):
            derivative, jacobian = residual(root, start)
            derivative = np.nan_to_num(np.asarray(derivative))
            jacobian = np.nan_to_num(np.asarray(jacobian))
            step = np.linalg.lstsq(jacobian, derivative.ravel())[0]
            root = root - step / max(1.0, np.linalg.norm(step) / (1 + np.linalg.norm(root)))
        derivative = np.asarray(residual(root, start)[0])
        if not np.abs(derivative).max(initial=0) <= TOLERANCE * (1 + np.abs(root).max(initial=0)):
            continue

        # The point is singular if the smallest pivot is as small as the rounding of the largest
        # one, or far smaller than at a nearby point, as at a double root.
        pivots, order = _pivots(residual(root, start)[1])
        nearby, _ = _pivots(residual(root + 0.1 * (1 + np.abs(root)), start)[1])
        if pivots.size and (
            pivots.min() < 1e-9 * pivots.max() or pivots.min() < 1e-6 * np.nan_to_num(nearby).min()
        ):
            raise ValueError(
                f"{model.label} at {dict(at)} has a singular operating point (its derivative does "
                "not determine every state there): give more of the point in at, or declare "
                "trim(self, at, p)."
            )
        return root, sorted(int(k) for k in order[:size])

    raise ValueError(
        f"{model.label} has no operating point with {dict(at)} at its start values: check `at`, "
        "the start values, or declare trim(self, at, p)."
    )


def _pivots(jacobian: ca.DM) -> tuple[Array, IntArray]:
    """Return the pivots of a Jacobian (rows, w), largest first, and the order of its rows."""
    from scipy.linalg import qr  # noqa: PLC0415  (see `_presolve`)

    result: Any = qr(np.nan_to_num(np.asarray(jacobian)).T, pivoting=True, mode="economic")
    _, triangle, order = result
    return np.abs(np.diag(triangle)), order
