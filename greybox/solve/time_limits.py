"""How long a search and each of its runs may take.

The clock is that of the day, not of the process: the end of a search is handed to workers
elsewhere.
"""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class TimeLimits:
    """The limits of one search.

    Attributes
    ----------
    start : float
        Of the runs from one start, s.
    end : float
        Time of day at which the search ends, s since 1970.
    """

    start: float = math.inf
    end: float = math.inf

    @classmethod
    def from_now(cls, seconds: float | None, start_seconds: float | None) -> "TimeLimits":
        """Return the limits of a search that begins now; None is no limit.

        Raises
        ------
        ValueError
            For what is no time.
        """
        for name, value in (("seconds", seconds), ("start_seconds", start_seconds)):
            if value is not None and not (isinstance(value, int | float) and value > 0):
                raise ValueError(
                    f"{name} is {value!r:.40}: give a number of seconds above 0, or None for no limit."
                )
        return cls(start_seconds or math.inf, time.time() + (seconds or math.inf))


class _State(threading.local):
    limits = TimeLimits()
    run_ends = math.inf


_state = _State()


def current_limits() -> TimeLimits:
    """Return the limits of the search at hand."""
    return _state.limits


@contextmanager
def limited(limits: TimeLimits) -> Iterator[None]:
    """Keep these limits within, and those that hold already."""
    before = _state.limits
    _state.limits = TimeLimits(min(before.start, limits.start), min(before.end, limits.end))
    try:
        yield
    finally:
        _state.limits = before


@contextmanager
def one_run(spent: float = 0.0, starts: int = 1) -> Iterator[None]:
    """Keep the limit of a start within, or of several that run at once; so many seconds of it are `spent`."""
    before = _state.run_ends
    _state.run_ends = min(before, time.time() + starts * _state.limits.start - spent)
    try:
        yield
    finally:
        _state.run_ends = before


def is_search_over() -> bool:
    """Tell whether the time of the search is up."""
    return time.time() >= _state.limits.end


def is_run_over() -> bool:
    """Tell whether the time of the run at hand is up."""
    return time.time() >= _state.run_ends
