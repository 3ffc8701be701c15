"""What is to be fitted: a model, data and a criterion, with fixed, tied and renamed parameters. Problems add."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import casadi as ca
import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.formulation.frequency_criteria import Criterion, RelativeError
from greybox.formulation.held_estimate import Estimated
from greybox.formulation.sensor_biases import with_own_biases
from greybox.formulation.time_criteria import OutputError, TimeCriterion
from greybox.modeling.harmonic_balance import check_sine
from greybox.modeling.model import Model, Names, merge, pick_signals, require_known
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.parameter import Parameter
from greybox.modeling.sine import Sine, as_sine
from greybox.modeling.state_space import StateSpace
from greybox.modeling.symbolic_reading import require_no_nan, traced

LONG = 200  # characters of a list in a sentence


@dataclass(frozen=True, eq=False)
class Problem:
    """One model, one set of data, one criterion.

    Parameters
    ----------
    model : Model
        The structure; for a frequency response an ODE is linearized at its operating point, for a record a transfer
        function is realized as states.
    data : FrequencyResponse or Record
        Meets the model by the names of its inputs and outputs. Outputs that a record does not hold are not compared.
        Files are read first, by `gb.read_response` or `gb.read`; see `several` for more than one record.
    criterion : Criterion or TimeCriterion, optional
        `RelativeError` (4.26) by default for a response, `OutputError` for a record.
    fixed : mapping of name to value, or a Fit
        Parameters held constant. A `Fit`, whole or as the value of a name, gives its estimate and its covariance, which
        then widens the standard errors here.
    free : sequence of str
        Parameters that the model declares fixed and that are to be estimated.
    tied : mapping of name to function
        ``{"p7": lambda p: 2 * p.p1}``: the parameter is this expression of the others.
    constraints : sequence of functions
        ``lambda p: p.T1 - p.T2``, each must be >= 0.
    delay : "exact" or "pade:n"
        How delays are evaluated.
    at : mapping of name to value
        The operating point of an ODE, for a frequency response: some states and inputs, the rest follows from
        ``derivative = 0``.
    rename : mapping of name to name
        Names under which parameters are known outside, so that added problems share or do not share them.
    weight : float
        Factor on this problem's cost in a sum.
    name : str
        A label; by default that of the data.
    amplitude : ``{signal: amplitude}`` or Sine, optional
        Compare with the response of an ODE to a sine of this amplitude, see `Sine`, instead of its linearization.

    Raises
    ------
    ValueError
        In one sentence with the value and the cure, for anything that does not fit together.
    """

    model: Model
    data: FrequencyResponse | Record
    criterion: Criterion | TimeCriterion = None  # type: ignore[assignment]
    fixed: Mapping[str, "float | Estimated"] | Estimated = field(default_factory=dict)
    free: Sequence[str] = ()
    tied: Mapping[str, Callable[[Any], Any]] = field(default_factory=dict)
    constraints: Sequence[Callable[[Any], Any]] = ()
    delay: str = "exact"
    at: Mapping[str, float] = field(default_factory=dict)
    rename: Mapping[str, str] = field(default_factory=dict)
    weight: float = 1.0
    name: str = ""
    amplitude: Sine = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Fill in the defaults and check that everything fits together."""
        _require(self.model, Model, "model", "an instance such as Tilt(), not the class")
        require_data(self.data)
        kind, usual = (TimeCriterion, OutputError()) if isinstance(self.data, Record) else (Criterion, RelativeError())
        if self.criterion is None:
            object.__setattr__(self, "criterion", usual)
        what = "record" if isinstance(self.data, Record) else "frequency response"
        _require(self.criterion, kind, "criterion", f"a criterion such as {type(usual).__name__}(), for a {what}")
        if isinstance(self.free, str):
            object.__setattr__(self, "free", (self.free,))
        if not self.name:
            object.__setattr__(self, "name", self.data.name or self.model.label)
        if not isinstance(self.weight, (int, float, np.number)) or not (math.isfinite(self.weight) and self.weight > 0):
            raise ValueError(f"weight {self.weight!r} must be a finite number above 0.")
        delay_order(self.delay)
        self._check_signals()
        self._check_names()
        self._check_operating_point()
        self._check_amplitude()
        object.__setattr__(self, "_parameters", self._build_parameters())
        self._check_functions()

    def _check_signals(self) -> None:
        added: Mapping[str, Parameter] = {}
        if isinstance(self.data, Record) and isinstance(self.criterion, TimeCriterion):
            self.criterion.compared(self.model, self.data)
            added = self.criterion.parameters(self.model, self.data)
            both = [name for name in added if name in self.model.parameters]
            if both:
                raise ValueError(
                    f"{self.model.label} declares {both[0]!r}, which is also the name of an unknown of the criterion: "
                    "rename it in the model."
                )
        elif isinstance(self.data, FrequencyResponse) and isinstance(self.criterion, Criterion):
            self.criterion.check(self.data)
            pick_signals(self.model, self.data.input, self.data.output)
        object.__setattr__(self, "_declared", {**self.model.parameters, **added})

    @property
    def declared(self) -> Mapping[str, Parameter]:
        """The parameters of the model, and after them those that the criterion adds."""
        return self.__dict__["_declared"]

    def _check_names(self) -> None:
        label, known = self.model.label, self.declared
        for what, names in (
            ("fixed", self.given),
            ("free", self.free),
            ("tied", self.tied),
            ("rename", self.rename),
        ):
            for name in names:
                if name not in known:
                    raise ValueError(
                        f"{what} names {name!r}, which {label} does not have; its parameters are {', '.join(known)}."
                    )
        for a, b, first, second in (
            (self.given, self.free, "fixed", "free"),
            (self.given, self.tied, "fixed", "tied"),
            (self.free, self.tied, "free", "tied"),
        ):
            both = [name for name in a if name in b]
            if both:
                raise ValueError(f"{both[0]!r} is both {first} and {second}: keep one of them.")
        for old, new in self.rename.items():
            if not isinstance(new, str) or not new:
                raise TypeError(f"rename gives {old!r} the name {new!r}: give a text.")
        outside = [self.rename.get(name, name) for name in known]
        for name in outside:
            if outside.count(name) > 1:
                raise ValueError(
                    f"rename gives two parameters of {label} the name {name!r}: use tied to make them equal."
                )

    def _check_operating_point(self) -> None:
        if isinstance(self.data, Record) and self.at:
            raise ValueError(
                f"at={dict(self.at)} is the operating point of a frequency response and this is a record: "
                "leave it out; known initial states go into OutputError(initial=...)."
            )
        if isinstance(self.model, StateSpace):
            require_known(self.at, (*self.model.states, *self.model.inputs), "state or input", self.model.label)
        elif self.at:
            raise ValueError(f"{self.model.label} has no operating point: leave out at={dict(self.at)}.")

    def _check_amplitude(self) -> None:
        if self.amplitude is None:
            return
        if not isinstance(self.data, FrequencyResponse):
            raise ValueError("amplitude belongs to a frequency response and the data are none: leave it out.")
        object.__setattr__(self, "amplitude", as_sine(self.amplitude))
        input, _ = pick_signals(self.model, self.data.input, self.data.output)
        check_sine(self.model, self.amplitude, input, self.data.omega)

    @property
    def given(self) -> Mapping[str, "float | Estimated"]:
        """Return `fixed` by name."""
        if isinstance(self.fixed, Mapping):
            return self.fixed
        if not isinstance(self.fixed, Estimated):
            raise TypeError(f"fixed is {self.fixed!r:.60}: give {{name: value}} or a Fit.")
        shared = {name: self.fixed for name in self.declared if self.rename.get(name, name) in self.fixed.estimate}
        if not shared:
            raise ValueError(
                f"the Fit given as fixed has {', '.join(self.fixed.estimate)}, of which {self.model.label} has none; "
                f"its parameters are {', '.join(self.model.parameters)}."
            )
        return shared

    def _build_parameters(self) -> dict[str, Parameter]:
        result = {}
        for local, parameter in self.declared.items():
            if local in self.tied:
                continue
            result[local] = self._as_stated(local, parameter)
        return result

    def _as_stated(self, local: str, parameter: Parameter) -> Parameter:
        """Apply `fixed` and `free` to one declared parameter."""
        given = self.given
        if local not in given:
            return replace(parameter, fixed=parameter.fixed and local not in self.free)
        value = given[local]
        if isinstance(value, Estimated):
            require_known([self.rename.get(local, local)], value.estimate, "estimate", "the Fit given as fixed")
            value = value.estimate[self.rename.get(local, local)]
        if not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
            raise ValueError(f"fixed gives {local!r} the value {value!r}: give a finite number or a Fit.")
        low, high = parameter.bounds
        if not low <= value <= high:
            raise ValueError(
                f"fixed gives {local!r} the value {value:g} outside its bounds ({low:g}, {high:g}): "
                "change the value or the bounds in the model."
            )
        return replace(parameter, start=float(value), fixed=True)

    def _check_functions(self) -> None:
        """Try ties, constraints and derived quantities in numbers, so that a mistake shows here, not inside CasADi."""
        if not isinstance(self.constraints, Sequence) or isinstance(self.constraints, str):
            raise TypeError(f"constraints is {self.constraints!r:.60}: give a list of functions.")
        start = {self.rename.get(n, n): p.start for n, p in self._own.items()}
        p = self.local_values(start)
        for name in self.tied:
            _require_number(p[name], f"tied[{name!r}]")
        for k, constraint in enumerate(self.constraints):
            _require_number(_call(constraint, p, f"constraints[{k}]"), f"constraints[{k}]")
        for name, function in self.model.derived.items():
            _require_number(_call(function, p, f"derived[{name!r}] of {self.model.label}"), f"derived[{name!r}]")
        self._trace_functions(start)

    def _trace_functions(self, names: Iterable[str]) -> None:
        """Try the same with expressions, where `if`, `max` and `math.exp` fail."""
        symbols = {name: ca.SX.sym(name) for name in names}
        p = self.local_values(symbols)
        named = {f"tied[{name!r}]": lambda _, name=name: p[name] for name in self.tied}
        named |= {f"constraints[{k}]": constraint for k, constraint in enumerate(self.constraints)}
        named |= {f"derived[{name!r}] of {self.model.label}": f for name, f in self.model.derived.items()}
        for what, function in named.items():
            require_no_nan(what, ca.SX(traced(what, function, p)))

    @property
    def _own(self) -> dict[str, Parameter]:
        return self.__dict__["_parameters"]

    @property
    def response(self) -> FrequencyResponse:
        """The data, which are a frequency response."""
        assert isinstance(self.data, FrequencyResponse)
        return self.data

    @property
    def numbers(self) -> int:
        """How many real numbers the data hold that are compared."""
        if isinstance(self.data, Record):
            outputs = [name for name in self.model.output_names if name in self.data.signals]
            return sum(int(np.isfinite(self.data[name]).sum()) for name in outputs)
        return 2 * len(self.data)

    @property
    def parts(self) -> tuple["Problem", ...]:
        """The problems in this sum: itself."""
        return (self,)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters by their outside name, as stated here; tied ones are left out."""
        return {self.rename.get(name, name): parameter for name, parameter in self._own.items()}

    @property
    def known(self) -> dict[str, Estimated]:
        """The earlier answers among the fixed values, by outside name."""
        return {self.rename.get(n, n): v for n, v in self.given.items() if isinstance(v, Estimated)}

    def local_values(self, values: Mapping[str, Any]) -> Names:
        """Name the model's parameters, ties evaluated, given numbers or expressions by outside name."""
        local = {name: values[self.rename.get(name, name)] for name in self._own}
        for name, tie in self.tied.items():
            local[name] = _call(tie, Names(local, f"the problem {self.name!r}, at this tie,"), f"tied[{name!r}]")
        return Names({name: local[name] for name in self.declared}, self.model.label)

    def __add__(self, other: Any) -> "Sum":
        return _add(self, other)

    def __radd__(self, other: Any) -> "Problem | Sum":
        return self if other == 0 else NotImplemented

    def with_(self, **changes: Any) -> Self:
        """Return the same problem with some fields changed."""
        return replace(self, **changes)


