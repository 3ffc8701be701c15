"""The response of a nonlinear ODE to a sine of finite amplitude, by harmonic balance.

Every signal is a truncated Fourier series; what the ODE leaves over, sampled along one period, must have no harmonics
(alternating frequency-time: Cameron and Griffin 1989, Journal of Applied Mechanics 56). Newton's method eliminates the
harmonics and the implicit function theorem differentiates them, so a solver sees the parameters alone. As unknowns of
the solver they took it five times as many iterations and cost it a fifth of the starts. Terms that are linear in the
signals are balanced exactly and never sampled: a linear model keeps its linear response.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.functions import exp
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.sine import Sine, as_sine
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import traced_derivative, traced_output
from greybox.modeling.trim import trim_function

# Samples over one period, at least. Odd, so that a kink such as that of |v| v, sampled at a symmetric orbit, counts as
# if sampled twice as often; and four a harmonic, for products of up to three signals without aliasing.
POINTS = 33
# Of the amplitude, where Newton's method fails at once: from 1/128 of it, where a model is nearly linear, doubled.
HALVINGS = 7
# The harmonics, per amplitude, where Newton's method begins: its first step then goes to the linear response. Not zero,
# where a kink has no slope.
SMALL = 1e-6
TOLERANCE = 1e-8  # of the balance, relative to the size of the harmonics: Newton's last step squares it
SINGULAR = 1e-9  # singular value of the balance, rows scaled to one, that is rounding: it leaves a direction open
DETERMINED = 1e-7  # part of a condition in the open directions from which it determines one, above rounding
TINY = 1e-300  # instead of a division by zero


def harmonic_response(
    model: Model,
    values: Mapping[str, float] | None,
    omega: ArrayLike,
    *,
    amplitude: Mapping[str, ArrayLike] | Sine,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    delay: str = "exact",
) -> FrequencyResponse:
    """Evaluate the response of an ODE to a sine of finite amplitude, at `omega` (n,) in rad/s.

    The response is the first harmonic of the output over that of the input: the describing function of a nonlinear
    model, the frequency response of a linear one.

    Parameters
    ----------
    amplitude : ``{signal: amplitude}`` or Sine
        Which signal is the sine: the input, or a state or an output that a loop holds to it. Its mean, and all other
        inputs, are what they are at the operating point `at`.
    values, input, output, at, delay
        As for `frequency_response`.

    Raises
    ------
    ValueError
        For a name that is not known, a transfer function, or where no periodic motion is found.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    input, output = pick_signals(model, input, output)
    sine = as_sine(amplitude)
    pade = delay_order(delay)
    function = harmonic_function(model, omega, sine, input=input, output=output, at=at, pade=pade)
    re, im = (np.asarray(part).ravel() for part in function(list(model.values(values).values())))
    finite = np.isfinite(re) & np.isfinite(im)
    if not finite.all():
        k = int(np.argmin(finite))
        raise ValueError(
            f"{model.label} has no periodic motion at omega = {omega[k]:g} rad/s in which {sine.signal} is a sine of "
            f"amplitude {sine.amplitudes(omega)[k]:g}: give a smaller amplitude, or check the values and `at`."
        )
    return FrequencyResponse(omega, re + 1j * im, input=input, output=output, name=model.label, source="model")


def response_of_test(
    model: Model,
    values: Mapping[str, float],
    omega: ArrayLike,
    sine: Sine | None,
    measured: NDArray[np.float64],
    **signals: Any,
) -> FrequencyResponse:
    """Evaluate the response to the `sine` with which the frequencies `measured` were tested; linearized without one."""
    if sine is None:
        return frequency_response(model, values, omega, **signals)
    sine = sine.between(measured, np.atleast_1d(np.asarray(omega, dtype=float)))
    return harmonic_response(model, values, omega, amplitude=sine, **signals)


