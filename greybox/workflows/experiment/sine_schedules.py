"""Sine schedules: one sine after another about an operating point, the paper's (3.14)."""

import math
from collections.abc import Sequence

import numpy as np

from greybox.data.checked_array import finite_numbers
from greybox.data.files.arrays import Array
from greybox.data.files.public import public
from greybox.workflows.experiment.excitation import Excitation, Maneuver, checked_band, round_up


@public
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
