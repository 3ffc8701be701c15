"""The base class of models: parameters, their values by name, and the names of signals."""

import inspect
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Self, SupportsIndex

from greybox.data.files.argument_checks import require_kind
from greybox.data.files.named_values import ByName, Values
from greybox.data.files.spelling import alternatives
from greybox.data.files.wording import listed
from greybox.modeling.declaration import declared_parameters, require_effect, require_usable
from greybox.modeling.formula_arguments import Names
from greybox.modeling.parameter import Parameters

PACKAGE = __name__.rpartition(".")[0]  # whose classes' attributes no parameter may hide

ParameterFormula = Callable[[Any], Any]  # a user's function of parameters by name

# How a model declares what it must have.
FORMULAS = {"output": "output(self, x, u, p)", "response": "response(self, s, p)"}


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
    trim: Callable[[Any, Any], Mapping[str, Any]] | None = None
    units: Mapping[str, str] = MappingProxyType({})
    derived: ClassVar[Mapping[str, ParameterFormula]] = MappingProxyType({})
    arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Collect the parameters of the class body and of the classes above it."""
        super().__init_subclass__(**kwargs)
        parameters = declared_parameters(cls)
        bases = [base for base in cls.__mro__[1:] if base.__module__.startswith(PACKAGE)]
        require_usable(parameters, cls.__name__, *bases)
        require_effect(cls, bases[0], declares_formulas=bases[0] is not Model)
        cls.parameters = MappingProxyType(ByName(parameters))

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
    def input_names(self) -> tuple[str, ...]:
        """Names of the input signals."""

    @property
    @abstractmethod
    def output_names(self) -> tuple[str, ...]:
        """Names of the output signals."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states; a transfer function declares none."""
        return ()

    @property
    def resting_signals(self) -> tuple[str, ...]:
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


def pick_signals(model: Model, input: str = "", output: str = "") -> tuple[str, str]:
    """Return the names of input and output; an empty name means the only signal."""
    return (
        _pick(input, model.input_names, "input", model.label),
        _pick(output, model.output_names, "output", model.label),
    )


def _pick(name: str, known: Sequence[str], what: str, owner: str) -> str:
    if name:
        require_known([name], known, what, owner)
        return name
    if len(known) > 1:
        raise ValueError(
            f"{owner} has several {what}s ({', '.join(known)}): specify which one, {what}=..."
        )

    return known[0]


AnyModel = Model | type[Model]


def equation(model: AnyModel) -> str:
    """Return the docstring of a model: its equation and source."""
    return inspect.cleandoc(class_of(model).__doc__ or "")


def class_of(model: AnyModel) -> type[Model]:
    """Return the class of a model, or the class itself."""
    return model if isinstance(model, type) else type(model)
