"""Finds where one signal of a record becomes later, or changes its sign, in mid-record.

A log that was joined from two, or a sensor whose clock was set, leaves the output later by a
constant from some row on. Each part alone is right, and so is its coherence; their mean is neither.
"""

import math
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import Array

# Segments of a record, overlapping by half, and the fewest on each side of a jump.
SEGMENTS, FEWEST = 48, 6
SHORTEST = 32  # samples of a segment
# Share of the power of the strongest frequency at which a frequency counts as excited.
EXCITED = 1e-3
# Mean squared difference of both sides, in variances: without the jump at least, and as a share of
# it with the jump at most. The first is 1 for one plant and white noise; a plant that changes
# otherwise fails the second.
CLEAR, EXPLAINED = 10.0, 0.1


class ClockJump(NamedTuple):
    """Where a signal changes: the first row after it, by how many rows it is later, its sign."""

    row: int
    later: float
    sign: float


def clock_jump(u: Array, y: Array) -> ClockJump | None:
    """Return where y (n,) becomes later than u (n,), or of another sign; None if it does not.

    The response of the samples before a row is compared with that of the samples after it, at the
    row where they differ most.
    """
    size = 2 * u.size // (SEGMENTS + 1) // 2 * 2
    if size < SHORTEST:
        return None
    starts = np.arange(0, u.size - size + 1, size // 2)
    inputs, outputs = (_spectra(values, starts, size) for values in (u, y))
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        return None

    power = np.cumsum(np.abs(inputs) ** 2, axis=0)
    cross = np.cumsum(outputs * inputs.conj(), axis=0)
    square = np.cumsum(np.abs(outputs) ** 2, axis=0)
    omega = 2 * np.pi * np.arange(1, size // 2) / size  # rad per row
    excited = power[-1] > EXCITED * power[-1].max()

    best, found = CLEAR, None
    for count in range(FEWEST, starts.size - FEWEST):
        # The segments that reach across the row belong to neither side.
        before = _response(count, power[count - 1], cross[count - 1], square[count - 1])
        rest = starts.size - count - 1
        after = _response(rest, *(total[-1] - total[count] for total in (power, cross, square)))
        if before is None or after is None:
            continue
        both = excited & np.isfinite(before[1]) & np.isfinite(after[1])
        if np.count_nonzero(both) < FEWEST:
            continue
        (first, v), (second, w) = ([x[both] for x in side] for side in (before, after))
        apart = np.mean(np.abs(second - first) ** 2 / (v + w))
        if apart <= best:
            continue
        later, sign, left = _shift(omega[both], first, second, v + w, size)
        is_other = sign < 0 or abs(later) > 0.5
        if is_other and left < EXPLAINED * apart:
            row = int(starts[count] + size // 2)
            best, found = float(apart), ClockJump(row, later, sign)
    return found


def _spectra(values: Array, starts: Array, size: int) -> Array:
    """Return the spectra (segments, frequencies) of values (n,), without their means."""
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size) ** 2
    pieces = values[starts[:, None] + np.arange(size)]
    pieces = pieces - pieces.mean(axis=1, keepdims=True)
    return np.fft.rfft(window * pieces)[:, 1 : size // 2]


def _response(count: int, power: Array, cross: Array, square: Array) -> tuple[Array, Array] | None:
    """Return the response and its variance (frequencies,) from sums over segments."""
    if power.max() <= 0:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        response = cross / power
        noise = square - np.abs(cross) ** 2 / power
        # Segments that overlap by half count as two thirds.
        variance = noise / power / max(count * 2 / 3 - 1, 1)
    # Without noise, windows leave about as much.
    variance = np.maximum(variance, 1e-4 * np.abs(response) ** 2)
    # A frequency that this side does not excite says nothing.
    return response, np.where(power > EXCITED * power.max(), variance, np.nan)


def _shift(
    omega: Array, first: Array, second: Array, variance: Array, size: int
) -> tuple[float, float, float]:
    """Return by how many rows, and with which sign, the second response follows the first.

    The last number is the mean squared difference that remains, in variances.
    """
    # Half of a segment at most, of which a part would be lost.
    later = np.arange(-size / 4, size / 4 + 0.05, 0.1)
    turned = np.exp(-1j * later[:, None] * omega) * first
    match = np.sum((second.conj() * turned).real / variance, axis=1)
    at = int(np.argmax(np.abs(match)))
    sign = math.copysign(1.0, match[at])
    left = np.mean(np.abs(second - sign * turned[at]) ** 2 / variance)
    return float(later[at]), sign, float(left)
