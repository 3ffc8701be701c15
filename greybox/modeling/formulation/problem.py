"""A problem: a model, data and a criterion, with fixed, tied and renamed parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from operator import itemgetter
from typing import Any, Self

import casadi as ca

from greybox.data.files.argument_checks import as_names, is_finite_number, require_kind
from greybox.data.files.arrays import Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.normalization import normalize
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import MULTIPLIED
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.formula_arguments import Names
from greybox.modeling.formulation.data_kind import DataKind
from greybox.modeling.formulation.data_kinds import kind_of
from greybox.modeling.formulation.frequency_criteria import Criterion
from greybox.modeling.formulation.held_estimate import HeldEstimate
from greybox.modeling.formulation.parameter_formulas import (
    evaluated,
    require_expressions,
    require_numbers,
)
from greybox.modeling.formulation.prior import Knowledge, NormalPrior
from greybox.modeling.formulation.resolved_parameters import (
    FixedValues,
    ResolvedParameters,
    StatedParameters,
    resolved_parameters,
)
from greybox.modeling.formulation.sum import Addable
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model, ParameterFormula, require_operating_point
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.parameter import Parameter, Parameters
from greybox.modeling.realization import dynamics


@public
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
        By default `MaximumLikelihood` for a response with variances, `RelativeError` (4.26) for
        one without, and `OutputError` for a record or a spectrum; a spectrum takes `EquationError`
        as well. In a sum with a likelihood the default for a response without variances is
        `RelativeLikelihood`, see `Sum`.
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
        likelihoods; the default for a response without variances is then `RelativeLikelihood`.

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
    free: Sequence[str] = ()
    tied: Mapping[str, ParameterFormula] = field(default_factory=dict)
    constraints: Sequence[ParameterFormula] = ()
    delay: str = "exact"
    at: Values = field(default_factory=dict)
    rename: Mapping[str, str] = field(default_factory=dict)
    weight: float = 1.0
    name: str = ""
    bounds: Mapping[str, Interval] = field(default_factory=dict)
    start: Values = field(default_factory=dict)
    starts: Mapping[str, Interval] = field(default_factory=dict)
    prior: Mapping[str, Knowledge] | HeldEstimate = field(default_factory=dict)

    # What follows from the fields above when the problem is made.
    has_default_criterion: bool = field(init=False, repr=False)
    resolved: ResolvedParameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Fill in the defaults, check that everything fits together, and resolve the parameters."""
        cure = "a model, then the data"
        if isinstance(self.model, type):
            cure = "an instance such as Tilt(), not the class"
        require_kind("model", self.model, Model, cure)
        kind_of(self.data)  # raises TypeError for anything that is not data
        self._fill_in_defaults()
        if not is_finite_number(self.weight) or self.weight <= 0:
            raise ValueError(f"weight {self.weight!r} must be a finite number above 0.")
        # An unknown word is refused here, not in the middle of a search.
        delay_order(self.delay)

        added = self._added_by_criterion()
        normalize(self, resolved=resolved_parameters(self.model, added, self._stated_parameters()))
        self._check_operating_point()
        self._check_functions()
        self._check_priors()

    def _fill_in_defaults(self) -> None:
        """Choose criterion and name, and give data, model and names their final form."""
        kind = self.kind
        usual = kind.usual_criterion(self.data)
        criterion = usual if self.criterion is None else self.criterion
        cure = f"a criterion such as {type(usual).__name__}(), for {kind.noun}"
        require_kind("criterion", criterion, kind.criterion_class, cure)

        normalize(
            self,
            criterion=criterion,
            has_default_criterion=self.criterion is None,
            free=as_names(self.free),
            name=self.name or kind.label(self.model, self.data),
        )
        normalize(
            self,
            model=kind.compared_model(self.model, self.data, criterion),
            data=kind.compared_data(self.data),
        )

    def _added_by_criterion(self) -> Parameters:
        """Return the parameters that the criterion adds to those of the model.

        Raises ValueError if model, data and criterion do not fit together.
        """
        added = self.kind.added_parameters(self.model, self.data, self.criterion)
        for name in added:
            if name in self.model.parameters:
                raise ValueError(
                    f"{self.model.label} declares {name!r}, which is also a parameter of the "
                    "criterion: rename it in the model."
                )

        return added

    def _stated_parameters(self) -> StatedParameters:
        """Return the statements about parameters, which are resolved together."""
        return StatedParameters(
            fixed=self.fixed,
            free=tuple(self.free),
            tied=self.tied,
            rename=self.rename,
            bounds=self.bounds,
            start=self.start,
            starts=self.starts,
            prior=self.prior,
        )

    def _check_operating_point(self) -> None:
        """Refuse an operating point that the data do not have, and unknown signals."""
        if self.at and not self.kind.has_operating_point:
            raise ValueError(
                f"at={dict(self.at)} is the operating point of a frequency response and this is "
                f"{self.kind.noun}: leave it out; known initial states go into "
                "OutputError(initial=...)."
            )
        require_operating_point(self.model, self.at)

    def _check_functions(self) -> None:
        """Evaluate ties, constraints and derived quantities once.

        A mistake in a formula is then named here, and is no error of CasADi in the search.
        """
        require_kind("constraints", self.constraints, list | tuple, "a list of functions")
        label = self.model.label
        functions: dict[str, ParameterFormula] = {}
        for name in self.tied:
            # The values below are complete: their ties are evaluated already.
            functions[f"tied[{name!r}]"] = itemgetter(name)
        for k, constraint in enumerate(self.constraints):
            functions[f"constraints[{k}]"] = constraint
        for name, formula in self.model.derived.items():
            functions[f"derived[{name!r}] of {label}"] = formula
        require_numbers(functions, self.local_starts)
        symbols = {name: ca.SX.sym(name) for name in self.parameters}
        require_expressions(functions, self.local_values(symbols))

    def _check_priors(self) -> None:
        """Require that a prior is added to a likelihood: other costs have another scale."""
        if self.priors and not (self.criterion.is_likelihood or self.has_default_criterion):
            raise ValueError(
                f"{self.priors[0].names[0]!r} has a prior, and the cost of "
                f"{type(self.criterion).__name__} is not a likelihood to which it could be added: "
                "leave the criterion out, or give RelativeLikelihood(), or MaximumLikelihood() "
                "where variances are known."
            )

    @property
    def kind(self) -> DataKind:
        """The kind of the data."""
        return kind_of(self.data)

    @property
    def declared(self) -> Parameters:
        """Parameters of model and criterion by their inner names, with their bounds and starts."""
        return self.resolved.declared

    @property
    def fixed_values(self) -> FixedValues:
        """Values of `fixed` by name: numbers and earlier fits."""
        return self.resolved.fixed_values

    @property
    def held_estimates(self) -> dict[str, HeldEstimate]:
        """Earlier fits among the fixed values, by outside name."""
        return self.resolved.held_estimates

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters by outside name, fixed or free as in this problem, without tied ones."""
        return self.resolved.by_outside_name

    @property
    def priors(self) -> tuple[NormalPrior, ...]:
        """Priors of the parameters, by outside name."""
        return self.resolved.priors

    @property
    def response(self) -> FrequencyResponse:
        """The data, if they are a frequency response."""
        assert isinstance(self.data, FrequencyResponse)
        return self.data

    @property
    def signals(self) -> dict[str, Any]:
        """Input and output of the response, its operating point, and the order of Padé delays."""
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

        It is also zero for a loop around a delay, which has no sampled form. And it is zero for a
        rate that was computed as s times the response of an angle: sampling folds back the angle.
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

    def local_values(self, values: Mapping[str, Any]) -> Names:
        """Return all parameters by inside name, from the untied ones by outside name.

        A tie may use the untied parameters and the ties before it.
        """
        local = {name: values[self.outside(name)] for name in self.resolved.untied}
        for name, tie in self.tied.items():
            values_so_far = Names(local, f"the problem {self.name!r}, at this tie,")
            local[name] = evaluated(tie, values_so_far, f"tied[{name!r}]")
        return Names({name: local[name] for name in self.declared}, self.model.label)

    @property
    def local_starts(self) -> Names:
        """Start values of all parameters by inside name."""
        return self.local_values({name: p.start for name, p in self.parameters.items()})

    def with_parts(self, parts: "Sequence[Problem]") -> "Problem":
        """Return the only part, see `Sum.with_parts`."""
        (part,) = parts
        return part

    def with_(self, **changes: Any) -> Self:
        """Return the problem with some fields changed; a criterion that was left out remains so."""
        # A default criterion is chosen again, because that of a sum may be another.
        if self.has_default_criterion:
            changes = {"criterion": None, **changes}
        return replace(self, **changes)

    def __repr__(self) -> str:
        return one_line(
            self, repr(self.name), f"{self.model.label} to {self.data!r:.60}", self.criterion.name
        )
