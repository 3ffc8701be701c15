"""A test signal to be flown: its samples and its maneuvers.

Sine schedules: one sine after another about an operating point, the paper's (3.14).

Frequency sweeps.

Orthogonal multisines with low peak factors, for several inputs at once.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from greybox.data.checked_array import finite_numbers
from greybox.data.record import NOT_STORED, Record
from greybox.files.arrays import Array, IntArray
from greybox.files.frozen_values import frozen
from greybox.files.named_values import Values

NOTHING: Values = MappingProxyType({})  # where no noise, limit or start is given


class Maneuver(NamedTuple):
    """One sine, sweep or multisine of an excitation, as planned.

    `start`, `settled` and `end` are times in s; the analysis begins at `settled`. `low` and `high`
    are angular frequencies in rad/s, `amplitude` and `offset` are in the unit of the signal.
    """

    signal: str
    kind: str
    start: float
    settled: float
    end: float
    low: float
    high: float
    amplitude: float
    offset: float


@frozen
class Excitation(Record):
    """A test signal to be flown, or several at once: a `Record` with its schedule.

    Attributes
    ----------
    schedule : tuple of Maneuver
    settings : mapping
        Parameters of the signal; for a multisine also its ``harmonics`` (name to multiples of
        2π / ``period``).
    """

    schedule: tuple[Maneuver, ...] = field(default=(), metadata=NOT_STORED)
    settings: Mapping[str, Any] = field(default_factory=dict, metadata=NOT_STORED)

    @property
    def peak_factors(self) -> dict[str, float]:
        """Morelli's relative peak factors: peak to peak over 2√2 σ, so that a sine has 1."""
        return {
            name: float(np.ptp(v) / (2 * math.sqrt(2) * np.std(v)))
            for name, v in self.signals.items()
        }

    def __str__(self) -> str:
        kinds = sorted({maneuver.kind for maneuver in self.schedule})
        low, high = min(s.low for s in self.schedule), max(s.high for s in self.schedule)
        factors = ", ".join(f"{value:.2f}" for value in self.peak_factors.values())
        return (
            f"{', '.join(kinds)} on {', '.join(self.signals)}: {self.time.size / self.rate:.1f} s "
            f"at {self.rate:g} Hz, {low:.4g} to {high:.4g} rad/s, peak factor {factors}"
        )


def checked_band(omega: Sequence[float], rate: float) -> Array:
    """Return the frequencies, rad/s; ValueError if one is not above 0 and far below the rate."""
    values = np.asarray(omega, dtype=float)
    # With five samples per period a held signal has 94 % of the amplitude.
    limit = math.tau * rate / 5
    bad = values[~((values > 0) & (values <= limit))]
    if values.size == 0 or bad.size:
        raise ValueError(
            f"omega is {f'{bad[0]:g} rad/s' if bad.size else 'empty'}: give frequencies above 0 "
            f"and up to {limit:.4g} rad/s, a fifth of the sampling rate of {rate:g} Hz, or raise "
            "the rate."
        )
    return values


def round_up(value: float) -> int:
    """Round up, except for rounding errors."""
    return math.ceil(value - 1e-9)


def sine_schedule(  # noqa: PLR0913 - each is one fact of the test card
    omega: Sequence[float],
    amplitude: float | Sequence[float],
    *,
    offset: float = 0.0,
    periods: int | Sequence[int] = 10,
    least: float = 15.0,
    lead_in: float = 2.0,
    pause: float = 2.0,
    rate: float = 100.0,
    signal: str = "reference",
    unit: str = "rad",
) -> Excitation:
    """Make sines, one after another, about an operating point: offset + η_i sin(ω_i (t - t_0)).

    Parameters
    ----------
    omega : (n,) sequence, rad/s
        Frequencies in the order of the flight.
    amplitude : float or (n,) sequence
        η_i, in the unit of the signal.
    offset : float
        The operating point.
    periods, least : int or (n,) sequence, and float, s
        A sine lasts `periods` periods or `least` seconds, whichever is longer, rounded up to whole
        periods.
    lead_in, pause : float, s
        Time of the same sine to settle before that, in whole periods; and time at the operating
        point before and after each sine.
    rate : float, Hz
    signal, unit : str

    Raises
    ------
    ValueError
        If a frequency is not between 0 and a fifth of the sampling rate, or if the lengths differ.
    """
    frequencies = checked_band(omega, rate)
    amplitudes = _for_each(frequencies, amplitude, "amplitudes")
    counts = _for_each(frequencies, periods, "numbers of periods")

    schedule = []
    clock = pause
    for w, eta, count in np.column_stack([frequencies, amplitudes, counts]).tolist():
        period = math.tau / w
        # Whole periods of settling keep the phase of the analyzed sine at zero.
        lead = round_up(lead_in / period) * period
        length = max(count, round_up(least / period)) * period
        schedule.append(
            Maneuver(signal, "sine", clock, clock + lead, clock + lead + length, w, w, eta, offset)
        )
        clock += lead + length + pause

    time = np.arange(round_up(clock * rate) + 1) / rate
    values = np.full(time.size, float(offset))
    for s in schedule:
        inside = (time >= s.start) & (time < s.end)
        values[inside] += s.amplitude * np.sin(s.low * (time[inside] - s.start))
    return Excitation(
        time,
        {signal: values},
        {signal: unit},
        schedule=tuple(schedule),
        settings={"pause": pause},
    )


