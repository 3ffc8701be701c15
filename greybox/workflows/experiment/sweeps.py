"""Frequency sweeps."""

import math

import numpy as np

from greybox.data.checked_array import finite_numbers
from greybox.data.files.arrays import Array
from greybox.data.files.public import public
from greybox.workflows.experiment.excitation import Excitation, Maneuver, checked_band, round_up

# Periods of the lowest frequency before a sweep: ArduPilot's SystemID mode; Tischler and Remple,
# section 5.6.
DWELL = 2


@public
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
