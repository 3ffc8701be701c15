"""Loops of a fitted plant: at its estimate, and at draws from the distribution of its parameters.

Begin with `drawn_loops`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from greybox.data.intersample import NO_HOLD
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.fitted_problem import compiled_again
from greybox.estimate.result import Fit
from greybox.experiment.controller import Controller
from greybox.experiment.sampled_loop import SampledLoop, sampled_loop
from greybox.files.arrays import Array
from greybox.modeling.model import Model
from greybox.solve.multistart import solver_for

DRAWS = 512  # a quantile of 2.5 % is then known to 4 % of a standard error
DRAWN = slice(1, 1 + DRAWS)  # the plants of a loop that are draws
BESIDE = slice(1 + DRAWS, None)  # those that differ in what the data do not determine

LONGEST = 4.0  # times a step: the error of a lag of half its value is that much larger upward


def drawn_loops(
    plant: Fit | Model,
    controller: Controller | Sequence[Controller],
    values: Mapping[str, float] | None = None,
    *,
    at: Mapping[str, float] | None,
    part: int,
) -> SampledLoop:
    """Return the loops of the estimate, of draws from its distribution, and of plants near it.

    The last ones differ from the estimate in directions about which the data say nothing. A model
    has one loop.

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is neither, and for values given with a fit.
    """
    model, center, known = plant_of_loop(plant, values, at=at, part=part)
    rows = _draws(plant, [*center]) if isinstance(plant, Fit) else np.array([[*center.values()]])
    return sampled_loop(model, rows, controller, **known)


def plant_of_loop(
    plant: Fit | Model,
    values: Mapping[str, float] | None,
    *,
    at: Mapping[str, float] | None,
    part: int,
) -> tuple[Model, dict[str, float], dict[str, Any]]:
    """Return the model, its values by the names of the fit, and what `sampled_loop` needs to know.

    Raises
    ------
    ValueError
        If the fit has no estimate.
    TypeError
        For a plant that is neither, and for values given with a fit.
    """
    if not isinstance(plant, (Fit, Model)):
        raise TypeError(f"{plant!r:.60} has no loop: give a Fit, or a model with its values.")
    if isinstance(plant, Model):
        center = {name: float(value) for name, value in plant.values(values).items()}
        return plant, center, {"at": at}
    if values is not None:
        raise TypeError("values were given with a Fit, which has its own: leave them out.")
    if not plant.converged:
        raise ValueError(f"the fit {plant.name!r} has no estimate: {plant.status}.")

    model, fitted = plant.model_of(part), plant.parts[part]
    is_response = isinstance(fitted, FittedResponse)
    names = [fitted.rename.get(name, name) for name in model.parameters]
    center = {name: plant.by_name[name].value for name in names}
    has_hold = is_response and NO_HOLD not in fitted.data.about
    return (
        model,
        center,
        {
            "at": fitted.at if is_response and not at else at,
            "delay_has": "hold" if has_hold else "nothing",
        },
    )


def _draws(fit: Fit, names: Sequence[str]) -> Array:
    """Return values (plants, parameters): the estimate, draws from its distribution, others.

    The others differ from the estimate in directions about which the data say nothing.
    """
    from scipy.special import chdtri, ndtri  # noqa: PLC0415  (takes a tenth of a second to import)
    from scipy.stats import qmc  # noqa: PLC0415  (takes a third of a second to import)

    # The cost depends on every parameter of the fit, also on those of its other parts.
    known = fit.known_directions(fit.names)
    lines = [fit.by_name[name] for name in fit.names]
    center = np.array([line.value for line in lines])
    variances, axes = np.linalg.eigh(known.covariance)
    root = axes * np.sqrt(np.maximum(variances, 0))
    dof = fit.fewest_degrees(names)

    shares = qmc.Sobol(len(lines) + 1, rng=np.random.default_rng(0)).random(DRAWS)
    shares = np.clip(shares, 1e-9, 1 - 1e-9)
    normal = ndtri(shares[:, :-1]) @ root.T
    widening = np.sqrt(dof / chdtri(dof, shares[:, -1])) if math.isfinite(dof) else np.ones(DRAWS)
    steps = normal * widening[:, None] - np.array([line.bias for line in lines])
    limits = np.array([line.bounds for line in lines]).T

    def drawn(steps: Array) -> Array:
        return _within(limits, center + steps, known.covariance)

    values = drawn(_lengths(fit, steps, drawn)[:, None] * steps)
    beside = np.clip(center + 0.1 * (known.size[:, None] * known.unseen).T, *limits)
    return np.vstack([center, values, beside])[:, [fit.names.index(name) for name in names]]


def _lengths(fit: Fit, steps: Array, drawn: Callable[[Array], Array]) -> Array:
    """Return factors (draws,) that lengthen steps (draws, k) from the estimate to their likelihood.

    With its factor the cost has risen as much as the standard errors predict for the step. Along
    one parameter that is its profile: where its errors are not symmetric, or a pole cannot pass
    zero, the draws follow. Fits whose problem cannot be compiled again keep their steps. `drawn`
    returns the values (m, k) at steps (m, k).
    """
    unchanged = np.ones(len(steps))
    if fit.white is None:
        return unchanged
    try:
        problem = compiled_again(fit)
    except (ValueError, LookupError):
        return unchanged

    p = len(fit.free)
    size = np.sqrt(np.diag(fit.white))
    size[size == 0] = 1  # of a parameter of which the data say nothing
    variances, axes = np.linalg.eigh(fit.white / np.outer(size, size))
    is_seen = variances > 1e-12 * variances.max()
    scale = np.sqrt(variances[is_seen])
    axes = axes[:, is_seen]
    # The square of a step in these coordinates is twice the rise of a quadratic cost.
    coordinates = steps[:, :p] / size @ axes / scale
    predicted = np.sum(coordinates**2, axis=1) / 2

    has_records = len(fit.responses) < len(fit.parts)
    simulated = solver_for(problem).cost if has_records else problem.cost

    def costs(steps: Array) -> Array:
        x = drawn(steps)[:, :p]
        if has_records:
            return np.array([simulated(values) for values in problem.all_values(x)])
        return problem.costs(x)

    lowest = costs(np.zeros((1, steps.shape[1])))

    def ratio(steps: Array, predicted: Array) -> Array:
        """Return how many times as fast the root of the cost rises as predicted."""
        # A model without a response there is as unlikely as can be.
        rise = np.nan_to_num((costs(steps) - lowest) / predicted, nan=1e6)
        return np.sqrt(np.maximum(rise, 0))

    if not has_records:
        return _roots(ratio, steps, predicted)

    # Costs take simulations: two standard errors along every axis, in both directions.
    length = 2 * np.sqrt(np.mean(coordinates**2, axis=0))
    ends = np.zeros((2 * len(length), steps.shape[1]))
    ends[:, :p] = np.kron([[1], [-1]], (size[:, None] * axes * scale * length).T)
    expected = np.tile(length**2 / 2, 2)
    rates = ratio(ends, expected)
    # There the cost is no parabola, not even a lopsided one.
    is_odd = np.abs(rates - 1) > 1 / 3
    roots = _roots(ratio, ends[is_odd], expected[is_odd])
    rates[is_odd] = 1 / np.maximum(roots, 1 / LONGEST)
    rate = np.where(coordinates > 0, *rates.reshape(2, -1))
    return np.sqrt(2 * predicted / np.sum((coordinates * rate) ** 2, axis=1))


def _roots(ratio: Callable[[Array, Array], Array], steps: Array, predicted: Array) -> Array:
    """Return the factors of steps (n, k) at which `ratio` is one."""
    from scipy.optimize import elementwise  # noqa: PLC0415  (takes a tenth of a second to import)

    def excess(lengths: Array, places: Array) -> Array:
        rows = places.astype(int)
        return ratio(lengths[:, None] * steps[rows], predicted[rows]) - 1

    places = np.arange(len(steps))
    ends = 0.0 * places, LONGEST + 0.0 * places
    root = elementwise.find_root(excess, ends, args=(places,), tolerances={"xatol": 0.01})
    # Where the cost remains low, a bound is met, or the data say nothing.
    return np.nan_to_num(root.x, nan=LONGEST)


def _within(limits: Array, values: Array, covariance: Array) -> Array:
    """Move values (n, p) to the bounds (2, p) that they pass, and correlated ones with them."""
    # Clipped alone, a parameter would leave the combinations that the data determine.
    for _ in range(2):
        for k, (low, high) in enumerate(limits.T):
            beyond = values[:, k] - np.clip(values[:, k], low, high)
            if beyond.any():
                values = values - beyond[:, None] * covariance[k] / covariance[k, k]
    return np.clip(values, *limits)
