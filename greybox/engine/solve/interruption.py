"""The early end of a search: by a time limit, or by Ctrl-C as soon as work can end in order.

SIGTERM, which batch systems, containers and systemd send before they kill, is obeyed like Ctrl-C.

The clock of the limit is the time of day, not that of the process: workers are told when a search
ends.

An exception that a signal handler raises is swallowed by CasADi while IPOPT evaluates a function:
that run counts as failed and the search goes on; in a root finder it becomes a RuntimeError.
Solvers therefore ask `stop_requested` at every iteration, and end the current run.

Only the main thread receives signals, and only Python's own handlers are replaced: a program with
a handler of its own keeps it. In other threads nothing here has an effect.
"""

import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum, auto
from types import FrameType
from typing import Any

from greybox.engine.solve.runs import INTERRUPTED, SEARCH_OVER


class Response(Enum):
    """The response to Ctrl-C."""

    RAISE = auto()  # KeyboardInterrupt at once
    STOP = auto()  # noted; solvers see it and end
    FINISH = auto()  # noted; the current work is finished


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a fit, a bootstrap or a batch.

    Attributes
    ----------
    fit, samples, study : Fit, Bootstrap, Study or None
        The best fit so far, the replicates so far, the members that were fitted.
    """

    fit: Any = None
    samples: Any = None
    study: Any = None

    def __init__(self, message: str, **done: Any) -> None:
        super().__init__(message)
        vars(self).update(done)


# The signals that end a program in order, with Python's own handlers of them.
ENDING = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}

# A shorter time limit leaves this time to build a model, s: whether a small model has an answer
# must not depend on how busy the machine is; idle, it is built within half a second.
BUILDING = 5.0

# Seconds within which a second signal is the same Ctrl-C: the terminal sends it to all processes,
# and programs such as timeout(1) forward it.
ECHO = 0.5


def end_after(seconds: float | None) -> float:
    """Return the time of day at which a search that begins now ends, s since 1970.

    None is no limit.

    Raises
    ------
    ValueError
        If the limit is not a number above 0.
    """
    if seconds is not None and not (isinstance(seconds, int | float) and seconds > 0):
        raise ValueError(f"seconds={seconds!r:.40} must be a number of seconds above 0, or None.")
    return time.time() + (seconds or math.inf)


class _State(threading.local):
    search_end = math.inf  # s since 1970
    listening = False
    noted = False
    noted_at = -math.inf  # s, on the monotonic clock
    number = int(signal.SIGINT)
    response = Response.RAISE


_state = _State()


def search_end() -> float:
    """Return the time of day at which the current search ends, s since 1970."""
    return _state.search_end


@contextmanager
def limited(end: float) -> Iterator[None]:
    """End the searches inside `with` at this time, s since 1970, or at an earlier limit."""
    previous = _state.search_end
    _state.search_end = min(previous, end)
    try:
        yield
    finally:
        _state.search_end = previous


@contextmanager
def building() -> Iterator[None]:
    """Raise TimeoutError within when the time of the search is up.

    A user's formulas do not ask for the time. Only the main thread of a process can be interrupted
    in them, and not on Windows.
    """
    remaining = _state.search_end - time.time()
    is_main = threading.current_thread() is threading.main_thread()
    if math.isinf(remaining) or not is_main or not hasattr(signal, "setitimer"):
        yield
        return
    previous = signal.signal(signal.SIGALRM, _stop_building)
    signal.setitimer(signal.ITIMER_REAL, max(remaining, BUILDING))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def _stop_building(*_: object) -> None:
    raise TimeoutError(
        "the time limit ended while the model was being built: give more time or a simpler model."
    )


def is_search_over() -> bool:
    """Return whether the time of the search is up."""
    return time.time() >= _state.search_end


def stop_requested() -> bool:
    """Return whether the search must end, because Ctrl-C was pressed or its time is up."""
    return bool(reason_to_end())


def interrupt_noted() -> bool:
    """Return whether the search must end because Ctrl-C was pressed."""
    return _state.noted and _state.response is Response.STOP


def reason_to_end() -> str:
    """Return the status with which the current run must end; empty if it may continue."""
    if interrupt_noted():
        return INTERRUPTED
    is_over = _state.response is not Response.FINISH and is_search_over()
    return SEARCH_OVER if is_over else ""


def take_interrupt() -> bool:
    """Return whether Ctrl-C was pressed since listening began or since the last call."""
    noted, _state.noted = _state.noted, False
    return noted


def raise_interrupt(cause: BaseException | None = None) -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed since listening began, and nobody took it.

    To be called where an error is caught: the error may be what a library made of Ctrl-C.
    """
    if _state.noted:
        raise KeyboardInterrupt from cause


def ended_status() -> int:
    """Return the exit status of a program that the last of these signals ended, as in a shell."""
    return 128 + _state.number


@contextmanager
def listening() -> Iterator[None]:
    """Remember a Ctrl-C during the block instead of raising KeyboardInterrupt at once.

    An error after it is raised as a KeyboardInterrupt, with the error as cause. A second Ctrl-C
    raises KeyboardInterrupt in any case.
    """
    # The handler of another program is left alone, and so are other threads.
    usual = {
        number: handler for number, handler in ENDING.items() if signal.getsignal(number) == handler
    }
    in_main_thread = threading.current_thread() is threading.main_thread()
    if _state.listening or not in_main_thread or not usual:
        yield
        return
    try:
        _state.listening = True
        _state.noted, _state.noted_at, _state.number = False, -math.inf, signal.SIGINT
        for number in usual:
            signal.signal(number, _note)
        yield
    except Exception as error:
        # CasADi turns an interrupt into errors of other classes.
        raise_interrupt(error)
        raise
    finally:
        with responding(Response.FINISH):  # what comes now must not leave a handler behind
            for number, handler in usual.items():
                signal.signal(number, handler)
            _state.listening = _state.noted = False


@contextmanager
def one_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt for a Ctrl-C in the block that nobody took, whatever became of it."""
    try:
        yield
    except Exception as error:
        raise_interrupt(error)
        raise
    raise_interrupt()


@contextmanager
def responding(response: Response) -> Iterator[None]:
    """Set the response to Ctrl-C for the block."""
    previous = _state.response
    _state.response = response
    try:
        yield
    finally:
        _state.response = previous


def _note(number: int, _frame: FrameType | None) -> None:
    now = time.monotonic()
    _state.number = number
    # Raised again, it would end the storage of the results.
    if now - _state.noted_at <= ECHO:
        return

    # A second Ctrl-C must end the program even if a solver does not look.
    again = _state.noted
    if not again:
        _state.noted, _state.noted_at = True, now
    if again or _state.response is Response.RAISE:
        raise KeyboardInterrupt
