"""The margins of broken loops of many plants, and the frequencies at which loops are evaluated."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from greybox.data.files.arrays import AnyArray, Array, BoolArray, ComplexArray
from greybox.workflows.experiment.crossings import Located, Numbers, crossings
from greybox.workflows.experiment.sampled_loop import SampledLoop

POINTS = 400  # in four decades below the Nyquist frequency
# Frequency at which a response counts as that at rest, rad per sample; it is exact to ten digits.
REST = 1e-6
# Logarithm of the largest gain at which the phase is meaningful: above it, near rest, the phase of
# two integrators is rounding.
LARGEST = math.log(1e4)
# Margins of the gain beyond this many decibels limit no gain.
FAR = 40.0
# A function of a loop and frequencies (n,), rad/s, to numbers of every plant.
LoopNumbers = Callable[[SampledLoop, Array], Numbers]


def loop_frequencies(loop: SampledLoop, points: int = POINTS) -> Array:
    """Return the frequencies (n,), rad/s, at which loops are evaluated before any refinement."""
    # A loop at 8 kHz, or one with a slow integrator, has a crossover far below its rate. Its
    # response is smooth there, so that fewer points are enough.
    slow = np.geomspace(1e-6, 1e-4, points // 8, endpoint=False)
    grid = np.r_[slow, np.geomspace(1e-4, 0.999, points)] * math.pi / loop.period
    poles = np.log(np.linalg.eigvals(loop.A).astype(complex)) / loop.period
    first = poles[0]
    is_light = (first.imag > 0) & (np.abs(first.real) < 0.1 * first.imag)
    for pole in first[is_light]:
        # Its resonance is narrower than the spacing of the grid, and at another frequency in every
        # draw.
        frequencies = nearest_pole(poles, pole).imag
        width = 5 * max(abs(pole.real), 1e-4 * pole.imag)
        near = np.linspace(frequencies.min() - width, frequencies.max() + width, 100)
        grid = np.union1d(grid, np.clip(near, grid[0], grid[-1]))
    return grid


def nearest_pole(poles: AnyArray, pole: Any) -> ComplexArray:
    """Return the pole (plants,) of each plant that is nearest to `pole`.

    `poles` (plants, n) are all poles of the plants.
    """
    nearest = np.nanargmin(np.abs(poles - pole), axis=1)[:, None]
    return np.take_along_axis(poles, nearest, 1)[:, 0]


def refined(loop: SampledLoop, numbers: LoopNumbers) -> Numbers:
    """Return numbers of the first plant, at frequencies that are accurate to rounding.

    Around the frequencies at which the quantities occur, points are added in three rounds, each
    closer than the last.
    """
    first_loop = loop.first
    coarse = loop_frequencies(loop)
    spacing = math.log(coarse[1] / coarse[0])
    factors = np.linspace(-1.5, 1.5, 61)
    answer = numbers(first_loop, coarse)
    for _ in range(3):
        frequencies = np.array([quantity.first[1] for quantity in answer.values()])
        frequencies = frequencies[np.isfinite(frequencies)]
        # A phase delay also depends on the phase at twice its frequency.
        centers = [*frequencies, *(2 * frequencies)]
        near = np.outer(centers, np.exp(factors * spacing))
        omega = np.unique([*coarse, *near.ravel()])
        answer = numbers(first_loop, omega[(omega >= coarse[0]) & (omega <= coarse[-1])])
        # The new points are a twentieth of the spacing apart, and interpolation between them has an
        # error of a thousandth of that.
        spacing /= 20
    return answer


# The logarithm of a plant without gain is minus infinity.
@np.errstate(all="ignore")
def margin_numbers(
    gain: ComplexArray, omega: Array, *, is_stable: BoolArray | bool = True, period: float = 0.0
) -> Numbers:
    """Return the margins of broken loops.

    Parameters
    ----------
    gain : (plants, n) array of complex
        Gains of the loops, with the sign of negative feedback.
    omega : (n,) array, rad/s
    is_stable : (plants,) array of bool or bool
        Whether the closed loops are stable.
    period : float, s
        That of a sampled loop, whose frequencies reach from near rest to near the Nyquist
        frequency. The gain is real at both.
    """
    if period:
        gain, omega = _mirrored(gain, omega, period)
    size = np.log(np.abs(gain))
    phase = np.unwrap(np.angle(gain), axis=1)

    # The frequencies at which the gain is one, and the distance of the phase from -180 degrees.
    unity = crossings(size, omega)
    lag = np.mod(unity.between(phase) + math.pi, math.tau)
    angle = np.degrees(np.minimum(lag, math.tau - lag))

    # The frequencies at which the gain is real and negative.
    real = crossings(gain.imag, omega)
    real = real.where((real.between(gain.real) < 0) & (real.between(size) < LARGEST))
    decibels = -20 / math.log(10) * real.between(size)
    is_near = np.abs(decibels) < FAR

    # The distance from the critical point, which is one over the sensitivity.
    distance = np.abs(1 + gain)
    least = distance.min(axis=1)
    closest = np.abs(omega[distance.argmin(axis=1)])
    margins = {
        "phase margin": unity.smallest(angle),
        "gain margin": real.smallest(np.where(decibels > 0, decibels, math.inf)),
        "gain reduction margin": real.smallest(np.where(decibels < 0, -decibels, math.inf)),
        "delay margin": unity.smallest(lag / unity.omega),
        "modulus margin": Located(least, closest),
    }
    # The margins of an unstable loop are zero.
    answer = {}
    for name, margin in margins.items():
        answer[name] = Located(np.where(is_stable, margin.value, 0.0), margin.omega)

    # If the sensitivity at rest is above -3 dB, the loop rejects no disturbance.
    rejects = crossings(distance - math.sqrt(2), omega).first
    rejection = np.where(distance[:, 0] > math.sqrt(2), rejects.value, 0.0)
    return {
        **answer,
        "crossover": unity.last,
        "disturbance rejection bandwidth": Located(rejection, rejects.omega),
        "disturbance rejection peak": Located(-20 * np.log10(least), closest),
        **unity.listed("phase margin", angle),
        **real.where(is_near).listed("gain margin", decibels[is_near]),
    }


def _mirrored(gain: ComplexArray, omega: Array, period: float) -> tuple[ComplexArray, Array]:
    """Return gains and frequencies with one more point beyond rest and the Nyquist frequency.

    Beyond both, the gain is the conjugate of its mirror image, so that crossings of the real axis
    there are found. The gain of an integrator is imaginary near rest, and does not cross the real
    axis there.
    """
    first = gain[:, :1]
    last = gain[:, -1:]
    is_integrator = np.abs(first.imag) > np.abs(first.real)
    before = np.where(is_integrator, first, first.conj())
    frequencies = np.r_[-omega[0], omega, math.tau / period - omega[-1]]
    return np.hstack([before, gain, last.conj()]), frequencies
