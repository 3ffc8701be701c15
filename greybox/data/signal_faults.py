"""What a logger does to a signal: repeats, interpolates, clips, freezes or mixes its samples.

Begin with `signal_faults`. A fault changes what every estimate makes of the signal, and leaves no
trace in a coherence: a signal that is held or interpolated between fewer samples is smooth, and
late. So each of them is looked for in the samples, once, and every use of a record says it.

Right signals have a similar look: steps, 3-2-1-1 and binary sequences rest and jump, an encoder
counts, an actuator is at its limit, a vehicle stands. `benchmarks/damaged_records.py` counts
how often one of them is accused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greybox.data.clock_jump import clock_jump
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.numbers_in_text import number, percent
from greybox.data.files.wording import counted
from greybox.data.record import Record
from greybox.data.saturation import at_limit
from greybox.data.sweep_jump import sweep_jump

# Fewer samples show no pattern.
FEWEST = 100
# Different values of a signal that is not made of steps.
LEVELS = 20
# Samples between those of the slower clock, at most.
LONGEST = 25
# Share of the changes that keep to one slower clock.
REGULAR = 0.9
# Bent rows at a corner of lines, up to which the corners count as samples in rows of their own.
ON_ROWS = 1.2
# Share of the range of a signal below which values are equal.
ROUNDING = 1e-9
# Share of the time at a limit below which a clipped signal is hardly wrong.
SHORT_CLIP = 0.005
# The share of a clipped signal above which too little is left of it without its tops.
LONG_CLIP = 0.2
# Single samples: how far they lie from the line through their neighbors, in deviations of all such
# distances and in deviations of the signal, and their share of the samples, at most.
FAR, FAR_IN_SIGNAL, RARE = 20.0, 0.5, 0.01


@dataclass(frozen=True, eq=False)
class SignalFault:
    """One fault of one signal.

    Attributes
    ----------
    signal : str
    kind : str
        "held", "interpolated", "clipped", "frozen", "far off", "alternating", "later" or
        "reversed".
    seen : str
        What is seen, as a sentence without its full stop.
    cure : str
        What to do, as a sentence.
    rows : (n,) int array
        The rows of the record that are no measurements. The others are right without them; if it
        is empty, none are.
    """

    signal: str
    kind: str
    seen: str
    cure: str
    rows: IntArray

    def __str__(self) -> str:
        return f"{self.seen}. {self.cure}"


Faults = Iterator[SignalFault]
NONE = np.empty(0, dtype=int)


@dataclass(frozen=True, eq=False)
class Signal:
    """The measured samples of a signal, beside the other signals of its record.

    Attributes
    ----------
    name : str
    values : (n,) array
    rows : (n,) int array
        The rows of the record in which it was measured.
    others : sequence of arrays
        The other signals in all rows of the record.
    """

    name: str
    values: Array
    rows: IntArray
    others: Sequence[Array]

    @cached_property
    def resolution(self) -> float:
        """The smallest difference of two different values."""
        steps = np.diff(self._levels)
        return float(steps.min()) if steps.size else 0.0

    @property
    def is_made_of_steps(self) -> bool:
        """Whether the signal has few levels, as a 3-2-1-1 or a binary sequence."""
        return self._levels.size < LEVELS

    @cached_property
    def _levels(self) -> Array:
        return np.unique(self.values)

    @cached_property
    def off_neighbors(self) -> Array:
        """How far each sample (n - 2,) lies from the middle of its two neighbors."""
        return self.values[1:-1] - (self.values[2:] + self.values[:-2]) / 2


def signal_faults(
    name: str,
    values: Array,
    others: Sequence[Array],
    *,
    is_command: bool = False,
    hold: float = np.inf,
) -> tuple[SignalFault, ...]:
    """Return the faults of a signal, at most one of them: others would only be its look.

    Parameters
    ----------
    name : str
    values : (n,) array
        The signal; NaN where it was not measured.
    others : sequence of (n,) arrays
        The other signals of the same rows.
    is_command : bool
        Whether the signal is an input, which may be held, at its limit, or at rest.
    hold : float, s
        For how long a value of a command lasted; 0 states that it is not held.
    """
    rows = np.flatnonzero(np.isfinite(values))
    values = values[rows]
    if values.size < FEWEST or not np.ptp(values) > 0:
        return ()
    # A change of units or of the time base leaves rounding errors in samples that were equal.
    unit = ROUNDING * float(np.ptp(values))
    signal = Signal(name, np.rint(values / unit) * unit, rows, others)

    looks = [_interpolated, _far_off, _alternating]
    if not is_command:
        looks = [_held, _clipped, _frozen, *looks]
    elif hold == 0:
        looks = [_held, *looks]
    for look in looks:
        for fault in look(signal):
            return (replace(fault, rows=rows[fault.rows]),)
    return ()


def record_faults(
    record: Record, outputs: Sequence[str], commands: Sequence[str] = ()
) -> tuple[SignalFault, ...]:
    """Return the faults of some signals of a record: outputs, and commands as inputs are."""
    if not record.has_time:
        return ()
    faults: list[SignalFault] = []
    for name in (*outputs, *commands):
        faults += signal_faults(
            name,
            record[name],
            [record[other] for other in record.signals if other != name],
            is_command=name not in outputs,
            hold=record.hold.get(name, np.inf),
        )
    # With several inputs, an output follows now one of them and now another.
    if len(commands) == 1 and not faults:
        for output in outputs:
            faults += _jumped(record, commands[0], output)
    return tuple(faults)


def _jumped(record: Record, command: str, output: str) -> Iterator[SignalFault]:
    """Look for a clock, or a sign, that changes in mid-record."""
    u, y = record[command], record[output]
    measured = np.flatnonzero(np.isfinite(u) & np.isfinite(y))
    jump = clock_jump(u[measured], y[measured]) or sweep_jump(u[measured], y[measured])
    if jump is None:
        return
    begin = number(float(record.time[measured[jump.row]]), 4)
    later = jump.later * record.step
    kind, what, cause = "reversed", "has the other sign", "its sign was changed"
    if jump.sign > 0:
        kind, cause = "later", "a clock jumped, rows of one signal were lost, or the plant changed"
        what = f"is {number(abs(later), 3)} s {'later' if later > 0 else 'earlier'}"
    yield SignalFault(
        output,
        kind,
        f"{output} {what} from about {begin} s on than before, against {command}: {cause}",
        "Use one side of it: record.between(START, END), or split the file there.",
        NONE,
    )


def _slower_clock(places: IntArray) -> int:
    """Return the number of rows between places that keep to one slower clock; zero if none do."""
    if places.size < LEVELS:
        return 0
    steps = np.diff(places)
    period = int(np.median(steps))
    if not 2 <= period <= LONGEST:
        return 0
    # A clock that is no multiple of the rows jumps by a row now and then; a missed change is a
    # multiple.
    multiples = np.maximum(np.rint(steps / period), 1)
    is_regular = np.abs(steps - multiples * period) <= np.where(multiples > 1, 1, period > 2)
    return period if np.mean(is_regular) > REGULAR else 0


def _held(signal: Signal) -> Faults:
    """Look for samples of a slower logger that are repeated until the next one."""
    changes = np.flatnonzero(np.diff(signal.values))
    period = _slower_clock(changes)
    if not period or signal.is_made_of_steps:
        return
    # A count of an encoder repeats, too, and changes by one or two counts.
    steps = np.abs(np.diff(signal.values)[changes])
    if np.unique(np.rint(steps / steps.min())).size < 5:
        return
    # When the slower log took its samples is not known.
    yield SignalFault(
        signal.name,
        "held",
        f"{signal.name} changes only in every {_ordinal(period)} row: a slower log was repeated, "
        "which delays it by half its interval on average",
        "Give NaN in the rows between.",
        NONE,
    )


def _interpolated(signal: Signal) -> Faults:
    """Look for straight lines between the samples of a slower logger."""
    values = signal.values
    bends = np.abs(np.diff(values, 2))
    # Lines of numbers with few digits bend by their rounding.
    rounding = max(ROUNDING * float(np.ptp(values)), 2.01 * signal.resolution)
    straight = bends <= rounding
    # Where corners are hardly larger, a rounded curve looks like lines.
    if straight.all() or np.median(bends[~straight]) < 10 * rounding:
        return
    # The corner of a line that lies between two rows bends both of them.
    bent = np.flatnonzero(~straight)
    corners = bent[np.diff(bent, prepend=-2) > 1]
    width = bent.size / corners.size
    period = _slower_clock(corners)
    is_lines = width <= 2 and np.mean(straight) > 0.8 * (1 - width / max(period, 1))
    moves = np.mean(np.diff(values) != 0) > 0.5
    slopes = np.unique(np.diff(values)[corners])
    if not (period and is_lines and moves and slopes.size >= LEVELS):
        return

    between = np.setdiff1d(np.arange(values.size), bent + 1)
    is_on_rows = width < ON_ROWS
    yield SignalFault(
        signal.name,
        "interpolated",
        f"{signal.name} runs in straight lines from every {_ordinal(period)} row to the next: "
        "a slower log was interpolated, which takes off its fast part",
        "Give NaN in the rows between." if is_on_rows else "Take the samples of that log.",
        between if is_on_rows else NONE,
    )


def _clipped(signal: Signal) -> Faults:
    """Look for a flat top of a signal that elsewhere never rests."""
    values = signal.values
    is_flat = at_limit(values)
    elsewhere = np.diff(values[~is_flat])
    begins = np.flatnonzero(np.diff(is_flat.astype(int)) > 0)
    # A rounded top is entered slowly.
    slopes = np.abs(values[begins] - values[np.maximum(begins - 1, 0)])
    is_entered_fast = begins.size > 0 and np.median(slopes) > 4 * signal.resolution
    share = float(np.mean(is_flat))
    if share > SHORT_CLIP and is_entered_fast and np.mean(elsewhere == 0) < 1 - REGULAR:
        yield SignalFault(
            signal.name,
            "clipped",
            f"{signal.name} rests at {number(np.abs(values[is_flat]).max(), 3)} for "
            f"{percent(share)} % of the time and nowhere else: its sensor or log "
            "was clipped there",
            "Make these samples NaN.",
            np.flatnonzero(is_flat) if share < LONG_CLIP else NONE,
        )


def _frozen(signal: Signal) -> Faults:
    """Look for a long rest of a signal that elsewhere never rests, while others move."""
    values = signal.values
    changes = np.flatnonzero(np.diff(values))
    rests = np.diff(np.r_[0, changes, values.size - 1])
    longest = int(rests.max())
    usual = float(np.quantile(rests, REGULAR))
    if longest < max(20, 10 * usual) or usual > 2:
        return
    begin = int(np.r_[0, changes][np.argmax(rests)])
    end = begin + longest
    meanwhile = signal.rows[begin + 1 : end]
    # A rounded signal that turns slowly rests, too, but does not jump when it moves again.
    steps = np.abs(np.diff(values))
    jump = steps[end] if end < steps.size else np.inf
    is_jump = jump > 4 * (np.median(steps) + signal.resolution)
    is_long = longest > max(100, 50 * usual)
    moves = (np.mean(np.diff(other[meanwhile]) != 0) > REGULAR for other in signal.others)
    if (is_jump or is_long) and any(moves):
        yield SignalFault(
            signal.name,
            "frozen",
            f"{signal.name} has one value in {counted(longest, 'row')} from row "
            f"{signal.rows[begin] + 1} on, while others move: its log stood still",
            "Make these samples NaN.",
            np.arange(begin + 1, end + 1),
        )


def _far_off(signal: Signal) -> Faults:
    """Look for single samples that their neighbors contradict."""
    if signal.is_made_of_steps:
        return
    values, middle = signal.values, signal.off_neighbors
    usual = 1.4826 * float(np.median(np.abs(middle))) + signal.resolution
    is_far = np.abs(middle) > max(FAR * usual, FAR_IN_SIGNAL * float(np.std(values)))
    # A single sample bends the lines beside it by half as much the other way, a step by as much on
    # one side.
    beside = -np.r_[0.0, middle[:-1]], -np.r_[middle[1:], 0.0]
    both = [np.abs(bend / np.where(is_far, middle, 1.0) - 0.5) < 0.2 for bend in beside]
    places = np.flatnonzero(is_far & both[0] & both[1]) + 1
    if 0 < places.size <= RARE * values.size:
        first = places[0]
        before, far, after = (number(x, 3) for x in values[first - 1 : first + 2])
        yield SignalFault(
            signal.name,
            "far off",
            f"{signal.name} has {counted(places.size, 'sample')} far from both neighbors, the "
            f"first in row {signal.rows[first]}: {far} between {before} and {after}",
            "Make them NaN.",
            places,
        )


def _alternating(signal: Signal) -> Faults:
    """Look for the samples of two sensors in turn."""
    values, middle = signal.values, signal.off_neighbors
    turns = np.mean(middle[1:] * middle[:-1] < 0)
    apart = np.abs(np.mean(values[::2][: values.size // 2] - values[1::2]))
    pairs = np.std(values[2:] - values[:-2])
    if turns > 0.95 and apart > pairs:
        yield SignalFault(
            signal.name,
            "alternating",
            f"{signal.name} jumps by {number(apart, 3)} from row to row and back: two sensors "
            "were logged in turn",
            "Give each its own column.",
            NONE,
        )


def _ordinal(count: int) -> str:
    words = {2: "second", 3: "third", 4: "fourth", 5: "fifth"}
    return words.get(count, f"{count}th")
