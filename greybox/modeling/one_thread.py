"""One lock for derivatives and solvers of CasADi, and results that every thread has by itself.

CasADi 3.8.2 frees a sparsity pattern twice if two threads use it at once, and the process crashes.
Only derivatives, solvers and mapped functions make such patterns, or free them. Evaluation of
functions is safe, as long as every thread has its own.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

LOCK = threading.RLock()


def one_thread_at_a_time(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let one thread at a time run any of the functions with this decorator."""

    @functools.wraps(function)
    def locked(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with LOCK:
            return function(*args, **kwargs)

    return locked


class Stored:
    """The last results by key, for every thread by itself.

    Two threads must not call one CasADi function at a time.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: dict[int, dict[Any, Any]] = {}

    def result(self, key: Any, build: Callable[[], Result]) -> Result:
        """Return the result of this key, built if it is not stored."""
        # The lock is also held where CasADi frees the oldest result. A thread that has ended leaves
        # its results to others, since freeing its own storage would not take the lock.
        with LOCK:
            results = self._results.setdefault(threading.get_ident(), {})
            result = results.pop(key) if key in results else build()
            results[key] = result
            if len(results) > self._most:
                del results[next(iter(results))]
            return result
