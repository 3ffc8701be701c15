"""Properties whose value is built when it is needed."""

import functools
from typing import Any, TypeVar

Result = TypeVar("Result")


class cached_property(functools.cached_property[Result]):  # noqa: N801
    """A property whose value is built once, without the lock that Python 3.11 holds meanwhile.

    Two threads that take that lock and the one of `one_thread` in opposite order would wait for
    ever.
    """

    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Any:
        """Return the value, stored in the instance, where Python finds it next time."""
        if instance is None:
            return self
        value = self.func(instance)
        instance.__dict__[self.attrname] = value
        return value
