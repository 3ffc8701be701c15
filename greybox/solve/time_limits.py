"""Time limits of a search and of each of its runs.

The clock is the time of day, not that of the process: the end of a search is sent to workers.
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
        Limit for the runs from one start, s.
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
            If a limit is not a number above 0.
        """
        for name, value in (("seconds", seconds), ("start_seconds", start_seconds)):
            if value is not None and not (isinstance(value, int | float) and value > 0):
                raise ValueError(
                    f"{name}={value!r:.40} must be a number of seconds above 0, or None for no limit."
                )
        return cls(start_seconds or math.inf, time.time() + (seconds or math.inf))


class _State(threading.local):
    limits = TimeLimits()
    run_ends = math.inf


_state = _State()


def current_limits() -> TimeLimits:
    """Return the limits of the current search."""
    return _state.limits


@contextmanager
def limited(limits: TimeLimits) -> Iterator[None]:
    """Apply these limits within, in addition to those around them."""
    previous = _state.limits
    _state.limits = TimeLimits(min(previous.start, limits.start), min(previous.end, limits.end))
    try:
        yield
    finally:
        _state.limits = previous


@contextmanager
def one_run(spent: float = 0.0, starts: int = 1) -> Iterator[None]:
    """Apply the limit of a start within, or of several that run at once; `spent` seconds of it are over."""
    previous = _state.run_ends
    _state.run_ends = min(previous, time.time() + starts * _state.limits.start - spent)
    try:
        yield
    finally:
        _state.run_ends = previous


def is_search_over() -> bool:
    """Return whether the time of the search is up."""
    return time.time() >= _state.limits.end


def is_run_over() -> bool:
    """Return whether the time of the current run is up."""
    return time.time() >= _state.run_ends
