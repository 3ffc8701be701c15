"""Numbers that describe loops of many plants: margins, crossings, closed-loop response, poles.

Begin with `margin_numbers` and `closed_loop_numbers`.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from greybox.experiment.sampled_loop import SampledLoop
from greybox.files.arrays import AnyArray, Array, BoolArray, ComplexArray, IntArray
from greybox.files.frozen_values import frozen

POINTS = 400  # in four decades below the Nyquist frequency
REST = 1e-6  # rad per sample: a response at rest, still exact to ten digits
LARGEST = math.log(1e4)  # gain; the phase of two integrators, near rest, is rounding above it


class Located(NamedTuple):
    """A quantity of every plant, and the frequency at which it occurs, both (plants,).

    The value is infinite where it does not exist, NaN where it is not defined.
    """

    value: Array
    omega: Array

    @property
    def first(self) -> tuple[float, float]:
        """The value and the frequency of the first plant."""
        return float(self.value[0]), float(self.omega[0])


Numbers = dict[str, Located]
LoopNumbers = Callable[[SampledLoop, Array], Numbers]  # at frequencies (n,)


@frozen
class Crossings:
    """Where the curves of many plants change their sign: one row for each crossing.

    Attributes
    ----------
    plants : int
        The number of curves.
    plant, place : (k,) arrays of int
        The curve, in order, and the point before the crossing.
    share : (k,) array
        How far the crossing is from that point to the next one.
    omega : (k,) array
    """

    plants: int
    plant: IntArray
    place: IntArray
    share: Array
    omega: Array

    def between(self, values: Array) -> Array:
        """Interpolate other curves (plants, n) at the crossings (k,)."""
        before, after = (values[self.plant, self.place + k] for k in (0, 1))
        return before + self.share * (after - before)

    def where(self, condition: BoolArray) -> "Crossings":
        """Return the crossings at which a condition (k,) is true."""
        names = ("plant", "place", "share", "omega")
        return replace(self, **{name: getattr(self, name)[condition] for name in names})

    def smallest(self, values: Array) -> Located:
        """Return the smallest of the values (k,) of each plant; infinity for none."""
        answer = Located(np.full(self.plants, math.inf), np.full(self.plants, np.nan))
        # If several values are assigned to one plant, the last one remains.
        falling = np.argsort(values, kind="stable")[::-1]
        falling = falling[np.isfinite(values[falling])]
        for array, numbers in zip(answer, (values, self.omega), strict=True):
            array[self.plant[falling]] = numbers[falling]
        return answer

    @property
    def first(self) -> Located:
        """The lowest frequency of each plant; infinity for none."""
        return self.smallest(self.omega)

    @property
    def last(self) -> Located:
        """The highest frequency of each plant; minus infinity for none."""
        value, omega = self.smallest(-self.omega)
        return Located(-value, omega)

    def listed(self, name: str, values: Array) -> Numbers:
        """Return the values (k,) at every crossing of the first plant, if it has several.

        Plants with fewer crossings have no limit at the last ones.
        """
        # The rows of a plant are in the order of frequency.
        rank = np.arange(len(self.plant)) - np.searchsorted(self.plant, self.plant)
        count = np.count_nonzero(self.plant == 0)
        return {
            f"{name} {k + 1}": self.where(rank == k).smallest(values[rank == k])
            for k in range(count if count > 1 else 0)
        }


def crossings(values: Array, omega: Array) -> Crossings:
    """Return where curves (plants, n) change their sign along `omega` (n,), or time."""
    is_negative = values < 0
    plant, place = np.nonzero(is_negative[:, :-1] != is_negative[:, 1:])
    before, after = values[plant, place], values[plant, place + 1]
    share = before / (before - after)
    at = omega[place] + share * (omega[place + 1] - omega[place])
    return Crossings(len(values), plant, place, share, at)


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
        places = _nearest(poles, pole).imag
        reach = 5 * max(abs(pole.real), 1e-4 * pole.imag)
        near = np.linspace(places.min() - reach, places.max() + reach, 100)
        grid = np.union1d(grid, np.clip(near, grid[0], grid[-1]))
    return grid


def _nearest(poles: AnyArray, pole: Any) -> ComplexArray:
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


def follows(loop: SampledLoop, setpoint: str, response: str) -> bool:
    """Return whether the response to a step of the setpoint has a final value other than zero."""
    omega = np.array([REST / loop.period, *loop_frequencies(loop)])
    size = np.abs(loop.first.gains(setpoint, [response], omega)[0, :, 0])
    return bool(size[0] > 1e-6 * size.max())


@np.errstate(all="ignore")  # draws may be unstable, or without gain
def closed_loop_numbers(
    loop: SampledLoop, omega: Array, setpoint: str, response: str, **attitude: Any
) -> Numbers:
    """Return numbers of the closed loops from a setpoint to a response.

    The options `attitude` are for the criteria of ADS-33: `integrals` is how often the response
    must be integrated to give an angle (None if it is neither an angle nor a rate), and `boundary`
    has phase delays and bandwidths (2, n).
    """
    return {
        **_response_numbers(loop, omega, setpoint, response, **attitude),
        **_step_numbers(loop, setpoint, response),
        **_pole_numbers(loop, setpoint, response),
    }


def _response_numbers(
    loop: SampledLoop,
    omega: Array,
    setpoint: str,
    response: str,
    integrals: int | None,
    boundary: Array,
) -> Numbers:
    final = loop.gains(setpoint, [response], REST / loop.period)[..., 0].real
    gain = loop.gains(setpoint, [response], omega)[..., 0] / final
    size, phase = np.abs(gain), np.unwrap(np.angle(gain), axis=1)
    answer = {
        "bandwidth": crossings(size - math.sqrt(0.5), omega).last,
        "-180 deg frequency": crossings(phase + math.pi, omega).first,
    }
    if integrals is None:
        return answer

    # ADS-33E-PRF, 3.3.2.1: 45 degrees before the phase at which a pilot's gain makes the attitude
    # unstable, and 6 dB below that gain; the phase delay is the slope of the phase beyond.
    size, phase = size / omega**integrals, phase - integrals * math.pi / 2
    reversal = crossings(phase + math.pi, omega).first
    enough = crossings(size - 10 ** (6 / 20) * _at(reversal.omega, omega, size)[:, None], omega)
    by_gain = enough.where(enough.omega < reversal.omega[enough.plant]).last
    by_phase = crossings(phase + 0.75 * math.pi, omega).first
    # A command of attitude has no gain bandwidth: its loop already holds the attitude.
    bandwidth = np.minimum(by_gain.value, by_phase.value) if integrals else by_phase.value
    twice = 2 * reversal.omega
    delay = -(math.pi + _at(twice, omega, phase)) / twice
    delay = np.where(twice <= omega[-1], delay, math.nan)
    answer |= {
        "ADS-33 gain bandwidth": by_gain,
        "ADS-33 phase bandwidth": by_phase,
        "ADS-33 bandwidth": Located(bandwidth, bandwidth),
        "phase delay": Located(delay, reversal.omega),
    }
    if boundary.size:
        # A boundary ends at its largest phase delay.
        above = bandwidth - np.interp(delay, *boundary, right=math.inf)
        answer["bandwidth above the boundary"] = Located(above, bandwidth)
    return answer


def _at(places: Array, omega: Array, curves: Array) -> Array:
    """Return each curve (plants, n) at its own frequency (plants,)."""
    return np.array([np.interp(w, omega, row) for w, row in zip(places, curves, strict=True)])


def _pole_numbers(loop: SampledLoop, setpoint: str, response: str) -> Numbers:
    """Return damping ratio and natural frequency of the poles that dominate a step.

    The dominant pole of the first plant has the largest part in the step; those of the other plants
    are next to it.
    """
    from scipy.linalg import eig  # noqa: PLC0415  (takes a tenth of a second to import)

    A, B, C, _ = (block[0] for block in loop.first.closed(setpoint, response))
    z, left, right = map(np.asarray, eig(A, left=True, right=True))
    part = (C @ right) * (left.conj().T @ B) / np.sum(left.conj() * right, axis=0) / (1 - z)
    # Past controls are poles at zero, which may be multiple; a pole at one is a position that no
    # controller holds.
    part[(np.abs(z) < 1e-3) | (np.abs(z - 1) < 1e-7)] = 0
    dominant = np.log(z[np.abs(part).argmax()]) / loop.period
    dominant = dominant.real + 1j * abs(dominant.imag)
    pole = _nearest(np.log(loop.poles) / loop.period, dominant)
    frequency = np.abs(pole)
    return {
        "damping ratio": Located(-pole.real / frequency, frequency),
        "natural frequency": Located(frequency, frequency),
    }


def _step_numbers(loop: SampledLoop, setpoint: str, response: str) -> Numbers:
    """Return overshoot (percent), rise time and settling time of a step of a setpoint.

    The rise is from 10 % to 90 % of the final response, which is settled within 2 % of it.
    """
    time, steps = step_responses(loop, setpoint, response)
    rise = crossings(steps - 0.9, time).first.value - crossings(steps - 0.1, time).first.value
    outside = np.abs(steps - 1) - 0.02  # of a settled response
    settling = np.where(outside[:, -1] < 0, crossings(outside, time).last.value, math.inf)
    numbers = {
        "overshoot": 100 * np.maximum(steps.max(axis=1) - 1, 0),
        "rise time": rise,
        "settling time": settling,
    }
    nowhere = np.full(len(steps), np.nan)
    return {n: Located(np.where(loop.is_stable, v, math.inf), nowhere) for n, v in numbers.items()}


def samples_to_settle(loop: SampledLoop, remaining: float = 1e-4) -> int:
    """Return after how many samples this share of the slowest mode of the first plant remains."""
    size = np.abs(loop.first.poles)
    # A pole at one is a position that no controller holds.
    slowest = size[size < 1 - 1e-7].max(initial=0.5)
    return max(int(math.log(remaining) / math.log(slowest)), 100)


def step_responses(loop: SampledLoop, setpoint: str, response: str) -> tuple[Array, Array]:
    """Return times (n,) and responses (plants, n) to a step of a setpoint, over their final values.

    They end when the slowest pole of the first plant has decayed.
    """
    count = samples_to_settle(loop)
    # So many points of a step response take 70 MB for all draws.
    stride = -(-count // 2**14)
    length = math.isqrt(count // stride) + 1
    A, B, C, D = loop.closed(setpoint, response)

    # With the constant input as a state, sample k is the last entry of the row [C D] M^k.
    M = np.zeros((len(A), len(A[0]) + 1, len(A[0]) + 1))
    M[:, :-1, :-1], M[:, :-1, -1], M[:, -1, -1] = A, B, 1
    rows = [np.hstack([C, D[:, None]])[:, None]]
    columns = [np.broadcast_to(np.eye(M.shape[1])[:, -1:], (len(M), M.shape[1], 1))]
    with np.errstate(all="ignore"):  # unstable loops
        between = np.linalg.matrix_power(M, stride)
        across = np.linalg.matrix_power(between, length)
        for _ in range(length - 1):
            rows.append(rows[-1] @ between)
            columns.append(across @ columns[-1])
        steps = np.hstack(rows) @ np.concatenate(columns, axis=2)
        steps = steps.mT
    final = loop.gains(setpoint, [response], REST / loop.period)[:, 0, 0].real
    time = loop.period * stride * np.arange(length**2, dtype=float)
    # Both begin at zero, before the step.
    return np.r_[0.0, time], np.pad(steps.reshape(len(M), -1) / final[:, None], ((0, 0), (1, 0)))
