"""The periodic motions of a nonlinear ODE under a sine: how many harmonics they need, and which of several is meant.

A nonlinear ODE may have several motions under one sine. The one meant is what a test would show
that raises the amplitude slowly: the motion at a small amplitude, where the model is nearly linear,
is followed along its curve, around the turning points at which it jumps in a test
(pseudo-arclength: Keller 1977); where that motion is unstable and the input is the sine, the stable
motion next to it. Others are found where that curve, past the amplitude, turns and comes back to
it, and from random harmonics. Those of an unstable plant are not reported where all are unstable:
no test without a loop shows any of them.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from greybox.data.frequency_response import FrequencyResponse
from greybox.files.arrays import Array, ComplexArray
from greybox.modeling.harmonic_balance import ENOUGH, HARMONICS, CompiledBalance, directly_found
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.sine import Sine, as_sine
from greybox.modeling.symbolic_reading import traced_derivative

RANGE = 1e3  # from where, relative to the amplitude, a motion is followed
# How far a curve is followed past the amplitude, to where it may turn and come back: a resonance
# jumps, and falls back, at amplitudes up to about its quality factor apart. There it may also lead
# nowhere: steps that are this short end it.
BEYOND, SHORT_STEP = 10.0, 0.01
STEP, LONGEST_STEP, SHORTEST_STEP = (
    0.2,
    0.5,
    1e-5,
)  # along the curve, in natural logarithms of amplitude and harmonics
STEPS = 400  # a curve that needs more winds too much to be followed
CORRECTIONS = 8  # Newton steps back to the curve
CONVERGED = 1e-9  # of the balance, relative to the harmonics
TINY = 1e-9  # size of harmonics, per amplitude, below which a step is not relative to them
LARGE = 1e6  # step, relative to the harmonics, that leads nowhere
DRAWN = 8  # random motions from which others are sought
LARGEST_DRAWN = (
    8.0  # the size of the last, relative to the motion that is known; the first is as large as that
)
DISTINCT = 1e-3  # difference of the harmonics of two motions, relative
STABILITY_POINTS = 512  # steps of the trapezoidal rule over one period
MARGIN = 1e-3  # above one, in a Floquet multiplier: the error of that rule


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

    The response is the first harmonic of the output over that of the input: the describing function
    of a nonlinear model, the frequency response of a linear one. Where there are several periodic
    motions, a UserWarning names them; the response is that of a test whose amplitude is raised
    slowly.

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
        For a name that is not known, a transfer function, or where no periodic motion is found.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    input, output = pick_signals(model, input, output)
    sine = as_sine(amplitude)
    signals = {"input": input, "output": output, "at": at, "delay": delay}
    found = periodic_motions(model, values, omega, sine, **signals)
    _require_finite(model, omega, sine, found.response)
    for sentence in found.several:
        warnings.warn(sentence, UserWarning, stacklevel=2)
    return FrequencyResponse(
        omega, found.response, input=input, output=output, name=model.label, source="model"
    )


def response_of_test(
    model: Model,
    values: Mapping[str, float],
    omega: ArrayLike,
    sine: Sine | None,
    measured: Array,
    **signals: Any,
) -> FrequencyResponse:
    """Evaluate the response to the `sine` with which the frequencies `measured` were tested; linearized without one."""
    if sine is None:
        return frequency_response(model, values, omega, **signals)
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    sine = sine.between(measured, omega)
    response, _ = directly_found(model, values, omega, sine, **_with_order(signals))
    _require_finite(model, omega, sine, response)
    input, output = pick_signals(model, signals.get("input", ""), signals.get("output", ""))
    return FrequencyResponse(
        omega, response, input=input, output=output, name=model.label, source="model"
    )


def _with_order(signals: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with the order of the Padé approximation in place of its name."""
    return {
        **{k: v for k, v in signals.items() if k != "delay"},
        "pade": delay_order(signals.get("delay", "exact")),
    }


def _require_finite(model: Model, omega: Array, sine: Sine, response: ComplexArray) -> None:
    finite = np.isfinite(response)
    if not finite.all():
        k = int(np.argmin(finite))
        raise ValueError(
            f"{model.label} has no periodic motion at omega = {omega[k]:g} rad/s in which {sine.signal} is a sine of "
            f"amplitude {sine.amplitudes(omega)[k]:g}: give a smaller amplitude, or check the values and `at`."
        )


