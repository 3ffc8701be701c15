"""When a record was sampled, and across which long steps its inputs are known.

A step that is long against its neighbors has two meanings. In a *schedule* nothing is missing: the
input is known, and a model runs on. Where *rows are lost* the input is unknown, and a new stretch
begins, with initial states of its own. The rule is this:

1. A clock within a quarter of a step of a uniform one has no holes. Nor has a schedule, a change of
   rate, or an irregular clock; nor has a clock in coarse stamps, whose steps are two neighboring
   multiples of a tick where the clock itself is uniform: the uniform clock counts in their place.
   A clock that loses a row at equal intervals has the same stamps, of one and two ticks, and its
   signals are smoother on these.
2. A *hole* is a step of more than one and a half of the usual steps before it and of those after
   it. In an irregular clock, it is three times longer than any of its neighbors.
3. The input is known across a hole if there is no input; if it has the same value on both sides and
   no value of it lasted for so short a time elsewhere; or if a line across so many rows, tried
   where the rows are there and the input moves, is wrong by less than a tenth of its spread.
4. Elsewhere rows are lost. `Record.gaps` states otherwise: "bridge" that inputs are known
   throughout, "cut" that nothing is known across any step of more than one and a half median steps.
"""

import math
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray, evenly_spread
from greybox.data.files.frozen_values import frozen
from greybox.data.files.wording import counted

Gaps = Literal["auto", "bridge", "cut"]

# Share of a step by which samples may be off uniform ones. Up to a quarter, every sample is nearest
# to its own place.
JITTER = 0.25

# Share of a step by which samples may be off uniform ones and still count as uniform: steps of a
# log are not known more precisely.
EXACT = 1e-3

# In usual steps: halfway between a step and that across one lost row.
LONG = 1.5

# In usual steps: longer than across one lost row, over which signals are resampled.
ONE_LOST = 2.5

# Steps before and after a long one that show what is usual there, and the fewest of them. The
# second of ten by size is a single step even where half of the rows are lost.
NEIGHBORS = 10
FEWEST = 3

# Times the longest neighbor: of 10 000 random (exponential) steps, one is that long.
LONG_IN_IRREGULAR = 3.0

# Tick of coarse stamps in the shortest of their steps, at least: finer ones are off by 0.1 steps.
COARSE = 0.19
# The rarer ones of both steps in a block of stamps that is compared with a uniform clock, and the
# fewest that show one. Of 1000 schedules, or clocks that had lost rows at random, at most 4 fitted
# by chance; of clocks of 75 Hz in stamps of 10 ms that had lost 5 % of their rows, 96 % fitted.
RARER = 8
FEWEST_RARER = 4

# Blocks that are compared in a long record.
BLOCKS = 2000
# By how many standard deviations more than half of the long steps must speak for lost rows.
CLEAR = 3.0

# Error of a line across lost rows, in standard deviations of the input, up to which the input is
# known: less than the error of most models.
KNOWN = 0.1
# Steps and places that are tried in a long record: enough for a tenth, and for an error.
TRIALS = 20_000


@frozen
class Clock:
    """The steps of a record.

    Attributes
    ----------
    step : float, s
        The usual step: the median, or that of the clock which coarse stamps round; NaN for one
        sample.
    kind : str
        "uniform", "rounded" (a uniform clock in coarse stamps), "regular" (steps are mostly whole
        multiples of the usual one), or "irregular".
    holes : (h,) int array
        Rows after which rows are missing.
    tick : float, s
        The unit of coarse stamps; zero for other clocks.
    """

    step: float
    kind: Literal["uniform", "rounded", "regular", "irregular"]
    holes: IntArray
    tick: float = 0.0


def require_gaps(gaps: str) -> None:
    """Raise ValueError for anything but one of `Gaps`."""
    if gaps not in get_args(Gaps):
        raise ValueError(
            f"gaps is {gaps!r:.40}: use 'bridge' where the inputs are known across long steps, "
            "'cut' where rows are lost, or 'auto'."
        )


