"""What ends a search early: its time limit, or Ctrl-C, which is noted at once and obeyed where work can end in order.

An exception that a signal handler raises is swallowed by CasADi while IPOPT evaluates a function:
that run counts as failed and the search goes on; in a root finder it becomes a RuntimeError.
Solvers therefore ask `stop_requested` at every iteration, and end the current run.

Only the main thread receives signals, and only Python's own handler, which raises
KeyboardInterrupt, is replaced: a program with a handler of its own keeps it. In other threads
nothing here has an effect.
"""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum, auto
from types import FrameType

from greybox.solve.outcome import INTERRUPTED, RUN_OVER, SEARCH_OVER
from greybox.solve.time_limits import is_run_over, is_search_over


class Response(Enum):
    """The response to Ctrl-C."""

    RAISE = auto()  # KeyboardInterrupt at once
    STOP = auto()  # noted; solvers see it and end
    FINISH = auto()  # noted; the current work is finished


# Seconds within which a second signal is the same Ctrl-C: the terminal sends it to all processes, and
# programs such as timeout(1) forward it.
ECHO = 0.5


class _State(threading.local):
    listening = False
    noted = False
    noted_at = 0.0  # s, on the monotonic clock
    response = Response.RAISE


_state = _State()


def stop_requested() -> bool:
    """Return whether the search must end, because Ctrl-C was pressed or its time is up."""
    return interrupt_noted() or (_state.response is not Response.FINISH and is_search_over())


def interrupt_noted() -> bool:
    """Return whether the search must end because Ctrl-C was pressed."""
    return _state.noted and _state.response is Response.STOP


def reason_to_end() -> str:
    """Return the status with which the current run must end; empty if it may continue."""
    if interrupt_noted():
        return INTERRUPTED
    if _state.response is Response.FINISH:
        return ""
    return SEARCH_OVER if is_search_over() else RUN_OVER if is_run_over() else ""


def take_interrupt() -> bool:
    """Return whether Ctrl-C was pressed since listening began or since the last call."""
    noted, _state.noted = _state.noted, False
    return noted


@contextmanager
def listening() -> Iterator[None]:
    """Note Ctrl-C within; an error after one was caused by it, and becomes a KeyboardInterrupt.

    A second Ctrl-C raises KeyboardInterrupt in any case.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if (
        _state.listening
        or not in_main_thread
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    _state.listening = True
    _state.noted = False
    signal.signal(signal.SIGINT, _note)
    try:
        yield
    except Exception as error:
        if _state.noted:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _state.listening = False
        _state.noted = False


@contextmanager
def responding(response: Response) -> Iterator[None]:
    """Respond to Ctrl-C in this way within."""
    previous = _state.response
    _state.response = response
    try:
        yield
    finally:
        _state.response = previous


def _note(_number: int, _frame: FrameType | None) -> None:
    now = time.monotonic()
    again = _state.noted and now - _state.noted_at > ECHO
    if not _state.noted:
        _state.noted, _state.noted_at = True, now
    if again or _state.response is Response.RAISE:
        raise KeyboardInterrupt