@dataclass(frozen=True, eq=False)
class PeriodicMotions:
    """The response (n,), NaN where there is none, and a sentence for every frequency with several motions.

    The first frequency without a motion ends the search.
    """

    response: ComplexArray
    several: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Motion:
    harmonics: Array
    response: complex
    stable: bool | None = None


class _Levels:
    """The balances of one sine with several numbers of harmonics, compiled where they are asked for."""

    def __init__(
        self, model: Model, vector: list[float], omega: Array, sine: Sine, options: dict[str, Any]
    ) -> None:
        self._model, self._vector, self._omega, self._sine, self._options = (
            model,
            vector,
            omega,
            sine,
            options,
        )
        self._balances: dict[int, CompiledBalance] = {}
        self._given: dict[int, Array] = {}

    def balance(self, harmonics: int) -> CompiledBalance:
        """Return the balance with so many harmonics."""
        if harmonics not in self._balances:
            sine = replace(self._sine, harmonics=harmonics)
            balance = CompiledBalance.at(self._model, self._omega, sine, **self._options)
            self._balances[harmonics] = balance
            self._given[harmonics] = np.asarray(
                ca.DM(balance.given(ca.DM(self._vector), self._omega))
            )
        return self._balances[harmonics]

    def given(self, harmonics: int, k: int) -> Array:
        """Return what is given at one frequency."""
        self.balance(harmonics)
        return self._given[harmonics][:, k]

    def solved(self, harmonics: int, guess: Array, k: int) -> Array | None:
        """Return the motion that Newton's method reaches, or None."""
        return _solved(self.balance(harmonics), guess, self.given(harmonics, k))

    def response(self, harmonics: int, x: Array, k: int) -> complex:
        """Return the response of a motion, extrapolated where the model has jumps."""
        balance = self.balance(harmonics)
        response = _response(balance, x, self.given(harmonics, k))
        if balance.fewer is None:
            return response
        guess = x[np.isin(balance.balance.places, self.balance(balance.fewer).balance.places)]
        coarse = self.solved(balance.fewer, guess, k)
        if coarse is None:
            return response
        return balance.extrapolated(
            response, _response(self.balance(balance.fewer), coarse, self.given(balance.fewer, k))
        )


def periodic_motions(
    model: Model, values: Mapping[str, float] | None, omega: Array, sine: Sine, **signals: Any
) -> PeriodicMotions:
    """Return the response of the motion that is meant, with as many harmonics as matter, and what others there are."""
    options = _with_order(signals)
    direct, number = directly_found(model, values, omega, sine, **options)
    level = _Levels(model, list(model.values(values).values()), omega, sine, options)
    begin = number if sine.harmonics is not None else max(number, HARMONICS[1])
    if not np.isfinite(direct).all():
        begin = min(begin, HARMONICS[2])
    if level.balance(begin).balance.linear:
        return PeriodicMotions(direct, ())
    response = np.array(direct)
    several = []
    for k in range(omega.size):
        motions = _motions(level, begin, k, sine.harmonics is None)
        if not motions:
            response[k] = np.nan
            break
        chosen = _chosen(motions)
        response[k] = chosen.response
        if chosen is not motions[0] or sum(motion.stable is not False for motion in motions) > 1:
            several.append(_said(model, sine, omega, k, motions, chosen))
    return PeriodicMotions(response, tuple(several))


def _said(
    model: Model, sine: Sine, omega: Array, k: int, motions: list[_Motion], chosen: _Motion
) -> str:
    kinds = {True: ", stable", False: ", unstable", None: ""}
    found = dict.fromkeys(
        f"{abs(m.response):.4g} at {np.angle(m.response, deg=True):.1f}°{kinds[m.stable]}"
        for m in motions
    )
    return (
        f"{model.label} has {len(motions)} periodic motions at omega = {omega[k]:g} rad/s in which {sine.signal} is a "
        f"sine of amplitude {sine.amplitudes(omega)[k]:g}, with the responses {'; '.join(found)}: that of "
        f"{abs(chosen.response):.4g} is used, but a test may show another, depending on how it began."
    )


def _chosen(motions: list[_Motion]) -> _Motion:
    """Return the first motion, or where it is unstable the stable one next to it."""
    stable = [motion for motion in motions if motion.stable]
    if motions[0].stable is not False or not stable:
        return motions[0]
    return min(stable, key=lambda motion: abs(motion.response - motions[0].response))


