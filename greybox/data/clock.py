"""The sampling clock of a record, and the long steps across which its inputs are known.

A time step that is much longer than its neighbors can mean two things. In a *schedule* no row is
missing: the input is known during the long step, and a model is simulated across it. Where *rows
are lost* the input is unknown, and a new stretch with its own initial states begins after the step.
These rules decide between the two:

1. A clock has no holes if all samples lie within a quarter of a step of uniform times. A change of
   the sampling rate makes no hole, and neither does the scatter of irregular times.
   Time stamps in coarse units make none, either: a uniform clock of 75 Hz in stamps of 10 ms has
   steps of 10 and 20 ms, and the uniform clock is used instead of its stamps. A clock that loses
   rows at equal intervals can have the same stamps. Then rows count as lost if the signals are
   smoother as functions of the stamps than as functions of uniform times.
2. A *hole* is a step that exceeds 1.5 times the usual step before it and 1.5 times the usual step
   after it. In an irregular clock, a hole is a step of more than three times each of its neighbors.
3. The inputs are known across a hole if every input meets one of two conditions. Either the input
   has the same value on both sides of the hole, and it never kept a value for so short a time in
   the rest of the record. Or linear interpolation across as many rows is accurate: where the rows
   are present and the input changes, its rms error is at most a tenth of the standard deviation of
   the input. A model without inputs needs none to be known.
4. Across every other hole, rows are lost. The field `Record.gaps` overrides these rules: "bridge"
   states that the inputs are known across every long step, "cut" that rows are lost in every step
   of more than 1.5 median steps.
"""

import math
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray, evenly_spread
from greybox.data.files.frozen_values import frozen
from greybox.data.files.wording import counted

Gaps = Literal["auto", "bridge", "cut"]

# Largest deviation of a sample from uniform times, in steps, at which no row counts as missing.
# Up to a quarter of a step, there is no doubt which uniform time belongs to a sample.
JITTER = 0.25

# Largest deviation from uniform times, in steps, at which the times themselves count as uniform:
# the time stamps of a log are not more precise.
EXACT = 1e-3

# A step is long beyond this number of usual steps: a normal step is 1, and a step across one lost
# row is 2.
LONG = 1.5

# A step of more usual steps than this lost two rows or more. Signals are interpolated across one
# lost row (a step of 2) when they are resampled.
ONE_LOST = 2.5

# The usual step near a long step is estimated from this number of steps on each side of it, and is
# unknown from fewer than FEWEST. Among ten steps, the second shortest is a step without a lost row
# even where half of the rows are lost.
NEIGHBORS = 10
FEWEST = 3

# In an irregular clock, a hole is longer than its longest neighbor by this factor. If steps are
# random (exponentially distributed), one step in 10 000 exceeds it.
LONG_IN_IRREGULAR = 3.0

# Stamps are coarse if their unit, the tick, is at least this share of their shortest step. Finer
# stamps deviate from a uniform clock by less than 0.1 steps, which JITTER tolerates.
COARSE = 0.19

# Coarse stamps have steps of two lengths. A block of stamps that is compared with a uniform clock
# has this number of steps of the rarer length. Stamps with fewer than FEWEST_RARER of them are not
# compared.
# In simulations, a uniform clock fitted at most 4 of 1000 schedules, or clocks that lost rows at
# random, by chance, and 96 % of the clocks of 75 Hz in stamps of 10 ms that lost 5 % of their rows.
RARER = 8
FEWEST_RARER = 4

# At most this number of blocks is compared in a long record, to limit the computing time.
BLOCKS = 2000

# Rows count as lost, rather than stamps as coarse, if a sign test rejects equal smoothness by more
# than this number of standard deviations.
CLEAR = 3.0

# An input is known across a hole if the rms error of linear interpolation there is at most this
# number of standard deviations of the input. Most models have larger errors.
KNOWN = 0.1

# At most this number of steps, or of interpolated samples, is examined in a long record. That is
# enough to estimate whether a tenth of the steps is irregular, and an rms error.
TRIALS = 20_000


