"""Finds manoeuvres: 2-1-1, 3-2-1-1, doublets, pulses, steps and other inputs between two rests.

A signal is at rest if it stays at one level for a second. The part between two rests of the same
level is one manoeuvre. A lasting change of the level is a step.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from greybox.data.clock import median_step
from greybox.data.excited_segment import Segment
from greybox.data.files.argument_checks import as_names
from greybox.data.files.arrays import Array, Interval
from greybox.data.files.public import public
from greybox.data.logs.segment_detection import SETPOINTS, present, stretches
from greybox.data.logs.sine_detection import sines_and_sweeps
from greybox.data.record import Record, Recording

# The signals that are searched if the caller names none.
STICKS = (
    *(f"RCIN.C{k}" for k in range(1, 5)),
    *(f"manual_control_setpoint.{name}" for name in ("roll", "pitch", "yaw", "throttle")),
)
CONTROLS = ("u", "de", "da", "dr", "dt", "elevator", "aileron", "rudder", "throttle", "stick")

# Shortest time at one level, s, that counts as a rest. It is the length of the shortest pulse of an
# aircraft's 3-2-1-1.
REST = 1.0

# A rest of more than this time, s, at another level ends a manoeuvre. It is twice the longest pulse
# of a 3-2-1-1, which takes three times the shortest one.
LASTING = 6.0

# Zero padding of the spectrum: the number of frequencies over that of the samples. The spectrum of
# a sine between two of these frequencies is then at most 10 % below its peak.
ZERO_PADDING = 4

# The highest frequency of a band over the sampling rate, as in `greybox.data.spectral.transients`.
HIGHEST = 0.4


class _Rest(NamedTuple):
    """A rest: its first and last sample, and the level in its first and in its last second."""

    first: int
    last: int
    first_level: float
    last_level: float


@public
def find_manoeuvres(
    data: Recording | Record, signal: str | Sequence[str] = ()
) -> tuple[Segment, ...]:
    """Return the manoeuvres in the inputs of a flight, in order of time.

    Their kind is "step" or "manoeuvre". Sines and sweeps are not manoeuvres, see `find_segments`.

    Parameters
    ----------
    data : Recording or Record
    signal : str or sequence of str
        Signals to search, such as ``"RCIN.C2"``. By default the sticks of a log, or its setpoints
        if it has none, and the controls of a record.

    Raises
    ------
    KeyError, ValueError
        If a named signal does not exist.
    """
    names = as_names(signal or ()) or present(data, STICKS)
    manoeuvres = []
    for name in names or present(data, (*SETPOINTS, *CONTROLS)):
        unit, parts = stretches(data, name)
        manoeuvres += [
            replace(run, axis=name, unit=unit, source=f"input {name}")
            for time, values in parts
            for run in manoeuvres_in(time, values)
        ]
    return tuple(sorted(manoeuvres, key=lambda s: (s.start, s.axis)))


def manoeuvres_in(time: Array, values: Array) -> list[Segment]:
    """Return the manoeuvres in one signal, (n,) arrays."""
    # Squares of values outside of this range would vanish or overflow.
    if time.size < 2 or not 1e-100 < np.ptp(values) < 1e100:
        return []

    # The range is between quantiles, since single samples may be damaged.
    low, high = np.quantile(values, [0.001, 0.999])
    # The standard deviation of the noise, from successive differences, to which a slow input adds
    # little. The median ignores the edges of the manoeuvre. The median absolute value of normal
    # noise times 1.4826 is its standard deviation.
    noise = 1.4826 * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2)
    # The tolerance for levels is twice the ripple on sticks and the drift of the trim, which are
    # below a hundredth of the range of a signal.
    drift = max(0.02 * float(high - low), 1e-12 * float(np.abs(values).max()))
    # The noise in a second of samples does not exceed a range of eight standard deviations.
    height = max(drift, 8.0 * noise)
    rests = _rests(time, values, height)
    manoeuvres = []
    last_rest = 0
    for k, rest in enumerate(rests[1:], start=1):
        # A short rest at another level is part of the manoeuvre.
        returns = abs(rest.first_level - rests[last_rest].last_level) <= 2 * drift
        is_lasting = time[rest.last] - time[rest.first] > LASTING
        if returns or is_lasting or rest is rests[-1]:
            manoeuvres.append(_between(time, values, rests[last_rest], rest, drift, height))
            last_rest = k

    return [segment for segment in manoeuvres if segment]


def _rests(time: Array, values: Array, height: float) -> list[_Rest]:
    """Return the parts of at least a second in which a signal stays within `height`."""
    window = max(round(REST / median_step(time)), 2)
    if time.size < window:
        return []
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # noqa: PLC0415  (slow import)

    # The filters are centered: their sample k covers the window that begins half a window earlier.
    # After the shift, sample k covers the window that begins with k.
    spread = maximum_filter1d(values, window) - minimum_filter1d(values, window)
    moves = np.ma.masked_greater(spread[window // 2 :][: time.size - window + 1], height)
    rests: list[_Rest] = []
    for run in np.ma.clump_unmasked(moves):
        first, last = run.start, run.stop + window - 2
        first_level = float(np.median(values[first : first + window]))
        last_level = float(np.median(values[last - window + 1 : last + 1]))
        rests.append(_Rest(first, last, first_level, last_level))
    return rests


def _between(
    time: Array, values: Array, before: _Rest, after: _Rest, drift: float, height: float
) -> Segment | None:
    """Return the manoeuvre between two rests.

    None if the signal does not exceed its noise, and for sines and sweeps, which are no manoeuvres.
    """
    # The rests of a noisy signal may overlap. A step is then in the overlap.
    first, last = sorted((before.last, after.first))
    rows = slice(first, last + 1)
    deviation = values[rows] - before.last_level
    kind = "manoeuvre"
    amplitude = float(np.abs(deviation).max())
    change = after.first_level - before.last_level
    # A step takes at most the time of a rest, as one motion of the hand or of the autopilot does.
    # Meanwhile, the signal stays within -50 % and 150 % of the change.
    is_short = time[after.first] - time[before.last] <= REST
    if abs(change) > 2 * drift and is_short and np.all(np.abs(deviation / change - 0.5) < 1):
        kind = "step"
        amplitude = abs(change)
    elif amplitude <= height or sines_and_sweeps(time[rows], values[rows]):
        return None

    return Segment(
        float(time[first]),
        float(time[max(last, first + 1)]),
        kind,
        band=_band(time, values, before, after, kind),
        amplitude=amplitude,
        offset=before.last_level,
    )


def _band(time: Array, values: Array, before: _Rest, after: _Rest, kind: str) -> Interval:
    """Return the band, rad/s, in which the input, or the derivative of a step, is strong.

    The lowest frequency has one period in the manoeuvre with a second of rest on both sides.
    """
    ends = np.searchsorted(time, [time[before.last] - REST, time[after.first] + REST])
    rows = slice(ends[0], ends[1] + 1)
    t = time[rows]
    x = values[rows] - before.last_level
    # The FFT needs uniform samples, and logs jitter.
    uniform = np.linspace(t[0], t[-1], t.size)
    step = float(uniform[1] - uniform[0])
    x = np.interp(uniform, t, x)
    # The spectrum of a step itself falls as 1/ω and depends on where the record ends.
    if kind == "step":
        x = np.diff(x)
    low = math.tau / (t[-1] - t[0])
    high = HIGHEST * math.tau / step
    omega = math.tau * np.fft.rfftfreq(ZERO_PADDING * t.size, step)
    in_range = (omega >= low) & (omega <= max(high, 2 * low))
    # A manoeuvre of a few samples has no frequency below the limit.
    if not in_range.any():
        return low, 2 * low

    omega = omega[in_range]
    magnitude = np.abs(np.fft.rfft(x, ZERO_PADDING * t.size))[in_range]
    # Frequencies are excited if the spectrum is at least -20 dB of its largest magnitude.
    strong = omega[magnitude >= 0.1 * magnitude.max()]
    # The band ends where the spectrum is weak for an octave.
    holes = np.flatnonzero(strong[1:] > 2 * strong[:-1])
    stop = strong[holes[0] if holes.size else -1]

    return low, float(max(stop, 2 * low))
