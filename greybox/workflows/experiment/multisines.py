"""Orthogonal multisines with low peak factors, for several inputs at once."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.public import public
from greybox.workflows.experiment.excitation import Excitation, Maneuver, checked_band, round_up


@public
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