@frozen
class Clock:
    """The sampling clock of a record: its usual step, its kind, and where rows may be missing.

    Attributes
    ----------
    step : float, s
        The usual step: the median step, or for coarse stamps the step of the uniform clock that was
        rounded. NaN for a record of one sample.
    kind : str
        "uniform", "rounded" (a uniform clock in coarse stamps), "regular" (most steps are whole
        multiples of the usual step), or "irregular".
    holes : (h,) int array
        Indices of the last rows before each hole, see the rules of this module.
    tick : float, s
        The unit of coarse stamps; zero for the other kinds.
    """

    step: float
    kind: Literal["uniform", "rounded", "regular", "irregular"]
    holes: IntArray
    tick: float = 0.0


def require_gaps(gaps: str) -> None:
    """Raise ValueError if `gaps` is not one of the options "auto", "bridge" and "cut"."""
    if gaps not in get_args(Gaps):
        raise ValueError(
            f"gaps is {gaps!r:.40}: use 'bridge' where the inputs are known across long steps, "
            "'cut' where rows are lost, or 'auto'."
        )


def median_step(values: Array) -> float:
    """Return the median difference of successive values (n,); NaN for a single value."""
    # np.median imports masked arrays, which takes a hundredth of a second.
    steps = np.sort(np.diff(values))
    if not steps.size:
        return math.nan
    return float((steps[(steps.size - 1) // 2] + steps[steps.size // 2]) / 2)


def off_uniform(time: Array) -> float:
    """Return the largest deviation of times (n,) from uniform times, in mean steps."""
    if time.size < 3:
        return 0.0
    # The mean step is more precise than the difference of two successive rounded times.
    step = (time[-1] - time[0]) / (time.size - 1)
    return float(np.abs(time - time[0] - step * np.arange(time.size)).max() / step)


def decimal_tick(time: Array) -> float:
    """Return the longest of the units 1, 0.1, ... 1e-6 s of which times (n,) are multiples.

    Zero if the times are finer than a microsecond.
    """
    for digits in range(7):
        ticks = time * 10.0**digits
        # The tolerance allows for rounding. Units below a microsecond are not tried: times in
        # seconds since 1970 have no such digits in floating point.
        if np.abs(ticks - np.round(ticks)).max() < 1e-3:
            return 10.0**-digits
    return 0.0


def clock_of(time: Array, signals: Sequence[Array] = ()) -> Clock:
    """Return the sampling clock of strictly increasing times (n,), s.

    The `signals`, arrays (n,) of samples of smooth signals at these times, help to distinguish lost
    rows from coarse time stamps, which can have the same times.
    """
    no_holes = np.zeros(0, dtype=int)
    median = median_step(time)
    deviation = off_uniform(time)
    if deviation <= EXACT:
        return Clock(median, "uniform", no_holes)

    steps = np.diff(time)
    step, tick = _rounded_step(steps)
    # A usual step of two ticks or more is no sign of lost rows: a clock of one tick would then have
    # lost most of its rows.
    if tick and not (step < LONG * tick and _smoother_on(time, signals, tick)):
        longest = max(steps.min() + 1.5 * tick, LONG * step)
        return Clock(step, "rounded", np.flatnonzero(steps > longest), tick)
    if deviation <= JITTER:
        return Clock(median, "uniform", no_holes)

    # More than a tenth of the steps must be no multiple of the usual step for an irregular clock.
    places = np.arange(steps.size)
    if np.mean(_off_whole(steps / median)) > 0.1:
        # In a record with two sampling rates, the median step belongs to one of them. Each step is
        # therefore compared with the steps around it.
        examined = evenly_spread(steps.size, TRIALS)
        before, after = _usual(steps, examined)
        usual = np.fmin(before, after)
        is_off = _off_whole(steps[examined] / np.where(np.isfinite(usual), usual, median))
        if np.mean(is_off) > 0.1:
            return Clock(median, "irregular", _long_in_irregular(steps))
    else:
        # Only steps that are longer than the lower quartile can be holes.
        lower_quartile = np.sort(steps)[steps.size // 4]
        places = np.flatnonzero(steps > LONG * lower_quartile)

    # A hole is long compared with both sides. The first and the last steps have one side only. The
    # other side is NaN, which np.fmax ignores.
    before, after = _usual(steps, places)
    usual = np.fmax(before, after)
    is_long = steps[places] > LONG * np.where(np.isfinite(usual), usual, np.inf)
    is_long &= _has_neighbors(steps, places, usual, before, after)
    return Clock(median, "regular", places[is_long])


def _off_whole(ratios: Array) -> BoolArray:
    """Return which steps (n,), in units of the usual step, are not close to 1, 2, 3, ..."""
    return np.abs(ratios - np.maximum(np.round(ratios), 1)) > JITTER


def _neighbors(steps: Array, places: IntArray) -> tuple[Array, Array]:
    """Return the ten steps before and the ten after each of the steps `places` (p,), (p, 10) each.

    Infinity stands for the steps beyond the ends of the record.
    """
    ends = np.full(NEIGHBORS, np.inf)
    padded = np.concatenate([ends, steps, ends])
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBORS)
    return windows[places], windows[places + NEIGHBORS + 1]


def _usual(steps: Array, places: IntArray) -> tuple[Array, Array]:
    """Return the usual step before and after each of the steps `places` (p,), two arrays (p,).

    NaN where fewer than three steps are available.
    """
    usual = []
    for sides in _neighbors(steps, places):
        ordered = np.sort(sides, axis=1)
        # The usual step is the mean of the steps that lost no row. The second shortest step alone
        # would be too short where times jitter. The margin of 1e-6 includes three ticks where the
        # second shortest step has two.
        single = ordered <= (LONG + 1e-6) * ordered[:, 1:2]
        single &= np.isfinite(ordered)
        mean = np.where(single, ordered, 0.0).sum(axis=1) / np.maximum(single.sum(axis=1), 1)
        usual.append(np.where(np.isfinite(ordered[:, FEWEST - 1]), mean, np.nan))
    return usual[0], usual[1]


def _has_neighbors(
    steps: Array, places: IntArray, usual: Array, before: Array, after: Array
) -> BoolArray:
    """Return at which of the steps `places` (p,) enough neighbors show the usual step.

    The usual step must be known `before` and `after`, each (p,), or none of the ten steps on the
    other side may be long.
    """
    steps_before, steps_after = _neighbors(steps, places)
    longest_usual = LONG * usual[:, None]
    none_long_before = np.all(steps_before <= longest_usual, axis=1)
    none_long_after = np.all(steps_after <= longest_usual, axis=1)
    return (np.isfinite(before) | none_long_after) & (np.isfinite(after) | none_long_before)


def _long_in_irregular(steps: Array) -> IntArray:
    """Return the indices of the steps that are much longer than all ten steps on each side."""
    next_longer = np.maximum(steps[:-2], steps[2:])
    places = np.flatnonzero(steps[1:-1] > LONG_IN_IRREGULAR * next_longer) + 1
    longest = np.max([sides.max(axis=1) for sides in _neighbors(steps, places)], axis=0)
    return places[steps[places] > LONG_IN_IRREGULAR * longest]


def _rounded_step(steps: Array) -> tuple[float, float]:
    """Return the step of a uniform clock in coarse stamps and the tick of the stamps, s.

    Both are zero if the steps (n,) are not those of such a clock.

    The rounded stamps of a uniform clock have steps of two lengths, neighboring multiples of a tick
    such as one and two ticks. The two lengths alternate so that a straight line passes within half
    a tick of every stamp. Where rows are lost at random, the two lengths alternate at random, and
    no line does. Lines are fitted to blocks of stamps, because a clock may drift and lose rows.
    """
    shortest = float(steps.min())
    longer = steps[steps > (1 + COARSE / 2) * shortest]
    tick = float(longer.min()) - shortest if longer.size else 0.0
    # The shortest step must have one to five ticks: 1 / COARSE = 5.3. Rounded stamps may make the
    # tick slightly longer than the shortest step, hence 1.1.
    if not COARSE <= tick / shortest < 1.1:
        return 0.0, 0.0
    ticks = np.round(steps / tick)
    within = steps < shortest + 1.5 * tick
    if np.any(np.abs(steps / tick - ticks)[within] > 0.05):
        return 0.0, 0.0
    two = within & (steps > shortest + tick / 2)
    one = within & ~two
    rarer = np.flatnonzero(two if np.count_nonzero(two) < np.count_nonzero(one) else one)
    size = min(RARER, rarer.size)
    if size < FEWEST_RARER:
        return 0.0, 0.0

    # A block has `size` successive steps of the rarer length. It extends to the next rarer step on
    # each side, or to a hole. `piece` is the index of the piece between holes in which a rarer step
    # lies. `rank` counts the rarer steps before it in that piece.
    ends = np.concatenate([[-1], np.flatnonzero(~within), [steps.size]])
    piece = np.searchsorted(ends, rarer)
    rank = np.arange(rarer.size) - np.searchsorted(piece, piece)
    firsts = np.flatnonzero(rank % size == 0)
    firsts = firsts[firsts + size <= rarer.size]
    firsts = firsts[piece[firsts] == piece[firsts + size - 1]]
    if not firsts.size:
        return 0.0, 0.0
    firsts = firsts[evenly_spread(firsts.size, BLOCKS)]
    around = np.concatenate([[-1], rarer, [steps.size]])
    begins = np.maximum(around[firsts] + 1, ends[piece[firsts] - 1] + 1)
    stops = np.minimum(around[firsts + size + 1], ends[piece[firsts]])

    # Only the stamps next to the rarer steps are examined: their distance from a line is largest. A
    # line passes within half a tick of all of them if some slope is compatible with every pair.
    rarer_in_block = rarer[firsts[:, None] + np.arange(size)]
    corners = np.concatenate(
        [begins[:, None], rarer_in_block, rarer_in_block + 1, stops[:, None]], axis=1
    )
    stamps = np.concatenate([[0.0], np.cumsum(ticks)])[corners]
    apart = corners[:, None, :] - corners[:, :, None]
    rise = stamps[:, None, :] - stamps[:, :, None]
    with np.errstate(divide="ignore"):
        # Two stamps deviate from a line by one tick together. A tenth more is for the digits of the
        # stamps.
        lowest = np.where(apart > 0, (rise - 1.1) / apart, -np.inf).max(axis=(1, 2))
        highest = np.where(apart > 0, (rise + 1.1) / apart, np.inf).min(axis=(1, 2))
    fits = lowest <= highest
    if 2 * np.count_nonzero(fits) <= fits.size:
        return 0.0, 0.0
    return float(steps[within].mean()), tick


def _smoother_on(time: Array, signals: Sequence[Array], tick: float) -> bool:
    """Return whether signals (n,) are clearly smoother at these times (n,) than at uniform times.

    If they are, rows are lost where a step has two ticks. Each sample between steps of different
    lengths is compared with a line between its two neighbors, and the sign test of the signal with
    the clearest result decides.
    """
    steps = np.diff(time)
    within = steps < 2.5 * tick
    unlike = np.abs(np.diff(steps)) > tick / 2
    places = np.flatnonzero(within[1:] & within[:-1] & unlike) + 1
    share = steps[places - 1] / (steps[places - 1] + steps[places])

    evidence = 0.0
    for values in signals:
        error_at_stamps = _off_lines(values, places, share)
        error_at_uniform = _off_lines(values, places, np.full_like(share, 0.5))
        # The errors at the two ends of a long step are correlated, so that pairs are tested.
        excess = np.add.reduceat(error_at_uniform - error_at_stamps, np.arange(0, places.size, 2))
        nonzero = excess[excess != 0]
        if nonzero.size:
            deviations = float(np.sign(nonzero).sum()) / math.sqrt(nonzero.size)
            evidence = max(evidence, deviations, key=abs)
    return evidence > CLEAR


def _off_lines(values: Array, places: IntArray, share: Array) -> Array:
    """Return the squared distances (p,) of values (n,) from lines between their two neighbors.

    A line is evaluated at the `share` (p,) of the way from the sample before to the sample after.
    The square is divided by the variance that white noise of unit variance would cause, and it is
    zero where a value is missing.
    """
    before = values[places - 1]
    after = values[places + 1]
    error = values[places] - (1 - share) * before - share * after
    return np.nan_to_num(np.square(error) / (1 + np.square(1 - share) + np.square(share)))


def runs_between_holes(time: Array, clock: Clock, longest: float = 0.0) -> list[IntArray]:
    """Return the indices of the times (n,) of each run between holes longer than `longest` s."""
    is_wide = time[clock.holes + 1] - time[clock.holes] > longest
    return np.split(np.arange(time.size), clock.holes[is_wide] + 1)


def lost_rows(time: Array, inputs: Array, clock: Clock, gaps: Gaps) -> IntArray:
    """Return the indices (c,) of the rows after which rows are lost, so that a new stretch begins.

    Parameters
    ----------
    time : (n,) array, s
    inputs : (m, n) array
        The inputs of the model; NaN where a sample is missing.
    clock : Clock
        The clock of `time`.
    gaps : "auto", "bridge" or "cut"
        See `Record.gaps`.
    """
    if gaps == "bridge":
        return np.zeros(0, dtype=int)
    if gaps == "cut":
        return np.flatnonzero(np.diff(time) > LONG * median_step(time))
    if not clock.holes.size or not len(inputs):
        return clock.holes[:0]

    known = np.all([_is_known(values, time, clock) for values in inputs], axis=0)
    return clock.holes[~known]


def described_gaps(time: Array, clock: Clock, cut: int, gaps: Gaps) -> str:
    """Return a sentence on the long steps of a record, of which `cut` begin a new stretch.

    Empty if there is nothing to say.
    """
    steps = np.diff(time)
    if gaps == "cut":
        places = counted(cut, "step")
        return f"cut at {places} longer than {LONG:g} median steps, as stated" if cut else ""
    if not clock.holes.size:
        if clock.kind == "uniform":
            return ""
        if clock.kind == "rounded":
            return (
                f"stamps of {1e3 * clock.tick:.4g} ms that round a clock of {1 / clock.step:.5g} "
                "Hz: the model runs on"
            )
        return f"steps of {steps.min():.4g} to {steps.max():.4g} s, in which no row is missing"

    longest = steps[clock.holes].max()
    found = f"rows are missing at {counted(clock.holes.size, 'place')}, for {longest:.4g} s at most"
    if gaps == "bridge":
        return f"{found}; inputs are known there, as stated"
    run_on = clock.holes.size - cut
    known = f"inputs are known at {run_on}, where the model runs on" if run_on else ""
    unknown = (
        f"inputs are unknown at {cut}, where a new stretch begins (gaps='bridge' if they are known)"
        if cut
        else ""
    )
    return "; ".join(filter(None, [found, known, unknown]))


def _is_known(values: Array, time: Array, clock: Clock) -> BoolArray:
    """Return across which holes (h,) of the clock the input `values` (n,) is known: rule 3."""
    holes = clock.holes
    before, after = values[holes], values[holes + 1]
    lengths = time[holes + 1] - time[holes]
    shortest = _shortest_hold(values, time, holes)
    # The margin of half a step keeps the rounding of times from deciding.
    known = (before == after) & (lengths < shortest - clock.step / 2)

    moves = ~known & np.isfinite(before) & np.isfinite(after)
    steps = np.diff(time)
    rows = np.maximum(np.round(lengths / clock.step), 2).astype(int)
    # Interpolation is tested where no step is long, that is where this count does not rise.
    whole = np.concatenate([[0], np.cumsum(steps > LONG * clock.step)])
    present = values[np.isfinite(values)]
    limit = KNOWN * np.std(present) if present.size else 0.0
    for count in np.unique(rows[moves]):
        is_accurate = _error_of_lines(values, whole, count) <= limit
        known[moves & (rows == count)] = is_accurate
    return known


def _shortest_hold(values: Array, time: Array, holes: IntArray) -> float:
    """Return the shortest time, s, for which a signal (n,) kept a value between two changes.

    If a change lies in a hole, the length of the hole is included. Infinity for fewer than two
    changes.
    """
    changes = np.flatnonzero(np.diff(values) != 0)
    if changes.size < 2:
        return math.inf
    # The time is from the last sample before the value to the first sample after it.
    return float(np.min(time[changes[1:] + 1] - time[changes[:-1]]))


def _error_of_lines(values: Array, whole: IntArray, count: int) -> float:
    """Return the rms error of linear interpolation of an input (n,) across `count` steps.

    The error is estimated where the input changes and no step is long, which means that `whole`
    (n,), the count of long steps up to each row, is constant. Infinity where that is nowhere.
    """
    firsts = np.arange(values.size - count)
    firsts = firsts[whole[count:] == whole[:-count]]
    firsts = firsts[values[firsts] != values[firsts + count]]
    if firsts.size > TRIALS // count + 1:
        firsts = firsts[:: firsts.size // (TRIALS // count + 1)]
    if firsts.size < FEWEST:
        return math.inf
    between = values[firsts[:, None] + np.arange(1, count)]
    share = np.arange(1, count) / count
    lines = values[firsts, None] + share * (values[firsts + count] - values[firsts])[:, None]
    error = np.sqrt(np.mean(np.square(between - lines)))
    return float(error) if np.isfinite(error) else math.inf
