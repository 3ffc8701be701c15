"""Formulas of a model, traced once as long as the model does not change."""

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from greybox.modeling.one_thread import LOCK

Result = TypeVar("Result")

_traced: ContextVar[dict[Any, Any]] = ContextVar("traced")

# The study that is running: the user's models do not change until it ends.
unchanged_in: ContextVar[str] = ContextVar("unchanged_in", default="")


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
