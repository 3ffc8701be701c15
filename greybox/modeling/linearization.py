"""Linear readings of a model: linearization, frequency response, and rational form with delay or Padé approximation."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.elimination import elimination_order, solve, solve_pencils
from greybox.modeling.functions import Complex, Rational, exp
from greybox.modeling.model import Model, Names, StateSpace, TransferFunction
from greybox.modeling.symbolic_reading import parameter_names, require_no_nan, traced, traced_derivative, traced_output
from greybox.modeling.trim import some_value, trim_function


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """``x' = A x + B u(t - delay)``, ``y = C x + D u(t - delay)`` about an operating point.

    Attributes
    ----------
    A, B, C, D : arrays (n, n), (n, m), (k, n), (k, m)
        The Jacobians.
    states, inputs, outputs : tuple of str
        Signal names, in the order of the rows and columns.
    delays : (m,) array, s
        The delay of every input.
    point : mapping of name to float
        States and inputs at the operating point.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    delays: NDArray[np.float64]
    point: Mapping[str, float]

    def __str__(self) -> str:
        names = ("x' = A x + B u(t - delay)", "y  = C x + D u(t - delay)")
        signals = f"states {', '.join(self.states)}; inputs {', '.join(self.inputs)}; outputs {', '.join(self.outputs)}"
        point = ", ".join(f"{name} = {value:.6g}" for name, value in self.point.items())
        matrices = [f"{name} =\n{np.array2string(getattr(self, name), precision=6)}" for name in "ABCD"]
        return "\n".join([*names, signals, f"about {point}", *matrices, f"delay = {self.delays} s"])

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A, (n,), rad/s."""
        return np.linalg.eigvals(self.A).astype(complex)


def delay_order(delay: str) -> int | None:
    """Return the Padé order in ``"pade:n"``, or None for ``"exact"``."""
    if delay == "exact":
        return None
    match = re.fullmatch(r"pade:([1-9]\d?)", delay) if isinstance(delay, str) else None
    if match is None:
        raise ValueError(f"delay {delay!r} is not known: use 'exact' or 'pade:n' with an order n from 1 to 99.")
    return int(match[1])


def pick_signals(model: Model, input: str = "", output: str = "") -> tuple[str, str]:
    """Return the input-output pair meant by `input` and `output`; an empty name is the only one that there is."""
    return (
        _pick(input, model.input_names, "input", model.label),
        _pick(output, model.output_names, "output", model.label),
    )


def _pick(name: str, known: Sequence[str], what: str, owner: str) -> str:
    if name in known:
        return name
    if name:
        raise ValueError(
            f"{owner} has no {what} {name!r}; it has {', '.join(known)}: name the data's {what} as one of them."
        )
    if len(known) > 1:
        raise ValueError(f"{owner} has several {what}s ({', '.join(known)}): say which one the data are, {what}=...")
    return known[0]


def jacobians(model: StateSpace) -> ca.Function:
    """Return the CasADi function (parameters, states, inputs) -> A, B, C, D."""
    n, m = len(model.states), len(model.inputs)
    p, z = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("z", n + m)
    f, h = traced_derivative(model, z, p), traced_output(model, z, p)
    x, u = z[:n], z[n:]
    blocks = [ca.jacobian(f, x), ca.jacobian(f, u), ca.jacobian(h, x), ca.jacobian(h, u)]
    return ca.Function("jacobians", [p, x, u], blocks)


def linearize(
    model: StateSpace, values: Mapping[str, float] | None = None, at: Mapping[str, float] | None = None
) -> LinearSystem:
    """Linearize `model` at the operating point `at` for the parameter `values` (by default the declared starts).

    Raises
    ------
    ValueError
        If a name is not known or there is no operating point.
    """
    p = model.values(values)
    vector = list(p.values())
    x, u = trim_function(model, at or {})(vector)
    point = np.concatenate([np.asarray(x).ravel(), np.asarray(u).ravel()])
    if not np.all(np.isfinite(point)):
        raise ValueError(
            f"{model.label} has no operating point with {dict(at or {})} at {dict(p)}: check `at` and the values."
        )
    blocks = [np.asarray(ca.DM(b)) for b in jacobians(model)(vector, x, u)]
    delays = [p[model.delays[name]] if name in model.delays else 0.0 for name in model.inputs]
    names = (*model.states, *model.inputs)
    return LinearSystem(
        *blocks,
        states=tuple(model.states),
        inputs=tuple(model.inputs),
        outputs=tuple(model.outputs),
        delays=np.array(delays, dtype=float),
        point=dict(zip(names, point.tolist(), strict=True)),
    )


def rational(
    model: Model,
    values: Mapping[str, float] | None = None,
    *,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    pade: int | None = None,
) -> Rational:
    """Read a model as numerator, denominator (coefficients, highest power of s first) and delay in s.

    With `pade`, the delay becomes part of the rational function, approximated to that order.

    Raises
    ------
    ValueError
        If the formula has no rational form, as a loop around an exact delay.
    """
    input, output = pick_signals(model, input, output)
    if isinstance(model, TransferFunction):
        _require_no_point(model, at)
        result = model.response(Rational([1.0, 0.0], pade=pade), model.values(values))
        return result if isinstance(result, Rational) else Rational([result])
    assert isinstance(model, StateSpace)
    system = linearize(model, values, at)
    i, k = system.inputs.index(input), system.outputs.index(output)
    b, c, d = system.B[:, i], system.C[k], system.D[k, i]
    denominator = np.atleast_1d(np.poly(np.linalg.eigvals(system.A))).real
    markov = [d, *(c @ np.linalg.matrix_power(system.A, j) @ b for j in range(len(b)))]
    numerator = np.convolve(denominator, markov)[: len(denominator)]
    result = Rational(numerator.tolist(), denominator.tolist())
    return result * exp(Rational([-1.0, 0.0], pade=pade) * system.delays[i])


def frequency_response(
    model: Model,
    values: Mapping[str, float] | None,
    omega: ArrayLike,
    *,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    delay: str = "exact",
) -> FrequencyResponse:
    """Evaluate the frequency response of `model` in numbers, at `omega` (n,) in rad/s.

    `values` are parameter values by name; what they leave out, as `{}` does all, is at its declared start. `at` is the
    operating point of an ODE.

    Raises
    ------
    ValueError
        For a name that is not known, or where the response is not finite, as at a pole on the imaginary axis.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    input, output = pick_signals(model, input, output)
    pade = delay_order(delay)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        if isinstance(model, TransferFunction):
            _require_no_point(model, at)
            response = _numbers(model, omega, model.values(values), pade)
        else:
            assert isinstance(model, StateSpace)
            response = _state_space_numbers(linearize(model, values, at), omega, input, output, pade)
    if not np.all(np.isfinite(response)):
        worst = omega[np.argmin(np.isfinite(response))]
        raise ValueError(f"{model.label} has no finite response at omega = {worst:g} rad/s: a pole lies there.")
    return FrequencyResponse(omega, response, input=input, output=output, name=model.label, source="model")