def _motions(level: _Levels, begin: int, k: int, more: bool) -> list[_Motion]:
    """Return the motions at one frequency, first that which is followed from small amplitudes.

    With `more` harmonics than at the beginning until they do not matter; what the cut-off alone had
    made is lost then.
    """
    number = begin
    found = [
        (x, level.response(number, x, k))
        for x in _candidates(level.balance(number), level.given(number, k))
    ]
    following = [n for n in HARMONICS if n > number] if more or len(found) > 1 else []
    for finer in following:
        refined = [
            level.solved(finer, _padded(x, level.balance(number), level.balance(finer)), k)
            for x, _ in found
        ]
        pairs = [
            (x, before, y) for (x, before), y in zip(found, refined, strict=True) if y is not None
        ]
        if not pairs:
            break
        if (
            not more
        ):  # as many as were asked for: the next ones only tell which are motions of the model
            found = [(x, before) for x, before, _ in pairs]
            break
        responses = [(y, level.response(finer, y, k), before) for _, before, y in pairs]
        kept = _distinct([y for y, _, _ in responses])
        found = [(y, after) for y, after, _ in responses if any(y is x for x in kept)]
        number = finer
        if all(abs(after - before) <= ENOUGH * abs(after) for _, after, before in responses):
            break
    return [
        _motion(level.balance(number), x, response, level.given(number, k)) for x, response in found
    ]


def _candidates(balance: CompiledBalance, given: Array) -> list[Array]:
    """Return distinct motions, that followed from small amplitudes first where it is found."""
    random = np.random.default_rng(0)
    raised = _followed(balance, given, 1 / RANGE)
    direct = _solved(balance, np.asarray(balance.guess(given)).ravel(), given)
    found = [*raised, *([] if direct is None else [direct])] or _followed(balance, given, RANGE)
    size = np.abs(found[0]).max() if found else 1.0
    for k in range(DRAWN):
        drawn = random.normal(size=balance.balance.unknown.numel()) / balance.balance.orders
        drawn *= size * LARGEST_DRAWN ** (k / (DRAWN - 1))
        reached = _solved(balance, drawn, given)
        if reached is not None:
            found.append(reached)
    motions = _distinct(found)
    # Where the model is symmetric, a motion that is not has a twin: the other way up, half a period
    # later.
    twins = [_solved(balance, x * balance.balance.mirror, given) for x in motions]
    return _distinct([*motions, *[x for x in twins if x is not None]])


def _distinct(found: list[Array]) -> list[Array]:
    result: list[Array] = []
    for x in found:
        if all(np.linalg.norm(x - y) > DISTINCT * max(np.linalg.norm(y), 1e-12) for y in result):
            result.append(x)
    return result


def _solved(balance: CompiledBalance, guess: Array, given: Array) -> Array | None:
    """Return the motion that Newton's method reaches, or None."""
    x = np.asarray(balance.careful(x0=guess, p=given)["x"]).ravel()
    return x if bool(balance.finish(x, given)[1]) and np.all(np.isfinite(x)) else None


def _response(balance: CompiledBalance, x: Array, given: Array) -> complex:
    re, im = np.asarray(balance.finish(x, given)[0]).ravel()
    return complex(re, im)


def _padded(x: Array, few: CompiledBalance, many: CompiledBalance) -> Array:
    """Return the harmonics of `x` in the places that they have among more."""
    padded = np.zeros(many.balance.unknown.numel())
    padded[np.isin(many.balance.places, few.balance.places)] = x
    return padded


def _followed(balance: CompiledBalance, given: Array, begin: float) -> list[Array]:
    """Return the motions, in their order along the curve that begins at `begin` times the amplitude.

    Past the amplitude the curve may turn and come back to it, as often as there are motions.
    """
    end = float(np.log(given[-2]))
    curve = _Curve(balance, given)
    at = end + float(np.log(begin))
    x = _solved(balance, np.asarray(balance.guess(curve.given_at(at))).ravel(), curve.given_at(at))
    found: list[Array] = []
    if x is None:
        return found
    y = np.append(x, at)
    direction = np.append(np.zeros(x.size), end - at)
    nearest, farthest = sorted((at, end - np.sign(at - end) * np.log(BEYOND)))
    step = STEP
    for _ in range(STEPS):
        scale = np.append(np.full(y.size - 1, max(float(np.linalg.norm(y[:-1])), TINY)), 1.0)
        tangent = curve.tangent(y, direction, scale)
        if tangent is None:
            return found

        following = None
        while following is None:
            guess = y + step * tangent
            if (guess[-1] - end) * (y[-1] - end) < 0:
                guess = y + (end - y[-1]) / tangent[-1] * tangent
                last = _solved(balance, guess[:-1], given)
                if last is not None and np.linalg.norm((last - guess[:-1]) / scale[:-1]) < step:
                    found.append(last)
                    following = np.append(last, end)
                    continue
            following = curve.corrected(guess, tangent, scale)
            if following is None or np.linalg.norm((following - guess) / scale) > 0.5 * step:
                following = None
                step /= 2
            if step < (SHORT_STEP if found else SHORTEST_STEP):
                return found

        direction = tangent / scale**2 if following[-1] == end else (following - y) / scale**2
        y = following
        if not nearest <= y[-1] <= farthest:
            return found
        step = min(1.5 * step, LONGEST_STEP)
    return found


