"""Numbers of closed loops of many plants, from their responses, step responses and poles."""

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


# Some draws of a plant may be unstable, or have no gain.
@np.errstate(all="ignore")
def closed_loop_numbers(
    loop: SampledLoop, omega: Array, setpoint: str, response: str, **attitude: Any
) -> Numbers:
    """Return numbers of the closed loops from a setpoint to a response.

    Parameters
    ----------
    loop : SampledLoop
    omega : (n,) array, rad/s
    setpoint, response : str
    integrals : int or None
        For the criteria of ADS-33: the number of integrations that lead from the response to an
        angle. None if the response is neither an angle nor a rate.
    boundary : (2, n) array
        For the same criteria: phase delays (s) and bandwidths (rad/s) of a required boundary.
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
    """Return bandwidths and phase delays of the closed-loop frequency responses."""
    final = loop.gains(setpoint, [response], REST / loop.period)[..., 0].real
    gain = loop.gains(setpoint, [response], omega)[..., 0] / final
    size, phase = np.abs(gain), np.unwrap(np.angle(gain), axis=1)
    answer = {
        "bandwidth": crossings(size - math.sqrt(0.5), omega).last,
        "-180 deg frequency": crossings(phase + math.pi, omega).first,
    }
    if integrals is None:
        return answer

    # ADS-33E-PRF, 3.3.2.1. At a phase of -180 degrees, the gain of a pilot could make the attitude
    # unstable. The bandwidth has a margin of 45 degrees to this phase, or of 6 dB to the gain
    # there. The phase delay is the slope of the phase beyond.
    size = size / omega**integrals
    phase = phase - integrals * math.pi / 2
    reversal = crossings(phase + math.pi, omega).first
    required_size = 10 ** (6 / 20) * _at(reversal.omega, omega, size)
    with_margin = crossings(size - required_size[:, None], omega)
    by_gain = with_margin.where(with_margin.omega < reversal.omega[with_margin.plant]).last
    by_phase = crossings(phase + 0.75 * math.pi, omega).first
    # If the attitude itself is commanded, the loop holds it and the gain bandwidth does not count.
    bandwidth = by_phase.value
    if integrals:
        bandwidth = np.minimum(by_gain.value, by_phase.value)
    # The phase delay follows from the phase at twice the frequency of -180 degrees.
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
        # Phase delays beyond the end of the boundary are not allowed at any bandwidth.
        above = bandwidth - np.interp(delay, *boundary, right=math.inf)
        answer["bandwidth above the boundary"] = Located(above, bandwidth)
    return answer


def _at(frequencies: Array, omega: Array, curves: Array) -> Array:
    """Return the value (plants,) of each curve (plants, n) at a frequency of its own (plants,)."""
    return np.array(
        [
            np.interp(frequency, omega, curve)
            for frequency, curve in zip(frequencies, curves, strict=True)
        ]
    )


def _pole_numbers(loop: SampledLoop, setpoint: str, response: str) -> Numbers:
    """Return damping ratio and natural frequency of the poles that dominate a step.

    The dominant pole of the first plant contributes most to its step response. That of another
    plant is the one nearest to it.
    """
    from scipy.linalg import eig  # noqa: PLC0415  (takes a tenth of a second to import)

    A, B, C, _ = (block[0] for block in loop.first.closed(setpoint, response))
    z, left, right = map(np.asarray, eig(A, left=True, right=True))
    # Residues of the step response.
    size = np.sum(left.conj() * right, axis=0)
    contribution = (C @ right) * (left.conj().T @ B) / size / (1 - z)
    # Left out are poles at zero, which are past controls and may be multiple, and poles at one,
    # which are positions that no controller holds.
    contribution[(np.abs(z) < 1e-3) | (np.abs(z - 1) < 1e-7)] = 0
    dominant = np.log(z[np.abs(contribution).argmax()]) / loop.period
    dominant = dominant.real + 1j * abs(dominant.imag)
    pole = nearest_pole(np.log(loop.poles) / loop.period, dominant)
    frequency = np.abs(pole)
    return {
        "damping ratio": Located(-pole.real / frequency, frequency),
        "natural frequency": Located(frequency, frequency),
    }


def step_numbers(loop: SampledLoop, setpoint: str, response: str) -> Numbers:
    """Return overshoot (percent), rise time (s) and settling time (s) of a step of a setpoint.

    The response rises from 10 % to 90 % of its final value, and has settled once it stays within
    2 % of it.
    """
    time, steps = step_responses(loop, setpoint, response)
    rise = crossings(steps - 0.9, time).first.value - crossings(steps - 0.1, time).first.value
    excess = np.abs(steps - 1) - 0.02
    has_settled = excess[:, -1] < 0
    settling = np.where(has_settled, crossings(excess, time).last.value, math.inf)
    numbers = {
        "overshoot": 100 * np.maximum(steps.max(axis=1) - 1, 0),
        "rise time": rise,
        "settling time": settling,
    }
    # These numbers belong to no frequency.
    no_frequency = np.full(len(steps), np.nan)
    return {
        name: Located(np.where(loop.is_stable, values, math.inf), no_frequency)
        for name, values in numbers.items()
    }


def samples_to_settle(loop: SampledLoop, remaining: float = 1e-4) -> int:
    """Return the number of samples after which a share of the slowest mode remains.

    The mode is that of the first plant.
    """
    size = np.abs(loop.first.poles)
    # A pole at one is a position that no controller holds.
    slowest = size[size < 1 - 1e-7].max(initial=0.5)
    return max(int(math.log(remaining) / math.log(slowest)), 100)


def step_responses(loop: SampledLoop, setpoint: str, response: str) -> tuple[Array, Array]:
    """Return times (n,), s, and responses (plants, n) to a step, divided by their final values.

    They end when the slowest pole of the first plant has decayed.
    """
    count = samples_to_settle(loop)
    # At most 2**14 points of a step response, which take 70 MB for all draws.
    stride = -(-count // 2**14)
    length = math.isqrt(count // stride) + 1
    A, B, C, D = loop.closed(setpoint, response)

    # The constant input is one more state: sample k is the last entry of the row [C D] M^k.
    plants, n = A.shape[:2]
    M = np.zeros((plants, n + 1, n + 1))
    M[:, :-1, :-1] = A
    M[:, :-1, -1] = B
    M[:, -1, -1] = 1
    # For k = i + length j, the sample is the product of row i, [C D] M^i, and column j, the last
    # one of M^(length j). This takes 2 length products in place of length².
    rows = [np.hstack([C, D[:, None]])[:, None]]
    columns = [np.broadcast_to(np.eye(n + 1)[:, -1:], (plants, n + 1, 1))]
    # Powers of unstable loops overflow.
    with np.errstate(all="ignore"):
        short_power = np.linalg.matrix_power(M, stride)
        long_power = np.linalg.matrix_power(short_power, length)
        for _ in range(length - 1):
            rows.append(rows[-1] @ short_power)
            columns.append(long_power @ columns[-1])
        samples = np.hstack(rows) @ np.concatenate(columns, axis=2)
    steps = samples.mT.reshape(plants, -1)
    final = loop.gains(setpoint, [response], REST / loop.period)[:, 0, 0].real
    time = loop.period * stride * np.arange(length**2, dtype=float)
    # Both begin with a zero, before the step.
    return np.r_[0.0, time], np.pad(steps / final[:, None], ((0, 0), (1, 0)))
