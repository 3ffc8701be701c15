"""One lock for derivatives and solvers of CasADi; properties whose value is built when needed.

CasADi 3.8.2 frees a sparsity pattern twice if two threads use it at once, and the process crashes.
Only derivatives, solvers and mapped functions make such patterns, or free them. Evaluation of
functions is safe, as long as every thread has its own.
"""

import functools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
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


_traced: ContextVar[dict[Any, Any]] = ContextVar("traced")


@contextmanager
def traced_once() -> Iterator[None]:
    """Store the results of functions `once` until the end: all responses of a model share them.

    They are not stored longer, because a model is the user's object, which may change.
    """
    outer = _traced.set(_traced.get({}))
    try:
        yield
    finally:
        with LOCK:
            _traced.reset(outer)


unchanged_in: ContextVar[str] = ContextVar("unchanged_in", default="")
"""The study that is running: the user's models do not change until it ends."""


@contextmanager
def unchanged(study: str = "") -> Iterator[None]:
    """Let equal models of a study, by default a new one, share what is traced, until the end."""
    outer = unchanged_in.set(study or str(time.time_ns()))
    try:
        yield
    finally:
        unchanged_in.reset(outer)


def once(function: Callable[..., Result]) -> Callable[..., Result]:
    """Run a function of a model, one thread at a time, once within `traced_once`."""

    @functools.wraps(function)
    def result(model: Any, *args: Any, **kwargs: Any) -> Result:
        with LOCK:
            # By identity, since a model that is a dataclass has no hash. The model is stored too,
            # so that no other one gets its number meanwhile.
            results = _traced.get({})
            key = (function, id(model), repr((args, kwargs)))
            if key not in results:
                results[key] = model, function(model, *args, **kwargs)
            return results[key][1]

    return result


class cached_property(functools.cached_property[Result]):  # noqa: N801
    """A property whose value is built once, without the lock that Python 3.11 holds meanwhile.

    Two threads that take that lock and the one above in opposite order would wait forever.
    """

    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Any:
        """Return the value, stored in the instance, where Python finds it next time."""
        if instance is None:
            return self
        value = self.func(instance)
        instance.__dict__[self.attrname] = value
        return value
