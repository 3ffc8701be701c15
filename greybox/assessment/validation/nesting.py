"""Whether one fit contains another, and at which values of its further parameters.

The criterion says whether it contains the other one, and so may the class of the model. Where the
class leaves it open, the formulas must be the same where the further parameters are zero.
"""

from collections.abc import Sequence

from greybox.assessment.fitted_part import FittedPart
from greybox.assessment.fitted_problem import KINDS, has_included_criterion
from greybox.assessment.result import Fit
from greybox.assessment.validation.same_data import count_unknowns
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values, selected, without
from greybox.data.files.wording import listed
from greybox.modeling.formulation.criterion import AnyCriterion
from greybox.modeling.model import Model, require_known
from greybox.modeling.model_reference import NO_VALUES, same_formulas
from greybox.modeling.traced_once import traced_once


class NotNestedError(ValueError):
    """The reason why one model is not another one with parameters removed."""


@frozen
class _Pair:
    """A part of the smaller fit and the same part of the larger one, with their models.

    An *inside* name of a parameter is that within a part, an *outside* name that in the fit.
    """

    small: FittedPart
    large: FittedPart
    small_model: Model
    large_model: Model

    @property
    def shared(self) -> list[str]:
        """Inside names of the parameters that both parts have."""
        of_small = {*self.small_model.parameters, *self.small.added}
        of_large = (*self.large_model.parameters, *self.large.added)
        return [name for name in of_large if name in of_small]

    @property
    def further(self) -> list[str]:
        """Inside names of the parameters that only the larger model has."""
        of_small = self.small_model.parameters
        return [name for name in self.large_model.parameters if name not in of_small]


@traced_once()
def nested_values(
    small: Fit, large: Fit, labels: tuple[str, str], at: Values = NO_VALUES
) -> Values:
    """Return the values at which the parameters that only `large` has free make it `small`.

    `at` are values that the user states for parameters that the model of `small` lacks.

    Raises
    ------
    NotNestedError
        If there are no such values, or they are not known.
    ValueError
        If the models are nested, but have no valid test, or for another name in `at`.
    LookupError
        If a loaded fit does not know its model.
    """
    parts = [*zip(small.parts, large.parts, strict=True)]
    if not all(_differ_in_parameters_alone(a, b) for a, b in parts):
        raise NotNestedError(
            f"{' and '.join(labels)} differ in their criteria, delays, ties or other settings"
        )
    # The smaller criterion estimates the noise of the sensors, too, but not as parameters.
    implicit = set()
    for small_part, large_part in parts:
        for name in large_part.sensor_noise:
            if name not in small_part.added:
                implicit.add(large_part.outside(name))
    terms = [name for name in large.free if name not in {*small.free, *implicit}]
    if not terms or count_unknowns(large) <= count_unknowns(small):
        raise NotNestedError(f"{labels[1]} estimates no more numbers than {labels[0]}")

    pairs = []
    for k, (small_part, large_part) in enumerate(parts):
        pairs.append(_Pair(small_part, large_part, small.model_of(k), large.model_of(k)))
    further = [pair.large.outside(name) for pair in pairs for name in pair.further]
    require_known(at, further, "term", labels[1])
    values = _held_values(pairs, small, large, labels)
    for pair in pairs:
        values |= _removing_values(pair, small, large, labels, at)

    values = {name: values[name] for name in terms}
    _require_effect(pairs, values, labels)
    return values


# --- settings and criteria


def _differ_in_parameters_alone(small: FittedPart, large: FittedPart) -> bool:
    """Return whether two parts differ in nothing but their models and further parameters."""

    def settings(part: FittedPart) -> list[object]:
        return [part.delay, part.weight, sorted(part.constraints), part.at]

    return (
        _contains_criterion(large, small)
        and large.tied in ({}, small.tied)
        and settings(large) == settings(small)
    )


def _contains_criterion(large: FittedPart, small: FittedPart) -> bool:
    """Return whether the criterion of a part contains that of a smaller one."""
    if large.has_criterion_of(small):
        return True
    # A fit knows a criterion of the user's by its name and settings alone.
    if not (has_included_criterion(large) and has_included_criterion(small)):
        return False

    def criterion(part: FittedPart) -> AnyCriterion:
        # Functions of initial states are stored as text, from which no criterion can be made.
        return KINDS[part.criterion_class](**without(part.settings, ("initial",)))

    has_same_initial = large.settings.get("initial") == small.settings.get("initial")
    return has_same_initial and criterion(large).contains(criterion(small))


