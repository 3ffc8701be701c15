"""The base class of models: parameters, their values by name, and the names of signals."""

import inspect
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from types import CodeType, MappingProxyType
from typing import Any, ClassVar, Self, SupportsIndex

from greybox.files.arrays import (
    Fields,
    Interval,
    Labels,
    Named,
    NamedStrings,
    StringPair,
    Strings,
    Values,
)
from greybox.files.text_table import alternatives, listed, nearest, require_kind
from greybox.modeling.parameter import Parameter, Parameters

PACKAGE = __name__.rpartition(".")[0]  # whose classes' attributes no parameter may hide


class Names(Named):
    """Values by name, ``p.a1`` or ``p["a1"]``: the arguments of a formula."""

    def __init__(self, values: Named, what: str = "it") -> None:
        self.__dict__.update(values)
        self.__dict__["_what"] = what

    def __getattr__(self, name: str) -> Any:
        # `copy` and `pickle` look for special methods before there are any values.
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __getitem__(self, name: str) -> Any:
        # A mapping raises KeyError. The values have no numbers, only names.
        if name not in self.__dict__:
            raise KeyError(f"{self._what} has no {name!r}; it has {alternatives(name, self)}")
        return self.__dict__[name]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name!r} cannot be set: these values are read-only.")

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.__dict__ if name != "_what")

    def __len__(self) -> int:
        return len(self.__dict__) - 1

    def __repr__(self) -> str:
        return f"Names({dict(self)!r})"


ParameterFormula = Callable[[Any], Any]
"""A user's function of parameters by name."""


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


DATA = str | tuple | list | Mapping

KINDS: dict[Any, str] = {
    Callable: "a function",
    str: "a name",
    tuple | list: "a tuple of names",
    Mapping: "a dictionary",
}
"""Kinds of attributes of a model, and how a message asks for them."""

FORMULAS = {"output": "output(self, x, u, p)", "response": "response(self, s, p)"}
"""How a model declares what it must have."""

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
"""Attributes that a user may expect and that nothing reads, with what has their effect."""


