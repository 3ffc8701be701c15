"""Model structures: a transfer function or an ODE, declared once with named parameters."""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, ClassVar, Self

from greybox.modeling.parameter import Parameter


class Names(Mapping[str, Any]):
    """Values by name, as attributes (``p.a1``) and as a mapping (``p["a1"]``); what a formula gets to see."""

    def __init__(self, values: Mapping[str, Any], what: str = "it") -> None:
        self.__dict__.update(values)
        self.__dict__["_what"] = what

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(f"{self._what} has no {name!r}; it has {', '.join(self) or 'nothing'}.")

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name) if name in self.__dict__ else self.__dict__[name]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name!r} cannot be set: these values are read-only.")

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.__dict__ if name != "_what")

    def __len__(self) -> int:
        return len(self.__dict__) - 1

    def __repr__(self) -> str:
        return f"Names({dict(self)!r})"


def _require_usable(names: Iterable[str], owner: str, taken: type = Names) -> None:
    """Raise ValueError for a name that would hide what the framework calls on `taken`."""
    for name in names:
        if hasattr(taken, name):
            raise ValueError(f"{owner} cannot have a parameter or signal called {name!r}: choose another name.")


class Model(ABC):
    """What `TransferFunction` and `StateSpace` share: declared parameters and derived quantities.

    Attributes
    ----------
    parameters : mapping of name to `Parameter`
        Collected from the class body, in the order of declaration.
    derived : mapping of name to function
        Quantities computed from the parameters, ``{"a3_tilde": lambda p: gb.g * p.a3}``; each gets its own standard
        error.
    """

    parameters: Mapping[str, Parameter] = MappingProxyType({})
    derived: ClassVar[Mapping[str, Callable[[Any], Any]]] = MappingProxyType({})
    arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Collect the parameters of the class body and of the classes above it."""
        super().__init_subclass__(**kwargs)
        found: dict[str, Parameter] = {}
        for owner in reversed(cls.__mro__):
            hidden = [n for n, value in vars(owner).items() if n in found and isinstance(value, (int, float))]
            if hidden:
                raise TypeError(
                    f"{cls.__name__}.{hidden[0]} is a number where a Parameter was declared: use Parameter(...)."
                )
            found |= {name: value for name, value in vars(owner).items() if isinstance(value, Parameter)}
        for taken in (Names, *(base for base in cls.__mro__[1:] if base.__module__ == __name__)):
            _require_usable(found, cls.__name__, taken)
        cls.parameters = MappingProxyType(found)

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Remember the arguments, so that a stored result can name its model."""
        if (args or kwargs) and cls.__init__ is object.__init__:
            raise TypeError(
                f"{cls.__name__}() takes no arguments: give values to a problem, e.g. fixed={{name: value}}, "
                "or to gb.frequency_response."
            )
        model = super().__new__(cls)
        model.arguments = (args, kwargs)
        return model

    @property
    @abstractmethod
    def input_names(self) -> tuple[str, ...]:
        """Names of the input signals."""

    @property
    @abstractmethod
    def output_names(self) -> tuple[str, ...]:
        """Names of the output signals."""

    @property
    def label(self) -> str:
        """The name of the structure, for tables."""
        return type(self).__name__

    def values(self, given: Mapping[str, float] | None = None, **more: float) -> Names:
        """Return parameter values by name: those given, otherwise the declared starts.

        Raises
        ------
        TypeError
            If `given` is no mapping.
        ValueError
            For a name that the model does not have.
        """
        if not isinstance(given, Mapping | None):
            raise TypeError(f"the values of {self.label} are {given!r:.60}: give {{name: value}}, after the model.")
        given = {**(given or {}), **more}
        require_known(given, self.parameters, "parameter", self.label)
        for name, value in given.items():
            if isinstance(value, (str, type(None))) or (isinstance(value, float) and not math.isfinite(value)):
                raise ValueError(f"{name} = {value!r} is no finite number: give a value for {self.label}.")
        return Names({n: given.get(n, p.start) for n, p in self.parameters.items()}, self.label)

    def __repr__(self) -> str:
        args, kwargs = self.arguments
        words = [repr(a) for a in args] + [f"{k}={v!r}" for k, v in kwargs.items()]
        return f"{type(self).__name__}({', '.join(words)})"