def _numbers(model: TransferFunction, omega: NDArray[np.float64], p: Names, pade: int | None) -> NDArray[np.complex128]:
    s: Any = 1j * omega if pade is None else Complex(np.zeros_like(omega), omega, pade)
    result = model.response(s, p)
    if isinstance(result, Complex):
        result = result.re + 1j * result.im
    if not isinstance(result, (int, float, complex, np.number, np.ndarray)):
        raise ValueError(f"{model.label}.response returns a {type(result).__name__}: return one expression of s and p.")
    values = np.asarray(result, dtype=complex)
    if values.shape not in ((), omega.shape):
        raise ValueError(
            f"{model.label}.response returns {values.size} values for {omega.size} frequencies: return one for each."
        )
    return np.broadcast_to(values, omega.shape)


def _require_no_point(model: Model, at: Mapping[str, float] | None) -> None:
    if at:
        raise ValueError(f"{model.label} is a transfer function and has no operating point: leave out at={dict(at)}.")


def _state_space_numbers(
    system: LinearSystem, omega: NDArray[np.float64], input: str, output: str, pade: int | None
) -> NDArray[np.complex128]:
    i, k = system.inputs.index(input), system.outputs.index(output)
    pencil = 1j * omega[:, None, None] * np.eye(len(system.A)) - system.A
    b = np.broadcast_to(system.B[:, i], (len(omega), len(system.A)))
    plant = solve_pencils(pencil, b) @ system.C[k] + system.D[k, i]
    shift = -system.delays[i] * Complex(np.zeros_like(omega), omega, pade)
    delayed = exp(shift) * plant
    return delayed.re + 1j * delayed.im


