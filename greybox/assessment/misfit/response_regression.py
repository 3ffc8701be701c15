"""A response as a regression of its residuals on the parameters and on missing terms."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from greybox.assessment.largest_deviation import SIZE, largest_deviation
from greybox.assessment.misfit.answer import Cause
from greybox.assessment.misfit.causes.included import RESPONSE_CAUSES
from greybox.assessment.misfit.causes.logged_signals import SCHEDULED
from greybox.assessment.misfit.causes.parameters import BOUND, FIXED, OWN
from greybox.assessment.misfit.regression import TINY, Regression, labeled
from greybox.assessment.misfit.term import ResponseTerm, Wording
from greybox.data.files.arrays import (
    Array,
    BoolArray,
    ComplexArray,
    real_and_imaginary,
    sum_of_squares,
)
from greybox.engine.compiled.response_part import ResponsePart

STEP = 1e-6  # of the numbers of a term, for derivatives
WITH_TRIM = Wording(
    SCHEDULED.text,
    "p.{signal} + p.{signal}_by_{target} * x.{target} in place of p.{signal}",
    SCHEDULED.opposite,
)


@dataclass(frozen=True)
class Order:
    """What values may depend on from part to part: the part itself, or a number that grows."""

    wording: Wording
    name: str
    number: float
    is_of_part: bool = False

    def term(self, parameter: str, slopes: ComplexArray) -> ResponseTerm:
        """Return the term for a parameter with relative slopes (n,)."""
        values = slopes * self.number
        return ResponseTerm(
            self.wording, parameter, self.name, is_of_part=self.is_of_part, values=values
        )


@lru_cache(4)  # responses of a study mostly have the same frequencies
def terms_of_response(*omega: float) -> tuple[ResponseTerm, ...]:
    """Return the terms that the model of a response at these frequencies may lack."""
    at = np.array(omega)
    return tuple([term for cause in RESPONSE_CAUSES for term in cause(at)])


def is_held(free: Array) -> BoolArray:
    """Return which parameters (p,) cannot move alone in the directions (p, d) of a fit."""
    return np.linalg.norm(free, axis=1) < 1 - 1e-9


def regression_of_response(
    part: ResponsePart, values: Array, names: Sequence[str], free: Array
) -> Regression:
    """Return the regression of a response at all `values`; the fit moves along `free` (p, d)."""
    response, criterion, data = part.response(values), part.error_model, part.data
    # Where the modeled response is zero, all of the measured one is misfit.
    size = criterion.error_size(response if response.any() else data.response, data)
    if criterion.known_noise and data.dof is not None:
        # Divided by an estimated deviation, an error follows Student's t, whose tails would look
        # like a term. Its weight is that of the likelihood, about the scale of all residuals.
        scale = data.dof * criterion.noise_ratio(response, data) + TINY
        size = np.sqrt(size**2 + 2 * np.abs(data.response - response) ** 2 / scale)
    used = size > 0
    # A single outlier would look like a narrow mode.
    worst = largest_deviation(part, values, len(free))
    if worst and len(used) * worst.probability < SIZE:
        used[worst.index] = False
    order = np.argsort(data.omega, kind="stable")
    order = order[used[order]]

    def rows(columns: ComplexArray) -> Array:
        turned = columns[order] * np.exp(-1j * np.angle(response[order]))[:, None]
        return real_and_imaginary(turned / size[order, None])

    states = part.problem.model.state_names
    orders = [Order(OWN, part.name, 1.0, is_of_part=True)]
    for signal, value in part.problem.at.items():
        orders.append(Order(WITH_TRIM if signal in states else SCHEDULED, signal, value))
    # Where most of a response is left, no size or correlation of its errors excuses the model.
    path = Cause(
        f"a response of {data.output or 'the output'} to {data.input or 'the input'}",
        "a path between both, or wider bounds",
        1.0,
        0.0,
        1.0,
        0.0,
        0.0,
    )
    regression = regression_of_curve(
        lambda x: (part.response(x), part.sensitivity(x)),
        data.response,
        rows,
        values,
        names,
        free,
        terms=terms_of_response(*data.omega.tolist()),
        orders=orders,
    )
    is_unlike = 2 * sum_of_squares(regression.residuals) >= sum_of_squares(regression.measured)
    # Of 1614 simulated right fits, whose errors are white, correlated along frequency, or larger at
    # one end, at both ends or in a band, 2.2 % are below this probability, and of those in white
    # ones 1 %.
    return replace(regression, causes=(path,) if is_unlike else (), level=0.01)


def regression_of_curve(
    curve: Callable[[Array], tuple[ComplexArray, ComplexArray]],
    measured: ComplexArray,
    rows: Callable[[ComplexArray], Array],
    values: Array,
    names: Sequence[str],
    free: Array,
    *,
    terms: Iterable[ResponseTerm],
    orders: Sequence[Order],
) -> Regression:
    """Return the regression of a measured curve (n,) over frequency, which has `terms` to try.

    The function `curve` returns the modeled one at all values x (k,), with its derivatives (n, k);
    `rows` returns real rows of columns (n, c), in which errors are alike. Values may depend on what
    `orders` lists.
    """
    places, p = np.flatnonzero(~is_held(free)), len(free)

    def modeled(x: Array) -> tuple[ComplexArray, ComplexArray]:
        # Where a response is zero, the effects of its parameters are not.
        model, slopes = curve(x)
        # In place of a modeled response of zero, since the square of its effects is zero.
        return np.where(model == 0, 1e-200, model), slopes

    def again(change: Array, factors: ComplexArray) -> Array:
        x = values.copy()
        x[:p] += free @ change
        model, slopes = modeled(x)
        by_term = model * (factors[1:] - factors[0]) / STEP
        columns = -np.vstack([(slopes[:, :p] @ free).T * factors[0], by_term])
        return rows(np.column_stack([measured - model * factors[0], *columns]))

    model, slopes = modeled(values)
    relative = slopes / model[:, None]
    own = []
    for k, (name, column) in enumerate(zip(names, relative.T, strict=True)):
        if k in places:
            own += [order.term(name, column) for order in orders]
        elif k < p:
            own.append(ResponseTerm(BOUND, name, is_doubted=True, values=column))
        else:
            own.append(ResponseTerm(FIXED, name, has_shape=False, values=column))
    residuals = rows((measured - model)[:, None])
    return Regression(
        rows(measured[:, None]),
        residuals,
        rows(-slopes[:, :p] @ free),
        labeled([*terms, *own]) if residuals.size else {},
        lambda terms: rows(np.column_stack([model * term.values for term in terms])),
        again if residuals.size else None,
    )
