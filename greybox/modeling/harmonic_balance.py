"""The response of a nonlinear ODE to a sine of finite amplitude, by harmonic balance.

Begin with `compiled_balance`. Every signal is a truncated Fourier series, and the residual of the
ODE, sampled along one period, must have no harmonics (alternating frequency-time method: Cameron
and Griffin 1989, Journal of Applied Mechanics 56). Newton's method solves for the harmonics, and
the implicit function theorem differentiates them, so that a solver sees only the parameters. With
the harmonics as unknowns of the solver, a fit took five times as many iterations, and a fifth of
the starts failed. Samples of a term that is linear in the signals have its harmonics exactly: a
linear model has its linear response.

If a formula switches, its samples are means over the sampling interval (`formula_structure`). If a
state decides a jump, as the speed does in dry friction, its harmonics fall slowly. The response of
a body that slides throughout is exact to 2 % with nine of them, to 0.4 % with 50; with stops, to 15
and 3 %, and 4 % above the break-away force to 90 and 10 %. A body at rest below that force creeps
by half a per cent of its compliance.

The response of a nonlinear ODE to a sine test, as a fit evaluates it.

Begin with `harmonic_response`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import finite_numbers
from greybox.data.frequency_response import FrequencyResponse
from greybox.files.arrays import (
    Array,
    ArrayPair,
    ComplexArray,
    Values,
    complex_array,
    frozen,
    unit_length,
)
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formula_structure import (
    has_switches,
    interval_means,
    is_elementary,
    walk,
)
from greybox.modeling.functions import exp
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, pick_signals, require_known
from greybox.modeling.one_thread import once, one_thread_at_a_time, traced_once
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.parameter import start_values
from greybox.modeling.sine import MOST_HARMONICS, Sine, as_sine
from greybox.modeling.state_space import StateSpace, input_delays
from greybox.modeling.symbolic_reading import parameter_names, symbols, traced_column
from greybox.modeling.trim import trim_of

# Numbers of harmonics to try in turn: each about doubles the previous one.
HARMONICS = (1, 3, 7, 15, 31, MOST_HARMONICS)
# A fit takes more harmonics only by hand: its time grows with their square.
MOST_IN_FITS = 9


def enough_harmonics(
    model: Model,
    omega: Array,
    sine: Sine,
    values: Values | None = None,
    **signals: Any,
) -> Sine:
    """Return the sine with as many harmonics as matter at the values, at most `MOST_IN_FITS`.

    The values are by default the declared starts.
    """
    if sine.harmonics is not None:
        return sine
    # Three at least: with one harmonic, the folds of a spring lie at other amplitudes.
    _, harmonics = directly_found(
        model, values, omega, sine, least=HARMONICS[1], most=MOST_IN_FITS, **signals
    )
    return replace(sine, harmonics=harmonics)


def directly_found(
    model: Model,
    values: Values | None,
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
    vector = [*model.values(values).values()]
    numbers = [sine.harmonics] if sine.harmonics else [n for n in HARMONICS if least <= n <= most]
    response = np.zeros(0, complex)
    previous = 0
    for number in numbers:
        few = response
        balance = compiled_balance(model, omega, replace(sine, harmonics=number), **signals)
        response = complex_array(*(part.full().ravel() for part in balance.function()(vector)))
        response[~np.isfinite(response)] = np.nan
        # A number of harmonics suffices if the next one changes the response by less than this.
        if previous and np.allclose(few, response, rtol=3e-4, atol=0, equal_nan=True):
            return response, previous
        previous = number

    return response, previous


def check_sine(model: Model, sine: Sine, input: str, omega: Array) -> None:
    """Raise ValueError, naming the cure, where model, data and sine do not fit together."""
    if not isinstance(model, StateSpace):
        raise ValueError(
            f"{model.label} is a transfer function, whose response is the same at every amplitude: "
            "omit the amplitude."
        )

    names = (input, *model.outputs, *model.states)
    require_known([sine.signal], names, "signal for a sine", model.label)
    sine.amplitudes(omega)


@frozen
class HarmonicBalance:
    """The periodic motions of a model under a `sine` of the frequencies `omega`.

    Harmonics are mean, cosine and sine coefficients of the states and the driven input, and the
    means of the other inputs, about the operating point (`trim`), divided by the amplitude.
    Settings are parameters, operating point, omega and amplitude.

    `guess` finds harmonics from the settings. From both, `finish` gives the response, and whether
    the harmonics are a motion; `linear` gives the equations (u,) and the response (2,), with their
    derivatives with respect to harmonics and settings in further columns.
    """

    omega: Array
    sine: Sine
    trim: ca.Function
    finish: ca.Function
    linear: ca.Function
    guess: ca.Function

    def function(self) -> ca.Function:
        """Return the function from the parameter vector to real and imaginary part (n,)."""
        p = ca.MX.sym("p", self.trim.size1_in(0))
        settings = self.settings(p)
        n = settings.size2()
        response, converged = self.finish.map(n)(self.guess.map(n)(settings), settings)

        # A missing motion becomes infinite, so that the run fails instead of using it.
        response = response / ca.repmat(converged, 2, 1)
        return ca.Function("response", [p], [row.T for row in ca.vertsplit(response)])

    def settings(self, p: Any) -> Any:
        """Return columns of parameters `p`, operating point, width 1, frequency and amplitude."""
        columns = ca.repmat(ca.vertcat(p, *self.trim(p), 1), 1, self.omega.size)
        amplitudes = ca.DM(self.sine.amplitudes(self.omega)).T
        return ca.vertcat(columns, ca.DM(self.omega).T, amplitudes)


@one_thread_at_a_time
@traced_once()
def compiled_balance(
    model: Model,
    omega: Array,
    sine: Sine,
    *,
    input: str = "",
    output: str = "",
    at: Values | None = None,
    pade: int | None = None,
) -> HarmonicBalance:
    """Compile the balance for the number of harmonics of a sine."""
    input, output = pick_signals(model, input, output)
    check_sine(model, sine, input, omega)
    trim = trim_of(model, at or {}).closed()
    start = ca.DM(start_values(model.parameters))
    point = ca.vertcat(*trim(start))
    declared = model, sine.signal, sine.harmonics, input, output, pade, (point, start)
    *_, size, _, numbers = _equations(*declared)

    middle = int(np.argsort(sine.amplitudes(omega))[omega.size // 2])
    values = ca.vertcat(start, point, 1, omega[middle], sine.amplitudes(omega)[middle])
    # A random orbit has no symmetry that would make the rank too low.
    generic = np.random.default_rng(0).normal(size=numbers.numel_in(0))
    conditions = _mean_conditions(*np.split(np.asarray(numbers(generic, values)), [size]))
    if conditions is None:
        raise ValueError(
            f"the input {input} cannot make {sine.signal!r} a sine in {model.label} at its "
            "start values: name a signal that it drives, or check `at`."
        )
    return HarmonicBalance(omega, sine, trim, *_functions(*declared, conditions))


@once
def _functions(model: StateSpace, *arguments: Any) -> tuple[ca.Function, ...]:
    """Return `finish`, `linear` and `guess` of a `HarmonicBalance`.

    The arguments are those of `_equations`, and the conditions on the means.
    """
    *declared, conditions = arguments
    unknown, settings, rows, slopes, size, switches, _ = _equations(model, *declared)
    by_unknown = slopes[:, : unknown.numel()]
    chosen = [*range(size), *(size + k for k in conditions)]
    equations, jacobian = rows[chosen], by_unknown[chosen, :]
    statement = {"x": unknown, "p": settings, "g": equations}
    options = {
        "error_on_fail": False,
        "abstol": 1e-11,
        "max_iter": 30,
        "show_eval_warnings": False,
        # A function with both.
        "jacobian_function": ca.Function("both", [unknown, settings], [jacobian, equations]),
    }
    # Twice as fast; `careful` is for guesses far from the solution.
    newton = ca.rootfinder("newton", "newton", statement, {**options, "line_search": False})
    careful = ca.rootfinder("careful", "newton", statement, options)

    # Relative to the harmonics; Newton's last step squares it.
    error = ca.norm_inf(equations) / (1 + ca.norm_inf(unknown))
    # Infinite harmonics would pass, since any equation is small relative to them.
    is_motion = ca.logic_and(error < 1e-8, ca.norm_inf(unknown) < math.inf)
    finish = ca.Function("finish", [unknown, settings], [rows[-2:], is_motion])
    equations_and_slopes = ca.densify(ca.horzcat(rows, slopes)[[*chosen, -2, -1], :])
    linear = ca.Function("linear", [unknown, settings], [equations_and_slopes])
    return finish, linear, _guess(newton, careful, finish, switches=switches)


@once
def _equations(
    model: StateSpace,
    signal: str,
    harmonics: int,
    input: str,
    output: str,
    pade: int | None,
    center: tuple[ca.DM, ca.DM],
) -> tuple[Any, Any, Any, Any, int, bool, ca.Function]:
    """Return unknowns, settings, equations with response, their slopes, size, any switches.

    The equations are a balance of this size, which must vanish, and conditions on the means, of
    which as many must vanish as the ODE leaves open. Real and imaginary part of the response
    follow. The slopes are by unknowns and settings. The last is the function to the slopes of the
    equations by the unknowns. The `center` is the operating point at the start values, and these.
    """
    n = len(model.states)
    names = model.resting_signals
    point, p = symbols(model)
    outputs = traced_column(model, "output", point, p)
    rows = [outputs[model.outputs.index(y)] for y in (output, signal) if y in model.outputs]
    derivatives = traced_column(model, "derivative", point, p)
    formulas = ca.vertcat(derivatives, *rows)

    # The width is that of the ramps of switches, relative to the final one.
    width, omega, amplitude = (ca.SX.sym(name) for name in ("width", "omega", "amplitude"))
    settings = ca.vertcat(p, point, width, omega, amplitude)

    # A signal that is a state or an input itself has no unknown coefficients but its mean.
    driven = names.index(input)
    held = names.index(signal) if signal in names else None
    if signal in model.outputs:  # perhaps a state under the name of an output
        held = next((k for k in range(len(names)) if ca.is_equal(rows[-1], point[k])), None)

    columns = 2 * harmonics + 1
    moving = {*range(n), driven} - {held}
    unknown, per_amplitude = _all_coefficients(len(names), columns, moving, held)

    constant, by_phase = ca.DM(ca.Sparsity.unit(columns, 0)).T, phase_derivative(harmonics)
    series = amplitude * per_amplitude + point @ constant
    switches = has_switches(formulas)
    sizes = _rms(series @ by_phase)
    if switches:
        # At rest an orbit has no speed to compare with, but its drive has one.
        gains = _gains(derivatives, point, p, *center)
        sizes = width * ca.sqrt(sizes**2 + (gains @ _rms(series) / omega) ** 2)
    every = ca.vertcat(unknown, settings)
    by_every = ca.jacobian(ca.vertcat(ca.vec(series.T), sizes, p), every)
    signals = ca.Function("signals", [unknown, settings], [series, sizes, p, by_every])

    # The equations are linear in what is sampled. Its slopes are products of small matrices: if
    # CasADi differentiated every sample, a step of Newton's method would take ten times as long.
    symbol = ca.SX.sym("sampled", columns, formulas.numel())
    balanced = symbol.T
    balance = [ca.vec((omega * series[:n, :] @ by_phase - balanced[:n, :]).T)]
    means = [per_amplitude[k, 0] for k in (*range(n, len(names)), *range(n))]
    # An output that is computed gets equations instead: its first cosine is the amplitude, all
    # other harmonics vanish.
    if held is None:
        moving_output = balanced[-1, :] - rows[-1] @ constant
        balance.append(moving_output[1:].T - amplitude * ca.DM.eye(columns - 1)[:, 0])
        means.insert(0, moving_output[0] / amplitude)
    else:
        means.insert(0, per_amplitude[held, 0])

    response = _first(balanced[n, :]) / _first(series[driven, :])
    delay = input_delays(model, parameter_names(model, p))[input]
    response *= exp(-Complex(ca.SX(0), omega, pade) * delay)

    # Per amplitude, so that one tolerance suits sines of any size.
    equations = ca.vertcat(ca.vertcat(*balance) / amplitude, *means)
    rows = ca.vertcat(equations, response.re, response.im)
    parts = [rows, *(ca.jacobian(rows, x) for x in (every, symbol))]
    at_samples = ca.Function("at_samples", [unknown, settings, symbol], parts)
    x: Any = at_samples.mx_in()[:2]
    sampled, slopes = _harmonics(formulas, point, p, *signals(*x))
    rows, direct, by_samples = at_samples(*x, sampled)
    total = direct + by_samples @ slopes
    numbers = ca.Function("numbers", x, [ca.densify(total[:-2, : unknown.numel()])])
    return *x, rows, total, equations.numel() - len(means), switches, numbers


def _all_coefficients(
    count: int, columns: int, moving: set[int], held: int | None
) -> tuple[ca.SX, ca.SX]:
    """Return the unknown coefficients, and those of all signals (count, columns).

    Signals that do not move have an unknown mean. The sine of the one that is `held` has the
    amplitude 1.
    """
    coefficients = ca.SX(count, columns)
    for k in range(count):
        free = columns if k in moving else 1
        coefficients[k, :free] = ca.SX.sym("c", 1, free)
    unknown = ca.vertcat(*ca.symvar(coefficients))
    if held is not None:
        coefficients[held, 1] = 1
    return unknown, coefficients


def _gains(derivatives: ca.SX, z: ca.SX, parameters: ca.SX, point: ca.DM, start: ca.DM) -> ca.SX:
    """Return the sizes of the derivatives with respect to the signals.

    Rows of zeros for the inputs follow those of the states.
    A gain that is infinite at the operating point, as that of a square root at zero, counts as 0.
    """
    rows = ca.vertcat(derivatives, ca.SX(z.numel() - derivatives.numel(), 1))
    jacobian = ca.fabs(ca.jacobian(rows, z))
    values = np.asarray(ca.Function("gains", [z, parameters], [jacobian])(point, start))
    finite = ca.sparsify(ca.DM(np.isfinite(values).astype(float))).sparsity()
    return ca.project(jacobian, finite)


def _rms(series: Any) -> Any:
    """Return the root mean squares of the oscillations of signals (k, 2h + 1), (k, 1)."""
    return ca.sqrt(ca.sum2(series[:, 1:] ** 2) / 2)


def phase_derivative(harmonics: int) -> ca.DM:
    """Return the matrix, applied from the right, that differentiates a series by the phase."""
    turn = ca.DM([[0, -1], [1, 0]])
    return ca.sparsify(ca.diagcat(0, *[k * turn for k in range(1, harmonics + 1)]))


def _first(row: Any) -> Complex:
    """Return the first harmonic as the complex amplitude of exp(jωt)."""
    return Complex(row[1], -row[2])


def _harmonics(
    formulas: ca.SX,
    z: ca.SX,
    parameters: ca.SX,
    series: Any,
    sizes: Any,
    p: Any,
    by_every: Any,
) -> tuple[Any, Any]:
    """Return the coefficients of sampled `formulas` (k, 1), (2h + 1, k), and their slopes.

    `series` are the coefficients of the signals z, and `sizes` (k, 1) how fast they change with
    the phase. The slopes are with respect to all symbols, and so are those of series, sizes and
    parameters in `by_every`.
    """
    harmonics = series.size2() // 2
    switches = has_switches(formulas)
    # An odd number of samples: a kink such as that of |v| v, sampled at a symmetric orbit, then
    # counts as if sampled twice as often. With 129, a relay and a saturation are exact to 1.5e-4,
    # and dry friction to 7e-4, which its truncation exceeds.
    points = max(129, 10 * harmonics + 1) if switches else max(33, 4 * harmonics + 1)
    waves, products, to_series = transforms(harmonics, points)
    slope, size = (ca.SX.sym(name, z.numel()) for name in ("slope", "size"))
    if switches:
        formulas = interval_means(formulas, z, slope, size, math.tau / points)

    inputs = [z, slope, size, parameters]
    partials = ca.jacobian(formulas, ca.vertcat(*inputs))
    entries = ca.vec(partials.nz[:])
    terms = [ca.densify(ca.vertcat(formulas, entries))]
    program = ca.Function("terms", inputs, terms, {"cse": True})
    # Samples are columns: CasADi multiplies a long column by a matrix from the left several times
    # as fast as a long row from the right.
    columns = _at_samples(program, [wave.T @ series.T for wave in waves], [sizes, p])
    values = ca.horzcat(*columns[: formulas.numel()])
    parts = columns[formulas.numel() :]

    # The slopes in the coefficients of the signals come first, because these are few.
    count = z.numel()
    width = series.size2()
    widths = [width] * count + [1] * (count + p.numel())
    blocks = [[ca.MX(width, each) for each in widths] for _ in range(formulas.numel())]
    sampled = ca.vertcat(z, slope, size)
    places = partials.sparsity().get_triplet()
    for part, entry, row, column in zip(parts, ca.vertsplit(entries), *places, strict=True):
        kind, k = divmod(column, count)
        if kind >= len(waves):
            blocks[row][column - count] = to_series[:width] @ part
        elif kind or ca.depends_on(entry, sampled):
            blocks[row][k] += ca.reshape(products[kind] @ (to_series @ part), width, width)
        else:  # the harmonics of a linear term are those of its signal
            blocks[row][k] += part[0] * ca.MX.eye(width)
    return to_series[:width] @ values, ca.blockcat(blocks) @ by_every


def _at_samples(program: ca.Function, sampled: list[Any], constant: list[Any]) -> list[Any]:
    """Return the results of a program at all samples, a column (points, 1) each.

    Its first inputs are `sampled`, (points, k) each, the others `constant`, (k, 1) each.
    """
    points = sampled[0].size1()
    if not is_elementary(program):
        columns = [signals.T for signals in sampled] + [ca.repmat(v, 1, points) for v in constant]
        return ca.horzsplit(program.map(points).call(columns)[0].T)

    # One operation on all samples at a time takes a quarter of the time of one sample after the
    # other.
    inputs = [*map(ca.horzsplit, sampled), *map(ca.vertsplit, constant)]
    return [ca.MX.ones(points) * column for column in walk(program, inputs, ca.MX)]


@cache
def transforms(harmonics: int, points: int) -> tuple[ArrayPair, list[ca.DM], Array]:
    """Return samples of waves and of their slopes, their products with waves, and `to_series`.

    The matrix `to_series` gives twice as many harmonics from samples over one period: a product of
    two waves has one or two of these. Four samples a harmonic allow products of three signals
    without aliasing.
    """
    # The samples cover one period evenly, so that the waves are orthogonal and need no inverse.
    phase = math.tau * np.arange(points) / points
    waves = [wave(k * phase) for k in range(1, 2 * harmonics + 1) for wave in (np.cos, np.sin)]
    double = np.array([np.ones(points), *waves])
    to_series = double * 2 / points
    to_series[0] /= 2
    few = slice(2 * harmonics + 1)
    waves = double[few], phase_derivative(harmonics).full() @ double[few]
    pairs = [(wave[:, None] * to_series[few]).reshape(-1, points) for wave in waves]
    return waves, [ca.sparsify(pair @ double.T, 1e-9) for pair in pairs], to_series


def _mean_conditions(*slopes: Array) -> list[int] | None:
    """Return the first conditions on the means that the balance leaves open.

    The `slopes` are those of the balance and of the conditions. The mean of the sine's own signal
    comes first. It determines nothing if an integrator follows it, as the angle follows the rate;
    the mean of a state then does. None if no conditions close the balance.
    """
    rows, conditions = (unit_length(np.nan_to_num(block), 1) for block in slopes)
    closed = rows
    rank = np.linalg.matrix_rank(rows, 1e-9)
    chosen: list[int] = []
    for k, condition in enumerate(conditions):
        further = np.vstack([closed, condition])
        # Smaller singular values are rounding alone.
        further_rank = np.linalg.matrix_rank(further, 1e-9)
        if further_rank > rank:
            closed, rank = further, further_rank
            chosen.append(k)

    return chosen if len(closed) == closed.shape[1] == rank else None


def _guess(
    newton: ca.Function, careful: ca.Function, finish: ca.Function, *, switches: bool
) -> ca.Function:
    """Return the function from settings to harmonics: at once, or in steps."""
    settings = ca.MX.sym("settings", newton.numel_in("p"))
    # So small that the first step leads to the linear response, but not zero, where a kink has no
    # slope.
    small = ca.DM(np.full(newton.numel_in("x0"), 1e-6))

    # If Newton's method fails, the problem is changed step by step from a nearly linear one. The
    # amplitude of a smooth model is doubled from a 128th. Switches weigh most at small amplitudes:
    # their ramps are narrowed instead, from such a width that a sign is a viscous friction; when
    # they were halved, motions that slide for a short time were missed in places.
    steps = [(1, 2.0**k) for k in range(-7, 1)]
    if switches:
        steps = [(3, 2.0 ** (k / 2)) for k in range(22, -1, -1)]
    followed = ca.MX(small)
    for place, factor in steps:
        scale = np.ones(settings.numel())
        scale[-place] = factor
        followed = careful(x0=followed, p=scale * settings)["x"]

    by_steps = ca.Function("by_steps", [settings], [followed], {"never_inline": True})

    # The branches are functions of their inputs: Newton's method must not run again in the first.
    direct = ca.MX.sym("direct", small.numel())
    inputs = [settings, direct]
    at_once, stepped = (ca.Function("branch", inputs, [x]) for x in (direct, by_steps(settings)))
    choose = ca.Function.if_else("choose", at_once, stepped)
    direct = newton(x0=small, p=settings)["x"]
    chosen = choose(finish(direct, settings)[1], settings, direct)
    return ca.Function("guess", [settings], [chosen])


def harmonic_response(
    model: Model,
    values: Values | None,
    omega: ArrayLike,
    *,
    amplitude: Mapping[str, ArrayLike] | Sine,
    input: str = "",
    output: str = "",
    at: Values | None = None,
    delay: str = "exact",
) -> FrequencyResponse:
    """Evaluate the response of an ODE to a sine of finite amplitude, at `omega` (n,) in rad/s.

    The response is the first harmonic of the output over that of the input: the describing function
    of a nonlinear model, the frequency response of a linear one. It is evaluated as in a fit: where
    several periodic motions exist, it is that of the search that begins at the linear response.
    Where the most harmonics do not settle it, as just above the break-away force of dry friction,
    its `about` has the change from half as many, ``truncation``.

    Parameters
    ----------
    amplitude : ``{signal: amplitude}`` or Sine
        Which signal is the sine: the input, or a state or an output that a loop holds to it. Its
        mean, and all other inputs, are what they are at the operating point `at`.
    values, input, output, at, delay
        As for `frequency_response`.

    Raises
    ------
    ValueError
        For an unknown name or a transfer function, or if no periodic motion is found.
    """
    omega = finite_numbers("omega", omega)
    sine = as_sine(amplitude)
    signals = {"input": input, "output": output, "at": at, "pade": delay_order(delay)}
    response, harmonics = directly_found(model, values, omega, sine, **signals)
    finite = np.isfinite(response)
    if not finite.all():
        k = np.argmin(finite)
        raise ValueError(
            f"no periodic motion of {model.label} was found at omega = {omega[k]:g} rad/s in which "
            f"{sine.signal} is a sine of amplitude {sine.amplitudes(omega)[k]:g}: give another "
            "amplitude (just above the break-away force of dry friction the search may fail), or "
            "check the values and `at`."
        )

    about = {}
    if harmonics == MOST_HARMONICS:
        half = replace(sine, harmonics=harmonics // 2)
        fewer, _ = directly_found(model, values, omega, half, **signals)
        change = 100 * np.abs(fewer / response - 1).max()
        about["truncation"] = (
            f"{harmonics} harmonics, the most: with half as many the response differs by up to "
            f"{change:.2g} %"
        )

    input, output = pick_signals(model, input, output)
    return FrequencyResponse(
        omega, response, input=input, output=output, name=model.label, source="model", about=about
    )


def response_of_test(
    model: Model,
    values: Values,
    omega: ArrayLike,
    sine: Sine | None,
    measured: Array,
    **signals: Any,
) -> FrequencyResponse:
    """Evaluate the response to a sine test, interpolated between the `measured` frequencies.

    Without a sine it is the response of the linearization.
    """
    if sine is None:
        return frequency_response(model, values, omega, **signals)
    amplitude = sine.between(measured, np.asarray(omega, dtype=float))
    return harmonic_response(model, values, omega, amplitude=amplitude, **signals)
