"""Numbers of closed loops of many plants: response, step and poles."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.workflows.experiment.controller import Controller
from greybox.workflows.experiment.crossings import Located, Numbers, crossings
from greybox.workflows.experiment.loop_numbers import REST, loop_frequencies, nearest_pole
from greybox.workflows.experiment.sampled_loop import SampledLoop


def setpoint_and_response(controllers: Sequence[Controller]) -> tuple[str, str] | None:
    """Return the first setpoint, and what its controller measures first; None if there is none."""
    for controller in controllers:
        if controller.setpoints and controller.inputs:
            setpoint, response = controller.setpoints[0], controller.inputs[0]
            return controller.outside(setpoint), controller.outside(response)
    return None


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
        **step_numbers(loop, setpoint, response),
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
    pole = nearest_pole(np.log(loop.poles) / loop.period, dominant)
    frequency = np.abs(pole)
    return {
        "damping ratio": Located(-pole.real / frequency, frequency),
        "natural frequency": Located(frequency, frequency),
    }


def step_numbers(loop: SampledLoop, setpoint: str, response: str) -> Numbers:
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