def median_step(values: Array) -> float:
    """Return the median step between values (n,); NaN for a single one."""
    # np.median imports masked arrays, which takes a hundredth of a second.
    steps = np.sort(np.diff(values))
    if not steps.size:
        return math.nan
    return float((steps[(steps.size - 1) // 2] + steps[steps.size // 2]) / 2)


def off_uniform(time: Array) -> float:
    """Return by how many mean steps times (n,) are off uniform ones at most."""
    if time.size < 3:
        return 0.0
    # The mean step has more digits than a difference of two rounded times.
    step = (time[-1] - time[0]) / (time.size - 1)
    return float(np.abs(time - time[0] - step * np.arange(time.size)).max() / step)


def decimal_tick(time: Array) -> float:
    """Return the unit of times (n,), the longest of 1, 0.1, ... 1e-6 s, or 0 for finer ones."""
    for digits in range(7):
        ticks = time * 10.0**digits
        # Of seconds since 1970, the digits behind the microseconds are rounded.
        if np.abs(ticks - np.round(ticks)).max() < 1e-3:
            return 10.0**-digits
    return 0.0


def clock_of(time: Array, signals: Sequence[Array] = ()) -> Clock:
    """Return the clock of times (n,), strictly increasing.

    Smooth signals (n,) that were sampled then tell lost rows from coarse stamps.
    """
    nothing = np.zeros(0, dtype=int)
    median = median_step(time)
    off = off_uniform(time)
    if off <= EXACT:
        return Clock(median, "uniform", nothing)

    steps = np.diff(time)
    step, tick = _rounded_step(steps)
    # A clock that loses most of its rows is none.
    if tick and not (step < LONG * tick and _smoother_on(time, signals, tick)):
        longest = max(steps.min() + 1.5 * tick, LONG * step)
        return Clock(step, "rounded", np.flatnonzero(steps > longest), tick)
    if off <= JITTER:
        return Clock(median, "uniform", nothing)

    places = np.arange(steps.size)
    if np.mean(_off_whole(steps / median)) > 0.1:
        # With two rates, the median is one of them: the steps around each are its measure.
        some = evenly_spread(steps.size, TRIALS)
        usual = np.fmin(*_usual(steps, some))
        off = _off_whole(steps[some] / np.where(np.isfinite(usual), usual, median))
        if np.mean(off) > 0.1:
            return Clock(median, "irregular", _long_in_irregular(steps))
    else:
        places = np.flatnonzero(steps > LONG * np.sort(steps)[steps.size // 4])

    # Long against both sides; at an end, there is only one.
    before, after = _usual(steps, places)
    here, usual = steps[places], np.fmax(before, after)
    is_long = here > LONG * np.where(np.isfinite(usual), usual, np.inf)
    is_long &= _has_neighbors(steps, places, usual, before, after)
    return Clock(median, "regular", places[is_long])


def _off_whole(parts: Array) -> BoolArray:
    """Return which steps (n,), in usual steps, are off whole numbers of them."""
    return np.abs(parts - np.maximum(np.round(parts), 1)) > JITTER


def _neighbors(steps: Array, places: IntArray) -> tuple[Array, Array]:
    """Return the ten steps before and after each of these places, (p, 10) each, or infinity."""
    ends = np.full(NEIGHBORS, np.inf)
    padded = np.concatenate([ends, steps, ends])
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBORS)
    return windows[places], windows[places + NEIGHBORS + 1]


def _usual(steps: Array, places: IntArray) -> tuple[Array, Array]:
    """Return the usual step before and after these places (p,); NaN for fewer than three steps."""
    usual = []
    for sides in _neighbors(steps, places):
        ordered = np.sort(sides, axis=1)
        # The mean of the single steps: the second alone would be short where times jitter.
        single = ordered <= (LONG + 1e-6) * ordered[:, 1:2]  # two and three ticks
        single &= np.isfinite(ordered)
        mean = np.where(single, ordered, 0.0).sum(axis=1) / np.maximum(single.sum(axis=1), 1)
        usual.append(np.where(np.isfinite(ordered[:, FEWEST - 1]), mean, np.nan))
    return usual[0], usual[1]


def _has_neighbors(
    steps: Array, places: IntArray, usual: Array, before: Array, after: Array
) -> BoolArray:
    """Return at which places (p,) both sides are known, or ten single steps on one side."""
    single = [np.all(s <= LONG * usual[:, None], axis=1) for s in _neighbors(steps, places)]
    return (np.isfinite(before) | single[1]) & (np.isfinite(after) | single[0])


def _long_in_irregular(steps: Array) -> IntArray:
    """Return the steps that are much longer than any neighbor, ten on each side."""
    next_longer = np.maximum(steps[:-2], steps[2:])
    places = np.flatnonzero(steps[1:-1] > LONG_IN_IRREGULAR * next_longer) + 1
    longest = np.max([sides.max(axis=1) for sides in _neighbors(steps, places)], axis=0)
    return places[steps[places] > LONG_IN_IRREGULAR * longest]


def _rounded_step(steps: Array) -> tuple[float, float]:
    """Return the step of a uniform clock in coarse stamps and their unit, or zeros for others.

    Where rows are lost at random, steps (n,) of one and two ticks follow one another at random. In
    the stamps of a uniform clock, two neighboring multiples of a tick alternate so that a straight
    line is within half a tick of every stamp. That is tried in blocks, because a clock may drift
    and lose rows.
    """
    shortest = float(steps.min())
    longer = steps[steps > (1 + COARSE / 2) * shortest]
    tick = float(longer.min()) - shortest if longer.size else 0.0
    # The shortest step is one tick to five.
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

    # A block has so many of the rarer steps in a row, and reaches to the next ones, or to a hole.
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

    # The stamps that are furthest off a line are next to the rarer steps.
    inside = rarer[firsts[:, None] + np.arange(size)]
    corners = np.concatenate([begins[:, None], inside, inside + 1, stops[:, None]], axis=1)
    stamps = np.concatenate([[0.0], np.cumsum(ticks)])[corners]
    apart = corners[:, None, :] - corners[:, :, None]
    rise = stamps[:, None, :] - stamps[:, :, None]
    with np.errstate(divide="ignore"):
        # A tenth for the digits of the stamps.
        lowest = np.where(apart > 0, (rise - 1.1) / apart, -np.inf).max(axis=(1, 2))
        highest = np.where(apart > 0, (rise + 1.1) / apart, np.inf).min(axis=(1, 2))
    fits = lowest <= highest
    if 2 * np.count_nonzero(fits) <= fits.size:
        return 0.0, 0.0
    return float(steps[within].mean()), tick


def _smoother_on(time: Array, signals: Sequence[Array], tick: float) -> bool:
    """Return whether signals (n,) are clearly smoother on these times (n,) than on uniform ones.

    Where steps are of one and two ticks, rows are lost then. Values beside unlike steps are
    compared, and the signal that says most decides.
    """
    steps = np.diff(time)
    within = steps < 2.5 * tick
    unlike = np.abs(np.diff(steps)) > tick / 2
    places = np.flatnonzero(within[1:] & within[:-1] & unlike) + 1
    share = steps[places - 1] / (steps[places - 1] + steps[places])

    evidence = 0.0
    for values in signals:
        uneven, uniform = (_off_lines(values, places, s) for s in (share, 0.5 + 0 * share))
        # Both ends of a long step have errors in common.
        excess = np.add.reduceat(uniform - uneven, np.arange(0, places.size, 2))
        told = excess[excess != 0]
        if told.size:
            deviations = float(np.sign(told).sum()) / math.sqrt(told.size)
            evidence = max(evidence, deviations, key=abs)
    return evidence > CLEAR


def _off_lines(values: Array, places: IntArray, share: Array) -> Array:
    """Return the squared errors (p,) of values (n,) from lines between their neighbors.

    Lines are evaluated at their `share` (p,). Unit: variance of white noise; zero if unknown.
    """
    before, here, after = (values[places + k] for k in (-1, 0, 1))
    error = here - (1 - share) * before - share * after
    return np.nan_to_num(np.square(error) / (1 + np.square(1 - share) + np.square(share)))


def runs_between_holes(time: Array, clock: Clock, longest: float = 0.0) -> list[IntArray]:
    """Return the places of every run of times (n,) between holes of more than `longest` s."""
    wide = time[clock.holes + 1] - time[clock.holes] > longest
    return np.split(np.arange(time.size), clock.holes[wide] + 1)


def lost_rows(time: Array, inputs: Array, clock: Clock, gaps: Gaps) -> IntArray:
    """Return the rows (c,) after which a new stretch begins: the input is unknown from there on.

    Parameters
    ----------
    time : (n,) array, s
    inputs : (m, n) array
        NaN where missing.
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
    """Return what the long steps are, in words, if a new stretch begins behind `cut` of them."""
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
    """Return across which holes (h,) of the clock an input (n,) is known."""
    holes = clock.holes
    before, after = values[holes], values[holes + 1]
    lengths = time[holes + 1] - time[holes]
    shortest = _shortest_hold(values, time, holes)
    # Half a step: rounding must not decide.
    known = (before == after) & (lengths < shortest - clock.step / 2)

    moves = ~known & np.isfinite(before) & np.isfinite(after)
    steps = np.diff(time)
    rows = np.maximum(np.round(lengths / clock.step), 2).astype(int)
    # A line is tried where no step is long.
    whole = np.concatenate([[0], np.cumsum(steps > LONG * clock.step)])
    present = values[np.isfinite(values)]
    limit = KNOWN * np.std(present) if present.size else 0.0
    for count in np.unique(rows[moves]):
        is_right = _error_of_lines(values, whole, count) <= limit
        known[moves & (rows == count)] = is_right
    return known


def _shortest_hold(values: Array, time: Array, holes: IntArray) -> float:
    """Return the shortest time, s, for which a value lasted between two others.

    Values that begin or end in a hole count for as long as they were seen, plus the hole.
    """
    changes = np.flatnonzero(np.diff(values) != 0)
    if changes.size < 2:
        return math.inf
    # From the last sample of the value before to the first of the next one.
    return float(np.min(time[changes[1:] + 1] - time[changes[:-1]]))


def _error_of_lines(values: Array, whole: IntArray, count: int) -> float:
    """Return the rms error of lines across so many steps where the input moves; inf if unknown."""
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