@dataclass(frozen=True, eq=False)
class Sum:
    """Several problems solved at once: costs add by their weights, parameters of one name are one unknown.

    The bias of a sensor is each record's own: where several records have it, ``x_bias`` becomes ``x_bias_1``,
    ``x_bias_2`` ..., numbered as the records are. Parts of the same record share it; so do parts that give it one name,
    ``rename={"x_bias": "x_bias"}``.
    """

    parts: tuple[Problem, ...]
    name: str = ""

    def __post_init__(self) -> None:
        """Name the biases, merge the parameters and check the labels."""
        object.__setattr__(self, "_stated", self.parts)
        object.__setattr__(self, "parts", with_own_biases(self.parts))
        if not self.name:
            object.__setattr__(self, "name", " + ".join(dict.fromkeys(part.name for part in self.parts)))
        merged: dict[str, Parameter] = {}
        for part in self.parts:
            for name, parameter in part.parameters.items():
                merged[name] = merge(name, merged[name], parameter) if name in merged else parameter
        self._check_ties(merged)
        object.__setattr__(self, "_parameters", merged)

    def _check_ties(self, merged: Mapping[str, Parameter]) -> None:
        random = np.random.default_rng(0)
        low, high = np.clip(np.array([p.bounds for p in merged.values()]).T, -1e3, 1e3)
        points = [[p.start for p in merged.values()], *random.uniform(low, high, (4, len(merged)))]
        seen: dict[str, list[float]] = {}
        for part in self.parts:
            for name in part.tied:
                outside = part.rename.get(name, name)
                values = [part.local_values(dict(zip(merged, point, strict=True)))[name] for point in points]
                if outside in merged or not np.allclose(seen.setdefault(outside, values), values, equal_nan=True):
                    raise ValueError(
                        f"{outside!r} is tied in {part.name!r} and otherwise in another part: tie it alike in both, "
                        f"or give one another name, rename={{{name!r}: ...}}."
                    )

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The merged parameters by outside name; tied ones are left out."""
        return dict(self.__dict__["_parameters"])

    @property
    def known(self) -> dict[str, Estimated]:
        """The earlier answers among the fixed values."""
        return {name: value for part in self.parts for name, value in part.known.items()}

    def __add__(self, other: Any) -> "Sum":
        return _add(self, other)

    def __radd__(self, other: Any) -> "Sum":
        return self if other == 0 else NotImplemented

    def with_(self, **changes: Any) -> "Sum":
        """Return the same sum with fields of every part changed (`name` is that of the sum)."""
        name = changes.pop("name", self.name)
        return Sum(tuple(replace(part, **changes) for part in _stated(self)), name)


def _add(a: Problem | Sum, b: Any) -> Sum:
    if not isinstance(b, Problem | Sum):
        return NotImplemented
    return Sum((*_stated(a), *_stated(b)))


def _stated(problem: Problem | Sum) -> tuple[Problem, ...]:
    """Return the parts as they were added, before their biases were numbered."""
    return problem.parts if isinstance(problem, Problem) else problem.__dict__["_stated"]


def require_data(given: Any) -> None:
    """Raise TypeError, saying what to give instead, for what is neither a frequency response nor a record."""
    if isinstance(given, FrequencyResponse | Record):
        return
    raise TypeError(f"data is {_described(given)}.")


def _described(given: Any) -> str:
    if isinstance(given, Recording):
        first = next(iter(given), "MESSAGE")
        return (
            f"a log with the messages {', '.join(given):.{LONG}}: give one of its records, such as log[{first!r}], or "
            "what gb.prepare(log, {name: 'MESSAGE.Field'}) makes of several"
        )
    if isinstance(given, str | Path):
        path = str(given)
        return (
            f"the path {path!r}: read the file first, gb.read_response({path!r}) for a frequency response or "
            f"gb.read({path!r}) for records"
        )
    if isinstance(given, Sequence) and given and all(isinstance(item, Record | FrequencyResponse) for item in given):
        cure = "use gb.several(model, records)" if len(given) > 1 else "take it out of the list"
        return f"a list with {len(given)} in it: {cure}"
    return f"{given!r:.80}: give a FrequencyResponse or a Record"


def _require(value: Any, kind: Any, what: str, cure: str) -> None:
    if not isinstance(value, kind):
        raise TypeError(f"{what} is {value!r:.80}: give {cure}.")


def _call(function: Callable[[Any], Any], p: Names, what: str) -> Any:
    """Evaluate a user's function of the parameters, naming it when it fails."""
    if not callable(function):
        raise TypeError(f"{what} is {function!r:.60}: give a function such as lambda p: 2 * p.{next(iter(p), 'a')}.")
    try:
        return traced(what, function, p)
    except (AttributeError, KeyError, ArithmeticError) as error:
        raise ValueError(f"{what}: {error}") from error


def _require_number(value: Any, what: str) -> None:
    if isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{what} gives a truth value: write a difference that must be >= 0, such as p.T1 - p.T2.")
    if not isinstance(value, (int, float, np.number)):
        raise ValueError(f"{what} gives {value!r:.60}: it must give an expression of the parameters.")
    if not math.isfinite(value):
        raise ValueError(f"{what} is {value} at the start values: correct the function or the starts.")
