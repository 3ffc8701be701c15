"""The margins of broken loops of many plants, and the frequencies at which loops are evaluated."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from greybox.data.files.arrays import AnyArray, Array, BoolArray, ComplexArray
from greybox.workflows.experiment.crossings import Located, Numbers, crossings
from greybox.workflows.experiment.sampled_loop import SampledLoop

POINTS = 400  # in four decades below the Nyquist frequency
REST = 1e-6  # rad per sample: a response at rest, still exact to ten digits
LARGEST = math.log(1e4)  # gain; the phase of two integrators, near rest, is rounding above it
LoopNumbers = Callable[[SampledLoop, Array], Numbers]  # at frequencies (n,)


def loop_frequencies(loop: SampledLoop, points: int = POINTS) -> Array:
    """Return the frequencies, in rad/s, at which loops are evaluated before any refinement."""
    # A loop at 8 kHz, or with a slow integrator, crosses a gain of one much below its rate. There
    # its response is smooth, and fewer points suffice.
    slow = np.geomspace(1e-6, 1e-4, points // 8, endpoint=False)
    grid = np.r_[slow, np.geomspace(1e-4, 0.999, points)] * math.pi / loop.period
    poles = np.log(np.linalg.eigvals(loop.A).astype(complex)) / loop.period
    first = poles[0]
    for pole in first[(first.imag > 0) & (np.abs(first.real) < 0.1 * first.imag)]:
        # A resonance that is narrower than the spacing, at another frequency in every draw.
        places = nearest_pole(poles, pole).imag
        reach = 5 * max(abs(pole.real), 1e-4 * pole.imag)
        near = np.linspace(places.min() - reach, places.max() + reach, 100)
        grid = np.union1d(grid, np.clip(near, grid[0], grid[-1]))
    return grid


def nearest_pole(poles: AnyArray, pole: Any) -> ComplexArray:
    """Return the pole of each plant (plants, n) that is nearest to another pole."""
    place = np.nanargmin(np.abs(poles - pole), axis=1)[:, None]
    return np.take_along_axis(poles, place, 1)[:, 0]


def refined(loop: SampledLoop, numbers: LoopNumbers) -> Numbers:
    """Return `numbers` of the first plant, with their frequencies accurate to rounding.

    Points are added, closer and closer, around the frequencies at which quantities occur.
    """
    alone, coarse = loop.first, loop_frequencies(loop)
    width = math.log(coarse[1] / coarse[0])
    answer = numbers(alone, coarse)
    for _ in range(3):
        places = np.array([quantity.first[1] for quantity in answer.values()])
        places = places[np.isfinite(places)]
        # A phase delay takes the phase at twice its frequency, too.
        near = np.outer([*places, *(2 * places)], np.exp(np.linspace(-1.5, 1.5, 61) * width))
        omega = np.unique([*coarse, *near.ravel()])
        answer = numbers(alone, omega[(omega >= coarse[0]) & (omega <= coarse[-1])])
        width /= 20  # the straight lines between points leave 0.001 of a spacing of 0.05 widths
    return answer


@np.errstate(all="ignore")  # a plant without gain is at minus infinity
def margin_numbers(
    gain: ComplexArray, omega: Array, *, is_stable: BoolArray | bool = True, period: float = 0.0
) -> Numbers:
    """Return the margins of broken loops with these gains (plants, n) at `omega` (n,).

    With the `period` of a sampled loop, `omega` ends near rest and the Nyquist frequency, where its
    gain is real.
    """
    if period:
        gain, omega = _mirrored(gain, omega, period)
    size, phase = np.log(np.abs(gain)), np.unwrap(np.angle(gain), axis=1)

    # Where the gain is one, and how far the phase is from -180 degrees there.
    unity = crossings(size, omega)
    lag = np.mod(unity.between(phase) + math.pi, math.tau)
    angle = np.degrees(np.minimum(lag, math.tau - lag))

    # Where the gain is real and negative.
    real = crossings(gain.imag, omega)
    real = real.where((real.between(gain.real) < 0) & (real.between(size) < LARGEST))
    decibels = -20 / math.log(10) * real.between(size)

    is_near = np.abs(decibels) < 40.0  # a crossing that is farther away limits no gain

    distance = np.abs(1 + gain)
    least, closest = distance.min(axis=1), np.abs(omega[distance.argmin(axis=1)])
    margins = {
        "phase margin": unity.smallest(angle),
        "gain margin": real.smallest(np.where(decibels > 0, decibels, math.inf)),
        "gain reduction margin": real.smallest(np.where(decibels < 0, -decibels, math.inf)),
        "delay margin": unity.smallest(lag / unity.omega),
        "modulus margin": Located(least, closest),
    }
    # An unstable loop has no margin left.
    answer = {n: Located(np.where(is_stable, m.value, 0.0), m.omega) for n, m in margins.items()}

    # A loop whose sensitivity at rest is above -3 dB rejects nothing.
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
    """Return gains and frequencies with their images beyond rest and the Nyquist frequency.

    The gain passes into its conjugate at both. The gain of an integrator is imaginary near rest and
    does not cross the real axis there.
    """
    first, last = gain[:, :1], gain[:, -1:]
    is_integrator = np.abs(first.imag) > np.abs(first.real)
    before = np.where(is_integrator, first, first.conj())
    at = np.r_[-omega[0], omega, math.tau / period - omega[-1]]
    return np.hstack([before, gain, last.conj()]), at