def harmonic_function(
    model: Model,
    omega: NDArray[np.float64],
    sine: Sine,
    *,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    pade: int | None = None,
) -> ca.Function:
    """Compile the response: the CasADi function from the parameter vector to real and imaginary part (n,)."""
    input, output = pick_signals(model, input, output)
    check_sine(model, sine, input, omega)
    assert isinstance(model, StateSpace)
    trim = trim_function(model, at or {})
    amplitudes = sine.amplitudes(omega)
    orbit = _Orbit.of(model, sine, input, output, pade)
    point = np.concatenate([np.asarray(part).ravel() for part in trim([q.start for q in model.parameters.values()])])
    chosen = _mean_conditions(orbit, point, omega, amplitudes)

    p = ca.MX.sym("p", len(model.parameters))
    columns = ca.repmat(ca.vertcat(p, *trim(p)), 1, omega.size)
    parts = _balanced(orbit, chosen, ca.vertcat(columns, ca.DM(omega).T, ca.DM(amplitudes).T))
    return ca.Function("response", [p], [parts[0, :].T, parts[1, :].T])


def check_sine(model: Model, sine: Sine, input: str, omega: NDArray[np.float64]) -> None:
    """Raise ValueError, naming the cure, where model, data and sine do not fit together."""
    if not isinstance(model, StateSpace):
        raise ValueError(
            f"{model.label} is a transfer function, whose response is the same at every amplitude: omit the amplitude."
        )
    known = dict.fromkeys((input, *model.outputs, *model.states))
    if sine.signal not in known:
        raise ValueError(
            f"the sine is of {sine.signal!r}, which {model.label} does not have: name one of {', '.join(known)}."
        )
    sine.amplitudes(omega)


@dataclass(frozen=True, eq=False)
class _Orbit:
    """The balance at one frequency, in unknown harmonics per amplitude.

    `unknown` (k,) are mean, cosine and sine coefficients of the states and the driven input and the means of the other
    inputs, about the operating point, divided by the amplitude; `given` holds parameters, operating point, omega and
    amplitude; `balance` must vanish; of the conditions `means` on the means as many must vanish as the ODE leaves
    open; `response` is real and imaginary part.
    """

    model: StateSpace
    sine: Sine
    input: str
    unknown: ca.SX
    given: ca.SX
    balance: ca.SX
    means: ca.SX
    response: ca.SX

    @classmethod
    def of(cls, model: StateSpace, sine: Sine, input: str, output: str, pade: int | None) -> "_Orbit":
        """Write down the balance."""
        n = len(model.states)
        names = (*model.states, *model.inputs)
        p = ca.SX.sym("p", len(model.parameters))
        z = ca.SX.sym("z", len(names))
        point = ca.SX.sym("point", len(names))
        omega = ca.SX.sym("omega")
        amplitude = ca.SX.sym("amplitude")
        rates = traced_derivative(model, z, p)
        read = traced_output(model, z, p)

        driven = n + model.input_names.index(input)
        held = _position(model, sine.signal, read, z)
        unknown, per_amplitude = _unknown_series([*range(n), driven], len(names), 2 * sine.harmonics + 1, held)
        series = amplitude * per_amplitude
        series[:, 0] += point
        outputs = _harmonics(read, z, series, sine.harmonics)

        balance = [ca.vec((_derivative(series[:n, :], omega) - _harmonics(rates, z, series, sine.harmonics)).T)]
        means = [per_amplitude[k, 0] for k in (*range(n, len(names)), *range(n))]
        if held is None:
            k = model.output_names.index(sine.signal)
            moving = outputs[k, :]
            moving[0] -= ca.substitute(read[k], z, point)
            moving[1] -= amplitude
            balance.append(moving[1:].T)
            means.insert(0, moving[0] / amplitude)
        else:
            means.insert(0, per_amplitude[held, 0])

        delay = p[list(model.parameters).index(model.delays[input])] if input in model.delays else ca.SX(0)
        first = _first(outputs[model.output_names.index(output), :]) / _first(series[driven, :])
        first = first * exp(-Complex(ca.SX(0), omega, pade) * delay)
        return cls(
            model=model,
            sine=sine,
            input=input,
            unknown=unknown,
            given=ca.vertcat(p, point, omega, amplitude),
            balance=ca.vertcat(*balance) / amplitude,
            means=ca.vertcat(*means),
            response=ca.vertcat(first.re, first.im),
        )


