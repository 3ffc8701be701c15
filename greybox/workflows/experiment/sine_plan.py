"""Sines, one after another, that reach wanted standard errors in the shortest flight.

Begin with `plan_sines`.
"""

import math
from collections.abc import Mapping
from dataclasses import field

import numpy as np

from greybox.data.files.arrays import Array, Interval, positive_or_one
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import NOTHING, Values, array_of
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.frequency_band import require_band
from greybox.data.record import Record
from greybox.data.spectral.estimated_points import HZ
from greybox.data.spectral.uniform_stretches import uniform_stretches
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.modeling import Model, frequency_response
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.model import pick_signals, require_known
from greybox.workflows.experiment.controller import Controllers
from greybox.workflows.experiment.excitation import Excitation
from greybox.workflows.experiment.optimal_design import require_determined
from greybox.workflows.experiment.sampled_loop import sampled_loop
from greybox.workflows.experiment.shortest_flight import Candidates, shortest_flight
from greybox.workflows.experiment.sine_schedules import sine_schedule

# A quiet flight has at least this number of periods of the lowest frequency.
QUIET_PERIODS = 4


@public
@frozen
class SinePlan:
    """Sines to be flown one after another; printed, it is a table.

    Attributes
    ----------
    omega, amplitude, duration : (n,) arrays, rad/s, unit of the excitation, s
        Settings of every sine. The duration is a whole number of periods, without the time to
        settle.
    limited_by : tuple of str
        For every sine, the signal whose limit sets its amplitude.
    standard_error : mapping of name to float
        Expected of an efficient estimate: of a fit to the whole record by `OutputError`, or nearly
        of a fit to the measured responses by `MaximumLikelihood` if each sine has ten periods or
        more.
    wanted : mapping of name to float
    flight_time : float, s
        Including the time to settle, and pauses.
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
    standard_error: Values
    wanted: Values
    flight_time: float
    signal: str
    unit: str
    rate: float
    settings: Values = field(repr=False)

    def __str__(self) -> str:
        title = f"{len(self.omega)} sines in {self.signal}, {self.flight_time:.0f} s of flight"
        unit = f" ({self.unit})" if self.unit else ""
        sines = text_table(
            ("rad/s", "Hz", f"amplitude{unit}", "limited by", "s", "periods"),
            [
                (f"{w:.4g}", f"{w / HZ:.3g}", f"{a:.3g}", limit, f"{t:.0f}", f"{round(t * w / HZ)}")
                for w, a, limit, t in zip(
                    self.omega, self.amplitude, self.limited_by, self.duration, strict=True
                )
            ],
            left=(3,),
        )
        wanted = {name: f"± {error:.2g}" for name, error in self.wanted.items()}
        errors = text_table(
            ("", "expected", "wanted"),
            [
                (name, f"± {error:.2g}", wanted.get(name, ""))
                for name, error in self.standard_error.items()
            ],
        )
        return "\n\n".join([title, sines, errors])

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


@public
def plan_sines(  # noqa: PLR0913 - each is one fact of the test card
    model: Model,
    values: Values,
    wanted: Values,
    *,
    band: Interval,
    amplitude: float,
    noise: float | Record,
    input: str = "u",
    output: str = "theta",
    excitation: str = "reference",
    controller: Controllers | None = None,
    limits: Values = NOTHING,
    rate: float = 100.0,
    periods: int = 10,
    lead_in: float = 2.0,
    pause: float = 2.0,
    unit: str = "rad",
    fixed: Values = NOTHING,
) -> SinePlan:
    """Plan sines that reach the wanted standard errors in the shortest flight.

    A sine of amplitude U at the plant's input and of duration t measures the response with the
    variance E|P̂ - P|² = 2 G / (t |U|²), where G is the one-sided spectral density of the output
    noise. Frequencies and lengths make the flight short, see `shortest_flight`. The
    model is linearized: fly the plan by `virtual_flight` first to see whether the amplitudes are
    too large for that.

    Parameters
    ----------
    model : Model
    values : mapping of name to float
        Rough estimates.
    wanted : mapping of name to float
        Standard errors of the parameters that matter, in their units.
    band : (low, high), rad/s
    amplitude : float
        Largest amplitude of the excitation, in its unit.
    noise : float or Record
        Standard deviation of the white noise of the output's sensor, per sample at `rate`; or a
        quiet flight of the same vehicle, whose output minus the model's response to its input is
        the noise, wind included.
    input, output : str
        Signals of the response that is measured.
    excitation : str
        The signal that the sines are added to: a setpoint of the controller, or an input of the
        plant.
    controller : Controller or several, optional
        Flies the vehicle meanwhile; without one the plant is tested in open loop.
    limits : mapping of signal to float
        Largest amplitudes of signals of the loop: outputs, inputs, states, and derivatives such as
        ``theta_dot``. They hold for settled sines; at the beginning of a sine, signals overshoot.
    rate : float, Hz
        Sampling rate of the log.
    periods : int
        Least number of periods of a sine. Fewer leave the variance of its response poorly known.
    lead_in, pause : float, s
        As in `greybox.experiment.sine_schedule`.
    unit : str
        Unit of the excitation.
    fixed : mapping of name to float
        As in `Problem`.

    Raises
    ------
    ValueError
        For invalid names and limits, for errors that cannot be reached in this band, and for a loop
        that diverges.
    """
    require_band(band)
    if not (wanted and isinstance(wanted, Mapping)):
        raise ValueError(f"wanted is {wanted!r:.60}: give {{parameter: standard error}}.")
    for name, value in {"band[0]": band[0], "amplitude": amplitude, **wanted, **limits}.items():
        if not value > 0:
            raise ValueError(f"the value of {name}, {value:g}, must be a positive number.")
    input, output = pick_signals(model, input, output)
    # Twice as many candidates change the flight time of the tilt model by less than 1 %.
    omega = np.geomspace(*band, 40)
    values = {**values, **fixed}
    row = np.array([[*model.values(values).values()]])
    signals = (input, *limits)
    loop = sampled_loop(model, row, controller, measured=signals, rate=rate)
    if controller is not None and not loop.is_stable[0]:
        raise ValueError(
            f"the loop of {model.label} is unstable: give gains that stabilize the plant."
        )
    # From the excitation, with the sampling of the controller.
    gains = dict(zip(signals, loop.gains(excitation, signals, omega)[0].T, strict=True))
    bounds = [limit / np.abs(gains[name]) for name, limit in limits.items()]
    amplitudes = np.array([np.full_like(omega, amplitude), *bounds])
    size, limit = amplitudes.min(axis=0), amplitudes.argmin(axis=0)

    exact = frequency_response(model, values, omega, input=input, output=output)
    nlp = compile_problem(Problem(model, exact, fixed=fixed))
    require_known(wanted, nlp.free, "free parameter", model.label)
    [part] = nlp.parts_of(ResponsePart)
    x = array_of(model.values(values), nlp.names)
    sensitivity = part.sensitivity(x)[:, : len(nlp.free)]
    density = noise_density(noise, model, values, omega, (input, output), rate)
    weight = (size * np.abs(gains[input])) ** 2 / density  # 2 / E|P̂ - P|² of a second
    # In units of the wanted errors, the matrices are well scaled and the targets are one.
    alone = 1 / positive_or_one(np.sqrt(weight @ np.abs(sensitivity) ** 2))  # errors of each alone
    scale = np.array([wanted.get(name, s) for name, s in zip(nlp.free, alone, strict=True)])
    scaled = sensitivity * scale
    information = weight[:, None, None] * np.real(np.conj(scaled)[:, :, None] * scaled[:, None, :])
    matters = np.array([name in wanted for name in nlp.free])
    require_determined(information.mean(axis=0), nlp.free)

    period = HZ / omega
    settling = np.ceil(lead_in / period - 1e-9) * period
    candidates = Candidates(information, matters, period, settling + pause, periods)
    # Four numbers more than the parameters use up remain for judging the model.
    flight = shortest_flight(candidates, math.ceil((len(nlp.free) + 4) / 2))
    chosen, duration = flight.places, flight.seconds
    if not np.isfinite(flight.total):
        raise ValueError(
            "no flight in this band reaches the wanted errors of "
            f"{', '.join(f'{name} ± {error:g}' for name, error in wanted.items())}: raise them."
        )
    covariance = np.linalg.inv(np.tensordot(duration, information[chosen], 1))
    errors = np.sqrt(np.diag(covariance)) * scale
    return SinePlan(
        omega=omega[chosen],
        amplitude=size[chosen],
        duration=duration,
        limited_by=tuple((excitation, *limits)[k] for k in limit[chosen]),
        standard_error=dict(zip(nlp.free, errors.tolist(), strict=True)),
        wanted=dict(wanted),
        flight_time=flight.total + pause,
        signal=excitation,
        unit=unit,
        rate=rate,
        settings={"lead_in": lead_in, "pause": pause},
    )


def noise_density(
    noise: float | Record,
    model: Model,
    values: Values,
    omega: Array,
    signals: tuple[str, str],
    rate: float,
) -> Array:
    """Return the one-sided spectral density (n,) of the output noise, its unit squared per Hz."""
    if not isinstance(noise, Record):
        if not noise > 0:
            raise ValueError(
                f"noise={noise!r} must be a positive standard deviation, or a quiet flight."
            )
        return np.full_like(omega, 2 * float(noise) ** 2 / rate)
    from scipy.signal import detrend  # noqa: PLC0415  (takes a tenth of a second to import)

    input, output = signals
    total = np.zeros(len(omega))
    seconds = 0.0
    for stretch in uniform_stretches(noise, [input, output]):
        count = stretch.values.shape[1]
        length = stretch.step * count
        window = 1 - np.cos(math.tau * (np.arange(count) + 0.5) / count)  # Hann
        # A spectrum of wind changes little over a sixth of its frequency.
        reach = np.maximum(omega / 6, 2 * HZ / length)
        lines = HZ / length * np.arange(1, min(count // 2, int(max(omega + reach) * length / HZ)))
        spectra = np.fft.rfft(window * detrend(stretch.values))[:, 1 : lines.size + 1]
        response = frequency_response(model, values, lines, input=input, output=output).response
        power = np.abs(spectra[1] - response * spectra[0]) ** 2
        mean_power = [
            power[np.abs(lines - w) <= r].mean() for w, r in zip(omega, reach, strict=True)
        ]
        total += length * 2 * stretch.step / np.sum(window**2) * np.array(mean_power)
        seconds += length
    if seconds * omega[0] < QUIET_PERIODS * HZ:
        raise ValueError(
            f"the quiet flight has {seconds:.3g} s, fewer than {QUIET_PERIODS} periods of "
            f"{omega[0]:.3g} rad/s: give a longer one."
        )
    return total / seconds
