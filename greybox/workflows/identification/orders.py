"""Rational transfer functions of rising order: which of them a measured response supports."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from greybox.assessment.fit import fit
from greybox.assessment.fitted_problem import problem_of
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array, ComplexArray, sum_of_squares
from greybox.data.files.named_values import Values, selected
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.regression.levy import coefficients, ratio, reweighted
from greybox.engine.regression.poles_and_zeros import near_pairs, root_text
from greybox.modeling.factored_form import upper_half
from greybox.modeling.formulation.starts import Sobol
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import require_known
from greybox.modeling.model_reference import included_model
from greybox.modeling.rational import Rational
from greybox.modeling.transfer_function import TransferFunction
from greybox.workflows.identification.selection import (
    UNSTABLE,
    Candidate,
    Selection,
    held_by_bounds,
    select,
)
from greybox.workflows.identification.structure_fit import fit_within_far_bounds, stated_for

# Largest default orders. More poles besides the integrators can seldom be distinguished in two
# decades of frequency.
POLES = 4
ZEROS = 2
INTEGRATORS = 2

# Phase in rad by which the longest of the delays that are tried first turns the highest frequency:
# more than one turn. The number of delays makes their steps narrower than a minimum is wide.
TURN = 8.0
DELAYS = 16
# Longest delay of all that are tried, over the longest of the first ones.
LONGEST = 8
# A remark; the errors of such a structure are those of a plant without a delay.
NO_DELAY = "without its delay, which ended at zero"
# Further starts of the chosen structure, which show whether its minimum is the lowest.
STARTS = 20
# Differences of BIC from the least above which a structure is not fitted by maximum likelihood.
NEAR = 10.0
# Fits by linear least squares of one size that are fitted by maximum likelihood: for random
# vehicles, least squares come within 1 of the least chi-square (`benchmarks/random_vehicles.py`).
BEST_OF_SIZE = 2
# Iterations of Sanathanan and Koerner, after which the coefficients have converged.
ITERATIONS = 8


@dataclass(frozen=True)
class Orders:
    """The structure of a rational transfer function.

    Attributes
    ----------
    n, m : int
        Orders of the denominator, integrators included, and of the numerator.
    integrators : int
    delay : bool
        Whether the structure has a delay.
    """

    n: int
    m: int
    integrators: int
    delay: bool = True

    @property
    def parameters(self) -> int:
        """The number of parameters of the structure."""
        delays = 1 if self.delay else 0
        return self.n - self.integrators + self.m + 1 + delays

    def __str__(self) -> str:
        text = f"n = {self.n}, m = {self.m}"
        if self.integrators:
            text += f", {counted(self.integrators, 'integrator')}"
        return f"{text}, delay" if self.delay else text


class LinearFit(NamedTuple):
    """BIC of a structure by linear least squares, and its coefficients at the best delay."""

    bic: float
    start: Values


class _LeastSquares(NamedTuple):
    """The weighted sum of squared errors of a structure, and its coefficients."""

    squares: float
    values: Values


def linear_fits(
    responses: Sequence[FrequencyResponse],
    through: Sequence[TransferFunction] = (),
    structures: Sequence[Orders] = (),
) -> dict[Orders, LinearFit]:
    """Fit structures by linear least squares, by default those of `select_orders`."""
    numbers = 2 * sum(map(len, responses))
    grid = [o for o in structures or orders_of() if o.parameters + 1 < numbers]
    if not grid:
        raise ValueError(
            f"no structure of the grid has fewer unknowns than {numbers} real numbers: lower n."
        )
    # Least squares only choose the orders that all responses are fitted with: the longest response
    # is enough, divided by the filters that follow the plant. Common errors are left out, since
    # one variance per point cannot represent them.
    longest = max(responses, key=len)
    gain = math.prod(frequency_response(f, None, longest.omega).response for f in through)
    variance = None if longest.variance is None else longest.variance / np.abs(gain) ** 2
    plant = replace(
        longest, response=longest.response / gain, variance=variance, common_errors=None
    )
    least_squares = {orders: _linear_fit(plant, orders) for orders in grid}
    # Errors beyond the given variances count as in `select`.
    least = min(solution.squares for solution in least_squares.values())
    inflation = max(1.0, least / len(plant))
    fits = {}
    for orders, solution in least_squares.items():
        bic = 2 * solution.squares / inflation + orders.parameters * math.log(numbers)
        fits[orders] = LinearFit(bic, solution.values)
    return fits


def best_response(fits: Mapping[Orders, LinearFit], omega: Array) -> ComplexArray:
    """Return the response of the structure of least BIC at `omega` (n,) in rad/s."""
    orders = min(fits, key=lambda orders: fits[orders].bic)
    values = fits[orders].start
    numerator, denominator = _polynomials(orders, values)
    return ratio(numerator, denominator, omega) * np.exp(-1j * omega * values["T_delay"])


@public
def select_orders(  # noqa: PLR0913 - every choice that an analyst makes
    data: FrequencyResponse | Sequence[FrequencyResponse],
    n: Sequence[int] = (),
    m: Sequence[int] = (),
    integrators: Sequence[int] = (),
    *,
    delay: bool = True,
    through: Sequence[TransferFunction] = (),
    linear: Mapping[Orders, LinearFit] | None = None,
    starts: int = STARTS,
    seed: int = 0,
    **stated: Any,
) -> Selection:
    """Fit rational transfer functions (2.13) of rising order, and choose the smallest supported.

    Nothing is assumed of the plant: signs and scales come from the response, by weighted linear
    least squares (`greybox.engine.regression.levy`) at the best delay. The structures that come
    close to the best are fitted by maximum likelihood: `MaximumLikelihood` where the data have
    variances, otherwise `RelativeLikelihood`. A bound that a parameter touches is widened. A delay
    that ends at zero is left out and named: the errors are then those of a plant without a delay,
    whose intervals contained 96 % of 239 coefficients of vehicles without one. The chosen structure
    is fitted again from other starts, which show whether its minimum is the lowest.

    Parameters
    ----------
    data : FrequencyResponse, or sequence of them
        Several of one plant are fitted together.
    n, m, integrators : sequence of int
        Orders of the denominator (integrators included) and of the numerator, and numbers of
        integrators. By default up to four poles, two zeros and two integrators.
    delay : bool
        Whether the structures have a delay.
    through : sequence of TransferFunction
        Filters in series with the plant.
    linear : mapping of Orders to LinearFit, optional
        The structures with their starts, instead of those of the grid.
    starts, seed : int
        Number of the other starts of the chosen structure, and their seed.
    **stated
        `fixed`, `bounds` and `start` of parameters, as in `Problem`: ``b0`` and ``a0`` upwards, and
        ``T_delay``.

    Raises
    ------
    ValueError
        If no structure of the grid has fewer unknowns than the data have numbers.
    """
    responses = [data] if isinstance(data, FrequencyResponse) else list(data)
    linear = linear or linear_fits(responses, through, orders_of(n, m, integrators, delay=delay))
    names = chain.from_iterable(fit.start for fit in linear.values())
    require_known(chain.from_iterable(stated.values()), names, "parameter", "the grid")
    near = _near_the_best(linear)
    candidates = []
    for orders in near:
        start = linear[orders].start
        candidate = _candidate(responses, orders, start, through, stated)
        candidates.append(candidate)
        if _delay_ended_at_zero(candidate.fit):
            without_delay = replace(orders, delay=False)
            undelayed = _candidate(responses, without_delay, start, through, stated)
            candidates[-1] = replace(undelayed, remarks=(NO_DELAY, *undelayed.remarks))
        # A stable plant with less delay may be another minimum, which `select` prefers unless it
        # is much higher; sometimes it is much lower.
        if candidate.unstable and (start := _stable_start(orders, candidate.fit.estimate)):
            stable = _candidate(responses, orders, start, through, stated)
            if not stable.unstable:
                candidates.append(stable)
    rejected = len(linear) - len(near)
    notes = []
    if rejected:
        notes.append(f"{counted(rejected, 'other structure')} had a higher BIC by least squares.")
    if any(orders.delay for orders in linear):
        longest = TURN / max(responses, key=len).omega.max()
        notes.append(
            f"{DELAYS} delays from 0 to {longest:.2g} s were tried, and longer ones where the "
            "longest was the best."
        )
    # The table lists the candidates in the order of their sizes.
    candidates.sort(key=lambda c: (len(c.fit.free), c.fit.cost))
    return _confirmed(select(candidates, "\n".join(notes)), Sobol(starts, seed))


def _near_the_best(linear: Mapping[Orders, LinearFit]) -> list[Orders]:
    """Return the structures near the least BIC, and of one size only the best ones."""
    least = min(linear_fit.bic for linear_fit in linear.values())
    near = []
    for orders, (bic, _) in linear.items():
        better = 0
        for other, (other_bic, _) in linear.items():
            if other.parameters == orders.parameters and other_bic < bic:
                better += 1
        if bic - least <= NEAR and better < BEST_OF_SIZE:
            near.append(orders)
    return near


def _delay_ended_at_zero(fit: Fit) -> bool:
    """Return whether the delay of a fit ended at its lower bound."""
    delay = fit.by_name.get("T_delay")
    return delay is not None and delay.at_bound and delay.value < 0.5 * delay.bounds[1]


def _confirmed(selection: Selection, others: Sobol) -> Selection:
    """Return the selection with other starts of the chosen structure that reach its minimum."""
    chosen = selection.chosen
    if chosen is None:
        return selection
    searched = fit(
        problem_of(chosen.fit),
        [selected(chosen.fit.estimate, chosen.fit.free), others],
        profiles=False,
        progress=False,
    )
    # The first run begins at the estimate. A lower minimum may be one that the selection refused,
    # such as an unstable plant.
    if not (searched.minima and 0 in searched.minima[0].runs):
        return selection
    confirmed = replace(chosen, fit=searched)
    candidates = [confirmed if c is chosen else c for c in selection.candidates]
    return replace(selection, candidates=tuple(candidates), chosen=confirmed)


def orders_of(
    n: Sequence[int] = (),
    m: Sequence[int] = (),
    integrators: Sequence[int] = (),
    *,
    delay: bool = True,
) -> list[Orders]:
    """Return the structures of a grid; see `select_orders`."""
    structures = []
    for count in integrators or range(INTEGRATORS + 1):
        for order in n or range(max(count, 1), count + POLES + 1):
            for zeros in m or range(ZEROS + 1):
                # The plant is strictly proper.
                if zeros < order and count <= order:
                    structures.append(Orders(order, zeros, count, delay))
    return structures


def _polynomials(orders: Orders, values: Values) -> tuple[list[float], list[float]]:
    """Return numerator and denominator, the highest power first."""
    numerator = [values[f"b{k}"] for k in range(orders.m, -1, -1)]
    denominator = [values.get(f"a{k}", 0.0) for k in range(orders.n - 1, -1, -1)]
    return numerator, [1.0, *denominator]


def _linear_fit(data: FrequencyResponse, orders: Orders) -> _LeastSquares:
    """Return the least weighted squares over the delay, and the coefficients there."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415  (slow to import)

    def at(delay: float) -> _LeastSquares:
        [fit] = _at_delays(data, orders, np.array([delay]))
        return fit

    if not orders.delay:
        return at(0.0)
    first_longest = TURN / float(data.omega.max())
    longest = first_longest
    while True:
        grid = np.linspace(0.0, longest, DELAYS)
        best = np.argmin([fit.squares for fit in _at_delays(data, orders, grid)])
        if best < DELAYS - 1 or longest > LONGEST * first_longest:
            break
        longest *= 2

    neighbors = grid[max(best - 1, 0) : best + 2]
    refined = minimize_scalar(
        lambda delay: at(delay).squares,
        bounds=(neighbors[0], neighbors[-1]),
        method="bounded",
        options={"maxiter": 20},
    )
    return at(refined.x)


