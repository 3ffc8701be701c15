"""When samples are taken, what the data say about it, and how inputs move between samples."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Clock:
    """The true times of samples, and what the data show of them.

    Attributes
    ----------
    name : str
    time : (n,) array, s
        When the samples were taken.
    stamps : (n,) array, s
        The times in the data.
    rows : (k,) array of int
        The samples that the data hold.
    exact : bool
        Whether the data say all: `stamps` are `time`, and no row is lost.
    constant_input : bool
        Whether the input may not move, because long steps would be lost rows otherwise.
    """

    name: str
    time: np.ndarray
    stamps: np.ndarray
    rows: np.ndarray
    exact: bool = True
    constant_input: bool = False


def _exact(name: str, time: np.ndarray, constant_input: bool = False) -> Clock:
    """Return a clock whose data have all samples at their times."""
    return Clock(name, time, time, np.arange(time.size), True, constant_input)


def uniform(rng: np.random.Generator, step: float, count: int) -> Clock:
    """Samples at equal steps, from zero or from a late or negative origin."""
    origin = float(rng.choice([0.0, 0.0, 1e3, -50.0])) * step
    return _exact("uniform", origin + step * np.arange(count))


def jitter(rng: np.random.Generator, step: float, count: int) -> Clock:
    """Times that deviate from equal steps by up to three tenths of a step, and are known."""
    return _exact("jitter", step * (np.arange(count) + rng.uniform(-0.3, 0.3, count)))


def two_rates(rng: np.random.Generator, step: float, count: int) -> Clock:
    """A clock that turns to steps of two to four times the length, or to half of it."""
    first, factor = count // 2, float(rng.choice([0.5, 2.0, 3.0, 4.0]))
    steps = np.r_[np.full(first, step), np.full(count - first - 1, factor * step)]
    return _exact("two rates", np.r_[0.0, np.cumsum(steps)])


def schedule(rng: np.random.Generator, step: float, count: int) -> Clock:
    """Samples of a laboratory: whole steps of different lengths, under a constant input."""
    steps = step * rng.choice([1.0, 1.0, 1.0, 2.0, 3.0, 5.0], count - 1)
    return _exact("schedule", np.r_[0.0, np.cumsum(steps)], constant_input=True)


def growing(rng: np.random.Generator, step: float, count: int) -> Clock:
    """Steps that grow, as those of a decay that is followed over decades."""
    growth = float(rng.uniform(1.01, 1.03))
    return _exact("growing", np.cumsum(0.3 * step * growth ** np.arange(count)))


def rounded(rng: np.random.Generator, step: float, count: int) -> Clock:
    """A uniform clock whose stamps are rounded to a tick that is little shorter than its step."""
    time, tick = step * np.arange(count), step * float(rng.uniform(0.5, 1.0))
    stamps = np.round(time / tick) * tick
    rows = np.flatnonzero(np.r_[True, np.diff(stamps) > tick / 2])
    return Clock("rounded", time, stamps, rows, exact=False)


def single_precision(rng: np.random.Generator, step: float, count: int) -> Clock:
    """A uniform clock with a late origin, stored with seven digits."""
    time = step * np.arange(count)
    stamps = np.float64(np.float32(time + float(rng.uniform(1e3, 2e4)) * step))
    rows = np.flatnonzero(np.r_[True, np.diff(stamps) > 1e-3 * step])
    return Clock("single precision", time, stamps, rows, exact=False)


def lost_rows(rng: np.random.Generator, step: float, count: int) -> Clock:
    """A uniform clock that lost single rows, and one stretch of rows."""
    time = step * np.arange(count)
    lost = rng.choice(np.arange(1, count), count // int(rng.choice([10, 20, 40])), replace=False)
    first = int(rng.integers(count // 4, count // 2))
    stretch = np.arange(first, first + int(rng.integers(0, 12)))
    rows = np.setdiff1d(np.arange(count), [*lost, *stretch])
    return Clock("lost rows", time, time, rows, exact=False)


CLOCKS: dict[str, Callable[[np.random.Generator, float, int], Clock]] = {
    "uniform": uniform,
    "jitter": jitter,
    "growing": growing,
    "two rates": two_rates,
    "schedule": schedule,
    "rounded": rounded,
    "single precision": single_precision,
    "lost rows": lost_rows,
}


@dataclass(frozen=True)
class Motion:
    """The inputs at the samples, and what they do between them.

    Attributes
    ----------
    values : (inputs, n) array
    held : bool
        True if a value lasts until the next sample; otherwise straight lines join the values.
    """

    values: np.ndarray
    held: bool

    def __str__(self) -> str:
        """Return how the inputs move."""
        return "held" if self.held else "linear"


def motion(
    rng: np.random.Generator,
    clock: Clock,
    inputs: int,
    *,
    resting: int = 0,
    held: bool | None = None,
) -> Motion:
    """Return random inputs at the times of a clock.

    Parameters
    ----------
    inputs : int
        How many.
    resting : int
        Samples at the beginning at which the inputs are zero.
    held : bool, optional
        A random choice by default.
    """
    held = bool(rng.random() < 0.5) if held is None else held
    count = clock.time.size
    if clock.constant_input:
        return Motion(np.outer(rng.uniform(0.5, 1.5, inputs), np.ones(count)), held)
    rows = []
    for _ in range(inputs):
        block = int(rng.integers(3, 10))
        levels = rng.uniform(-1.5, 1.5, count // block + 3)
        number = np.arange(count)
        row = (
            levels[number // block]
            if held
            else np.interp(number / block, np.arange(levels.size), levels)
        )
        if not held and rng.random() < 0.4:  # a sensor's noise, or a quick hand
            row = row + 0.3 * rng.standard_normal(count)
        row[:resting] = 0.0
        rows.append(row)
    return Motion(np.array(rows), held)