def _for_each(frequencies: Array, values: float | Sequence[float], what: str) -> Array:
    array = finite_numbers(what, values)
    if array.size not in (1, frequencies.size):
        raise ValueError(
            f"there are {frequencies.size} frequencies but {array.size} {what}: give one for each."
        )
    return np.broadcast_to(array, frequencies.shape)


# Periods of the lowest frequency before a sweep: ArduPilot's SystemID mode; Tischler and Remple,
# section 5.6.
DWELL = 2


def sweep(  # noqa: PLR0913 - each is one fact of the test card
    low: float,
    high: float,
    duration: float,
    rate: float,
    *,
    amplitude: float = 1.0,
    fade_in: float = 5.0,
    fade_out: float = 5.0,
    dwell: int = DWELL,
    signal: str = "u",
    unit: str = "",
) -> Excitation:
    """Make a logarithmic sweep from `low` to `high`, faded in and out with half cosines.

    It begins with `dwell` periods of the lowest frequency, which count to the duration. It is,
    sample for sample, the signal of ArduPilot's SystemID mode (libraries/AP_Math/chirp.cpp).

    Parameters
    ----------
    low, high : float, rad/s
    duration, fade_in, fade_out : float, s
    rate : float, Hz
    amplitude : float
        In the signal's unit.
    dwell : int
        Periods of the lowest frequency at the start.
    signal, unit : str

    Raises
    ------
    ValueError
        For a band that is empty or above a fifth of the sampling rate, or a duration too short for
        dwell and fades.
    """
    checked_band([low, high], rate)
    finite_numbers("amplitude", amplitude)
    if low >= high:
        raise ValueError(f"a sweep from {low:g} to {high:g} rad/s: the frequency must rise.")
    hold = dwell * math.tau / low
    # NaN fails every comparison.
    is_long = duration >= fade_in + fade_out and duration > hold
    if not (is_long and min(fade_in, fade_out) >= 0):
        raise ValueError(
            f"{duration:g} s are too short for {dwell} periods at {low:g} rad/s ({hold:.1f} s) and "
            f"fades of {fade_in:g} and {fade_out:g} s: raise the duration or the lowest frequency, "
            "or give dwell=0."
        )

    time = np.arange(round_up(duration * rate) + 1) / rate
    span = duration - hold
    late = np.maximum(time - hold, 0)
    rise = math.log(high / low)
    # The integral of a frequency that grows exponentially; expm1 keeps digits at the start.
    phase = low * span / rise * np.expm1(rise * late / span)
    window = _half_cosine(time, fade_in) * _half_cosine(duration - time, fade_out)
    values = amplitude * window * np.sin(phase + low * np.minimum(time - hold, 0))

    settings = {
        "low": low,
        "high": high,
        "duration": duration,
        "amplitude": amplitude,
        "fade_in": fade_in,
        "fade_out": fade_out,
        "dwell": dwell,
    }
    maneuver = Maneuver(signal, "logarithmic sweep", 0.0, 0.0, duration, low, high, amplitude, 0.0)
    return Excitation(
        time, {signal: values}, {signal: unit}, schedule=(maneuver,), settings=settings
    )


def _half_cosine(elapsed: Array, length: float) -> Array:
    """Return the rise from 0 to 1 of a half cosine of this length, s."""
    share = np.clip(elapsed / length, 0, 1) if length > 0 else np.ones(elapsed.size)
    return 0.5 - 0.5 * np.cos(math.pi * share)