def _at_delays(data: FrequencyResponse, orders: Orders, delays: Array) -> list[_LeastSquares]:
    """Return the least squares for every delay."""
    # Without variances, errors are taken as relative, as `RelativeLikelihood` takes them.
    size = np.abs(data.response) if data.variance is None else np.sqrt(data.variance)
    unknowns = orders.parameters - (1 if orders.delay else 0)
    if 2 * len(data) <= unknowns or not np.all(size > 0):
        return [_LeastSquares(math.inf, {})] * len(delays)

    # The response without each delay, (delays, n).
    undelayed = data.response * np.exp(1j * data.omega * delays[:, None])
    weight = np.broadcast_to(1 / size, undelayed.shape)
    structure = (orders.n, orders.m, orders.integrators)
    numerators, denominators, *_ = reweighted(data.omega, undelayed, structure, weight, ITERATIONS)
    fits = []
    for k, delay in enumerate(delays):
        numerator, denominator = numerators[k], denominators[k]
        error = (ratio(numerator, denominator, data.omega) - undelayed[k]) / size
        values = dict(coefficients(numerator, denominator, orders.integrators))
        if orders.delay:
            values["T_delay"] = float(delay)
        fits.append(_LeastSquares(sum_of_squares(error), values))
    return fits


def _candidate(
    responses: Sequence[FrequencyResponse],
    orders: Orders,
    start: Values,
    through: Sequence[TransferFunction],
    stated: Mapping[str, Any],
) -> Candidate:
    """Fit a structure by maximum likelihood."""
    polynomial: Any = included_model("greybox.models.polynomial", "Polynomial")
    highest = max(float(response.omega.max()) for response in responses)
    gain = max(float(np.max(np.abs(response.response))) for response in responses)
    plant = polynomial(
        orders.n,
        orders.m,
        orders.integrators,
        # Poles and zeros more than ten times above the highest frequency are constants there.
        radius=10 * highest,
        starts=highest,
        input=responses[0].input or "u",
        output=responses[0].output or "y",
        delay=3 * max(start.get("T_delay", 0.0), TURN / highest) if orders.delay else 0.0,
    )
    options = stated_for(plant, stated)
    bounds = {}
    for name, parameter in plant.parameters.items():
        if name != "T_delay":
            _, size = parameter.bounds
            # The model's bounds of the numerator are for a gain of one.
            if name.startswith("b"):
                size *= 10 * gain
            size = max(size, 100 * abs(start[name]))
            bounds[name] = (-size, size)
    fixed = options.get("fixed", {})
    point = {name: start[name] for name in plant.parameters if name not in fixed}
    model = plant
    for other in through:
        model = model.through(other)
    result = fit_within_far_bounds(
        model,
        responses,
        point | options.get("start", {}),
        bounds=bounds,
        stated=options,
    )
    return Candidate(str(orders), result, *_described(orders, result))


