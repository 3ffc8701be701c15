"""Sines, one after another, that tell as much as wanted of a model in the shortest flight."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem, compile_problem
from greybox.compiled.response_part import ResponsePart
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.experiment.closed_loop import loop_gains
from greybox.experiment.controller import Controller
from greybox.experiment.excitation import Excitation
from greybox.experiment.optimal_design import require_determined, shares, time_needed
from greybox.experiment.sines import sine_schedule
from greybox.files.arrays import Array, ComplexArray, IntArray
from greybox.files.text_table import text_table
from greybox.formulation.frequency_criteria import MaximumLikelihood
from greybox.formulation.problem import Problem
from greybox.modeling import Model, frequency_response
from greybox.spectral.uniform_stretches import uniform_stretches
from greybox.spectral.welch import HZ

CANDIDATES = 40  # frequencies in the band; twice as many change the flight time of the tilt model by less than 1 %
AVERAGED = 15  # lines of a spectrum: its relative error is a quarter, that of the standard errors an eighth
SPARE = (
    4  # numbers that the sines leave to judge the model by, beside those that its parameters take
)
QUIET_PERIODS = 4  # of the lowest frequency that a quiet flight holds at least
NOWHERE: Mapping[str, float] = {}


class _Card(NamedTuple):
    """What every sine costs besides its duration."""

    periods: int
    lead_in: float
    pause: float

    def flown(self, omega: Array, seconds: Array) -> tuple[Array, float]:
        """Return durations (n,) of whole periods and the flight time of sines that shall last at least so long, s."""
        period = HZ / omega
        duration = np.maximum(np.ceil(seconds / period - 1e-9), self.periods) * period
        settling = np.ceil(self.lead_in / period - 1e-9) * period
        return duration, float(np.sum(duration + settling + self.pause)) + self.pause


@dataclass(frozen=True, eq=False)
class SinePlan:
    """Sines to be flown one after another; prints itself.

    Attributes
    ----------
    omega, amplitude, duration : (n,) arrays, rad/s, unit of the excitation, s
        Of every sine; the duration is a whole number of periods, without what it needs to settle.
    limited_by : tuple of str
        For every sine, the signal whose limit sets its amplitude.
    standard_error : mapping of name to float
        Expected of an efficient estimate: that of the whole record by `OutputError`, or nearly that
        of the measured responses by `MaximumLikelihood` when each sine has ten periods or more.
    wanted : mapping of name to float
    flight_time : float, s
        With what the sines need to settle, and with pauses.
    equally_spaced : float, s
        The flight time that as many sines, at equally spaced logarithms of frequency and equally
        long, would take for the same errors.
    signal, unit : str
        The excitation.
    rate : float, Hz
    settings : mapping
        `lead_in` and `pause`, s.
    """

    omega: Array
    amplitude: Array
    duration: Array
    limited_by: tuple[str, ...]
    standard_error: Mapping[str, float]
    wanted: Mapping[str, float]
    flight_time: float
    equally_spaced: float
    signal: str
    unit: str
    rate: float
    settings: Mapping[str, float] = field(repr=False)

    def __str__(self) -> str:
        sines = [
            (f"{w:.4g}", f"{w / HZ:.3g}", f"{a:.3g}", limit, f"{t:.0f}", f"{round(t * w / HZ)}")
            for w, a, limit, t in zip(
                self.omega, self.amplitude, self.limited_by, self.duration, strict=True
            )
        ]
        errors = [
            (name, f"± {error:.2g}", f"± {self.wanted[name]:.2g}" if name in self.wanted else "")
            for name, error in self.standard_error.items()
        ]
        unit = f" ({self.unit})" if self.unit else ""
        return "\n".join(
            [
                f"{len(self.omega)} sines in {self.signal}, {self.flight_time:.0f} s of flight;",
                f"equally spaced sines would take {self.equally_spaced / self.flight_time:.2g} times as long.",
                "",
                text_table(
                    ("rad/s", "Hz", f"amplitude{unit}", "limited by", "s", "periods"),
                    sines,
                    left=(3,),
                ),
                "",
                text_table(("", "expected", "wanted"), errors),
            ]
        )

    def excitation(self) -> Excitation:
        """Return the test signal, for `virtual_flight`, `ardupilot_script` or a file."""
        periods = [round(t * w / HZ) for w, t in zip(self.omega, self.duration, strict=True)]
        return sine_schedule(
            self.omega.tolist(),
            self.amplitude.tolist(),
            periods=periods,
            least=0.0,
            rate=self.rate,
            signal=self.signal,
            unit=self.unit,
            **self.settings,
        )


def plan_sines(  # noqa: PLR0913 - each is one fact of the test card
    model: Model,
    values: Mapping[str, float],
    wanted: Mapping[str, float],
    *,
    band: tuple[float, float],
    amplitude: float,
    noise: float | Record,
    input: str = "u",
    output: str = "theta",
    excitation: str = "reference",
    controller: Controller | Sequence[Controller] | None = None,
    limits: Mapping[str, float] = NOWHERE,
    travel: Mapping[str, float] = NOWHERE,
    rate: float = 100.0,
    periods: int = 10,
    lead_in: float = 2.0,
    pause: float = 2.0,
    unit: str = "rad",
    free: Sequence[str] = (),
    fixed: Mapping[str, float] = NOWHERE,
) -> SinePlan:
    """Plan sines that reach the wanted standard errors in the shortest flight.

    The response at a frequency is estimated from a sine of amplitude U at the plant's input and of
    duration t with the variance E|P̂ - P|² = 2 G / (t |U|²), G being the one-sided spectral density
    of what the output shows beside the response; the shares of the flight time follow from the
    Fisher information as large as the limits allow. Larger amplitudes than the model is linear for
    are not seen here: fly the plan by `virtual_flight` first.

    Parameters
    ----------
    model : Model
    values : mapping of name to float
        Rough estimates.
    wanted : mapping of name to float
        Standard errors, in the parameters' units, of those that matter.
    band : (low, high), rad/s
    amplitude : float
        Largest amplitude of the excitation, in its unit.
    noise : float or Record
        Standard deviation of white noise of the output's sensor, per sample at `rate`; or a quiet
        flight of the same vehicle, whose output minus the model's response to its input is taken as
        the noise, wind included.
    input, output : str
        Of the response that is to be measured.
    excitation : str
        The signal that the sines are added to: a setpoint of the controller, or an input of the
        plant.
    controller : Controller or several, optional
        What flies the vehicle meanwhile; without one the plant is tested in open loop.
    limits : mapping of signal to float
        Largest amplitude of signals of the loop: outputs, inputs, states, and derivatives as
        ``theta_dot``.
    travel : mapping of signal to float
        Largest amplitude of the integral of a signal: of a velocity, m.
    rate : float, Hz
        At which the log is written.
    periods : int
        That each sine has at least. Fewer leave the variance of its response poorly known.
    lead_in, pause : float, s
        As of `greybox.experiment.sine_schedule`.
    unit : str
        Of the excitation.
    free, fixed
        As of `Problem`.

    Raises
    ------
    ValueError
        For names and limits that do not fit, for errors that are not reachable in this band, and
        for a loop that diverges.
    """
    low, high = band
    if not isinstance(noise, Record) and not noise > 0:
        raise ValueError(
            f"noise is {noise!r}: give a positive standard deviation, or a quiet flight."
        )
    if not 0 < low < high:
        raise ValueError(f"band is {band!r}: give two frequencies in rad/s, the lower one first.")
    if not wanted:
        raise ValueError("wanted is empty: give a standard error for at least one parameter.")
    wrong = [name for name, value in {**wanted, **limits, **travel}.items() if not value > 0]
    if wrong:
        raise ValueError(
            f"{wrong[0]} is given {({**wanted, **limits, **travel})[wrong[0]]:g}: give a positive number."
        )
    rates = [c.rate for c in _several(controller)]
    grid = np.geomspace(low, high, CANDIDATES)
    signals = {input, *limits, *travel}
    omega, gains = loop_gains(
        model,
        values,
        grid,
        signals,
        excitation=excitation,
        controller=controller,
        amplitude=amplitude,
        rate=max(rates, default=rate),
    )
    bounds = [
        (excitation, np.full(len(omega), amplitude))
    ]  # a signal may have a limit and one of its travel
    bounds += [(name, limit / np.abs(gains[name])) for name, limit in limits.items()]
    bounds += [(name, limit * omega / np.abs(gains[name])) for name, limit in travel.items()]
    each = np.array([most for _, most in bounds])
    size = each.min(axis=0)
    limited_by = tuple(bounds[k][0] for k in each.argmin(axis=0))

    nlp, sensitivity = _sensitivities(model, values, omega, (input, output), free=free, fixed=fixed)
    missing = [name for name in wanted if name not in nlp.free]
    if missing:
        raise ValueError(
            f"{missing[0]} is not estimated: it has no standard error; free are {', '.join(nlp.free)}."
        )
    density = _density(noise, model, values, omega, (input, output), rate)
    weight = (size * np.abs(gains[input])) ** 2 / density  # 2 / E|P̂ - P|² of a second
    scale = np.array([wanted.get(name, np.nan) for name in nlp.free])
    scale = np.where(np.isfinite(scale), scale, _sizes(sensitivity, weight))
    scaled = sensitivity * scale
    information = weight[:, None, None] * np.real(np.conj(scaled)[:, :, None] * scaled[:, None, :])
    target = np.array([1.0 if name in wanted else np.inf for name in nlp.free])
    require_determined(
        information.mean(axis=0), nlp.free, "no sine in this band", "choose another band"
    )

    card = _Card(periods, lead_in, pause)
    chosen, duration = _fewest(omega, information, target, card)
    chosen, duration = _with_spare(
        omega, chosen, duration, math.ceil((len(nlp.free) + SPARE) / 2), periods
    )
    achieved = np.linalg.inv(np.tensordot(duration, information[chosen], 1))
    spaced = np.unique(np.rint(np.linspace(0, len(omega) - 1, len(chosen))).astype(int))
    total = time_needed(information[spaced].mean(axis=0), target)
    equal = card.flown(omega[spaced], np.full(len(spaced), total / len(spaced)))
    return SinePlan(
        omega[chosen],
        size[chosen],
        duration,
        tuple(limited_by[k] for k in chosen),
        dict(zip(nlp.free, (np.sqrt(np.diag(achieved)) * scale).tolist(), strict=True)),
        dict(wanted),
        card.flown(omega[chosen], duration)[1],
        equal[1],
        excitation,
        unit,
        rate,
        {"lead_in": lead_in, "pause": pause},
    )


def _several(controller: Controller | Sequence[Controller] | None) -> list[Controller]:
    return [controller] if isinstance(controller, Controller) else list(controller or ())


def _sensitivities(
    model: Model,
    values: Mapping[str, float],
    omega: Array,
    signals: tuple[str, str],
    *,
    free: Sequence[str],
    fixed: Mapping[str, float],
) -> tuple[CompiledProblem, ComplexArray]:
    """Return the compiled problem and the derivatives (n, p) of the response by its free parameters."""
    exact = frequency_response(
        model, {**values, **fixed}, omega, input=signals[0], output=signals[1]
    )
    data = FrequencyResponse(omega, exact.response, *signals, variance=np.abs(exact.response) ** 2)
    at = {**values, **fixed}
    nlp = compile_problem(Problem(model, data, MaximumLikelihood(), free=free, fixed=fixed))
    parameters = nlp.problem.parameters
    x = np.array([at.get(name, parameters[name].start) for name in nlp.names])
    part = nlp.parts[0]
    assert isinstance(part, ResponsePart)
    return nlp, part.sensitivity(x)[:, : len(nlp.free)]


def _sizes(sensitivity: ComplexArray, weight: Array) -> Array:
    """Return sizes (p,) in which parameters that do not matter can be compared with those that do."""
    norm = np.sqrt((weight[:, None] * np.abs(sensitivity) ** 2).sum(axis=0))
    return 1 / np.where(norm > 0, norm, 1.0)


def _density(
    noise: float | Record,
    model: Model,
    values: Mapping[str, float],
    omega: Array,
    signals: tuple[str, str],
    rate: float,
) -> Array:
    """Return the one-sided spectral density (n,) of the output beside the response, in its unit squared per Hz."""
    if not isinstance(noise, Record):
        return np.full(len(omega), 2 * float(noise) ** 2 / rate)
    input, output = signals
    total, seconds = np.zeros(len(omega)), 0.0
    for stretch in uniform_stretches(noise, [input, output], "linear"):
        u, y = stretch.values
        length = stretch.step * u.size
        window = 1 - np.cos(2 * np.pi * (np.arange(u.size) + 0.5) / u.size)  # Hann
        lines = _lines_around(omega, length)
        each, where = np.unique(lines, return_inverse=True)
        response = frequency_response(model, values, each, input=input, output=output).response[
            where.ravel()
        ]
        basis = window * np.exp(-1j * np.outer(lines.ravel(), np.arange(u.size) * stretch.step))
        power = np.abs(basis @ y - response * (basis @ u)) ** 2
        total += (
            length * 2 * stretch.step / np.sum(window**2) * power.reshape(lines.shape).mean(axis=1)
        )
        seconds += length
    if seconds * omega[0] < QUIET_PERIODS * HZ:
        raise ValueError(
            f"the quiet flight has {seconds:.3g} s, fewer than {QUIET_PERIODS} periods of {omega[0]:.3g} rad/s: "
            "give a longer one."
        )
    return total / seconds


def _lines_around(omega: Array, length: float) -> Array:
    """Return lines (n, m), rad/s, around every frequency over which its density is averaged."""
    apart = HZ / length
    reach = np.clip(
        omega / 6, 2 * apart, None
    )  # a spectrum of wind changes little over a sixth of its frequency
    return np.maximum(omega[:, None] + np.linspace(-1, 1, AVERAGED) * reach[:, None], apart)


def _fewest(omega: Array, information: Array, target: Array, card: _Card) -> tuple[IntArray, Array]:
    """Return which sines, and how long each, s: every further one costs what it needs to settle.

    The optimal shares sit on few frequencies, or on neighbors of these; the smallest share is given
    up as long as that makes the flight shorter.
    """
    chosen = np.flatnonzero(shares(information, target))
    best: tuple[float, IntArray, Array] | None = None
    while len(chosen):
        part = information[chosen]
        if np.linalg.cond(part.sum(axis=0)) > 1e14:
            break
        share = shares(part, target)
        chosen, share = chosen[share > 0], share[share > 0]
        seconds = share * time_needed(np.tensordot(share, information[chosen], 1), target)
        duration, total = card.flown(omega[chosen], seconds)
        if not np.isfinite(total) or (best is not None and total > 1.5 * best[0]):
            break
        if best is None or total < best[0]:
            best = total, chosen, duration
        chosen = np.delete(chosen, np.argmin(share))
    assert best is not None
    return best[1], best[2]


def _with_spare(
    omega: Array, chosen: IntArray, duration: Array, count: int, periods: int
) -> tuple[IntArray, Array]:
    """Return so many sines at least: short ones are added in the middle of the widest gaps of the band."""
    seconds = dict(zip(chosen.tolist(), duration.tolist(), strict=True))
    while len(seconds) < min(count, len(omega)):
        edges = [-1, *sorted(seconds), len(omega)]
        gaps = np.diff(edges)
        k = int(np.argmax(gaps))
        middle = (edges[k] + edges[k + 1]) // 2
        seconds[middle] = periods * HZ / omega[middle]
    order = sorted(seconds)
    return np.array(order), np.array([seconds[k] for k in order])
