"""The response of a nonlinear ODE to a sine of finite amplitude, by harmonic balance.

Begin with `harmonic_function`. Every signal is a truncated Fourier series, and the residual of the
ODE, sampled along one period, must have no harmonics (alternating frequency-time method: Cameron
and Griffin 1989, Journal of Applied Mechanics 56). Newton's method solves for the harmonics, and
the implicit function theorem differentiates them, so that a solver sees only the parameters. With
the harmonics as unknowns of the solver, a fit took five times as many iterations, and a fifth of
the starts failed. Terms that are linear in the signals are balanced exactly and never sampled: a
linear model has its linear response.

If a formula switches, its samples are means over the sampling interval (`formula_structure`). If a
state decides a jump, as the speed does in dry friction, its harmonics fall slowly: the response
with nine of them is exact to half a per cent, with 50 to a tenth of a per cent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formula_structure import has_switches, interval_means
from greybox.modeling.functions import exp
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.sine import MOST_HARMONICS, Sine
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import traced_derivative, traced_output
from greybox.modeling.trim import trim_of

# Numbers of harmonics to try in turn: each about doubles the previous one.
HARMONICS = (1, 3, 7, 15, 31, MOST_HARMONICS)
# Relative change of the response by the next number of harmonics, below which the number suffices.
ENOUGH = 3e-4
# Up to this number of harmonics the balance is a graph of scalars: three times as fast, but its
# size grows with the cube of the number.
MOST_SCALARS = 9


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
    """Return the CasADi function from the parameter vector to real and imaginary part (n,).

    A sine without a number of harmonics gets as many as matter at the start values.
    """
    signals: dict[str, Any] = {"input": input, "output": output, "at": at, "pade": pade}
    if sine.harmonics is None:
        sine = enough_harmonics(model, omega, sine, **signals)
    return CompiledBalance.at(model, omega, sine, **signals).response(omega)


def enough_harmonics(
    model: Model,
    omega: Array,
    sine: Sine,
    values: Mapping[str, float] | None = None,
    **signals: Any,
) -> Sine:
    """Return the sine with as many harmonics as matter at the values, at most `MOST_SCALARS`.

    The values are by default the declared starts.
    """
    if sine.harmonics is not None:
        return sine
    # Three at least: one harmonic has the folds of a spring at other amplitudes.
    _, harmonics = directly_found(
        model, values, omega, sine, least=HARMONICS[1], most=MOST_SCALARS, **signals
    )
    return replace(sine, harmonics=harmonics)


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
    """Return the response as a fit evaluates it, and the number of harmonics.

    The response is NaN where no periodic motion is found.
    """
    vector = list(model.values(values).values())
    numbers = [sine.harmonics or 0]
    if sine.harmonics is None:
        numbers = [number for number in HARMONICS if least <= number <= most]

    responses: list[ComplexArray] = []
    for number in numbers:
        function = harmonic_function(model, omega, replace(sine, harmonics=number), **signals)
        real, imaginary = (np.asarray(part).ravel() for part in function(vector))
        is_finite = np.isfinite(real) & np.isfinite(imaginary)
        # Infinite parts would make NaN as a product, and NaN alone marks a missing motion.
        response = np.full(omega.size, np.nan + 0j)
        response[is_finite] = real[is_finite] + 1j * imaginary[is_finite]
        responses.append(response)
        if len(responses) > 1 and agree(*responses[-2:]).all():
            return responses[-1], numbers[len(responses) - 2]

    return responses[-1], numbers[-1]


def agree(few: ComplexArray, many: ComplexArray) -> BoolArray:
    """Return where the response with more harmonics is the same, or missing as well."""
    is_same = np.abs(many - few) <= ENOUGH * np.abs(many)
    return is_same | (np.isnan(few) & np.isnan(many))


def check_sine(model: Model, sine: Sine, input: str, omega: Array) -> None:
    """Raise ValueError, naming the cure, where model, data and sine do not fit together."""
    if not isinstance(model, StateSpace):
        raise ValueError(
            f"{model.label} is a transfer function, whose response is the same at every amplitude: "
            "omit the amplitude."
        )

    names = dict.fromkeys((input, *model.outputs, *model.states))
    if sine.signal not in names:
        raise ValueError(
            f"the sine is of {sine.signal!r}, which {model.label} does not have: name one of "
            f"{', '.join(names)}."
        )

    sine.amplitudes(omega)


@dataclass(frozen=True, eq=False)
class Balance:
    """The balance at one frequency, in unknown harmonics per amplitude.

    `unknown` (k,) are mean, cosine and sine coefficients of the states and the driven input, and
    the means of the other inputs, about the operating point, divided by the amplitude. `settings`
    are parameters, operating point, omega and amplitude. `balance` must vanish, and so must as many
    of the conditions `means` on the means as the ODE leaves open. `response` is real and imaginary
    part, `slopes` the function from unknown and settings to the derivatives of `balance` and
    `means` by the unknown.
    """

    unknown: Any
    settings: Any
    balance: Any
    means: Any
    response: Any
    is_linear: bool
    slopes: ca.Function

    @classmethod
    @one_thread_at_a_time
    def of(
        cls,
        model: StateSpace,
        harmonics: int,
        signal: str,
        input: str,
        output: str,
        pade: int | None,
    ) -> "Balance":
        """Return the balance of a model with so many harmonics."""
        kind: Any = ca.SX if harmonics <= MOST_SCALARS else ca.MX
        n = len(model.states)
        names = (*model.states, *model.inputs)
        symbols = ca.SX.sym("z", len(names))
        parameters = ca.SX.sym("p", len(model.parameters))
        outputs = traced_output(model, symbols, parameters)
        rows = [outputs[model.outputs.index(y)] for y in (output, signal) if y in model.outputs]
        formulas = ca.vertcat(traced_derivative(model, symbols, parameters), *rows)
        at_point = ca.Function("at_point", [symbols, parameters], [rows[-1]])

        p = kind.sym("p", len(model.parameters))
        point = kind.sym("point", len(names))
        omega = kind.sym("omega")
        amplitude = kind.sym("amplitude")

        # A signal that is a state or an input itself has no unknown coefficients but its mean.
        driven = names.index(input)
        held = names.index(signal) if signal in names else None
        if signal in model.outputs:  # perhaps a state under the name of an output
            held = next((k for k in range(len(names)) if ca.is_equal(rows[-1], symbols[k])), None)

        columns = 2 * harmonics + 1
        places, constant = _places([*range(n), driven], len(names), columns, held)
        unknown = kind.sym("harmonics", places.size2())
        per_amplitude = ca.reshape(places @ unknown + constant, columns, len(names)).T
        first_column = ca.DM(ca.Sparsity.unit(columns, 0)).T
        series = amplitude * per_amplitude + point @ first_column
        balanced, is_linear = _harmonics(formulas, symbols, parameters, series, p, harmonics)

        derivative = phase_derivative(harmonics)
        balance = [ca.vec((omega * series[:n, :] @ derivative - balanced[:n, :]).T)]
        means = [per_amplitude[k, 0] for k in (*range(n, len(names)), *range(n))]
        # An output that is computed gets equations instead: its first cosine is the amplitude, all
        # other harmonics vanish.
        if held is None:
            moving = balanced[-1, :] - (at_point(point, p) @ first_column)
            balance.append(moving[1:].T - amplitude * ca.DM([1, *[0] * (2 * harmonics - 1)]))
            means.insert(0, moving[0] / amplitude)
        else:
            means.insert(0, per_amplitude[held, 0])

        mean_conditions = ca.vertcat(*means)
        # Per amplitude, so that one tolerance serves sines of any size.
        residual = ca.vertcat(*balance) / amplitude
        settings = ca.vertcat(p, point, omega, amplitude)
        slopes = [ca.jacobian(e, unknown) for e in (residual, mean_conditions)]

        response = _first(balanced[n, :]) / _first(series[driven, :])
        if input in model.delays:
            delay = p[list(model.parameters).index(model.delays[input])]
            response = response * exp(-Complex(kind(0), omega, pade) * delay)

        return cls(
            unknown=unknown,
            settings=settings,
            balance=residual,
            means=mean_conditions,
            response=ca.vertcat(response.re, response.im),
            is_linear=is_linear,
            slopes=ca.Function("slopes", [unknown, settings], slopes),
        )


def _places(moving: Sequence[int], rows: int, width: int, held: int | None) -> tuple[ca.DM, ca.DM]:
    """Return matrix and constant from the unknown to all coefficients, row by row.

    A signal that is `held` to a sine, or does not move, has only its mean as unknown.
    """
    places = [
        k * width + i for k in range(rows) for i in range(width if k in moving and k != held else 1)
    ]
    matrix = _scatter(places, rows * width)
    constant = ca.DM(rows * width, 1)
    if held is not None:
        constant[held * width + 1] = 1
    return matrix, constant


def _scatter(rows: Sequence[int], size: int) -> ca.DM:
    """Return the matrix that puts entries into these rows of a vector of this size."""
    count = len(rows)
    return ca.DM.triplet(list(rows), list(range(count)), [1.0] * count, size, count)


def phase_derivative(harmonics: int) -> ca.DM:
    """Return the matrix, applied from the right, that differentiates a series by the phase."""
    matrix = ca.DM(2 * harmonics + 1, 2 * harmonics + 1)
    for k in range(1, harmonics + 1):
        cosine = 2 * k - 1
        sine = 2 * k
        matrix[sine, cosine] = k
        matrix[cosine, sine] = -k
    return matrix


def _first(row: Any) -> Complex:
    """Return the first harmonic as the complex amplitude of exp(jωt)."""
    return Complex(row[1], -row[2])


@one_thread_at_a_time
def _harmonics(
    formulas: ca.SX, z: ca.SX, parameters: ca.SX, series: Any, p: Any, harmonics: int
) -> tuple[Any, bool]:
    """Return the coefficients (k, 2h + 1) of `formulas` (k, 1), and whether all are linear.

    `series` are the coefficients of the signals z.
    """
    switches = has_switches(formulas)
    # An odd number of samples: a kink such as that of |v| v, sampled at a symmetric orbit, then
    # counts as if sampled twice as often. With 257, a relay and a saturation are exact to 1e-4.
    points = max(257 if switches else 33, 4 * harmonics + 1)
    to_samples, to_series = transforms(harmonics, points)
    slopes = ca.SX.sym("slopes", z.numel())
    sizes = ca.SX.sym("sizes", z.numel())
    if switches:
        formulas = interval_means(formulas, z, slopes, sizes, 2 * np.pi / points)

    # Linear rows are balanced exactly, so that a linear model keeps its linear response.
    jacobian = ca.jacobian(formulas, z)
    rows = [k for k in range(formulas.numel()) if ca.depends_on(jacobian[k, :], z)]
    constants = ca.substitute(formulas, z, ca.SX.zeros(z.numel()))
    for k in rows:
        jacobian[k, :] = 0
        constants[k] = 0

    linear, constant = ca.Function("linear", [parameters], [jacobian, constants])(p)
    coefficients = linear @ series + constant @ ca.DM(ca.Sparsity.unit(2 * harmonics + 1, 0)).T
    if not rows:
        return coefficients, True

    speeds = series @ phase_derivative(harmonics)
    rms_speeds = ca.sqrt(ca.sum2(speeds**2) / 2)
    terms = ca.vertcat(*[formulas[k] for k in rows])
    term = ca.Function("term", [z, slopes, sizes, parameters], [terms])
    sampled = term.map("terms", "serial", points, [2, 3], [])(
        series @ to_samples, speeds @ to_samples, rms_speeds, p
    )

    return coefficients + _scatter(rows, formulas.numel()) @ (sampled @ to_series), False


def transforms(harmonics: int, points: int) -> tuple[ca.DM, ca.DM]:
    """Return the matrices, from the right, from coefficients to samples over one period and back.

    Four samples a harmonic allow products of three signals without aliasing.
    """
    # The samples cover one period evenly, so that the waves are orthogonal and need no inverse.
    phase = 2 * np.pi * np.arange(points) / points
    waves = [wave(k * phase) for k in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
    to_samples = np.array([np.ones(points), *waves])
    to_series = to_samples.T * 2 / points
    to_series[:, 0] /= 2
    return ca.DM(to_samples), ca.DM(to_series)


def _mean_conditions(balance: Balance, settings: Array) -> tuple[int, ...] | None:
    """Return the first conditions on the means that the balance leaves open at a random orbit.

    The mean of the sine's own signal comes first. It determines nothing if an integrator follows
    it, as the angle follows the rate; the mean of a state then does. None if the balance leaves
    more open.
    """
    # A random orbit has no symmetry that would make the rank too low.
    generic = np.random.default_rng(0).normal(size=balance.unknown.numel())
    slopes = [
        np.nan_to_num(np.asarray(ca.DM(block))) for block in balance.slopes(generic, settings)
    ]
    rows, conditions = (
        block / np.maximum(np.linalg.norm(block, axis=1, keepdims=True), 1e-300) for block in slopes
    )
    # Directions of the unknown that change no harmonic of the balance are open.
    _, singular, basis = np.linalg.svd(rows)
    open_directions = basis[int(np.sum(singular > 1e-9)) :]  # below, rounding alone
    missing = balance.unknown.numel() - balance.balance.numel()

    chosen: list[int] = []
    for k, row in enumerate(conditions):
        in_open = np.array([*conditions[chosen], row]) @ open_directions.T
        if len(chosen) < missing and np.linalg.matrix_rank(in_open, 1e-7) == len(in_open):
            chosen.append(k)

    return None if len(chosen) < missing or len(open_directions) > missing else tuple(chosen)


@dataclass(frozen=True, eq=False)
class Newton:
    """Newton's method on the balance, as functions of the harmonics and the settings.

    `newton` and `careful`, which searches along a line, take them as `x0` and `p`; `finish` gives
    the response and whether the harmonics are a motion; `guess` finds harmonics from the settings
    alone.
    """

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
        statement = {"x": x, "p": balance.settings, "g": equations}
        options = {
            "error_on_fail": False,
            "abstol": 1e-11,
            "max_iter": 30,
            "show_eval_warnings": False,
        }
        # Twice as fast; `careful` is for guesses far from the solution.
        without_line_search = {**options, "line_search": False}
        newton = ca.rootfinder("newton", "newton", statement, without_line_search)
        careful = ca.rootfinder("careful", "newton", statement, options)

        # Relative to the harmonics; Newton's last step squares it.
        size = ca.norm_inf(equations) / (1 + ca.norm_inf(x))
        finish = ca.Function("finish", [x, balance.settings], [balance.response, size < 1e-8])
        return cls(newton, careful, finish, _guess(newton, careful, finish))


def _guess(newton: ca.Function, careful: ca.Function, finish: ca.Function) -> ca.Function:
    """Return the function from settings to harmonics: at once, or with a rising amplitude."""
    settings: Any = ca.MX.sym("settings", newton.numel_in("p"))
    # So small that the first step leads to the linear response, but not zero, where a kink has no
    # slope.
    small = ca.DM(np.full(newton.numel_in("x0"), 1e-6))

    # If Newton's method fails, the amplitude is doubled step by step from a 128th, where a smooth
    # model is nearly linear.
    followed = ca.MX(small)
    for k in range(7, -1, -1):
        step = ca.vertcat(settings[:-1], settings[-1] / 2**k)
        followed = careful(x0=followed, p=step)["x"]

    by_doubling = ca.Function("by_doubling", [settings], [followed], {"never_inline": True})

    direct = newton(x0=small, p=settings)["x"]
    chosen = ca.if_else(finish(direct, settings)[1], direct, by_doubling(settings), True)
    return ca.Function("guess", [settings], [chosen])


@dataclass(frozen=True, eq=False)
class CompiledBalance:
    """The balance of a `model` under a `sine` from its operating point (`trim`), and its solver."""

    balance: Balance
    solver: Newton
    model: StateSpace
    sine: Sine
    trim: ca.Function

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
        """Compile for the number of harmonics of a sine."""
        input, output = pick_signals(model, input, output)
        check_sine(model, sine, input, omega)
        assert isinstance(model, StateSpace)
        assert sine.harmonics is not None
        trim = trim_of(model, at or {}).closed()
        balance = Balance.of(model, sine.harmonics, sine.signal, input, output, pade)

        start = [q.start for q in model.parameters.values()]
        point = np.concatenate([np.asarray(part).ravel() for part in trim(start)])
        amplitudes = sine.amplitudes(omega)
        middle = int(np.argsort(amplitudes)[omega.size // 2])
        settings = np.concatenate([start, point, [omega[middle], amplitudes[middle]]])
        conditions = _mean_conditions(balance, settings)
        if conditions is None:
            raise ValueError(
                f"the input {input} cannot make {sine.signal!r} a sine in {model.label} at its "
                "start values: name a signal that it drives, or check `at`."
            )

        return cls(balance, Newton.of(balance, conditions), model, sine, trim)

    def response(self, omega: Array) -> ca.Function:
        """Return the function from the parameter vector to real and imaginary part (n,)."""
        p = ca.MX.sym("p", len(self.model.parameters))
        settings = self.settings(p, omega)
        n = settings.size2()
        guesses = self.solver.guess.map(n)(settings)

        # Newton's method once more, from its own solution: derivatives then go through this call
        # and leave out the guess.
        harmonics = self.solver.newton.map(n)(x0=guesses, p=settings)["x"]
        response, converged = self.solver.finish.map(n)(harmonics, settings)

        # A missing motion becomes infinite, so that the run fails instead of using it.
        response = response / ca.repmat(converged, 2, 1)
        return ca.Function("response", [p], [response[0, :].T, response[1, :].T])

    def settings(self, p: Any, omega: Array) -> Any:
        """Return columns of parameters `p`, operating point, frequency and amplitude."""
        columns = ca.repmat(ca.vertcat(p, *self.trim(p)), 1, omega.size)
        amplitudes = ca.DM(self.sine.amplitudes(omega)).T
        return ca.vertcat(columns, ca.DM(omega).T, amplitudes)
