"""Public functions and classes: short signatures, and the closest name for an unknown argument."""

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, Signature, signature
from types import MappingProxyType
from typing import Any, TypeVar

from greybox.data.files.spelling import alternatives

LONGEST = 20  # characters of a default value that are shown

Public = TypeVar("Public", bound=Callable[..., Any])


def public(thing: Public) -> Public:
    """Return a function, or a class, that answers an unknown argument with the closest name.

    Its signature has no annotations where a person reads it, as in IPython and in the
    documentation: the docstring has the types, and type checkers read the source. Python 3.13
    suggests names of arguments itself.
    """
    if isinstance(thing, type):
        kind: Any = thing
        kind.__init__ = _public(thing.__init__, thing.__name__)
        return kind
    return _public(thing, thing.__name__)


def _public(function: Any, label: str) -> Any:
    described = signature(function)
    parameters = described.parameters.values()
    takes_any = any(p.kind is Parameter.VAR_KEYWORD for p in parameters)
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    names = [name for name in names if name != "self"]
    known = frozenset(names)

    @wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        for name in () if takes_any else kwargs.keys() - known:
            raise TypeError(f"{label} has no argument {name!r}; it has {alternatives(name, names)}")
        return function(*args, **kwargs)

    shown = [p.replace(annotation=p.empty, default=_short(p.default)) for p in parameters]
    checked.__signature__ = Signature(shown)  # type: ignore[attr-defined]
    return checked


class _Dots:
    """In place of a default value that is longer than a person reads."""

    def __repr__(self) -> str:
        return "..."


def _short(default: Any) -> Any:
    if default is Parameter.empty:
        return default
    if isinstance(default, MappingProxyType):
        default = dict(default)
    return default if len(repr(default)) <= LONGEST else _Dots()
