"""The frequency response of a model, in numbers and compiled; an ODE is linearized."""

from collections.abc import Callable, Sequence
from functools import cache
from numbers import Number
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import finite_numbers
from greybox.data.files.arrays import Array, all_finite
from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import NO_HOLD
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.elimination import eliminated, elimination_order, solve_pencils
from greybox.modeling.function_of_s import is_casadi
from greybox.modeling.functions import exp
from greybox.modeling.held_inputs import first_terms, folded_back
from greybox.modeling.linearization import jacobians, linearize
from greybox.modeling.model import Model, pick_signals, require_operating_point
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.parameter import start_values
from greybox.modeling.rational import Rational, as_rational
from greybox.modeling.state_space import StateSpace, input_delays
from greybox.modeling.symbolic_reading import parameter_names, require_no_nan, symbols, traced
from greybox.modeling.transfer_function import TransferFunction
from greybox.modeling.trim import Trimmed, trim_of


@public
def frequency_response(
    model: Model,
    values: Values | None,
    omega: ArrayLike,
    *,
    input: str = "",
    output: str = "",
    at: Values | None = None,
    delay: str = "exact",
) -> FrequencyResponse:
    """Evaluate the frequency response of `model` in numbers, at `omega` (n,) in rad/s.

    `values` are parameter values by name; a parameter without one has its declared start. `at` is
    the operating point of an ODE.

    Raises
    ------
    ValueError
        For an unknown name, or a response that is not finite, as at a pole on the imaginary axis.

    Examples
    --------
    >>> from greybox.models.rate import DampedAngle
    >>> values = {"K_phi": 91.0, "a": 0.68, "T_rotor": 0.05, "T_delay": 0.0}
    >>> response = gb.frequency_response(DampedAngle(), values, omega=[1.0, 10.0])
    >>> abs(response.response).round(3)
    array([75.156,  0.812])
    """
    omega = finite_numbers("omega", omega)
    input, output = pick_signals(model, input, output)
    pade = delay_order(delay)
    # At a pole the response is infinite, which is refused below with its frequency.
    with np.errstate(all="ignore"):
        # Plain complex numbers if possible: tests compare them with those of `Complex`.
        s = 1j * omega if pade is None else Complex(np.zeros_like(omega), omega, pade)
        if isinstance(model, TransferFunction):
            require_operating_point(model, at)
            result = model.response(s, model.values(values))
        else:
            assert isinstance(model, StateSpace)
            system = linearize(model, values, at)
            i, k = system.inputs.index(input), system.outputs.index(output)
            pencil = 1j * omega[:, None, None] * np.eye(len(system.A)) - system.A
            plant = solve_pencils(pencil, system.B[None, :, i]) @ system.C[k] + system.D[k, i]
            result = exp(-system.delays[i] * s) * plant
        re, im = _parts(result, model.label, omega.size)
        response = np.broadcast_to(np.asarray(re + 1j * im, dtype=complex), omega.shape)

    if not all_finite(response):
        worst = omega[np.argmin(np.isfinite(response))]
        raise ValueError(
            f"{model.label} has no finite response at omega = {worst:g} rad/s: a pole lies there."
        )

    return FrequencyResponse(
        omega,
        response,
        input=input,
        output=output,
        name=model.label,
        source="model",
        about={NO_HOLD: "0"},
    )


