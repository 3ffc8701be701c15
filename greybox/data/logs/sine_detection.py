"""Finds sines and sweeps in one signal by its zero crossings."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from greybox.data.clock import median_step
from greybox.data.excited_segment import Segment
from greybox.data.files.arrays import Array, IntArray

# `benchmarks/signal_constants.py` shows what these constants decide. Below, "of 20" means pairs of
# noisy sines; "of 15", schedules that are clean, offset, quantized or held; "of 24", sweeps; and
# "of 16", signals without a sine.

# Least amplitude of a sine as a share of the signal's range; a turning point is twice as high. All
# heights up to half of the range are tried, so that neither noise nor a large step hides the
# turning points: with 0.01 alone, none of 20 is found; with 0.1 alone, 13; with 0.5 alone, 12 of
# 15.
LEAST_AMPLITUDE = 0.005
HEIGHTS = np.array([2 * LEAST_AMPLITUDE, 0.03, 0.1, 0.25, 0.5])

# Least number of mid-level crossings of a sine: two periods. With 3, sines are found in 5 of 16.
# With 9, long tests are found as well.
CROSSINGS = 5

# Tolerance of a crossing about the line through the previous ones, in half periods. At 0.1, 18 of
# 20 are found and 3 of 24 sweeps are called sines. At 0.4, 10 of 15 are found, because successive
# frequencies merge.
OFF_LINE = 0.2

# Range of one swing over the median of the previous ones. It separates sines of one frequency whose
# amplitudes differ by a factor of 2, not 1.5. At 0.9 to 1.1, 17 of 20 are found.
SWING = (0.6, 1.6)

# Distance of a crossing from the median line, in half periods, above which it is cut at the ends.
# At 0.01, 14 of 15 are found; at 0.3, five.
TRANSIENT = 0.03

# Least number of samples of a sine, and in each period. With 40, no schedule is found at 20 rad/s
# and 100 Hz; from 2 to 16, all are.
SAMPLES = 8

# Largest share of the variance that a fitted sine may leave unexplained. At 0.015, 15 of 20 are
# found. At 0.3, sines are found in 6 of 16: the fundamental of a square wave leaves 1 - 8/π² =
# 0.19.
UNEXPLAINED = 0.15

# Phase at the ends of a piece relative to a straight line, rad, above which the piece is part of a
# sweep. At 0.012, 17 of 20 are found; at 0.4, 5 of 24 sweeps are called sines.
BENT = 0.12

# Largest unexplained share for a piece of a sweep. Besides the noise, a bend of b rad leaves 4/45
# b²; this allows two rad.
BENT_UNEXPLAINED = 0.5

# A sine ends where the signal is farther off the fitted sine than this share of the amplitude. From
# 0.005 to 0.15, all ends are found within half a period; at 0.5, those of 10 of 15.
FOLLOWS = 0.05

# Least number of half periods of a sweep. With fewer, sticks and noise may follow one another as
# smoothly.
SWEEP_HALF_PERIODS = 12
SWEEP_PARTS = 6  # a sweep is faster, or slower, in every part than in the one before

# Least ratio of the frequencies at the ends of a sweep. At 1.1 and at 1.3, all 24 are found as one
# sweep.
SWEEP_RATIO = 1.3

# The next half period of a sweep is predicted from this number of half periods, within this
# relative tolerance. The frequency of a logarithmic sweep is linear in the number of half periods,
# and that of a linear sweep nearly so.
KNOWN_PERIODS = 4
OFF_SWEEP = 0.25
# Weights of the regression line through them, one step and one and a half before the first.
NEXT = np.array([1.0, 0.5, 0.0, -0.5])
BEYOND = np.array([1.15, 0.55, -0.05, -0.65])


def sines_and_sweeps(time: Array, values: Array) -> list[Segment]:
    """Return the sines of at least two periods, and the sweeps, in one signal, (n,) arrays.

    A half period ends where the signal crosses the middle between two turning points. Several least
    heights of turning points are tried. Crossings on one line form a piece. A piece is a sine if a
    fitted sine explains 85 % of its variance and its phase does not bend. A bent piece is a part of
    a sweep, which ends where a smooth change of frequency no longer predicts the crossings.
    """
    # Squares must neither vanish nor overflow.
    if time.size < SAMPLES or not 1e-100 < np.ptp(values) < 1e100:
        return []

    corners = np.arange(time.size)
    tried = corners[:0]
    candidates = []
    # Low heights first: each next one needs only the turning points of the previous one.
    for height in np.ptp(values) * HEIGHTS:
        corners = _turning_points(values, corners, float(height))
        if np.array_equal(corners, tried):
            continue  # the runs would be the same
        tried = corners
        crossings, swings = _crossings(time, values, corners)
        for a, b in _runs(crossings, swings):
            piece = _fitted(time, values, crossings[a:b])
            if piece and piece.kind == "sweep":
                piece = _sweep(time, values, corners, crossings, swings, (a, b), piece)
            if piece:
                candidates.append(piece)

    # The longest run wins. Neighbors may overlap by a tenth, since their ends are uncertain by a
    # period.
    accepted: list[Segment] = []
    for run in sorted(candidates, key=lambda s: -s.duration):
        overlaps = [min(run.end, s.end) - max(run.start, s.start) for s in accepted]
        if all(overlap < 0.1 * run.duration for overlap in overlaps):
            accepted.append(run)
    sweeps = [run for run in accepted if run.kind == "sweep"]
    alone = [run for run in accepted if not any(_part_of(run, sweep) for sweep in sweeps)]
    return sorted(alone, key=lambda s: s.start)


def _turning_points(values: Array, corners: IntArray, height: float) -> IntArray:
    """Return the corners where the signal turns by at least `height`, and both ends."""
    turns = []
    # The direction is unknown at first, then 1 on the way up and -1 on the way down; `extreme` is
    # the index of the highest (lowest) value so far.
    direction = 0
    extreme = int(corners[0])
    levels = values[corners].tolist()
    low = high = top = levels[0]
    for index, level in zip(corners.tolist(), levels, strict=True):
        if direction == 0:
            low = min(low, level)
            high = max(high, level)
            direction = (level - low >= height) - (high - level >= height)
        elif (top - level) * direction >= height:
            turns.append(extreme)
            direction = -direction
        elif (level - top) * direction <= 0:
            continue
        extreme = index
        top = level

    return np.array([corners[0], *turns, extreme], dtype=np.intp)


def _crossings(time: Array, values: Array, corners: IntArray) -> tuple[Array, Array]:
    """Return when the signal crosses the middle between turning points, s, and their distances."""
    times = []
    for a, b in pairwise(corners):
        part = (values[a : b + 1] - (values[a] + values[b]) / 2) * np.sign(values[b] - values[a])
        # Noise crosses the middle several times; the mean of the first and the last is unbiased.
        last_below = a + np.flatnonzero(part <= 0)[-1]
        first_above = a + np.flatnonzero(part >= 0)[0]
        times.append((time[last_below] + time[first_above]) / 2)
    return np.array(times), np.abs(np.diff(values[corners]))


def _runs(crossings: Array, swings: Array) -> Iterator[tuple[int, int]]:
    """Yield the first and one past the last of crossings that form a line and have one height."""
    start = 0
    end = 3  # the fewest from which a line can be extrapolated and checked
    while end <= crossings.size:
        # 400 crossings predict the next one as well as all, and the time grows with their square.
        line = crossings[max(start, end - 399) : end + 1]
        heights = swings[max(start, end + 1 - CROSSINGS) : end + 1]
        if end < crossings.size and _continues(line, heights):
            end += 1
            continue

        if end - start >= CROSSINGS:
            yield start, end
            start = end - 1
        else:
            start += 1
        end = start + 3


def _continues(crossings: Array, swings: Array) -> bool:
    """Return whether the line through the others predicts the last crossing; swings are alike."""
    n = crossings.size - 1
    past = crossings[:-1]
    centered = np.arange(n) - (n - 1) / 2
    # Slope of the regression line.
    half_period = 12 * (centered @ past) / (n * (n * n - 1))
    error = abs(crossings[-1] - past.mean() - half_period * (n + 1) / 2)
    ratio = swings[-1] / np.median(swings[:-1])
    return bool(error < OFF_LINE * half_period and SWING[0] < ratio < SWING[1])


def _fitted(time: Array, values: Array, crossings: Array) -> Segment | None:
    """Fit offset, trend, sine and its frequency, then extend the ends while the signal follows."""
    index = np.arange(crossings.size)
    apart = crossings.size // 2
    half_period = float(np.median(crossings[apart:] - crossings[:-apart])) / apart
    error = np.abs(crossings - half_period * index - np.median(crossings - half_period * index))
    good = crossings[error < max(TRANSIENT * half_period, 5 * np.median(error))]
    if good.size < CROSSINGS or good[-1] - good[0] < SAMPLES * median_step(time):
        return None

    start, end = good[[0, -1]].tolist()
    period = 2 * half_period
    window = slice(*np.searchsorted(time, (start - period, end + period)))
    time = time[window]
    values = values[window]
    rows = (time >= start) & (time <= end)
    # With times from the middle, offset, trend and phase are hardly correlated.
    middle = (start + end) / 2
    t = time[rows] - middle
    x = values[rows]
    if t.size < SAMPLES * (end - start) / period:
        return None

    omega = _refined_frequency(t, x, math.pi / half_period)
    bend = _phase_curvature(t, x, omega) * ((end - start) / 2) ** 2
    c = _factors(t, x, omega, 4)
    amplitude = math.hypot(c[2], c[3])
    deviation = np.abs(values - _waves(time - middle, omega, 4) @ c)
    noise = np.sqrt(np.mean(deviation[rows] ** 2))
    unexplained = BENT_UNEXPLAINED if bend > BENT else UNEXPLAINED
    if amplitude < LEAST_AMPLITUDE * np.ptp(values) or noise**2 > unexplained * (
        amplitude**2 / 2 + noise**2
    ):
        return None
    if bend > BENT:
        return Segment(
            start, float(crossings[-1]), "sweep", band=(omega, omega), amplitude=amplitude
        )

    off = time[deviation > max(FOLLOWS * amplitude, 4 * noise)]
    # The sine ends where the signal first leaves it, before and after the crossings.
    first = off[off < start].max(initial=time[0])
    last = off[off > end].min(initial=time[-1])
    run = Segment(float(first), float(last), omega=omega, amplitude=amplitude, offset=float(c[0]))
    # A second at least; with 0.1 to 10 s, the same sines are found.
    return run if run.duration >= 1 else None


def _refined_frequency(t: Array, x: Array, omega: float) -> float:
    """Return the frequency of a sine by Gauss-Newton steps, of a tenth at most."""
    # The derivative of a sin ωt + b cos ωt by ω is a t cos ωt - b t sin ωt.
    for _ in range(4):
        c = _factors(t, x, omega, 6)
        step = (c[2] * c[4] + c[3] * c[5]) / (c[2] ** 2 + c[3] ** 2 + 1e-300)
        omega += float(np.clip(step, -0.1 * omega, 0.1 * omega))
    return omega


def _phase_curvature(t: Array, x: Array, omega: float) -> float:
    """Return how strongly the phase bends away from that of one frequency, rad/s²."""
    c = _factors(t, x, omega, 8)
    return abs(c[2] * c[7] - c[3] * c[6]) / (c[2] ** 2 + c[3] ** 2 + 1e-300)


def _sweep(
    time: Array,
    values: Array,
    corners: IntArray,
    crossings: Array,
    swings: Array,
    run: tuple[int, int],
    piece: Segment,
) -> Segment | None:
    """Return the whole sweep of which a piece, with the crossings of a `run`, was found.

    The half wave in which a sweep leaves or reaches a rest is part of it.
    """
    step = median_step(time)

    def follows(k: int, way: int) -> bool:
        """Return whether a smooth change of frequency predicts the next crossing, one way."""
        # In half periods per second; the first is next to the predicted crossing.
        frequency = 1 / np.abs(np.diff(crossings[k - way * np.arange(KNOWN_PERIODS + 1)]))
        predicted = 1 / max(float(NEXT @ frequency), 0.5 * frequency[0])
        error = abs(abs(crossings[k + way] - crossings[k]) - predicted)
        # 1/2 on the way from a rest, whose middle is not that of the sweep.
        ratio = swings[k + way] / swings[k]
        return bool(error < OFF_SWEEP * predicted + step and SWING[0] < ratio < SWING[1])

    def end(k: int, way: int) -> int:
        while 0 <= k + way < crossings.size and follows(k, way):
            k += way
        return k

    first, last = end(run[0], -1), end(run[1] - 1, 1)
    if last - first < SWEEP_HALF_PERIODS:
        return None
    # The periods of noise in a narrow band wander both ways.
    parts = np.array_split(np.diff(crossings[first : last + 1]), SWEEP_PARTS)
    changes = np.diff([part.mean() for part in parts])
    if np.any(changes > 0) and np.any(changes < 0):
        return None
    begins = crossings[first : first + KNOWN_PERIODS + 1]
    ends = crossings[last - KNOWN_PERIODS : last + 1][::-1]
    slow, fast = sorted(map(_end_frequency, (begins, ends)), key=max)
    if max(fast) < SWEEP_RATIO * min(slow):
        return None
    start = _first_half_wave(time, values, corners[first : first + 2], begins)
    # In reversed time, the end is the start.
    backward = time.size - 1 - corners[last : last + 2][::-1]
    stop = -_first_half_wave(-time[::-1], values[::-1], backward, -ends)
    return replace(piece, start=start, end=stop, band=(min(slow), max(fast)))


def _end_frequency(crossings: Array) -> tuple[float, float]:
    """Return the frequency half a wave beyond the first of these crossings, and at it, rad/s."""
    frequency = math.pi / np.abs(np.diff(crossings))
    beyond = float(BEYOND @ frequency)
    return float(np.clip(beyond, 0.5 * frequency[0], frequency[0])), float(frequency[0])


def _first_half_wave(time: Array, values: Array, corners: IntArray, crossings: Array) -> float:
    """Return when the signal left the middle before its first turning point.

    The next half periods limit how long before the first of the `crossings` this may be. Otherwise
    it is this crossing.
    """
    peak = corners[0]
    middle = values[corners].mean()
    periods = np.diff(crossings)
    longest = (1 + OFF_SWEEP) * max(periods[0], periods[0] ** 2 / periods[1])
    from_ = np.searchsorted(time, crossings[0] - longest)
    beyond = np.flatnonzero((values[from_:peak] - middle) / (values[peak] - middle) <= FOLLOWS)
    return float(time[from_ + beyond[-1]]) if beyond.size else float(crossings[0])


def _part_of(sine: Segment, sweep: Segment) -> bool:
    """Return whether a "sine" is the slow start or the end of a sweep: short, and next to it.

    Short is a sine of up to four periods, or one that lasts up to 15 % of the sweep at one of its
    frequencies (within a factor of 1.5). A very short end of a sweep may be far from its last
    piece.
    """
    reach = 0.3 * sweep.duration if sine.duration < 0.05 * sweep.duration else 2 * sine.duration
    near = max(sweep.start - sine.end, sine.start - sweep.end) < reach
    within = sweep.band[0] / 1.5 < sine.omega < sweep.band[1] * 1.5
    short = (within and sine.duration < 0.15 * sweep.duration) or sine.periods < 4
    return sine.kind == "sine" and near and short


def _factors(t: Array, x: Array, omega: float, columns: int) -> Array:
    """Return the factors on these waves whose sum is closest to x (n,)."""
    return np.linalg.lstsq(_waves(t, omega, columns), x)[0]


def _waves(x: Array, omega: float, columns: int) -> Array:
    """Return the columns 1, x, sin, cos, x cos, -x sin, x² sin, x² cos, as many as asked for."""
    s = np.sin(omega * x)
    c = np.cos(omega * x)
    return np.stack(
        [np.ones_like(x), x, s, c, x * c, -x * s, x * x * s, x * x * c][:columns], axis=-1
    )
