"""Finds where an output becomes later than its input in the middle of a single sweep.

A sweep excites each frequency once, so the responses before and after a jump of the clock cannot
be compared, as `clock_jump` does. Two things show the jump. Near it, the ratio of output to input
turns from one row to the next and keeps its magnitude, while a plant changes it gradually. And over
the whole record, one linear model explains the samples better with the delay than without it, which
rules out gusts and nonlinear plants. A plant that changes suddenly may look the same.
`benchmarks/damaged_records.py` counts what is found.
"""

from typing import NamedTuple

import numpy as np

from greybox.data.clock_jump import ClockJump
from greybox.data.files.arrays import Array, BoolArray, ComplexArray

# A sweep never rests: its amplitude exceeds a share of the usual one, and its phase always grows.
MOVING, GROWING = 0.2, 0.98
# Rows in a period of the highest frequency with power, after decimation, and the share of the power
# below that frequency.
PERIOD, POWER = 12, 0.98
# Periods on each side of a row, and the degree in time of the ratio of output to input there. With
# two periods, resonances of right plants look like steps; with four, more jumps are missed.
PERIODS, DEGREE = 3, 3
# Means of successive rows on each side of a row, by which a window of any length has one size, and
# windows that are computed together.
BINS, TOGETHER = 10 * PERIODS, 1000
# The least angle, rad, by which the ratio turns, the most by which the log of its magnitude
# changes, and how much smaller the sum of squares becomes with this step.
ANGLE, MAGNITUDE, CLEARER = 0.1, 0.15, 1.3
# Lags of a linear model of the record, and how much smaller its sum of squares becomes with the
# delay: none of the 480 right sweeps of `benchmarks/damaged_records.py` comes to it.
LAGS, EXPLAINED = 8, 1.05
# Steps that are tried in the linear model.
TRIED = 3


class Step(NamedTuple):
    """A turn of the ratio of output to input: its row, angle, frequency, and how clear it is."""

    row: int
    angle: float
    omega: float
    clearer: float


def sweep_jump(u: Array, y: Array) -> ClockJump | None:
    """Return where y (n,) becomes later than a sweep u (n,); None if it does not, or u is none."""
    span = _sweep(u)
    if span is None:
        return None
    u, y = u[span], y[span]

    spectrum = np.cumsum(np.abs(np.fft.rfft(u - u.mean())) ** 2)
    highest = np.searchsorted(spectrum, POWER * spectrum[-1]) / u.size  # periods per row
    decimation = max(1, int(1 / (PERIOD * highest)))
    u, y = (_decimated(x - x.mean(), decimation) for x in (u, y))

    steps = _steps(u, y)
    steps.sort(key=lambda step: -step.clearer)
    best, jump = EXPLAINED, None
    for step in steps[:TRIED]:
        # An angle is known up to full turns.
        for turns in (-1, 0, 1):
            later = (2 * np.pi * turns - step.angle) / step.omega
            shift = round(later)
            gain = _gain(u, y, step.row, shift) if shift else 1.0
            if gain > best:
                row = span.start + step.row * decimation
                best, jump = gain, ClockJump(row, later * decimation, 1.0)
    return jump


def _sweep(u: Array) -> slice | None:
    """Return the rows of a sweep: the longest stretch that has one frequency at a time."""
    if not (u.size and np.ptp(u) > 0):
        return None
    analytic = _analytic(u - u.mean())
    amplitude = np.abs(analytic)
    moves = amplitude > MOVING * np.quantile(amplitude, 0.9)
    span = _longest(moves)
    phase = np.unwrap(np.angle(analytic[span]))
    periods = (phase[-1] - phase[0]) / (2 * np.pi) if phase.size else 0.0
    if periods < 4 * PERIODS or np.mean(np.diff(phase) > 0) < GROWING:
        return None
    return span


