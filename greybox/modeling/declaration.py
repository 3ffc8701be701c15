"""Checks of the declaration of a model, in the body of its class."""

from collections.abc import Callable, Iterable, Mapping
from types import CodeType
from typing import Any

from greybox.data.files.argument_checks import require_kind
from greybox.data.files.spelling import nearest
from greybox.modeling.formula_arguments import Names
from greybox.modeling.parameter import Parameter

DATA = str | tuple | list | Mapping  # kinds of declared values that are no functions

# Kinds of attributes of a model, and how a message asks for them.
KINDS: dict[Any, str] = {
    Callable: "a function",
    str: "a name",
    tuple | list: "a tuple of names",
    Mapping: "a dictionary",
}

_SMOOTH = (
    "split the record where states jump, and give the pieces as one problem, gb.several(model, "
    "pieces), which estimates the states at the beginning of each; a formula may switch with "
    "gb.where."
)
_BEGINNING = (
    "give initial={state: value} to the criterion or to gb.simulate; state_starts says where the "
    "search begins."
)
_NOISE = "give process_noise=[...] or noise=... to the criterion, such as gb.PredictionError."

# Attributes that a user may expect and that nothing reads, with what has their effect.
NO_EFFECT = {
    "algebraic": "write it into the formulas.",
    "delays": "multiply the response by gb.exp(-p.T * s).",
    "parameters": "declare each by its name, a1 = gb.Parameter(2.0).",
    **dict.fromkeys(("event", "events", "guards", "jumps", "resets"), _SMOOTH),
    **dict.fromkeys(("initial", "initial_state", "initial_states", "x0"), _BEGINNING),
    **dict.fromkeys(("noise", "process_noise", "measurement_noise"), _NOISE),
    **dict.fromkeys(
        ("bounds", "starts", "priors"), "give each to its parameter, gb.Parameter(2.0, bounds=...)."
    ),
    "constraints": "give constraints=[lambda p: ...] to the problem.",
}


def require_usable(names: Iterable[str], owner: str, *bases: type) -> None:
    """Raise ValueError for a name that would hide an attribute of `Names` or of these `bases`."""
    for name in names:
        if any(hasattr(base, name) for base in (Names, *bases)):
            raise ValueError(
                f"{owner} cannot have a parameter or signal called {name!r}: choose another name."
            )


def require_signal_names(cls: type, *attributes: str) -> None:
    """Raise ValueError for attributes of a class that are not tuples of distinct, usable names."""
    for attribute in attributes:
        names = getattr(cls, attribute)
        if isinstance(names, str) or len(set(names)) != len(names):
            raise ValueError(
                f"{cls.__name__}.{attribute} = {names!r} must be a tuple of different names."
            )
        require_usable(names, cls.__name__)


def declared_parameters(cls: type) -> dict[str, Parameter]:
    """Return the parameters of a class body and of the classes above it, by name."""
    parameters: dict[str, Parameter] = {}
    # Base classes first, so that a subclass can declare a parameter anew.
    for owner in reversed(cls.__mro__):
        for name in parameters.keys() & vars(owner).keys():
            if not isinstance(vars(owner)[name], Parameter):
                raise TypeError(
                    f"{cls.__name__}.{name} is {vars(owner)[name]!r} where a Parameter was "
                    "declared: use gb.Parameter(...)."
                )
        parameters |= {
            name: value for name, value in vars(owner).items() if isinstance(value, Parameter)
        }
    return parameters


def require_effect(cls: type, base: type, *, declares_formulas: bool) -> None:
    """Raise TypeError for attributes of another kind than in `base`, or that nothing reads.

    Of those that `base` does not have, only names that nearly are those of a declaration, or that
    declare something in other tools (if the base already declares which formulas a model has), are
    refused: others are a user's own.
    """
    declared = {name: getattr(base, name) for name in dir(base) if not name.startswith("_")}
    data = [name for name, value in declared.items() if isinstance(value, DATA)]
    functions = [name for name in ("derivative", "response", "trim") if name in declared]
    declared |= declared_parameters(cls)
    for name, value in vars(cls).items():
        for kind, words in KINDS.items():
            if isinstance(declared.get(name), kind):
                require_kind(f"{cls.__name__}.{name}", value, kind | property, words)
        # The class body cannot give `parameters`, which are collected from it.
        is_unread = name == "parameters" or (name not in declared and name not in _read_by(cls))
        if not is_unread or not (isinstance(value, DATA) or callable(value)):
            continue
        near = _nearly(name, data if isinstance(value, DATA) else functions)
        if near or (name in NO_EFFECT and declares_formulas):
            cure = NO_EFFECT.get(name, f"did you mean {near!r}?")
            raise TypeError(f"{cls.__name__}.{name} has no effect: {cure}")


def _nearly(name: str, known: Iterable[str]) -> str | None:
    """Return the name of a declaration that is misspelled, if any."""
    # Names such as input2, limits_of_u or delay_s are a user's own.
    words = name.count("_")
    alike = [candidate for candidate in known if candidate.count("_") == words]
    is_word = name.replace("_", "").isalpha() and not name.startswith("_")
    return nearest(name, alike, likeness=0.85) if is_word else None


def _read_by(cls: type) -> set[str]:
    """Return the names of attributes that the functions of a class body read."""
    functions: list[Any] = []
    for value in vars(cls).values():
        functions += value.values() if isinstance(value, Mapping) else [value]
    functions = [getattr(f, "fget", None) or getattr(f, "__func__", f) for f in functions]
    codes = [f.__code__ for f in functions if hasattr(f, "__code__")]

    names: set[str] = set()
    while codes:
        code = codes.pop()
        names.update(code.co_names)
        codes += [inner for inner in code.co_consts if isinstance(inner, CodeType)]
    return names