def _stable_start(orders: Orders, values: Values) -> Values:
    """Return the values with unstable poles mirrored; none if the delay is too short for that.

    Well below p rad/s, 1 / (s - p) is nearly -exp(2 s / p) / (s + p).
    """
    numerator, denominator = _polynomials(orders, values)
    poles = np.roots(denominator)
    is_unstable = poles.real > 0
    delay = values.get("T_delay", 0.0) - 2 * float(np.sum(1 / poles[is_unstable]).real)
    poles[is_unstable] *= -1
    # Each mirrored pole changes the sign.
    sign = (-1.0) ** np.sum(is_unstable)
    mirrored = coefficients(sign * np.array(numerator), np.poly(poles).real, orders.integrators)
    return {**mirrored, "T_delay": delay} if delay > 0 else {}


def _described(orders: Orders, fit: Fit) -> tuple[str, tuple[str, ...]]:
    """Return the factored transfer function, and remarks on its poles and zeros."""
    if not fit.converged:
        return "", ()
    numerator, denominator = _polynomials(orders, fit.estimate)
    form = Rational(numerator, denominator, fit.estimate.get("T_delay", 0.0))
    unstable = [f"{UNSTABLE} {root_text(p)}" for p in upper_half(form.poles) if p.real > 0]
    pairs = [str(pair) for pair in near_pairs(form.zeros, form.poles)]
    return str(form), (*unstable, *pairs, *held_by_bounds(fit))