def _analytic(values: Array) -> ComplexArray:
    """Return the analytic signal (n,), of positive frequencies only."""
    # As `scipy.signal.hilbert`, which takes a third of a second to import.
    spectrum = np.fft.fft(values)
    spectrum[1 : (values.size + 1) // 2] *= 2
    spectrum[values.size // 2 + 1 :] = 0
    return np.fft.ifft(spectrum)


def _longest(flags: BoolArray) -> slice:
    """Return the longest run of true flags (n,)."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(int)))
    begins, ends = edges[::2], edges[1::2]
    at = int(np.argmax(ends - begins))
    return slice(int(begins[at]), int(ends[at]))


def _decimated(values: Array, rows: int) -> Array:
    """Return the means (n // rows,) of successive rows."""
    count = values.size // rows
    return values[: count * rows].reshape(count, rows).mean(axis=1)


def _steps(u: Array, y: Array) -> list[Step]:
    """Return the turns of y over u at rows a quarter of a period apart."""
    analytic = _analytic(u)
    phase = np.maximum.accumulate(np.unwrap(np.angle(analytic)))
    periods = (phase - phase[0]) / (2 * np.pi)
    middles = np.arange(PERIODS + 1, periods[-1] - PERIODS - 1, 0.25)
    begin, row, end = (np.searchsorted(periods, middles + k) for k in (-PERIODS, 0, PERIODS))
    is_long = np.minimum(row - begin, end - row) >= BINS
    windows = np.stack([begin, row, end], axis=1)[is_long]
    sums = [np.r_[0, np.cumsum(x)] for x in (analytic, y)]

    steps = []
    for k in range(0, len(windows), TOGETHER):
        begin, row, end = windows[k : k + TOGETHER].T
        # As many bins on both sides, so that all windows have matrices of one size.
        share = np.arange(BINS + 1) / BINS
        before = begin[:, None] + np.floor(share * (row - begin)[:, None])
        after = row[:, None] + np.floor(share * (end - row)[:, None])
        edges = np.c_[before, after[:, 1:]].astype(int)
        near, values = (np.diff(total[edges]) / np.diff(edges) for total in sums)
        half = np.maximum(row - begin, end - row)[:, None]
        time = ((edges[:, 1:] + edges[:, :-1]) / 2 - row[:, None]) / half

        parts = near.real, near.imag
        smooth = [part * time**power for power in range(DEGREE + 1) for part in parts]
        turned = [part * (time > 0) for part in parts]
        columns = np.stack([*smooth, np.ones_like(time), time, *turned], axis=2)
        q, r = np.linalg.qr(columns)
        along = np.einsum("kij,ki->kj", q, values)
        left = np.sum((values - np.einsum("kij,kj->ki", q, along)) ** 2, axis=1)
        diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))
        is_regular = diagonal.min(axis=1) > 1e-9 * diagonal.max(axis=1)
        r[~is_regular] = np.eye(r.shape[1])
        found = np.linalg.solve(r, along[..., None])[..., 0]

        square = np.maximum(np.sum(values**2, axis=1), 1e-300)
        clearer = 1 + np.sum(along[:, -2:] ** 2, axis=1) / np.maximum(left, 1e-18 * square)
        gain = found[:, 0] - 1j * found[:, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = 1 + (found[:, -2] - 1j * found[:, -1]) / gain
            keeps = np.abs(np.log(np.abs(turn))) < MAGNITUDE
        omega = (phase[end - 1] - phase[begin]) / (end - 1 - begin)
        is_step = is_regular & keeps & (np.abs(np.angle(turn)) > ANGLE) & (clearer > CLEARER)
        for i in np.flatnonzero(is_step):
            numbers = map(float, (np.angle(turn[i]), omega[i], clearer[i]))
            steps.append(Step(int(row[i]), *numbers))
    return steps


def _gain(u: Array, y: Array, row: int, shift: int) -> float:
    """Return how much better a linear model explains y if it is later by a shift from a row on.

    The ratio of both sums of squares, without the rows at the jump, which belong to neither side.
    """
    rows = np.arange(LAGS + abs(shift), y.size - abs(shift))
    rows = rows[(rows < row - 2) | (rows > row + LAGS + 2 + abs(shift))]
    past = [y[rows - lag] for lag in range(1, LAGS + 1)]

    def left(later: int) -> float:
        delayed = rows - np.where(rows > row, later, 0)
        columns = np.stack([*past, *(u[delayed - lag] for lag in range(LAGS + 1))], axis=1)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        values, *_ = np.linalg.lstsq(columns, y[rows], rcond=1e-10)
        return float(np.sum((y[rows] - columns @ values) ** 2))

    return left(0) / max(left(shift), 1e-24 * float(np.sum(y**2)))
