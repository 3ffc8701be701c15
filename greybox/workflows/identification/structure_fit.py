"""The fit of one structure to measured responses, within bounds that do not limit it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from greybox.assessment.fit import fit
from greybox.assessment.result import Fit, Quantity
from greybox.data.files.arrays import Interval
from greybox.data.files.named_values import Values
from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.formulation.frequency_criteria import MaximumLikelihood, RelativeLikelihood
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.signal_units import as_the_only_pair
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.model import Model

# A bound that holds a parameter is moved by this factor, at most three times: six decades in all.
FACTOR = 100.0

# The start of least squares is close to a minimum. IPOPT would otherwise begin by moving toward
# the middle between the bounds, which are decades apart.
NEAR_MINIMUM = {"mu_init": 1e-5, "bound_push": 1e-8, "bound_frac": 1e-8}

STATED = ("fixed", "free", "bounds", "start")


@dataclass(frozen=True)
class Structure:
    """A model to fit, its name on the command line, and parameters to free."""

    model: Model
    name: str
    free: Sequence[str] = ()


def problem_of_structure(
    model: Model, responses: Sequence[FrequencyResponse], **options: Any
) -> Problem | Sum[Problem]:
    """Return the problem of a model and the responses of its only pair, by maximum likelihood."""
    parts = tuple(
        Problem(
            model,
            as_the_only_pair(model, response),
            RelativeLikelihood() if response.variance is None else MaximumLikelihood(),
            **options,
        )
        for response in responses
    )
    return parts[0] if len(parts) == 1 else Sum(parts)


def stated_for(model: Model, stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options, limited to the parameters that a model has."""
    unknown = [name for name in stated if name not in STATED]
    if unknown:
        raise TypeError(f"there is no option {unknown[0]!r}; there are {', '.join(STATED)}.")
    options: dict[str, Any] = {}
    for what, values in stated.items():
        names = [name for name in values if name in model.parameters]
        options[what] = names if what == "free" else {name: values[name] for name in names}
    return options


def fit_within_far_bounds(
    model: Model,
    responses: Sequence[FrequencyResponse],
    point: Values,
    *,
    bounds: Mapping[str, Interval],
    stated: Mapping[str, Any],
) -> Fit:
    """Fit a structure, and widen a bound that holds a parameter, unless it is zero or `stated`.

    A delay or a time constant of zero is where its term is absent. `stated` are options of
    `Problem`.
    """
    of_user = stated.get("bounds", {})
    options = {**stated, "bounds": {**bounds, **of_user}}
    widenings = 0
    # One widening is not enough for gains in µs or degrees, which are decades off.
    while True:
        problem = problem_of_structure(model, responses, **options)
        result = fit(problem, [point], solver_options=NEAR_MINIMUM, profiles=False, progress=False)
        held = [q for q in result.quantities if q.at_bound and q.name not in of_user]
        wider = {q.name: moved for q in held if (moved := _wider(q)) != q.bounds}
        if not wider or widenings == 3:
            return result
        options["bounds"] |= wider
        widenings += 1


def _wider(quantity: Quantity) -> Interval:
    low, high = quantity.bounds
    if quantity.value - low < high - quantity.value:
        return (low * FACTOR if low < 0 else low / FACTOR, high)
    return (low, high * FACTOR if high > 0 else high / FACTOR)