@one_thread_at_a_time
def response_formulas(
    model: Model,
    omega: Array,
    pairs: Sequence[tuple[str, str]],
    symbol: ca.SX | None = None,
    *,
    at: Values | None = None,
    pade: int | None = None,
    hold: float = 0.0,
) -> list[Trimmed]:
    """Compile frequency responses at `omega` (n,): real and imaginary parts.

    After a `hold` (s) of the input they are those of samples, see `folded_back`.
    `pairs` are inputs and outputs; the responses of a state space share one elimination. With a
    `symbol`, the functions take one frequency as their last input; `omega` are the values that will
    occur.
    """
    frequency = [] if symbol is None else [symbol]
    frequencies = ca.SX(ca.DM(omega)) if symbol is None else symbol
    s = Complex(ca.SX.zeros(frequencies.numel()), frequencies, pade)
    pairs = [pick_signals(model, *pair) for pair in pairs]
    if isinstance(model, TransferFunction):
        _, p = symbols(model)
        require_operating_point(model, at)
        owner, names = f"{model.label}.response", parameter_names(model, p)
        result = traced(owner, model.response, s, names)
        if hold:
            read = as_rational(traced(owner, model.response, Rational([1.0, 0.0]), names))
            undelayed = Rational(read.numerator, read.denominator)
            result += _beside(undelayed, s, hold, read.delay) * exp(-s * read.delay)
        parts = _columns(result, s, model.label)
        require_no_nan(owner, ca.vertcat(*parts))
        response = ca.Function("response", [p, ca.SX(0, 1), *frequency], parts)
        return [Trimmed(None, response)] * len(pairs)

    assert isinstance(model, StateSpace)
    n = len(model.states)
    inputs = sorted({input for input, _ in pairs})
    outputs = sorted({output for _, output in pairs})
    i = [model.input_names.index(name) for name in inputs]
    k = [model.output_names.index(name) for name in outputs]
    trim = trim_of(model, at or {})

    # C (s I - A)⁻¹ B + D, then the delay
    p, w = trim.function.sx_in()
    blocks: Any = jacobians(model)(p, *trim.function(p, w))
    A, B, C, D = blocks
    system = ca.blockcat([[-A, B[:, i]], [-C[k, :], D[k, i]]])
    entries = [
        [None if system[r, c].is_zero() else system[r, c] for c in range(n + len(i))]
        for r in range(n + len(k))
    ]
    at_point = Trimmed(trim.root, ca.Function("matrix", [p, w], [A]))
    order = _elimination_order(model, at_point, omega)
    solved = cache(lambda line: eliminated(entries, line, order))
    delays = input_delays(model, parameter_names(model, p))

    def formula(input: str, output: str) -> Trimmed:
        row, column = outputs.index(output), inputs.index(input)
        delay = delays[input]
        result = solved(s)[row][column]
        if hold:
            result += _beside(lambda q: solved(q)[row][column], s, hold, delay)
        result = result * exp(-s * delay)
        parts = _columns(result, s, model.label)
        return Trimmed(trim.root, ca.Function("response", [p, w, *frequency], parts))

    return [formula(*pair) for pair in pairs]


def _beside(undelayed: Callable[[Any], Any], s: Complex, hold: float, delay: Any) -> Any:
    """Return what sampling adds to a response without its delay, see `folded_back`.

    For direct feedthrough with a delay, nothing is added: the addition jumps where the delay is a
    whole number of holds, and its mean over all delays is zero.
    """
    # The frequency is exact, whatever the approximation of the delay.
    at_line = Complex(s.re, s.im) * hold
    at_once, rate = first_terms(undelayed, hold)
    step, ramp, _ = folded_back(at_line, delay / hold)
    return ramp * rate + (step * at_once if ca.SX(delay).is_zero() else 0)


def _elimination_order(model: StateSpace, matrix: Trimmed, omega: Array) -> tuple[int, ...]:
    """Choose the order of elimination from matrices at the start values and at random starts."""
    # A pivot that vanishes for all parameters does so at any few values.
    random = np.random.default_rng(0)
    points = [start_values(model.parameters)]
    points += [[q.draw(random) for q in model.parameters.values()] for _ in range(3)]
    closed: Any = matrix.closed()
    samples = [matrix.full() for matrix in map(closed, points)]
    # A draw may have no operating point.
    regular = [A for A in samples if all_finite(A)]
    return elimination_order(np.reshape(regular, (len(regular), *samples[0].shape)), omega)


def _parts(result: Any, owner: str, count: int) -> tuple[Any, Any]:
    """Return real and imaginary part of a response: one value, or as many as frequencies."""
    parts: tuple[Any, Any] = (
        (result.re, result.im) if isinstance(result, Complex) else (result, 0.0)
    )
    for part in parts:
        size = part.numel() if is_casadi(part) else np.size(part)
        if not isinstance(part, Number | np.ndarray) and not is_casadi(part):
            raise ValueError(
                f"{owner}.response returns a {type(part).__name__}: return one expression of s "
                "and p."
            )
        if size not in (1, count):
            raise ValueError(
                f"{owner}.response returns {size} values for {count} frequencies: return one for "
                "each."
            )

    return parts


def _columns(result: Any, s: Complex, owner: str) -> list[ca.SX]:
    """Return real and imaginary part of a traced response, one entry per frequency."""
    zeros = ca.SX.zeros(s.im.numel())
    return [part + zeros for part in _parts(result, owner, zeros.numel())]