# --- values of parameters


def _held_values(
    pairs: list[_Pair], small: Fit, large: Fit, labels: tuple[str, str]
) -> dict[str, float]:
    """Return the values in the smaller fit of the parameters that both have."""
    values: dict[str, float] = {}
    sources: dict[str, str] = {}
    names = [(p.small.outside(n), p.large.outside(n)) for p in pairs for n in p.shared]
    for source, target in names:
        if sources.setdefault(target, source) != source:
            raise NotNestedError(
                f"{labels[1]} has one {target} where {labels[0]} has {sources[target]} and {source}"
            )
        value = small.estimate[source]
        is_held = large.by_name[target].kind == "fixed"
        is_same = small.by_name[source].kind == "fixed" and value == large.estimate[target]
        if is_held and not is_same:
            raise NotNestedError(f"{labels[1]} has {target} fixed, and {labels[0]} has not")
        values[target] = value

    return values


def _removing_values(
    pair: _Pair, small: Fit, large: Fit, labels: tuple[str, str], at: Values
) -> dict[str, float]:
    """Return the values at which the parameters of one part that `small` lacks have no effect."""
    inside_values = _values_of_model(pair, small, large, labels, at)
    # Biases, gains and process noise are absent at zero.
    not_removed = {*pair.small.added, *pair.large.sensor_noise}
    for name in pair.large.added:
        if name not in not_removed:
            inside_values[name] = 0.0

    values = {pair.large.outside(name): value for name, value in inside_values.items()}
    for name, value in values.items():
        quantity = large.by_name[name]
        low, high = quantity.bounds
        is_possible = low <= value <= high if name in large.free else quantity.value == value
        if not is_possible:
            raise NotNestedError(
                f"{labels[1]} cannot have {name} = {value:g}: it is fixed or bounded elsewhere"
            )
    return values


def _values_of_model(
    pair: _Pair, small: Fit, large: Fit, labels: tuple[str, str], at: Values
) -> dict[str, float]:
    """Return the values, by name in the model, at which the larger model is the smaller one.

    Further parameters are zero, or as the larger fit holds them, unless the user or the class of
    the model states other values.
    """
    outside = {name: pair.large.outside(name) for name in pair.further}
    usual = {}
    for name, outside_name in outside.items():
        is_free = outside_name in large.free
        usual[name] = 0.0 if is_free else large.estimate[outside_name]
    if at:
        return usual | {name: at[o] for name, o in outside.items() if o in at}
    stated = pair.large_model.contains(pair.small_model)
    if stated is not None:
        return usual | dict(stated)

    fixed = {}
    for name in pair.small_model.parameters:
        outside_name = pair.small.outside(name)
        if small.by_name[outside_name].kind == "fixed":
            fixed[name] = small.estimate[outside_name]
    values = usual | selected(fixed, pair.shared)
    is_same_model = pair.small.model == pair.large.model
    if is_same_model or same_formulas(pair.large_model, pair.small_model, values, fixed):
        return usual
    reason = f"{labels[1]} is not {labels[0]}"
    free = [name for name, o in outside.items() if o in large.free]
    if free:
        reason += f" where {listed(free)} is 0; if it is elsewhere, state it: at={{name: value}}"
    raise NotNestedError(reason)


def _require_effect(pairs: list[_Pair], values: Values, labels: Sequence[str]) -> None:
    """Raise ValueError if a term has no effect where the other terms have their values.

    The ratio then does not have the distribution of the test: Davies (1977), Biometrika 64.
    """
    if len(values) == 1:
        return
    without_effect = []
    for name in values:
        changed_value = values[name] + 0.1 * max(abs(values[name]), 1.0)
        effects = []
        for pair in pairs:
            model, outside = pair.large_model, pair.large.outside
            inside = {n: values[outside(n)] for n in model.parameters if outside(n) in values}
            changed = {n: changed_value for n in inside if outside(n) == name}
            if changed:
                effects.append(not same_formulas(model, model, inside | changed, inside))
        if effects and not any(effects):
            without_effect.append(name)

    if without_effect:
        names = listed(without_effect)
        raise ValueError(
            f"{names} of {labels[1]} has no effect where the other terms are as in "
            f"{labels[0]}, so no nested test is valid: fix {names} to test the others."
        )