def response_function(
    model: Model,
    omega: NDArray[np.float64],
    *,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    pade: int | None = None,
) -> ca.Function:
    """Compile the frequency response: the CasADi function from the parameter vector to real and imaginary part (n,)."""
    input, output = pick_signals(model, input, output)
    p = ca.SX.sym("p", len(model.parameters))
    s = Complex(ca.SX.zeros(len(omega)), ca.SX(ca.DM(omega)), pade)
    if isinstance(model, TransferFunction):
        _require_no_point(model, at)
        result = traced(f"{model.label}.response", model.response, s, parameter_names(model, p))
        return ca.Function("response", [p], _parts(result, s, model.label))
    assert isinstance(model, StateSpace)
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
    i, k = model.input_names.index(input), model.output_names.index(output)
    matrices, trim = jacobians(model), trim_function(model, at or {})
    A, B, C, D = matrices(p, x, u)
    n = A.size1()
    entries = [[None if A[r, c].is_zero() else A[r, c] for c in range(n)] for r in range(n)]
    states = solve(entries, [B[r, i] for r in range(n)], s, _order(model, matrices, trim, i, omega))
    result = sum((state * C[k, r] for r, state in enumerate(states) if not C[k, r].is_zero()), D[k, i])
    if input in model.delays:
        result = result * exp(-s * p[list(model.parameters).index(model.delays[input])])
    at_point = ca.Function("response", [p, x, u], _parts(result, s, model.label))
    q: Any = ca.SX.sym("p", p.numel()) if trim.is_a("SXFunction") else ca.MX.sym("p", p.numel())
    return ca.Function("response", [q], at_point(q, *trim(q)))


def _order(
    model: StateSpace, matrices: ca.Function, trim: ca.Function, input: int, omega: NDArray[np.float64]
) -> tuple[int, ...]:
    """Choose the order of elimination from the matrices at the start values and at some others."""
    random = np.random.default_rng(0)
    points = [[q.start for q in model.parameters.values()]]
    points += [[some_value(q, random) for q in model.parameters.values()] for _ in range(3)]
    blocks = [[np.asarray(ca.DM(block)) for block in matrices(point, *trim(point))[:2]] for point in points]
    usable = [(A, B[:, input]) for A, B in blocks if np.all(np.isfinite(A)) and np.all(np.isfinite(B))]
    if not usable:
        return tuple(range(len(model.states)))
    zero = np.all([A == 0 for A, _ in usable], axis=0)
    few = omega if omega.size <= 50 else omega[np.linspace(0, omega.size - 1, 50).astype(int)]
    return elimination_order(np.array([A for A, _ in usable]), np.array([b for _, b in usable]), zero, few)


def _parts(result: Any, s: Complex, owner: str) -> list[ca.SX]:
    """Return real and imaginary part of a traced response, one entry per frequency."""
    if not isinstance(result, (Complex, int, float, np.number, np.ndarray, ca.SX, ca.DM)):
        raise ValueError(f"{owner}.response returns a {type(result).__name__}: return one expression of s and p.")
    both: Any = (result.re, result.im) if isinstance(result, Complex) else (result, 0.0)
    parts = [ca.SX(part) for part in both]
    for k, part in enumerate(parts):
        if part.is_scalar():
            parts[k] = part + ca.SX.zeros(s.im.numel())
        elif part.shape != s.im.shape:
            raise ValueError(
                f"{owner}.response returns {part.numel()} values for {s.im.numel()} frequencies: return one for each."
            )
    require_no_nan(f"{owner}.response", ca.vertcat(*parts))
    return parts
