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

TOLERANCE = 1e-9  # on the derivative at a trim, relative to the states and inputs there


@frozen
class Trimmed:
    """A function of an operating point in two steps; only the first needs an iteration.

    Attributes
    ----------
    root : casadi.Function or None
        (p) -> the unknowns w of ``derivative = 0``, by Newton's method; None without unknowns, when
        w is empty.
    function : casadi.Function
        (p, w, ...) -> the result, an SX function or one mapped over frequencies. Its first and
        second derivatives with respect to p, with w held, are those at the operating point: from a
        root, one step of Newton's method has the first derivatives of the root, a second step the
        second ones. They take a fraction of the time of CasADi's derivatives through its root
        finder.
    """

    root: ca.Function | None
    function: ca.Function

    def closed(self) -> ca.Function:
        """Return the function of (p, ...), with the operating point inside."""
        symbols: Any = self.function.mx_in() if self.root else input_symbols(self.function)
        p, w, *arguments = symbols
        w = w if self.root is None else self.root(p)
        results = self.function.call([p, w, *arguments])
        return ca.Function(self.function.name(), [p, *arguments], results)


@once
def trim_of(model: Model, at: Values) -> Trimmed:
    """Return states and inputs at the operating point `at` as functions of the parameters.

    A transfer function has no states, and rests without an input. The point of an ODE is the first
    of these: the result of the model's own `trim`; the origin, or where the states are declared to
    begin, if it is an equilibrium for all parameter values (so that a hover, where
    ``C_x |v| v = 0`` has a double root, has finite derivatives); the solution of
    ``derivative = 0``, differentiated by the implicit function theorem.

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
    closed = _closed_form(model, p, point)
    # Whether this is an equilibrium for all parameters, by eight random draws.
    derivative = derivative_function(model)
    random = np.random.default_rng(0)
    draws = ([q.draw(random) for q in model.parameters.values()] for _ in range(8))
    at_draws = (derivative(ca.vertcat(*closed.function(draw, [])), draw).full() for draw in draws)
    if all(np.all(np.abs(values) < 1e-12) for values in at_draws):
        return closed

    return _implicit_trim(model, at)


def _closed_form(model: Model, p: ca.SX, point: Sequence[Any]) -> Trimmed:
    n = len(model.state_names)
    owner = f"{model.label}.trim"
    return Trimmed(
        None,
        ca.Function("trim", [p, ca.SX(0, 1)], [column(owner, point[:n]), column(owner, point[n:])]),
    )


def _own_trim(model: Model, at: Values, p: ca.SX) -> Trimmed:
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
    # If this does not converge, the parameters move from their start values in ten steps.
    root = ca.MX(ca.DM(guess))
    for step in range(1, 11):
        root = newton(x0=root, p=start + (parameters - start) * step / 10)["x"]

    in_steps = ca.Function("in_steps", [parameters], [root])
    root = ca.if_else(is_root(direct, parameters), direct, in_steps(parameters), True)

    # Two more steps give the derivatives, see `Trimmed`. Without a root the point becomes infinite,
    # so that the run fails instead of using it.
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
    """Solve the trim at the start values; return it and as many independent equations."""
    start = start_values(model.parameters)
    size = residual.size1_in(0)
    random = np.random.default_rng(0)
    # Zero itself is left out: kinks and roots have no slope there.
    guesses = [np.full(size, c) for c in (0.1, 1.0, -0.1, -1.0, 10.0)]
    guesses += list(random.normal(0, 3, (15, size)))
    # First with the states where the model declares that they begin.
    values = model.values(None)
    starts = dict(zip(model.states, state_starts(model, Names(values, model.label)), strict=True))
    declared = [k for k, name in enumerate(unknown) if name in model.state_starts]
    for guess in guesses[: 5 if declared else 0][::-1]:
        near = guess.copy()
        near[declared] = [float(starts[unknown[k]]) for k in declared]
        guesses.insert(0, near)

    for guess in guesses:
        root = guess
        # At a double root a Newton step only halves the distance: 60 steps reach rounding. Longer
        # steps than the size of the point would leave the nearest root.
        for _ in range(60):
            derivative, jacobian = residual(root, start)
            derivative = np.nan_to_num(np.asarray(derivative))
            jacobian = np.nan_to_num(np.asarray(jacobian))
            step = np.linalg.lstsq(jacobian, derivative.ravel())[0]
            root = root - step / max(1.0, np.linalg.norm(step) / (1 + np.linalg.norm(root)))
        derivative = np.asarray(residual(root, start)[0])
        if not np.abs(derivative).max(initial=0) <= TOLERANCE * (1 + np.abs(root).max(initial=0)):
            continue

        # A pivot counts as zero if it is as small as the rounding of the largest one, or far
        # smaller than at a nearby point, as at a double root.
        pivots, order = _pivots(residual(root, start)[1])
        nearby, _ = _pivots(residual(root + 0.1 * (1 + np.abs(root)), start)[1])
        if pivots.size and pivots.min() < max(
            1e-9 * pivots.max(), 1e-6 * np.nan_to_num(nearby).min()
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
    """Return the pivots of a Jacobian, largest first, and the order of its rows."""
    from scipy.linalg import qr  # noqa: PLC0415  (see `_presolve`)

    result: Any = qr(np.nan_to_num(np.asarray(jacobian)).T, pivoting=True, mode="economic")
    _, triangle, order = result
    return np.abs(np.diag(triangle)), order
