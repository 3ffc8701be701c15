"""The response of a nonlinear ODE to a sine of finite amplitude, by harmonic balance.

Every signal is a truncated Fourier series; what the ODE leaves over, sampled along one period, must
have no harmonics (alternating frequency-time: Cameron and Griffin 1989, Journal of Applied
Mechanics 56). Newton's method eliminates the harmonics and the implicit function theorem
differentiates them, so a solver sees the parameters alone. As unknowns of the solver they took it
five times as many iterations and cost it a fifth of the starts. Terms that are linear in the
signals are balanced exactly and never sampled: a linear model keeps its linear response.

Where a formula switches, the instants of the switches are unknowns of the samples too: every
interval in which a sign, a comparison or a rounding turns is cut there (`formula_structure`). Where
a state decides a jump, as the speed in dry friction, its harmonics fall so slowly that the response
is extrapolated, from two numbers of harmonics, to infinitely many.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formula_structure import has_jumps, has_switches, interval_mean, separated
from greybox.modeling.functions import exp
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.sine import MOST_HARMONICS, Sine
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import traced_derivative, traced_output
from greybox.modeling.trim import trim_of

# Samples over one period, at least. Odd, so that a kink such as that of |v| v, sampled at a
# symmetric orbit, counts as if sampled twice as often; and four a harmonic, for products of up to
# three signals without aliasing.
POINTS = 33
# Of the amplitude, where Newton's method fails at once: from 1/128 of it, where a model is nearly
# linear, doubled.
HALVINGS = 7
# The harmonics, per amplitude, where Newton's method begins: its first step then goes to the linear
# response. Not zero, where a kink has no slope.
SMALL = 1e-6
# Tried in turn: each about doubles the last.
HARMONICS = (1, 3, 7, 15, 31, MOST_HARMONICS)
ENOUGH = (
    3e-4  # change of the response by the next number of harmonics, relative, that does not matter
)
TOLERANCE = (
    1e-8  # of the balance, relative to the size of the harmonics: Newton's last step squares it
)
SINGULAR = 1e-9  # singular value of the balance, rows scaled to one, that is rounding: it leaves a direction open
DETERMINED = (
    1e-7  # part of a condition in the open directions from which it determines one, above rounding
)
# Harmonics below which nothing is extrapolated.
MOST_SMOOTH = 2
TINY = 1e-300  # instead of a division by zero
# Samples over one period where a formula switches, see `formula_structure`: a relay is then exact
# to 1e-7, a saturation to 2e-5.
SWITCHED_POINTS = 65
# Of these samples, in intervals: where a sine or its derivative is zero, a switch then is an eighth
# from an end of an interval at least. At an end it might count in neither of the two, or in both.
SHIFT = 0.125
WIDENINGS = 12  # of the width, in steps of two, from one that is most of a period
# Harmonics up to which the balance is a graph of scalars: three times as fast, but its size grows
# with their cube.
MOST_SCALARS = 9
# Balances that a thread keeps compiled: every fit asks for the same three or four numbers of
# harmonics several times, for the response, its curve, and how much more of them change.
KEPT = 16
WIDTH = 0.05  # of a switch whose argument rests there


@one_thread_at_a_time
def harmonic_function(
    model: Model,
    omega: Array,
    sine: Sine,
    *,
    input: str = "",
    output: str = "",
    at: Mapping[str, float] | None = None,
    pade: int | None = None,
) -> ca.Function:
    """Compile the response: the CasADi function from the parameter vector to real and imaginary part (n,).

    Of a sine without a number of harmonics, with as many as matter at the start values.
    """
    if sine.harmonics is None:
        sine = enough_harmonics(model, omega, sine, input=input, output=output, at=at, pade=pade)
    balance = CompiledBalance.at(model, omega, sine, input=input, output=output, at=at, pade=pade)
    fewer = balance.fewer
    if fewer is None:
        return balance.response(omega)
    sine = replace(sine, harmonics=fewer)
    coarse = CompiledBalance.at(model, omega, sine, input=input, output=output, at=at, pade=pade)
    p = ca.MX.sym("p", len(model.parameters))
    pairs = zip(balance.response(omega)(p), coarse.response(omega)(p), strict=True)
    return ca.Function("response", [p], [balance.extrapolated(many, few) for many, few in pairs])


def enough_harmonics(
    model: Model,
    omega: Array,
    sine: Sine,
    values: Mapping[str, float] | None = None,
    **signals: Any,
) -> Sine:
    """Return the sine with as many harmonics as matter at the values, by default the starts; `MOST_SCALARS` at most."""
    if sine.harmonics is not None:
        return sine
    _, number = directly_found(
        model, values, omega, sine, least=HARMONICS[1], most=MOST_SCALARS, **signals
    )
    return replace(sine, harmonics=number)


def directly_found(
    model: Model,
    values: Mapping[str, float] | None,
    omega: Array,
    sine: Sine,
    *,
    least: int = 1,
    most: int = MOST_HARMONICS,
    **signals: Any,
) -> tuple[ComplexArray, int]:
    """Return the response as a fit evaluates it, NaN where no motion is found, and the number of harmonics."""
    vector = list(model.values(values).values())
    numbers = (
        [n for n in HARMONICS if least <= n <= most] if sine.harmonics is None else [sine.harmonics]
    )
    last = None
    before = numbers[0]
    response = np.full(omega.size, np.nan + 0j)
    for number in numbers:
        function = harmonic_function(model, omega, replace(sine, harmonics=number), **signals)
        re, im = (np.asarray(part).ravel() for part in function(vector))
        finite = np.isfinite(re) & np.isfinite(im)
        response = np.full(omega.size, np.nan + 0j)
        response[finite] = re[finite] + 1j * im[finite]
        if last is not None and _agree(last, response).all():
            return response, before
        last = response
        before = number
    return response, numbers[-1]


def _agree(few: ComplexArray, many: ComplexArray) -> BoolArray:
    """Tell where the response with more harmonics is the same, or missing as well."""
    same = np.abs(many - few) <= ENOUGH * np.abs(many)
    return same | (np.isnan(few) & np.isnan(many))


def check_sine(model: Model, sine: Sine, input: str, omega: Array) -> None:
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


@dataclass(frozen=True)
class Equations:
    """What a balance is written from, in plain values, so that equal models and sines have one balance.

    `formulas` is the serialized function (states and inputs, parameters) -> derivative, outputs;
    `delay` the position of the parameter that delays the input.
    """

    formulas: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: int
    delay: int | None
    signal: str
    input: str
    output: str
    pade: int | None

    @classmethod
    def of(
        cls, model: StateSpace, signal: str, input: str, output: str, pade: int | None
    ) -> "Equations":
        """Read the model."""
        z = ca.SX.sym("z", len(model.states) + len(model.inputs))
        p = ca.SX.sym("p", len(model.parameters))
        formulas = ca.Function(
            "formulas", [z, p], [traced_derivative(model, z, p), traced_output(model, z, p)]
        )
        return cls(
            formulas=formulas.serialize(),
            states=tuple(model.states),
            inputs=model.input_names,
            outputs=model.output_names,
            parameters=len(model.parameters),
            delay=list(model.parameters).index(model.delays[input])
            if input in model.delays
            else None,
            signal=signal,
            input=input,
            output=output,
            pade=pade,
        )


@dataclass(frozen=True, eq=False)
class Balance:
    """The balance at one frequency, in unknown harmonics per amplitude.

    `unknown` (k,) are mean, cosine and sine coefficients of the states and the driven input and the
    means of the other inputs, about the operating point, divided by the amplitude; `given` holds
    parameters, operating point, omega, amplitude and the `WIDTH` of switches; `balance` must
    vanish; of the conditions `means` on the means as many must vanish as the ODE leaves open;
    `response` is real and imaginary part; `slopes` gives the derivatives of `balance` and `means` by
    the unknown.
    """

    harmonics: int
    unknown: Any
    given: Any
    balance: Any
    means: Any
    response: Any
    switches: bool
    jumps: bool
    linear: bool
    slopes: ca.Function

    @classmethod
    @one_thread_at_a_time
    def of(cls, equations: "Equations", harmonics: int) -> "Balance":
        """Write down the balance."""
        kind: Any = ca.SX if harmonics <= MOST_SCALARS else ca.MX
        n = len(equations.states)
        names = (*equations.states, *equations.inputs)
        symbols = ca.SX.sym("z", len(names))
        parameters = ca.SX.sym("p", equations.parameters)
        rates, read = ca.Function.deserialize(equations.formulas)(symbols, parameters)
        output_names = equations.outputs
        wanted = [
            output_names.index(name)
            for name in (equations.output, equations.signal)
            if name in output_names
        ]
        formulas = ca.vertcat(rates, *[read[k] for k in wanted])
        at_point = ca.Function("read", [symbols, parameters], [read[wanted[-1]]])

        p = kind.sym("p", equations.parameters)
        point = kind.sym("point", len(names))
        omega = kind.sym("omega")
        amplitude = kind.sym("amplitude")
        width = kind.sym("width")

        driven = n + equations.inputs.index(equations.input)
        held = _position(equations, read, symbols)
        columns = 2 * harmonics + 1
        places, constant = _places([*range(n), driven], len(names), columns, held)
        unknown = kind.sym("harmonics", places.size2())
        per_amplitude = ca.reshape(places @ unknown + constant, 2 * harmonics + 1, len(names)).T
        first_column = ca.DM(ca.Sparsity.unit(2 * harmonics + 1, 0)).T
        series = amplitude * per_amplitude + point @ first_column
        found, switches = _harmonics(formulas, symbols, parameters, series, p, width, harmonics)

        derivative = _derivative(harmonics)
        balance = [ca.vec((omega * series[:n, :] @ derivative - found[:n, :]).T)]
        means = [per_amplitude[k, 0] for k in (*range(n, len(names)), *range(n))]
        if held is None:
            moving = found[-1, :] - (at_point(point, p) @ first_column)
            balance.append(moving[1:].T - amplitude * ca.DM([1, *[0] * (2 * harmonics - 1)]))
            means.insert(0, moving[0] / amplitude)
        else:
            means.insert(0, per_amplitude[held, 0])

        means = ca.vertcat(*means)
        balance = ca.vertcat(*balance) / amplitude
        given = ca.vertcat(p, point, omega, amplitude, width)
        blocks = [ca.jacobian(e, unknown) for e in (balance, means)]

        delay = kind(0) if equations.delay is None else p[equations.delay]
        first = _first(found[n, :]) / _first(series[driven, :])
        first = first * exp(-Complex(kind(0), omega, equations.pade) * delay)
        return cls(
            harmonics=harmonics,
            unknown=unknown,
            given=given,
            balance=balance,
            means=means,
            response=ca.vertcat(first.re, first.im),
            switches=switches,
            jumps=switches
            and has_jumps(
                rates, symbols, ca.vertcat(*[symbols[k] for k in range(len(names)) if k != held])
            ),
            linear=not ca.depends_on(separated(formulas, symbols)[1], symbols),
            slopes=ca.Function("slopes", [unknown, given], blocks),
        )


def _position(equations: "Equations", read: ca.SX, z: ca.SX) -> int | None:
    """Return where the signal of the sine stands among states and inputs; None for an output that is a formula."""
    if equations.signal in equations.outputs:
        formula = read[equations.outputs.index(equations.signal)]
        return next((k for k in range(z.numel()) if ca.is_equal(formula, z[k])), None)
    return (*equations.states, *equations.inputs).index(equations.signal)


def _places(moving: Sequence[int], rows: int, width: int, held: int | None) -> tuple[ca.DM, ca.DM]:
    """Return matrix and constant from the unknown to all coefficients, row by row.

    What is `held` to a sine or does not move has a mean alone.
    """
    where = [
        k * width + i for k in range(rows) for i in range(width if k in moving and k != held else 1)
    ]
    places = ca.DM.triplet(
        where, list(range(len(where))), [1.0] * len(where), rows * width, len(where)
    )
    constant = ca.DM(rows * width, 1)
    if held is not None:
        constant[held * width + 1] = 1
    return places, constant


def _derivative(harmonics: int) -> ca.DM:
    """Return the matrix, from the right, from the coefficients to those of the derivative by the phase."""
    result = ca.DM(2 * harmonics + 1, 2 * harmonics + 1)
    for k in range(1, harmonics + 1):
        cosine = 2 * k - 1
        sine = 2 * k
        result[sine, cosine] = k
        result[cosine, sine] = -k
    return result


def _first(row: Any) -> Complex:
    """Return the first harmonic as the complex amplitude of exp(jωt)."""
    return Complex(row[1], -row[2])


def _harmonics(
    formulas: ca.SX, z: ca.SX, parameters: ca.SX, series: Any, p: Any, width: Any, harmonics: int
) -> tuple[Any, bool]:
    """Return the coefficients (k, 2h + 1) of `formulas` (k, 1) of signals `z` with their `series`; if they switch."""
    linear, rest = separated(formulas, z)
    slopes, constants = ca.Function("linear", [parameters], [linear, _free_of(rest, z)])(p)
    first_column = ca.DM(ca.Sparsity.unit(2 * harmonics + 1, 0)).T
    result = slopes @ series + constants @ first_column

    rows = [k for k in range(rest.numel()) if ca.depends_on(rest[k], z)]
    if not rows:
        return result, False
    rest = ca.vertcat(*[rest[k] for k in rows])
    used = [j for j in range(z.numel()) if ca.depends_on(rest, z[j])]
    signals = ca.vertcat(*[z[j] for j in used])
    moving = ca.vertcat(*[series[j, :] for j in used])
    switches = has_switches(rest, signals)
    to_samples, to_series = _transforms(
        harmonics, *((SWITCHED_POINTS, SHIFT) if switches else (POINTS, 0.0))
    )
    points = to_samples.size2()

    if switches:
        speeds = moving @ _derivative(harmonics)
        sizes = ca.sqrt(ca.sum2(speeds**2) / 2 + TINY)
        term = _mean_term(rest, signals, parameters, points).map(
            "terms", "serial", points, [2, 3, 4], []
        )
        mean, moment = term(moving @ to_samples, speeds @ to_samples, sizes, width, p)
        found = mean @ to_series + moment @ (to_series @ _derivative(harmonics).T)
    else:
        term = ca.Function("term", [signals, parameters], [rest])
        found = term.map("terms", "serial", points, [1], [])(moving @ to_samples, p) @ to_series
    scatter = ca.DM.triplet(
        rows, list(range(len(rows))), [1.0] * len(rows), formulas.numel(), len(rows)
    )
    return result + scatter @ found, switches


def _free_of(rest: ca.SX, z: ca.SX) -> ca.SX:
    """Return the rows that do not depend on z, zero in place of the others."""
    return ca.vertcat(
        *[ca.SX(0) if ca.depends_on(rest[k], z) else rest[k] for k in range(rest.numel())]
    )


def _mean_term(rest: ca.SX, signals: ca.SX, parameters: ca.SX, points: int) -> ca.Function:
    """Return the function from signals, slopes by the phase, rms slopes, width and parameters to mean and moment."""
    slopes = ca.SX.sym("slopes", signals.numel())
    sizes = ca.SX.sym("sizes", signals.numel())
    width = ca.SX.sym("width")
    mean, moment = interval_mean(rest, signals, slopes, width * sizes, 2 * np.pi / points)
    return ca.Function("term", [signals, slopes, sizes, width, parameters], [mean, moment])


def _transforms(harmonics: int, least: int, shift: float) -> tuple[ca.DM, ca.DM]:
    """Return the matrices, from the right, from coefficients to samples over one period and back."""
    points = max(least, 4 * harmonics + 1)
    phase = 2 * np.pi * (np.arange(points) + shift) / points
    waves = [wave(k * phase) for k in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
    to_samples = np.array([np.ones(points), *waves])
    to_series = to_samples.T * 2 / points
    to_series[:, 0] /= 2
    return ca.DM(to_samples), ca.DM(to_series)


def _mean_conditions(balance: Balance, given: Array) -> tuple[int, ...] | None:
    """Choose what fixes the means: the first conditions that the balance, at some orbit, does not determine already.

    The mean of the sine's own signal comes first. It determines nothing where an integrator follows
    it, as the angle follows the rate: then that of a state. None where the balance leaves more
    open.
    """
    generic = np.random.default_rng(0).normal(size=balance.unknown.numel())
    rows, conditions = (
        np.nan_to_num(np.asarray(ca.DM(block))) for block in balance.slopes(generic, given)
    )
    rows, conditions = (
        e / np.maximum(np.linalg.norm(e, axis=1, keepdims=True), TINY) for e in (rows, conditions)
    )
    _, singular, basis = np.linalg.svd(rows)
    open_directions = basis[int(np.sum(singular > SINGULAR)) :]
    chosen: list[int] = []
    missing = balance.unknown.numel() - balance.balance.numel()
    for k, row in enumerate(conditions):
        in_open = np.array([*conditions[chosen], row]) @ open_directions.T
        if len(chosen) < missing and np.linalg.matrix_rank(in_open, DETERMINED) == len(in_open):
            chosen.append(k)
    return None if len(chosen) < missing or len(open_directions) > missing else tuple(chosen)


@dataclass(frozen=True, eq=False)
class Newton:
    """Newton's method on the balance, by functions of the harmonics and what is given, in this order.

    `newton` and `careful`, which searches along a line, take them as `x0` and `p`; `finish` gives
    the response and whether the harmonics are a motion. `guess` finds harmonics from what is given
    alone.
    """

    balance: Balance
    newton: ca.Function
    careful: ca.Function
    finish: ca.Function
    guess: ca.Function

    @classmethod
    @one_thread_at_a_time
    def of(cls, balance: Balance, conditions: tuple[int, ...]) -> "Newton":
        """Compile with those `conditions` on the means."""
        x = balance.unknown
        equations = ca.vertcat(balance.balance, *[balance.means[k] for k in conditions])
        statement = {"x": x, "p": balance.given, "g": equations}
        options = {
            "error_on_fail": False,
            "abstol": 1e-11,
            "max_iter": 30,
            "show_eval_warnings": False,
        }
        size = ca.norm_inf(equations) / (1 + ca.norm_inf(x))
        both = [x, balance.given]
        newton = ca.rootfinder(
            "newton", "newton", statement, {**options, "line_search": False}
        )  # twice as fast
        careful = ca.rootfinder("careful", "newton", statement, options)
        finish = ca.Function("finish", both, [balance.response, size < TOLERANCE])
        return cls(
            balance=balance,
            newton=newton,
            careful=careful,
            finish=finish,
            guess=_guess(newton, careful, finish, switches=balance.switches),
        )


def _guess(
    newton: ca.Function, careful: ca.Function, finish: ca.Function, *, switches: bool
) -> ca.Function:
    """Return the function from what is given to the harmonics: at once, or else in steps, see `_in_steps`."""
    given: Any = ca.MX.sym("given", newton.numel_in("p"))
    root: Any = ca.MX.sym("root", newton.numel_in("x0"))
    small = ca.DM(np.full(root.numel(), SMALL))
    found = newton(x0=small, p=given)["x"]
    for k, name in enumerate(("by_doubling", "by_narrowing")[: 2 if switches else 1]):
        otherwise = _in_steps(name, careful, finish, k, small, give_up=switches)
        chosen = ca.if_else(finish(root, given)[1], root, otherwise(given), True)
        choose = ca.Function("choose", [root, given], [chosen], {"never_inline": True})
        found = choose(found, given)
    return ca.Function("guess", [given], [found])


def _in_steps(
    name: str,
    careful: ca.Function,
    finish: ca.Function,
    from_end: int,
    small: ca.DM,
    *,
    give_up: bool,
) -> ca.Function:
    """Return the function from what is given to the harmonics, from where the model is nearly linear.

    That is a small amplitude, where it is smooth; and where it switches, a switch as wide as its
    argument. With `give_up` nothing is tried after a step that failed: of masses that mostly stick
    it loses 4 % of the frequencies and takes a fifth of the time.
    """
    given: Any = ca.MX.sym("given", careful.numel_in("p"))
    if from_end == 0:
        steps = [
            ca.vertcat(given[:-2], given[-2] / 2**k, given[-1]) for k in range(HALVINGS, -1, -1)
        ]
    else:
        steps = [ca.vertcat(given[:-1], given[-1] * 2**k) for k in range(WIDENINGS, -1, -1)]

    root: Any = ca.MX.sym("root", small.numel())
    before: Any = ca.MX.sym("before", given.numel())
    step: Any = ca.MX.sym("step", given.numel())
    further = careful(x0=root, p=step)["x"]
    gone_on = ca.if_else(finish(root, before)[1], further, root, True) if give_up else further
    go_on = ca.Function("go_on", [root, before, step], [gone_on], {"never_inline": give_up})
    found = careful(x0=small, p=steps[0])["x"]
    for last, following in pairwise(steps):
        found = go_on(found, last, following)
    return ca.Function(name, [given], [found])


class _Kept(threading.local):
    """What one thread has compiled: every CasADi function works in memory of its own, which threads must not share."""

    def __init__(self) -> None:
        self.balance = lru_cache(maxsize=KEPT)(Balance.of)
        self.newton = lru_cache(maxsize=KEPT)(Newton.of)


_kept = _Kept()


@dataclass(frozen=True, eq=False)
class CompiledBalance(Newton):
    """Newton's method on the balance of a `model` under a `sine`, from its operating point (`trim`)."""

    model: StateSpace
    sine: Sine
    trim: ca.Function
    driven_directly: bool

    @classmethod
    def at(
        cls,
        model: Model,
        omega: Array,
        sine: Sine,
        *,
        input: str = "",
        output: str = "",
        at: Mapping[str, float] | None = None,
        pade: int | None = None,
    ) -> "CompiledBalance":
        """Compile for the `harmonics` of a sine, or find what is compiled already."""
        input, output = pick_signals(model, input, output)
        check_sine(model, sine, input, omega)
        assert isinstance(model, StateSpace)
        assert sine.harmonics is not None
        trim = trim_of(model, at or {}).closed()
        balance = _kept.balance(
            Equations.of(model, sine.signal, input, output, pade), sine.harmonics
        )

        start = [q.start for q in model.parameters.values()]
        point = np.concatenate([np.asarray(part).ravel() for part in trim(start)])
        amplitudes = sine.amplitudes(omega)
        middle = int(np.argsort(amplitudes)[omega.size // 2])
        given = np.concatenate([start, point, [omega[middle], amplitudes[middle], WIDTH]])
        conditions = _mean_conditions(balance, given)
        if conditions is None:
            raise ValueError(
                f"the input {input} cannot make {sine.signal!r} a sine in {model.label} at its start values: name a "
                "signal that it drives, or check `at`."
            )
        newton = _kept.newton(balance, conditions)
        return cls(
            **vars(newton), model=model, sine=sine, trim=trim, driven_directly=sine.signal == input
        )

    @property
    def fewer(self) -> int | None:
        """How many harmonics the response is extrapolated from besides these; None where that is not needed."""
        return (
            (self.harmonics - 1) // 2
            if self.balance.jumps and self.harmonics > MOST_SMOOTH
            else None
        )

    @property
    def harmonics(self) -> int:
        """How many are balanced."""
        return self.balance.harmonics

    def extrapolated(self, many: Any, few: Any) -> Any:
        """Return the response as its error goes with one over the harmonics, from these and the `fewer`.

        A jump that a state decides, as in friction, puts a kink into that state just where it
        matters: its harmonics fall with the square of their number, and what is cut off with the
        number.
        """
        assert self.fewer is not None
        return many + (many - few) * (self.fewer + 1) / (self.harmonics - self.fewer)

    def response(self, omega: Array) -> ca.Function:
        """Return the function from the parameter vector to real and imaginary part of the response (n,)."""
        p = ca.MX.sym("p", len(self.model.parameters))
        parts = self._responses(self.given(p, omega))
        return ca.Function("response", [p], [parts[0, :].T, parts[1, :].T])

    def given(self, p: Any, omega: Array) -> Any:
        """Return what is given at every frequency, as columns: parameters `p`, operating point, frequency, sine."""
        columns = ca.repmat(ca.vertcat(p, *self.trim(p)), 1, omega.size)
        amplitudes = ca.DM(self.sine.amplitudes(omega)).T
        return ca.vertcat(columns, ca.DM(omega).T, amplitudes, ca.DM.ones(1, omega.size) * WIDTH)

    def _responses(self, given: Any) -> Any:
        """Return real and imaginary part of the response, (2, n), for columns of what is given at every frequency."""
        n = given.size2()
        guesses = self.guess.map(n)(given)
        # Newton's method once more, from its own solution: derivatives then go through this call
        # and leave out the guess.
        response, converged = self.finish.map(n)(
            self.newton.map(n)(x0=guesses, p=given)["x"], given
        )
        # A motion that was not found becomes infinite, so that the run that met it fails instead of
        # using it.
        return response / ca.repmat(converged, 2, 1)
