"""A problem: a model, data and a criterion, with fixed, tied and renamed parameters."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import combinations
from numbers import Real
from operator import itemgetter
from typing import Any, Self

import casadi as ca
import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import MULTIPLIED
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.arrays import (
    Fields,
    Interval,
    Labels,
    Named,
    NamedStrings,
    Values,
    attributes,
    frozen,
    selected,
)
from greybox.files.text_table import as_names, is_finite_number, one_line, require_kind
from greybox.formulation.frequency_criteria import Criterion, RelativeError
from greybox.formulation.held_estimate import HeldEstimate, shared_parameters
from greybox.formulation.prior import Knowledge, NormalPrior, normal_priors
from greybox.formulation.restated_parameter import held_at, restated
from greybox.formulation.signal_units import check_response_units, check_units
from greybox.formulation.spectrum_criteria import EquationError, outputs_in_spectrum
from greybox.formulation.sum import Addable
from greybox.formulation.time_criteria import OutputError, TimeCriterion
from greybox.formulation.unsupported_data import described
from greybox.modeling.model import (
    Model,
    Names,
    ParameterFormula,
    require_known,
    require_operating_point,
)
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.parameter import Parameter, Parameters
from greybox.modeling.realization import dynamics
from greybox.modeling.symbolic_reading import called, require_no_nan


@frozen
class Problem(Addable):
    """One model, one set of data, one criterion.

    Parameters
    ----------
    model : Model
        The structure. For a frequency response or a spectrum, an ODE is linearized at its operating
        point; for a record, a transfer function is realized as states.
    data : FrequencyResponse, Record or TransientSpectrum
        Its signals have the names of the model's inputs and outputs. Outputs that a record or a
        spectrum lacks are not compared. Read files with `gb.read_response` or `gb.read`; for more
        than one record or response, see `several`.
    criterion : Criterion or TimeCriterion, optional
        By default `RelativeError` (4.26) for a response and `OutputError` for a record or a
        spectrum; a spectrum takes `EquationError` as well. In a sum with a likelihood the default
        for a response is `RelativeLikelihood`, see `Sum`.
    fixed : mapping of name to value, or a Fit
        Parameters held constant. A `Fit`, by itself or as the value of a name, gives its estimate,
        and its covariance widens the standard errors here.
    free : sequence of str
        Parameters to estimate although the model declares them fixed.
    tied : mapping of name to function
        ``{"p7": lambda p: 2 * p.p1}``: the parameter equals this expression of the others.
    constraints : sequence of functions
        ``lambda p: p.T1 - p.T2``: every value must be at least 0.
    delay : "exact" or "pade:n"
        How delays are evaluated. In time an exact delay costs nothing, while "pade:n" adds n fast
        states for every delayed input: a fit of the tilt took 1.6, 5 and 11 times as long with
        n = 1, 2 and 3, because small delays need small steps.
    at : mapping of name to value
        The operating point of an ODE, for a frequency response or a spectrum: some states and
        inputs, the rest follows from ``derivative = 0``.
    rename : mapping of name to name
        Other names of parameters in the answer. Added problems share parameters with equal names.
    weight : float
        Factor on this problem's cost in a sum. A record whose errors stay correlated deserves less
        than one, next to data whose errors do not: a note of the fit names the value. Costs with
        weights other than one are not likelihoods, so comparisons have no AIC.
    name : str
        A label; by default that of the data.
    bounds : mapping of name to (float, float)
        ``{"a1": (-10, 10)}``: bounds in place of the declared ones, see `Parameter`. Bounds of a
        tied parameter limit its expression.
    start : mapping of name to float
        ``{"a1": -5.0}``: start of a single run in place of the declared value.
    starts : mapping of name to (float, float)
        ``{"a1": (-8, -2)}``: the box in which starts are drawn, in place of the declared one.
    prior : mapping of name to (mean, standard deviation) or Fit, or a Fit
        Normal prior of free parameters; a `Fit` gives its estimate and covariance. It overrides
        `Parameter(prior=...)`. The estimate is then the maximum a posteriori one, and
        `Fit.prior_share` is the share of the prior in the information. Criteria must be
        likelihoods; the default for a response is then `RelativeLikelihood`.

    Raises
    ------
    ValueError
        If model, data and options do not fit together; the message has the value and the cure.

    Examples
    --------
    >>> from greybox.models.rate import DampedAngle
    >>> from greybox.problems import sitl_pitch
    >>> problem = gb.Problem(DampedAngle(), sitl_pitch.data(), fixed={"T_delay": 0.0})
    >>> [name for name, parameter in problem.parameters.items() if not parameter.fixed]
    ['K_phi', 'a', 'T_rotor']
    """

    model: Model
    data: FrequencyResponse | Record | TransientSpectrum
    criterion: Criterion | TimeCriterion = None  # type: ignore[assignment]
    fixed: Mapping[str, float | HeldEstimate] | HeldEstimate = field(default_factory=dict)
    free: Labels = ()
    tied: Mapping[str, ParameterFormula] = field(default_factory=dict)
    constraints: Sequence[ParameterFormula] = ()
    delay: str = "exact"
    at: Values = field(default_factory=dict)
    rename: NamedStrings = field(default_factory=dict)
    weight: float = 1.0
    name: str = ""
    bounds: Mapping[str, Interval] = field(default_factory=dict)
    start: Values = field(default_factory=dict)
    starts: Mapping[str, Interval] = field(default_factory=dict)
    prior: Mapping[str, Knowledge] | HeldEstimate = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fill in the defaults and check that everything fits together."""
        is_class = isinstance(self.model, type)
        cure = "an instance such as Tilt(), not the class" if is_class else "a model, then the data"
        require_kind("model", self.model, Model, cure)
        data = self.data
        if not isinstance(data, FrequencyResponse | Record | TransientSpectrum):
            raise TypeError(f"data is {described(data)}.")
        usual, kind, place = OutputError(), TimeCriterion, "a record or a TransientSpectrum"
        if isinstance(data, FrequencyResponse):
            # In records and spectra of manoeuvres too, a hold is not a part of the model.
            vars(self)["data"] = data.without_hold()
            usual, kind, place = RelativeError(), Criterion, "a frequency response"
        self._fill_in_defaults(usual)
        cure = f"a criterion such as {type(usual).__name__}(), for {place}"
        require_kind("criterion", self.criterion, kind, cure)
        if not is_finite_number(self.weight) or self.weight <= 0:
            raise ValueError(f"weight {self.weight!r} must be a finite number above 0.")

        if isinstance(data, Record):
            criterion: Any = self.criterion
            vars(self)["model"] = criterion.disturbed(self.model, data)

        # An unknown word is refused here, not in the middle of a search.
        delay_order(self.delay)

        # The names come first: with `declared`, they are checked.
        self._check_rename()
        self._check_operating_point()
        self._check_functions()
        if self.priors and not (self.criterion.is_likelihood or self.has_default_criterion):
            raise ValueError(
                f"{self.priors[0].names[0]!r} has a prior, and the cost of "
                f"{type(self.criterion).__name__} is not a likelihood to which it could be added: "
                "leave the criterion out, or give RelativeLikelihood(), or MaximumLikelihood() "
                "where variances are known."
            )

    def _fill_in_defaults(self, usual: Criterion | TimeCriterion) -> None:
        vars(self)["_has_default_criterion"] = self.criterion is None
        if self.criterion is None:
            vars(self)["criterion"] = usual
        vars(self)["free"] = as_names(self.free)
        if not self.name:
            model, data = self.model, self.data
            has_several = len(model.input_names) * len(model.output_names) > 1
            pair = data.pair if has_several and isinstance(data, FrequencyResponse) else ""
            vars(self)["name"] = data.name or pair or model.label

    def _added_by_criterion(self) -> Parameters:
        """Check model, data and criterion; return the parameters that the criterion adds."""
        criterion: Any = self.criterion  # of the kind of the data
        if isinstance(self.data, FrequencyResponse):
            criterion.check(self.data)
            check_response_units(self.model, self.data)
            return {}

        if isinstance(self.data, TransientSpectrum):
            outputs_in_spectrum(criterion, self.model, self.data)
            added = criterion.color(self.data) if isinstance(criterion, EquationError) else {}
        else:
            added = criterion.parameters(self.model, self.data)
        check_units(self.model, self.data)
        for name in added:
            if name in self.model.parameters:
                raise ValueError(
                    f"{self.model.label} declares {name!r}, which is also a parameter of the "
                    "criterion: rename it in the model."
                )

        return added

    def _check_names(self) -> None:
        """Require that options name parameters, and that none is two of fixed, free and tied."""
        kinds = {"fixed": self.fixed_values, **attributes(self, "free", "tied")}
        mappings = attributes(self, "rename", "bounds", "start", "starts")
        for what, names in mappings.items():
            require_kind(what, names, Mapping, "{name of a parameter: ...}")

        # A misspelled name would otherwise be ignored silently.
        for what, names in {**kinds, **mappings}.items():
            require_known(names, self._as_declared, "parameter", f"{what}: {self.model.label}")

        for first, second in combinations(kinds, 2):
            for name in kinds[first]:
                if name in kinds[second]:
                    raise ValueError(f"{name!r} is both {first} and {second}: keep one of them.")

    def _check_rename(self) -> None:
        for old, new in self.rename.items():
            if not isinstance(new, str) or not new:
                raise TypeError(f"rename gives {old!r} the name {new!r}: give a string.")
        # Two parameters with the same name would become one unknown by accident.
        outside = [self.outside(name) for name in self.declared]
        for name in outside:
            if outside.count(name) > 1:
                raise ValueError(
                    f"rename gives two parameters of {self.model.label} the name {name!r}: use "
                    "tied to make them equal."
                )

    def _check_operating_point(self) -> None:
        if isinstance(self.data, Record) and self.at:
            raise ValueError(
                f"at={dict(self.at)} is the operating point of a frequency response and this is a "
                "record: leave it out; known initial states go into OutputError(initial=...)."
            )
        require_operating_point(self.model, self.at)

    def _restated(self, name: str, parameter: Parameter) -> Parameter:
        """Apply `bounds`, `start` and `starts` to one declared parameter."""
        # A parameter that is never estimated would ignore them silently.
        stated = attributes(self, "bounds", "start", "starts").items()
        changes = {what: values[name] for what, values in stated if name in values}
        if name in self.tied and changes.keys() - {"bounds"}:
            raise ValueError(f"{name!r} is tied, so that it has no start of its own: leave it out.")
        if (
            changes
            and parameter.fixed
            and not (name in self.fixed_values or name in self.free or name in self.tied)
        ):
            raise ValueError(
                f"{' and '.join(changes)} names {name!r}, which {self.model.label} declares fixed: "
                f"give free=[{name!r}] to estimate it, or fixed={{{name!r}: ...}} to hold it at "
                "another value."
            )

        return restated(name, parameter, **changes)

    def _as_stated(self, name: str, parameter: Parameter) -> Parameter:
        """Apply `fixed` and `free` to one declared parameter."""
        if name not in self.fixed_values:
            return replace(parameter, fixed=parameter.fixed and name not in self.free)

        value = self.fixed_values[name]
        # An earlier fit has the parameter under its outside name.
        if isinstance(value, HeldEstimate):
            require_known(
                [self.outside(name)], value.estimate, "estimate", "the Fit given as fixed"
            )
            value = value.estimate[self.outside(name)]
        return held_at(name, parameter, value)

    def _check_functions(self) -> None:
        """Try ties, constraints and derived quantities with numbers and with expressions.

        A mistake then shows here, not inside CasADi.
        """
        require_kind("constraints", self.constraints, list | tuple, "a list of functions")
        label = self.model.label
        functions: dict[str, ParameterFormula] = {
            f"tied[{name!r}]": itemgetter(name) for name in self.tied
        }
        functions |= {f"constraints[{k}]": f for k, f in enumerate(self.constraints)}
        functions |= {f"derived[{n!r}] of {label}": f for n, f in self.model.derived.items()}
        numbers = self.local_starts
        for what, function in functions.items():
            _require_number(_call(function, numbers, what), what)

        # `if`, `max` and `math.exp` work with numbers and fail here.
        symbols = self.local_values({name: ca.SX.sym(name) for name in self.parameters})
        for what, function in functions.items():
            require_no_nan(what, ca.SX(_call(function, symbols, what)))

    @cached_property
    def _as_declared(self) -> Parameters:
        return {**self.model.parameters, **self._added_by_criterion()}

    @cached_property
    def declared(self) -> Parameters:
        """Parameters of model and criterion by their inner names, with their bounds and starts."""
        self._check_names()
        return {name: self._restated(name, p) for name, p in self._as_declared.items()}

    @cached_property
    def _stated(self) -> Parameters:
        """Parameters by inside name, fixed or free as in this problem, without tied ones."""
        return {
            name: self._as_stated(name, p)
            for name, p in self.declared.items()
            if name not in self.tied
        }

    @property
    def fixed_values(self) -> Mapping[str, float | HeldEstimate]:
        """Values of `fixed` by name: numbers and earlier fits."""
        if isinstance(self.fixed, Mapping):
            return self.fixed
        require_kind("fixed", self.fixed, HeldEstimate, "{name: value} or a Fit")

        outside = {name: self.outside(name) for name in self._as_declared}
        return shared_parameters(self.fixed, outside, "fixed")

    @property
    def held_estimates(self) -> dict[str, HeldEstimate]:
        """Earlier fits among the fixed values, by outside name."""
        return {
            self.outside(name): v
            for name, v in self.fixed_values.items()
            if isinstance(v, HeldEstimate)
        }

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters by outside name, fixed or free as in this problem, without tied ones."""
        return {self.outside(name): parameter for name, parameter in self._stated.items()}

    @cached_property
    def priors(self) -> tuple[NormalPrior, ...]:
        """Priors of the parameters, by outside name."""
        # Biases and gains of a criterion have no priors, and an earlier fit has no part in them.
        outside = {name: self.outside(name) for name in self.declared}
        return tuple(
            normal_priors(selected(self._stated, self.model.parameters), self.prior, outside)
        )

    @property
    def response(self) -> FrequencyResponse:
        """The data, if they are a frequency response."""
        assert isinstance(self.data, FrequencyResponse)
        return self.data

    @property
    def signals(self) -> Fields:
        """The input and output of the response, the operating point and the order of the delay."""
        data = self.response
        return {
            "input": data.input,
            "output": data.output,
            "at": self.at,
            "pade": delay_order(self.delay),
        }

    @cached_property
    def sampled_hold(self) -> float:
        """The divided hold of a response, s; zero without one.

        It is also zero for a loop around a delay, and for the rate that is s times the response of
        an angle: what sampling folds back is that of the angle.
        """
        hold = self.response.divided_hold
        if not hold or MULTIPLIED in self.response.about:
            return 0.0
        try:
            dynamics(self.model)
        except ValueError:  # a loop around a delay
            return 0.0
        return hold

    @property
    def record(self) -> Record:
        """The data, if they are a record."""
        assert isinstance(self.data, Record)
        return self.data

    @property
    def parts(self) -> tuple["Problem", ...]:
        """The problem itself, as the only part."""
        return (self,)

    def outside(self, name: str) -> str:
        """Return the name of a parameter in the answer."""
        return self.rename.get(name, name)

    def local_values(self, values: Named) -> Names:
        """Return the parameters by inside name, ties evaluated, from values by outside name."""
        local = {name: values[self.outside(name)] for name in self._stated}
        for name, tie in self.tied.items():
            local[name] = _call(
                tie, Names(local, f"the problem {self.name!r}, at this tie,"), f"tied[{name!r}]"
            )
        return Names({name: local[name] for name in self.declared}, self.model.label)

    @property
    def local_starts(self) -> Names:
        """The start values of the parameters by inside name, ties evaluated."""
        return self.local_values({name: p.start for name, p in self.parameters.items()})

    def with_parts(self, parts: "Sequence[Problem]") -> "Problem":
        """Return the only part, see `Sum.with_parts`."""
        (part,) = parts
        return part

    @property
    def has_default_criterion(self) -> bool:
        """Whether the criterion was left out."""
        return self.__dict__["_has_default_criterion"]

    def with_(self, **changes: Any) -> Self:
        """Return the problem with some fields changed; a criterion that was left out remains so."""
        # A sum may choose another default later.
        left_out = {"criterion": None} if self.has_default_criterion else {}
        return replace(self, **{**left_out, **changes})

    def __repr__(self) -> str:
        return one_line(
            self, repr(self.name), f"{self.model.label} to {self.data!r:.60}", self.criterion.name
        )


def _call(function: ParameterFormula, p: Names, what: str) -> Any:
    """Evaluate a user's function of the parameters, naming it when it fails."""
    cure = f"a function such as lambda p: 2 * p.{next(iter(p), 'a')}"
    require_kind(what, function, Callable, cure)
    return called(what, function, p)


def _require_number(value: Any, what: str) -> None:
    # A comparison has no slope that a solver could follow.
    if isinstance(value, bool | np.bool_):
        raise ValueError(
            f"{what} gives True or False: write a difference that must be >= 0, such as p.T1 - "
            "p.T2."
        )
    if not isinstance(value, Real):
        raise ValueError(
            f"{what} gives {value!r:.60}: it must give an expression of the parameters."
        )

    if not math.isfinite(value):
        raise ValueError(
            f"{what} is {value} at the start values: correct the function or the starts."
        )