class TransferFunction(Model):
    """A transfer function in s from one input to one output, e.g. equation (4.25).

    A subclass declares `input` and `output`, its parameters, and `response`. Transfer functions multiply:
    ``rotor * tilt`` is the series connection in which the signal passes `rotor` first.
    """

    input: str = "u"
    output: str = "y"

    @abstractmethod
    def response(self, s: Any, p: Any) -> Any:
        """Return the value at `s` for the parameter values `p`.

        `s` is a complex array, a `Complex` or a `Rational`; write the formula with ``+ - * / **`` and functions such as
        `gb.exp`, and every reading works.
        """

    @property
    def input_names(self) -> tuple[str, ...]:
        """The one input."""
        return (self.input,)

    @property
    def output_names(self) -> tuple[str, ...]:
        """The one output."""
        return (self.output,)

    def __mul__(self, other: Any) -> "TransferFunction":
        return Series(self, other) if isinstance(other, TransferFunction) else NotImplemented


class Series(TransferFunction):
    """Series connection: the signal passes `first`, then `second`; parameters of one name are one unknown."""

    def __init__(self, first: TransferFunction, second: TransferFunction) -> None:
        _require_transfer_functions(first, second)
        self.first, self.second = first, second
        self.parameters = merged_parameters((first, second))
        self.input, self.output = first.input, second.output

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Those of both."""
        return {**self.first.derived, **self.second.derived}

    def response(self, s: Any, p: Any) -> Any:
        """Product of the two responses."""
        return self.first.response(s, p) * self.second.response(s, p)

    @property
    def label(self) -> str:
        """The names of both."""
        return f"{self.first.label} * {self.second.label}"


class Feedback(TransferFunction):
    """Closed loop forward / (1 - sign · forward · back); negative feedback with the default sign.

    A loop around a delay has exact readings in numbers and in CasADi; its rational reading needs a Padé approximation.
    """

    def __init__(self, forward: TransferFunction, back: TransferFunction | None = None, sign: int = -1) -> None:
        _require_transfer_functions(forward, *(() if back is None else (back,)))
        if sign not in (-1, 1):
            raise ValueError(f"sign {sign!r} must be -1 (negative feedback) or 1.")
        self.forward, self.back, self.sign = forward, back, sign
        parts = (forward,) if back is None else (forward, back)
        self.parameters = merged_parameters(parts)
        self.input, self.output = forward.input, forward.output

    @property
    def derived(self) -> Mapping[str, Callable[[Any], Any]]:  # type: ignore[override]
        """Those of all parts."""
        return {**self.forward.derived, **(self.back.derived if self.back else {})}

    def response(self, s: Any, p: Any) -> Any:
        """Return forward over one plus the loop."""
        forward = self.forward.response(s, p)
        loop = forward if self.back is None else forward * self.back.response(s, p)
        return forward / (1 - self.sign * loop)

    @property
    def label(self) -> str:
        """The names of what is in the loop."""
        return f"Feedback({self.forward.label}" + (f", {self.back.label})" if self.back else ")")


def feedback(forward: TransferFunction, back: TransferFunction | None = None, sign: int = -1) -> TransferFunction:
    """Close the loop around `forward`, through `back` if given; `sign` is that of the feedback."""
    return Feedback(forward, back, sign)


class StateSpace(Model):
    """An ODE ``x' = derivative(x, u, p)``, ``y = output(x, u, p)``, e.g. equation (4.23).

    A subclass declares `states`, `inputs` and `outputs`, `delays` (input name to the name of the parameter that delays
    it), its parameters, `derivative` and `output`. With ``states = ()`` it is a static model and needs no derivative.

    It may declare ``trim(self, at, p)``, which returns the remaining states and inputs at the operating point `at` by
    name; without it they follow from ``derivative = 0``.

    What a delayed input did before a record is known only if it rests at the beginning: if it moves, a fit leaves out
    as many seconds there as the upper bound of its delay, so give delays tight upper bounds (see `TimeCriterion`).
    """

    states: Sequence[str] = ()
    inputs: Sequence[str] = ("u",)
    outputs: Sequence[str] = ("y",)
    delays: Mapping[str, str] = MappingProxyType({})

    trim: Callable[[Any, Any], Mapping[str, Any]] | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Check the signal names of the declaration."""
        super().__init_subclass__(**kwargs)
        for attribute in ("states", "inputs", "outputs"):
            names = getattr(cls, attribute)
            if isinstance(names, str) or len(set(names)) != len(names):
                raise ValueError(f"{cls.__name__}.{attribute} = {names!r} must be a tuple of different names.")
            _require_usable(names, cls.__name__)
        twice = set(cls.states) & set(cls.inputs)
        if twice:
            raise ValueError(f"{cls.__name__} has {twice.pop()!r} both as state and as input: use two names.")
        require_known(cls.delays, cls.inputs, "input", f"{cls.__name__}.inputs")
        require_known(cls.delays.values(), cls.parameters, "parameter", cls.__name__)
        if cls.states and cls.derivative is StateSpace.derivative:
            raise TypeError(f"{cls.__name__} has states but no derivative(self, x, u, p): declare it.")

    def derivative(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return the time derivative of every state, in the order of `states`; a static model has none."""
        return ()

    @abstractmethod
    def output(self, x: Any, u: Any, p: Any) -> Sequence[Any]:
        """Return every output, in the order of `outputs`."""

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.outputs)


def require_known(names: Iterable[str], known: Iterable[str], what: str, owner: str) -> None:
    """Raise ValueError, naming the cure, for a name in `names` that is not in `known`."""
    known = list(known)
    for name in names:
        if name not in known:
            raise ValueError(f"{owner} has no {what} {name!r}; it has {', '.join(known) or 'none'}.")


def merge(name: str, a: Parameter, b: Parameter) -> Parameter:
    """Return the one unknown that two declarations of the same name describe: bounds and start boxes intersect.

    Raises
    ------
    ValueError
        When the units differ, one is fixed and the other free, or the bounds do not meet.
    """
    if a == b:
        return a
    if a.unit != b.unit:
        raise ValueError(
            f"{name!r} has the unit {a.unit!r} in one part and {b.unit!r} in the other: "
            f"they cannot be one unknown; give one another name, rename={{{name!r}: ...}}."
        )
    if a.fixed != b.fixed:
        raise ValueError(
            f"{name!r} is fixed in one part and free in the other: fix or free it in both, "
            f"or give one another name, rename={{{name!r}: ...}}."
        )
    if a.fixed and a.start != b.start:
        raise ValueError(
            f"{name!r} is fixed at {a.start:g} in one part and at {b.start:g} in the other: "
            f"use one value, or give one another name, rename={{{name!r}: ...}}."
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


def merged_parameters(models: Iterable[Model]) -> dict[str, Parameter]:
    """Merge the parameters of several models; the same name is one unknown."""
    result: dict[str, Parameter] = {}
    for model in models:
        for name, parameter in model.parameters.items():
            result[name] = merge(name, result[name], parameter) if name in result else parameter
    return result


def equation(model: Model | type[Model]) -> str:
    """Return the docstring of a model: its equation and source."""
    owner = model if isinstance(model, type) else type(model)
    return inspect.cleandoc(owner.__doc__ or "")


def _intersect(name: str, what: str, a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    low, high = max(a[0], b[0]), min(a[1], b[1])
    if low > high or (low == high and what == "bounds"):
        raise ValueError(
            f"the {what} of {name!r}, ({a[0]:g}, {a[1]:g}) and ({b[0]:g}, {b[1]:g}), do not meet: "
            f"widen them, or give one another name, rename={{{name!r}: ...}}."
        )
    return low, high


def _require_transfer_functions(*models: Any) -> None:
    for model in models:
        if not isinstance(model, TransferFunction):
            raise TypeError(f"{model!r} is not a TransferFunction: only transfer functions are connected.")