def require_effect(cls: type, base: type) -> None:
    """Raise TypeError for attributes of another kind than in `base`, or that nothing reads.

    Of those that `base` does not have, only names that nearly are those of a declaration, or that
    declare something in other tools, are refused: others are a user's own.
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
        if near or (name in NO_EFFECT and base is not Model):
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


class Model(ABC):
    """What `TransferFunction` and `StateSpace` share: declared parameters and derived quantities.

    Attributes
    ----------
    parameters : mapping of name to `Parameter`
        Collected from the class body, in the order of declaration.
    derived : mapping of name to function
        Quantities computed from the parameters, ``{"a3_tilde": lambda p: gb.g * p.a3}``; a fit
        gives their standard errors.
    units : mapping of signal name to str
        Declared units of inputs and outputs, ``{"theta": "rad"}``: records in other units are
        refused.
    """

    parameters: Parameters = MappingProxyType({})
    trim: Callable[[Any, Any], Named] | None = None
    units: NamedStrings = MappingProxyType({})
    derived: ClassVar[Mapping[str, ParameterFormula]] = MappingProxyType({})
    arguments: tuple[tuple[Any, ...], Fields]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Collect the parameters of the class body and of the classes above it."""
        super().__init_subclass__(**kwargs)
        parameters = declared_parameters(cls)
        bases = [base for base in cls.__mro__[1:] if base.__module__.startswith(PACKAGE)]
        require_usable(parameters, cls.__name__, *bases)
        require_effect(cls, bases[0])
        cls.parameters = MappingProxyType(parameters)

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Remember the arguments, so that a stored result can name its model."""
        # Tilt(a1=3) looks like a value of a parameter, and Python would accept it silently.
        if (args or kwargs) and cls.__init__ is object.__init__:
            raise TypeError(
                f"{cls.__name__}() takes no arguments: give values to a problem, e.g. "
                "fixed={name: value}, or to gb.frequency_response."
            )
        if missing := sorted(getattr(cls, "__abstractmethods__", ())):
            formulas = [FORMULAS.get(name, f"{name}(...)") for name in missing]
            raise TypeError(
                f"{cls.__name__} has no formula {listed(formulas)}: declare it in the class."
            )
        model = super().__new__(cls)
        model.arguments = (args, kwargs)
        return model

    @property
    @abstractmethod
    def input_names(self) -> Strings:
        """Names of the input signals."""

    @property
    @abstractmethod
    def output_names(self) -> Strings:
        """Names of the output signals."""

    @property
    def state_names(self) -> Strings:
        """Names of the states; a transfer function declares none."""
        return ()

    @property
    def resting_signals(self) -> Strings:
        """States and inputs at an operating point; a transfer function has none."""
        return ()

    @property
    def is_static(self) -> bool:
        """True if the model has neither states nor delays."""
        return False

    @property
    def label(self) -> str:
        """The name of the structure, for tables."""
        return type(self).__name__

    def contains(self, other: "Model") -> Values | None:
        """Return the values of the parameters that only this model has, at which it is the other.

        By default None, which leaves that to the comparison of two fits: it looks whether the
        formulas are the same where these parameters are zero. A class may state other values, such
        as one for an exponent; parameters that it does not name are zero.
        """
        return None

    def _repr_markdown_(self) -> str:
        return f"**{self.label}**\n\n{equation(self)}"

    def values(self, values: Values | None = None, **more: float) -> Names:
        """Return parameter values by name; a parameter without one has its declared start.

        Raises
        ------
        TypeError
            If `values` is not a mapping.
        ValueError
            For a name that the model does not have.
        """
        cure = "{name: value}, after the model"
        require_kind(f"the argument of {self.label}", values, Mapping | None, cure)
        values = {**(values or {}), **more}
        require_known(values, self.parameters, "parameter", self.label)
        for name, value in values.items():
            if isinstance(value, str | None) or (
                isinstance(value, float) and not math.isfinite(value)
            ):
                raise ValueError(
                    f"{name} = {value!r} of {self.label} is not a finite number: give one."
                )

        return Names({n: values.get(n, p.start) for n, p in self.parameters.items()}, self.label)

    def __reduce_ex__(self, protocol: SupportsIndex) -> tuple[Any, ...]:
        """Return the class by its name, and the state: for pickles and copies."""
        state = super().__reduce_ex__(protocol)[2]
        return _new, (_ImportedClass(type(self)),), state

    def __repr__(self) -> str:
        args, kwargs = self.arguments
        written = [*map(repr, args), *(f"{k}={v!r}" for k, v in kwargs.items())]
        return f"{type(self).__name__}({', '.join(written)})"


class _ImportedClass:
    """The class of a model in a pickle, which names it; a copy has the class itself."""

    def __init__(self, cls: type) -> None:
        self.cls = cls

    def __deepcopy__(self, memo: Any) -> Self:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        cls = self.cls
        found: Any = sys.modules.get(cls.__module__)
        for name in cls.__qualname__.split("."):
            found = getattr(found, name, None)
        if found is not cls:
            raise TypeError(
                f"{cls.__qualname__} of the module {cls.__module__!r} cannot be imported by its "
                "name, so no model of this class, and no fit with one, can be pickled: declare it "
                "at the top of a module; or store the fit with gb.save(fit, path), and read it "
                f"with gb.load(path, models=[{cls.__name__}])."
            )
        return _ImportedClass, (cls,)


def _new(of: _ImportedClass) -> Any:
    """Return a model of this class, which gets its attributes afterwards."""
    return object.__new__(of.cls)


def require_known(names: Iterable[str], known: Iterable[str], what: str, owner: str) -> None:
    """Raise ValueError, naming the cure, for a name in `names` that is not in `known`."""
    known = list(known)
    for name in names:
        if name not in known:
            raise ValueError(f"{owner} has no {what} {name!r}; it has {alternatives(name, known)}")


def require_operating_point(model: Model, at: Values | None) -> None:
    """Raise ValueError for an operating point of a transfer function, or of unknown signals."""
    if at and not model.resting_signals:
        raise ValueError(
            f"{model.label} is a transfer function and has no operating point: leave out "
            f"at={dict(at)}."
        )
    require_known(at or {}, model.resting_signals, "state or input", model.label)


def pick_signals(model: Model, input: str = "", output: str = "") -> StringPair:
    """Return the names of input and output; an empty name means the only signal."""
    return (
        _pick(input, model.input_names, "input", model.label),
        _pick(output, model.output_names, "output", model.label),
    )


def _pick(name: str, known: Labels, what: str, owner: str) -> str:
    if name:
        require_known([name], known, what, owner)
        return name
    if len(known) > 1:
        raise ValueError(
            f"{owner} has several {what}s ({', '.join(known)}): specify which one, {what}=..."
        )

    return known[0]


def merge(name: str, a: Parameter, b: Parameter) -> Parameter:
    """Merge two declarations with the same name: bounds and start boxes intersect.

    Raises
    ------
    ValueError
        If the units differ, one is fixed and the other free, or the bounds do not overlap.
    """
    if a == b:
        return a
    conflict = ""
    if a.unit != b.unit:
        conflict = f"has the unit {a.unit!r} in one part and {b.unit!r} in the other"
    elif a.fixed != b.fixed:
        conflict = "is fixed in one part and free in the other"
    # Two constants with the same name and different values are two quantities.
    elif a.fixed and a.start != b.start:
        conflict = f"is fixed at {a.start:g} in one part and at {b.start:g} in the other"
    if conflict:
        raise ValueError(
            f"{name!r} {conflict}: they are one unknown only if alike in both; else give one "
            f"another name, rename={{{name!r}: ...}}."
        )

    low, high = _intersect(name, "bounds", a.bounds, b.bounds)
    first, last = _intersect(name, "start boxes", a.box, b.box)
    first, last = max(first, low), min(last, high)
    boxed = a.starts is not None or b.starts is not None
    return replace(
        a,
        bounds=(low, high),
        start=min(max(a.start, low), high),
        starts=(first, last) if boxed and first <= last else None,
    )


def merged_parameters(owners: Iterable[Any]) -> dict[str, Parameter]:
    """Merge the `parameters` of several models or problems; a common name is one unknown."""
    result: dict[str, Parameter] = {}
    for owner in owners:
        for name, parameter in owner.parameters.items():
            result[name] = merge(name, result.setdefault(name, parameter), parameter)
    return result


AnyModel = Model | type[Model]


def equation(model: AnyModel) -> str:
    """Return the docstring of a model: its equation and source."""
    return inspect.cleandoc(class_of(model).__doc__ or "")


def class_of(model: AnyModel) -> type[Model]:
    """Return the class of a model, or the class itself."""
    return model if isinstance(model, type) else type(model)


def _intersect(name: str, what: str, a: Interval, b: Interval) -> Interval:
    low, high = max(a[0], b[0]), min(a[1], b[1])
    if low > high or (low == high and what == "bounds"):
        raise ValueError(
            f"the {what} of {name!r}, ({a[0]:g}, {a[1]:g}) and ({b[0]:g}, {b[1]:g}), do not "
            f"overlap: widen them, or give one another name, rename={{{name!r}: ...}}."
        )
    return low, high