@dataclass(frozen=True, eq=False)
class _Curve:
    """The motions over the amplitude: points are the harmonics and, last, the logarithm of the amplitude."""

    balance: CompiledBalance
    given: Array

    def given_at(self, logarithm: float) -> Array:
        """Return what is given at another amplitude."""
        return np.concatenate([self.given[:-2], [np.exp(logarithm)], self.given[-1:]])

    def tangent(self, y: Array, direction: Array, scale: Array) -> Array | None:
        """Return the tangent on the side of `direction`, of length one in units of `scale`."""
        _, jacobian = self._evaluated(y)
        found = _solution(
            np.vstack([jacobian * scale, direction * scale]), np.append(np.zeros(y.size - 1), 1.0)
        )
        return None if found is None else found / np.linalg.norm(found) * scale

    def corrected(self, guess: Array, tangent: Array, scale: Array) -> Array | None:
        """Return the point of the curve in the plane across the tangent, by Newton's method, or None."""
        y = guess
        across = tangent / scale
        for _ in range(CORRECTIONS):
            rest, jacobian = self._evaluated(y)
            if np.all(np.abs(rest) < CONVERGED * (1 + np.abs(y[:-1]).max(initial=0))):
                return y
            change = _solution(
                np.vstack([jacobian * scale, across]),
                -np.append(rest, across @ ((y - guess) / scale)),
            )
            if change is None:
                return None
            y = y + change * scale
        return None

    def _evaluated(self, y: Array) -> tuple[Array, Array]:
        given = self.given_at(y[-1])
        rest, jacobian, by_logarithm = (
            np.asarray(ca.DM(v)) for v in self.balance.linearized(y[:-1], given)
        )
        return rest.ravel(), np.hstack([jacobian, by_logarithm])


def _solution(matrix: Array, right: Array) -> Array | None:
    """Solve linear equations; None where they are singular or not finite."""
    if not np.all(np.isfinite(matrix)) or not np.all(np.isfinite(right)):
        return None
    try:
        found: Array = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return found if np.all(np.abs(found) < LARGE) else None


def _motion(balance: CompiledBalance, x: Array, response: complex, given: Array) -> _Motion:
    stable = (
        _is_stable(balance, x, given) if balance.driven_directly and balance.model.states else None
    )
    return _Motion(x, response, stable)


def _is_stable(balance: CompiledBalance, x: Array, given: Array) -> bool:
    """Tell whether small deviations from a motion decay, by its Floquet multipliers."""
    model = balance.model
    n = len(model.states)
    z = ca.SX.sym("z", n + len(model.inputs))
    p = ca.SX.sym("p", len(model.parameters))
    slope = ca.Function(
        "slope", [z, p], [ca.densify(ca.jacobian(traced_derivative(model, z, p), z[:n]))]
    )

    series = np.asarray(ca.DM(balance.coefficients(x, given)))
    phase = 2 * np.pi * (np.arange(STABILITY_POINTS) + 0.5) / STABILITY_POINTS
    waves = [np.ones(phase.size)]
    for k in range(1, series.shape[1] // 2 + 1):
        waves += [np.cos(k * phase), np.sin(k * phase)]
    parameters = np.tile(given[: p.numel(), None], (1, phase.size))
    slopes = np.asarray(slope.map(phase.size)(series @ np.array(waves), parameters))
    omega = given[-3]
    half = slopes.reshape(n, phase.size, n).transpose(1, 0, 2) * np.pi / (omega * STABILITY_POINTS)
    if not np.all(np.isfinite(half)):
        return True
    steps = np.linalg.solve(np.eye(n) - half, np.eye(n) + half)
    period = np.eye(n)
    for step in steps:
        period = step @ period
    return bool(np.abs(np.linalg.eigvals(period)).max() < 1 + MARGIN)