def multisine(
    low: float,
    high: float,
    period: float,
    rate: float,
    *,
    amplitude: float = 1.0,
    signals: Sequence[str] = ("u",),
    unit: str = "",
    periods: int = 4,
) -> Excitation:
    """Make sums of sines with low peaks, orthogonal over a period, for several inputs at once.

    The harmonics of 2π / period inside the band are assigned to the signals in turn, each with
    equal power. The phases start from Schroeder's (IEEE Trans. Information Theory 16, 1970) and
    then minimize norms of rising exponent (Guillaume, Schoukens, Pintelon, Kollár, IEEE Trans.
    Instrumentation and Measurement 40, 1991); time is shifted so that every signal starts at zero.
    Interleaved harmonics in flight: Morelli, AIAA Paper 2003-5466.

    Parameters
    ----------
    low, high : rad/s
    period : s
        A whole number of samples.
    rate : Hz
    amplitude : float
        Peak of each signal.
    signals : sequence of str
    unit : str
    periods : int
        Number of repetitions. If there are several, the first is for settling.

    Raises
    ------
    ValueError
        If the period is not a whole number of samples, or has too few harmonics in the band.
    """
    checked_band([low, high], rate)
    count = round(period * rate)
    if count < 1 or abs(count - period * rate) > 1e-6 * count:
        raise ValueError(
            f"a period of {period:g} s at {rate:g} Hz has {period * rate:g} samples: make that a "
            "whole number."
        )
    # The harmonics in the band are assigned to the signals in turn.
    step = math.tau / period
    harmonics = np.arange(round_up(low / step), math.floor(high / step + 1e-9) + 1)
    if not 0 < 2 * len(signals) <= harmonics.size:
        raise ValueError(
            f"a period of {period:g} s has {harmonics.size} harmonics from {low:g} to {high:g} "
            f"rad/s for {len(signals)} signals: lengthen the period or widen the band."
        )
    assigned = {name: harmonics[k :: len(signals)] for k, name in enumerate(signals)}
    values = {}
    for name, own in assigned.items():
        one_period = _sum(own, _phases(own), count)
        values[name] = np.tile(amplitude * one_period / np.max(np.abs(one_period)), periods)
    time = np.arange(count * periods) / rate
    settled = period if periods > 1 else 0.0
    end = period * periods
    schedule = tuple(
        Maneuver(name, "multisine", 0.0, settled, end, h[0] * step, h[-1] * step, amplitude, 0.0)
        for name, h in assigned.items()
    )
    harmonics_by_name = {name: tuple(own.tolist()) for name, own in assigned.items()}
    settings = {"period": period, "harmonics": harmonics_by_name}
    return Excitation(
        time, values, dict.fromkeys(signals, unit), schedule=schedule, settings=settings
    )


def _phases(harmonics: IntArray) -> Array:
    """Return phases (n,) of equal sines whose sum has a low peak and begins at zero."""
    from scipy.optimize import minimize  # noqa: PLC0415  (slow import)

    n = harmonics.size
    # Eight samples per period of the highest harmonic: the peak between samples is at most
    # 1/cos(π/8) = 1.08 times higher.
    count = 2 ** math.ceil(math.log2(8 * harmonics[-1]))

    def norm(phases: Array, p: int) -> tuple[float, Array]:
        values = _sum(harmonics, phases, count)
        top = np.max(np.abs(values))
        power = (values / top) ** (2 * p - 1)
        mean = np.mean(power * values / top)
        # d values / d phase is the same sine a quarter period later; its product with `power` is a
        # Fourier coefficient
        coefficients = np.fft.fft(power)[harmonics] / count
        slope = math.sqrt(2 / n) * (coefficients * np.exp(-1j * phases)).real
        return float(top * mean ** (1 / (2 * p))), slope * mean ** (1 / (2 * p) - 1)

    phases = -math.pi * np.arange(n) * np.arange(1, n + 1) / n  # Schroeder, for equal powers
    # The 64-norm is within 12 % of the peak for a period of 1000 samples: n**(1/64) = 1.11.
    for p in (2, 4, 8, 16, 32):
        outcome = minimize(
            norm, phases, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": 100}
        )
        phases = outcome.x
    return _from_zero(harmonics, phases, count)


def _from_zero(harmonics: IntArray, phases: Array, count: int) -> Array:
    """Shift time to a rising zero crossing."""
    from scipy.optimize import brentq  # noqa: PLC0415  (slow import)

    values = _sum(harmonics, phases, count)
    k = np.flatnonzero((values <= 0) & (np.roll(values, -1) > 0))[0]

    def value(shift: float) -> float:
        return float(np.sum(np.sin(math.tau * harmonics * shift + phases)))

    # Between samples, so that the signal starts exactly at zero.
    crossing: Any = brentq(value, k / count, (k + 1) / count, xtol=1e-16)
    return phases + math.tau * harmonics * crossing


def _sum(harmonics: IntArray, phases: Array, count: int) -> Array:
    """Return one period (count,) with a root mean square of one."""
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[harmonics] = -0.5j * count * math.sqrt(2 / harmonics.size) * np.exp(1j * phases)
    return np.fft.irfft(spectrum, count)