def _position(model: StateSpace, signal: str, read: ca.SX, z: ca.SX) -> int | None:
    """Return where a signal stands among states and inputs; None for an output that is a formula of them."""
    if signal in model.output_names:
        formula = read[model.output_names.index(signal)]
        return next((k for k in range(z.numel()) if ca.is_equal(formula, z[k])), None)
    return (*model.states, *model.inputs).index(signal)


def _unknown_series(moving: Sequence[int], rows: int, width: int, held: int | None) -> tuple[ca.SX, ca.SX]:
    """Return the unknown coefficients and all as rows; what is `held` to a sine or does not move has a mean alone."""
    unknown = [ca.SX.sym(f"z{k}", width if k in moving and k != held else 1) for k in range(rows)]
    series = ca.SX(rows, width)
    for k, symbols in enumerate(unknown):
        series[k, : symbols.numel()] = symbols.T
    if held is not None:
        series[held, 1] = 1
    return ca.vertcat(*unknown), series


def _derivative(series: ca.SX, omega: ca.SX) -> ca.SX:
    """Return the coefficients of the time derivative, row by row."""
    result = ca.SX(*series.shape)
    for k in range(1, series.size2() // 2 + 1):
        cosine = 2 * k - 1
        sine = 2 * k
        result[:, cosine] = k * omega * series[:, sine]
        result[:, sine] = -k * omega * series[:, cosine]
    return result


def _first(row: ca.SX) -> Complex:
    """Return the first harmonic as the complex amplitude of exp(jωt)."""
    return Complex(row[1], -row[2])


def _harmonics(formula: ca.SX, z: ca.SX, series: ca.SX, harmonics: int) -> ca.SX:
    """Return the coefficients of `formula` (k, 1) of the signals `z` with the coefficients `series`: (k, 2h + 1)."""
    linear, rest = _separated(formula, z)
    to_samples, to_series = _transforms(harmonics)
    samples = series @ to_samples
    rows = []
    for k in range(rest.numel()):
        used = [j for j in range(z.numel()) if ca.depends_on(rest[k], z[j])]
        if not used:
            rows.append(ca.horzcat(rest[k], ca.SX(1, 2 * harmonics)))
            continue
        others = [s for s in ca.symvar(rest[k]) if not ca.depends_on(s, z)]
        term = ca.Function("term", [ca.vertcat(*[z[j] for j in used]), ca.vertcat(*others)], [rest[k]])
        sampled = [term(samples[used, i], ca.vertcat(*others)) for i in range(to_samples.shape[1])]
        rows.append(ca.horzcat(*sampled) @ to_series)
    return linear @ series + ca.vertcat(*rows) if rows else ca.SX(0, series.size2())


def _separated(formula: ca.SX, z: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Split `formula` into the coefficients of the signals in which a row is linear, and what is left of the row."""
    slope = ca.jacobian(formula, z)
    rest = ca.SX(formula)
    linear = ca.SX(*slope.shape)
    for k in range(slope.size1()):
        columns = [j for j in range(z.numel()) if slope.has_nz(k, j) and not ca.depends_on(slope[k, j], z)]
        for j in columns:
            linear[k, j] = slope[k, j]
        if columns:
            rest[k] = ca.substitute(rest[k], ca.vertcat(*[z[j] for j in columns]), ca.SX.zeros(len(columns)))
    return linear, rest


def _transforms(harmonics: int) -> tuple[ca.DM, ca.DM]:
    """Return the matrices from coefficients to samples over one period and back."""
    points = max(POINTS, 4 * harmonics + 1)
    phase = 2 * np.pi * np.arange(points) / points
    waves = [wave(k * phase) for k in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
    to_samples = np.array([np.ones(points), *waves])
    to_series = to_samples.T * 2 / points
    to_series[:, 0] /= 2
    return ca.DM(to_samples), ca.DM(to_series)


def _mean_conditions(
    orbit: _Orbit, point: NDArray[np.float64], omega: NDArray[np.float64], amplitudes: NDArray[np.float64]
) -> list[int]:
    """Choose what fixes the means: the first conditions that the balance, at some orbit, does not determine already.

    The mean of the sine's own signal comes first. It determines nothing where an integrator follows it, as the angle
    follows the rate: then that of a state.
    """
    blocks = [ca.jacobian(e, orbit.unknown) for e in (orbit.balance, orbit.means)]
    middle = int(np.argsort(amplitudes)[omega.size // 2])
    start = [q.start for q in orbit.model.parameters.values()]
    given = np.concatenate([start, point, [omega[middle], amplitudes[middle]]])
    generic = np.random.default_rng(0).normal(size=orbit.unknown.numel())
    function = ca.Function("slopes", [orbit.unknown, orbit.given], blocks)
    rows, conditions = (np.nan_to_num(np.asarray(ca.DM(block))) for block in function(generic, given))
    rows, conditions = (e / np.maximum(np.linalg.norm(e, axis=1, keepdims=True), TINY) for e in (rows, conditions))
    _, singular, basis = np.linalg.svd(rows)
    open_directions = basis[int(np.sum(singular > SINGULAR)) :]
    chosen: list[int] = []
    missing = orbit.unknown.numel() - orbit.balance.numel()
    for k, row in enumerate(conditions):
        in_open = np.array([*conditions[chosen], row]) @ open_directions.T
        if len(chosen) < missing and np.linalg.matrix_rank(in_open, DETERMINED) == len(in_open):
            chosen.append(k)
    if len(chosen) < missing or len(open_directions) > missing:
        raise ValueError(
            f"the input {orbit.input} cannot make {orbit.sine.signal!r} a sine in {orbit.model.label} at its start "
            "values: name a signal that it drives, or check `at`."
        )
    return chosen


def _balanced(orbit: _Orbit, chosen: Sequence[int], given: Any) -> Any:
    """Return real and imaginary part of the response, (2, n), for columns of what is given at every frequency."""
    x = orbit.unknown
    n = given.size2()
    balance = ca.vertcat(orbit.balance, *[orbit.means[k] for k in chosen])
    options = {"error_on_fail": False, "abstol": 1e-11, "max_iter": 30, "show_eval_warnings": False}
    equations = {"x": x, "p": orbit.given, "g": balance}
    newton = ca.rootfinder("newton", "newton", equations, {**options, "line_search": False})  # twice as fast
    careful = ca.rootfinder("careful", "newton", equations, options)
    size = ca.norm_inf(balance) / (1 + ca.norm_inf(x))
    finish = ca.Function("finish", [x, orbit.given], [orbit.response, size < TOLERANCE])
    guesses = _guess(newton, careful, finish).map(n)(given)
    # Newton's method once more, from its own solution: derivatives then go through this call and leave out the guess.
    response, converged = finish.map(n)(newton.map(n)(x0=guesses, p=given)["x"], given)
    # A motion that was not found becomes infinite, so that the run that met it fails instead of using it.
    return response / ca.repmat(converged, 2, 1)


def _guess(newton: ca.Function, careful: ca.Function, finish: ca.Function) -> ca.Function:
    """Return the function from what is given to the harmonics: at once, or else from small amplitudes upwards."""
    given: Any = ca.MX.sym("given", newton.numel_in("p"))
    direct: Any = ca.MX.sym("direct", newton.numel_in("x0"))
    small = ca.DM(np.full(direct.numel(), SMALL))
    root = ca.MX(small)
    for halving in range(HALVINGS, -1, -1):
        root = careful(x0=root, p=ca.vertcat(given[:-1], given[-1] / 2**halving))["x"]
    by_doubling = ca.Function("by_doubling", [given], [root])
    chosen = ca.if_else(finish(direct, given)[1], direct, by_doubling(given), True)
    choose = ca.Function("choose", [direct, given], [chosen], {"never_inline": True})
    return ca.Function("guess", [given], [choose(newton(x0=small, p=given)["x"], given)])
