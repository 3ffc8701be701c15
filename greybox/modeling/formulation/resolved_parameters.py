"""The parameters of a problem: as its model and criterion declare them, with the problem's options.

A parameter has two names. Its inside name is that of the declaration, within the model. Its outside
name is that in the answer of a fit; the parts of a sum share a parameter by its outside name. The
two differ only if the problem renames the parameter.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import Interval
from greybox.data.files.named_values import Values, attributes, selected
from greybox.modeling.formulation.held_estimate import HeldEstimate, shared_parameters
from greybox.modeling.formulation.prior import Knowledge, NormalPrior, normal_priors
from greybox.modeling.formulation.restated_parameter import held_at, restated
from greybox.modeling.model import Model, ParameterFormula, require_known
from greybox.modeling.parameter import Parameter, Parameters

FixedValues = Mapping[str, float | HeldEstimate]
"""Numbers, or earlier fits whose estimate is the value, by name."""

RANGE_OPTIONS = ("bounds", "start", "starts")
"""Options for the values that a search may take, and where it begins: fields of the class below."""


@dataclass(frozen=True)
class StatedParameters:
    """What a problem states of its parameters, by inside name, as `Problem` describes it."""

    fixed: FixedValues | HeldEstimate
    free: tuple[str, ...]
    tied: Mapping[str, ParameterFormula]
    rename: Mapping[str, str]
    bounds: Mapping[str, Interval]
    start: Values
    starts: Mapping[str, Interval]
    prior: Mapping[str, Knowledge] | HeldEstimate


@dataclass(frozen=True)
class ResolvedParameters:
    """All parameters of a problem: declared, fixed, free or tied, by inside and outside name.

    Attributes
    ----------
    declared : mapping of inside name to Parameter
        All parameters with the bounds and starts of the problem. `fixed` is still what the model
        declares.
    untied : mapping of inside name to Parameter
        The parameters that are not tied, fixed or free as in the problem. A fixed one starts at its
        value.
    outside : mapping of inside name to outside name
    fixed_values : mapping of inside name to float or HeldEstimate
        The values that the problem fixes.
    priors : tuple of NormalPrior
        The priors of free parameters, by outside name.
    """

    declared: Parameters
    untied: Parameters
    outside: Mapping[str, str]
    fixed_values: FixedValues
    priors: tuple[NormalPrior, ...]

    # Stored, since it is looked up anew for every parameter.
    @cached_property
    def by_outside_name(self) -> dict[str, Parameter]:
        """The parameters that are not tied, by outside name."""
        return {self.outside[name]: parameter for name, parameter in self.untied.items()}

    @cached_property
    def held_estimates(self) -> dict[str, HeldEstimate]:
        """Earlier fits among the fixed values, by outside name."""
        held = {}
        for name, value in self.fixed_values.items():
            if isinstance(value, HeldEstimate):
                held[self.outside[name]] = value
        return held


def resolved_parameters(
    model: Model, criterion_parameters: Parameters, stated: StatedParameters
) -> ResolvedParameters:
    """Return the parameters of a model and its criterion as a problem states them.

    Raises
    ------
    ValueError
        For names that are not parameters, or that two options contradict, for values outside their
        bounds, and for two parameters with one outside name.
    TypeError
        For options of another kind.
    """
    label = model.label
    parameters = {**model.parameters, **criterion_parameters}

    _check_kinds(stated)
    outside = {name: stated.rename.get(name, name) for name in parameters}
    fixed_values = _fixed_values(stated.fixed, outside)
    _check_names(stated, fixed_values, parameters, label)

    declared = {}
    for name, parameter in parameters.items():
        declared[name] = _with_stated_range(name, parameter, stated, fixed_values, label)
    _check_outside_names(outside, label)

    untied = {}
    for name, parameter in declared.items():
        if name in fixed_values:
            value = _fixed_value(fixed_values[name], outside[name])
            untied[name] = held_at(name, parameter, value)
        elif name not in stated.tied:
            is_fixed = parameter.fixed and name not in stated.free
            untied[name] = replace(parameter, fixed=is_fixed)

    # Biases and gains of a criterion have no priors, and an earlier fit has no part in them.
    of_model = selected(untied, model.parameters)
    priors = tuple(normal_priors(of_model, stated.prior, outside))
    return ResolvedParameters(declared, untied, outside, fixed_values, priors)


def _check_kinds(stated: StatedParameters) -> None:
    """Require mappings where options are by name, and texts as new names."""
    for option, mapping in attributes(stated, "rename", *RANGE_OPTIONS).items():
        require_kind(option, mapping, Mapping, "{name of a parameter: ...}")

    for old, new in stated.rename.items():
        if not isinstance(new, str) or not new:
            raise TypeError(f"rename gives {old!r} the name {new!r}: give a string.")


def _fixed_values(fixed: Any, outside: Mapping[str, str]) -> FixedValues:
    """Return the fixed values by inside name; an earlier fit fixes all parameters that it has."""
    if isinstance(fixed, Mapping):
        return fixed
    require_kind("fixed", fixed, HeldEstimate, "{name: value} or a Fit")
    return shared_parameters(fixed, outside, "fixed")


def _check_names(
    stated: StatedParameters, fixed_values: FixedValues, parameters: Parameters, label: str
) -> None:
    """Require that options name parameters, and that none is two of fixed, free and tied."""
    roles = {"fixed": fixed_values, "free": stated.free, "tied": stated.tied}
    # A misspelled name would otherwise be ignored silently.
    for option, names in {**roles, **attributes(stated, "rename", *RANGE_OPTIONS)}.items():
        require_known(names, parameters, "parameter", f"{option}: {label}")

    for role, other_role in combinations(roles, 2):
        for name in roles[role]:
            if name in roles[other_role]:
                raise ValueError(f"{name!r} is both {role} and {other_role}: keep one of them.")


def _with_stated_range(
    name: str,
    parameter: Parameter,
    stated: StatedParameters,
    fixed_values: FixedValues,
    label: str,
) -> Parameter:
    """Return a declared parameter with the bounds, start and start box that the problem states."""
    changes = {}
    for option, values in attributes(stated, *RANGE_OPTIONS).items():
        if name in values:
            changes[option] = values[name]

    # A parameter that is never estimated would ignore these options silently.
    has_start = name in stated.start or name in stated.starts
    if name in stated.tied and has_start:
        raise ValueError(f"{name!r} is tied, so that it has no start of its own: leave it out.")
    has_role = name in fixed_values or name in stated.free or name in stated.tied
    if changes and parameter.fixed and not has_role:
        raise ValueError(
            f"{' and '.join(changes)} names {name!r}, which {label} declares fixed: "
            f"give free=[{name!r}] to estimate it, or fixed={{{name!r}: ...}} to hold it at "
            "another value."
        )

    return restated(name, parameter, **changes)


def _check_outside_names(outside: Mapping[str, str], label: str) -> None:
    """Require different outside names: two parameters would become one unknown by accident."""
    names = [*outside.values()]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"rename gives two parameters of {label} the name {name!r}: use "
                "tied to make them equal."
            )


def _fixed_value(value: Any, outside: str) -> Any:
    """Return a fixed value; an earlier fit has the parameter under its outside name."""
    if not isinstance(value, HeldEstimate):
        return value
    require_known([outside], value.estimate, "estimate", "the Fit given as fixed")
    return value.estimate[outside]
