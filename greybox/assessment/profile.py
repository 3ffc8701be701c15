"""Profile likelihood: the lowest cost with one quantity held, as a function of its value.

With C the cost and Ĉ its minimum, the signed root of the likelihood ratio is r = ±√(2 c (C - Ĉ)),
and the interval is where |r| is below Student's t. Sources: Bates and Watts (1988), Nonlinear
Regression Analysis and Its Applications, section 6.1; Chandler and Bate (2007), Inference for
clustered data using the independence loglikelihood, Biometrika 94.

At the points of a profile, parameters are held by their bounds, any other quantity by an equation.
One solver is used for all parameters, and one program for each other quantity.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.assessment.fitted_problem import compiled_again
from greybox.assessment.held_minima import Held, HeldMinima, NoProfileError, Point, slope_of
from greybox.assessment.profile_result import End, ProfileOf, Profiles
from greybox.assessment.quantities import quantity_function
from greybox.assessment.response_band import require_level, t_quantile
from greybox.assessment.result import Fit, Quantity, require_fit
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.arrays import Array, Interval, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import array_of
from greybox.data.files.numbers_in_text import number
from greybox.data.files.progress import bar
from greybox.data.files.public import public
from greybox.data.files.wording import listed
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.covariance.covariance import informations
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.modeling.formulation.starts import Sobol
from greybox.modeling.model import require_known
from greybox.modeling.one_thread import one_thread_at_a_time

# Change of r from point to point, as a share of the limit of |r|: three points to a crossing show a
# curve.
STEP = 0.35
# Largest factor between neighboring steps.
GROWTH = 3.0
# Factor by which a misleading standard error changes within one standard error of the estimate. In
# the trials, factors from 1.25 to 1.4 selected the same profiles, and well-determined models with
# 2 to 10 % noise stayed below 1.2.
CHANGE_OF_ERROR = 1.3
# Numbers in the data beyond which a fit does not look for misleading standard errors by itself.
LARGE = 1000
# Parameters to profile, times free parameters, times parts: each point is a run, and more work than
# this takes a second or longer.
MOST_WORK = 12


@public
def profile(
    fit: Fit,
    names: Sequence[str] | str | None = None,
    *,
    problem: AnyProblem | None = None,
    level: float = 0.95,
) -> Profiles:
    """Profile the likelihood along parameters and derived quantities of a fit.

    The criterion determines the likelihood that its cost represents:

    - `RelativeError` (4.26), `SquaredRelativeError`, `RelativeLikelihood`: errors isotropic in the
      complex plane and of one relative size, which is estimated; Student's t.
    - `MaximumLikelihood`: errors of the given variances, scaled up if the residuals are larger.
    - `OutputError`, `PredictionError`, `EquationError`: normal errors of the outputs or of their
      equation, with the variances of the residuals. Where these are correlated in time, or of
      different sizes over a manoeuvre, the ratio is scaled so that small changes have the standard
      errors of the fit.
    - `MagnitudePhase`, and a criterion of your own that does not weigh points by their errors: no
      likelihood, refused.

    Parameters
    ----------
    fit : Fit
    names : sequence of str, optional
        By default all free parameters and derived quantities.
    problem : Problem or Sum, optional
        The fitted problem; needed where it has ties, constraints, or values fixed by an earlier
        fit.
    level : float
        Confidence level of the intervals.

    Raises
    ------
    ValueError
        If the criterion admits no likelihood ratio, and for a problem other than the fitted one.
    LookupError
        If a loaded fit does not know its model.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> low, high = gb.profile(fit, ["a1"])["a1"].interval
    >>> low < fit.estimate["a1"] < high
    True
    """
    require_fit(fit)
    fit.require_estimate()
    require_level(level)
    if fit.priors:
        raise ValueError(
            f"the fit {fit.name!r} has priors, so its cost is not a likelihood: use the "
            "standard errors."
        )

    nlp = compiled_again(fit, problem)
    # A quantity that follows from constants alone has the standard error zero and no profile.
    quantities = {q.name: q for q in fit.quantities if q.kind != "fixed" and q.standard_error != 0}

    chosen = checked_items(
        "a name",
        quantities if names is None else names,
        str,
        "names of parameters and derived quantities",
    )
    require_known(chosen, quantities, "quantity to profile", f"the fit {fit.name!r}")

    # Two fresh starts for every point of a response: another minimum may become the lowest away
    # from the estimate. For records, the states of the neighboring point lead to the minimum, and a
    # run from elsewhere takes seconds.
    fresh = 0 if nlp.has_states else 2
    return _profiles(nlp, fit, [quantities[name] for name in chosen], level, fresh)


def with_profiles_where_misleading(nlp: CompiledProblem, fit: Fit) -> Fit:
    """Return the fit with profiles of the parameters whose standard error misleads.

    If profiles would take a second or longer, the fit gets a note with the names of these
    parameters instead. The fit is unchanged where there is no likelihood, and where finding these
    parameters would take long.
    """
    is_batched = ResponseSolver.serves(nlp)
    # Records with states, and sums of these with responses, take minutes.
    are_quick = is_batched or nlp.limits
    if nlp.has_states:
        are_quick = all(p.has_states and (p.is_static or not p.samples) for p in nlp.parts)
    is_large = nlp.numbers > LARGE and not is_batched
    is_slow = is_large or not are_quick
    released = _released(fit)
    if (is_slow and not released) or any(p.roots for p in nlp.programs):
        return fit
    if fit.priors or any(_refusals(nlp, _estimate(nlp, fit), fit)):
        return fit

    misleading = [*_misleading(nlp, fit, released, looks_around=not is_slow)]
    if not misleading:
        return fit
    if is_batched or len(misleading) * len(nlp.free) * len(nlp.parts) <= MOST_WORK:
        try:
            profiles = _profiles(nlp, fit, misleading, 0.95, fresh=0)
        except NoProfileError:
            return fit
        return replace(fit, profiles=profiles, warnings=(*profiles.warnings, *fit.warnings))
    names = listed([quantity.name for quantity in misleading])
    note = f"standard errors that mislead: {names}; gb.profile (greybox profile) gives intervals."
    return replace(fit, notes=(*fit.notes, note))


def _released(fit: Fit) -> list[int]:
    """Return the places in `Fit.free` of the parameters at a bound that does not hold them."""
    if fit.directions is None:
        return []
    is_known = fit.known_directions(fit.free).is_known
    return [k for k, name in enumerate(fit.free) if name in fit.at_bound and not is_known[k]]


def _misleading(
    nlp: CompiledProblem, fit: Fit, released: Sequence[int], *, looks_around: bool
) -> Iterator[Quantity]:
    """Yield the parameters whose standard errors mislead.

    The interval of such a parameter reaches beyond its bounds or contains zero, or the parameter is
    correlated with one of the parameters `released`, which are at a bound although the data allow
    either side of it. With `looks_around`, a standard error misleads too if it differs one standard
    error away from the estimate.

    Standard errors assume a response that is linear in the parameters. A standard error changes,
    for example, near a fold of the response, where two values of a parameter give nearly the same
    response. The likelihood is then far from normal.
    Source: Bates and Watts (1988), chapter 7 (parameter-effects curvature).
    """
    free = [fit.by_name[name] for name in nlp.free]
    x, size = np.nan_to_num([(q.value, q.standard_error) for q in free]).T
    intervals = fit.interval()

    def errors(at: Array) -> Array:
        at = np.clip(at, nlp.lower, nlp.upper)
        z = nlp.scaling.to_solver(at)
        # Frequency responses need no trajectory. Computing one would take a third of the time.
        trajectories = [part.trajectory(z) if part.has_states else None for part in nlp.parts]
        for trajectory in trajectories:
            if trajectory is not None and not all_finite(trajectory.products):
                return np.full(len(x), math.inf)

        parts = informations(nlp, at, trajectories)
        jacobian = np.vstack([part.jacobian for part in parts])[:, : len(x)]
        return np.linalg.norm(np.linalg.pinv(np.nan_to_num(jacobian * size)), axis=1)

    middle = errors(x) if looks_around else np.ones(len(x))

    def changes(k: int, step: Array) -> bool:
        nearby = middle[k], errors(x - step)[k], errors(x + step)[k]
        return max(nearby) > CHANGE_OF_ERROR * min(nearby)

    for k, (q, row) in enumerate(zip(free, np.nan_to_num(fit.correlation), strict=True)):
        low, high = intervals[q.name]
        is_within_bounds = q.bounds[0] <= low <= high <= q.bounds[1]
        # With a correlation of √0.75, knowing the released parameter would halve the standard
        # error.
        is_correlated = bool(np.any(row[released] ** 2 > 0.75))
        # With an error of half the value, the interval contains zero.
        is_plain = is_within_bounds and size[k] <= 0.5 * abs(x[k]) and not is_correlated
        if not is_plain or (looks_around and changes(k, row * size)):
            yield q


# --- the cost as a likelihood


def _estimate(nlp: CompiledProblem, fit: Fit) -> Array:
    return array_of(fit.estimate, nlp.free)


def _refusals(nlp: CompiledProblem, x: Array, fit: Fit) -> Iterator[str]:
    """Yield why the costs at the minimum x (p,) admit no likelihood ratio."""
    # The cost of a record is a log-likelihood. The cost of a frequency response is a log-likelihood
    # up to a factor if every point has the same weight in units of its error. The curvature of the
    # cost gives this factor.
    values = nlp.all_values(x)
    for part in nlp.parts_of(ResponsePart):
        _, meat = part.criterion.spread(part.response(values), part.data, 1.0)
        if not part.criterion.weighs_alike and np.ptp(meat) > 1e-6 * meat.max(initial=0.0):
            yield (
                f"{type(part.criterion).__name__} does not weigh the points of "
                f"{part.problem.name!r} by their errors, so its cost is not a log-likelihood: use "
                "RelativeError, SquaredRelativeError or MaximumLikelihood, or a bootstrap"
            )
    known = fit.directions
    if known is None or not np.any(np.sqrt(np.diag(known.covariance)) > 1e-12 * np.abs(known.at)):
        yield "its errors are not known, or they are rounding"


def likelihood_factor(fit: Fit, gradient: Array) -> float:
    """Return the factor c that turns a difference of costs into one of log-likelihoods.

    The factor is the ratio of two variances along the `gradient` (p,) of the profiled quantity: the
    variance from the curvature of the cost, over the variance of the estimate.

    Source: Chandler and Bate (2007), Biometrika 94.
    """
    # The factor is 1 for errors of known size. For sums of relative errors it contains the
    # estimated size of these errors. It makes the profile agree with the standard error where the
    # cost is quadratic.
    assert fit.white is not None
    known = fit.known_directions(fit.free)
    by_curvature = gradient @ fit.white @ gradient
    variance = gradient @ known.covariance @ gradient

    # If the data have no information along the gradient, the factor is the average over the
    # directions that the data determine.
    if not (variance > 0 and by_curvature > 0):
        scale = np.outer(known.size, known.size)
        by_curvature = np.trace(fit.white / scale)
        variance = np.trace(known.covariance / scale)
    return float(by_curvature / variance)


# --- the search along one quantity


@frozen
class _Search:
    """The search for the points of one profile.

    Attributes
    ----------
    minima : HeldMinima
    held : Held
    best : Point
        The estimate.
    factor : float
        Factor c of the likelihood ratio, see `likelihood_factor`.
    bounds : (float, float)
    size : float
        Typical size of the quantity.
    first : float
        The first step.
    starts : sequence of Point
        Further starts of every point.
    """

    minima: HeldMinima
    held: Held
    best: Point
    factor: float
    bounds: Interval
    size: float
    first: float
    starts: Sequence[Point]

    def root(self, point: Point) -> float:
        """Return the signed root r of the likelihood ratio, negative below the estimate."""
        increase = 2 * max(point.cost - self.best.cost, 0.0)
        numbers = self.minima.numbers
        if math.isfinite(numbers) and math.isfinite(increase):
            # With an estimated variance, the cost of N residuals is N/2 times the logarithm of the
            # sum of their squares, and r² is the F statistic of this sum. This is exact for a
            # linear model, however few the residuals. An exponent of 100 is beyond any limit of a
            # profile, and larger exponents would overflow.
            increase = numbers * math.expm1(min(increase / numbers, 100.0))
        return math.copysign(math.sqrt(self.factor * increase), point.value - self.best.value)

    def point(self, value: float, *starts: Point) -> Point:
        """Return the lowest minimum from these starts with the quantity at a value."""
        return replace(self.minima.lowest(self.held, starts, value), value=value)

    def walk(self, direction: int, limit: float) -> tuple[list[Point], End]:
        """Compute points from the estimate until |r| crosses a limit; return how the walk ended."""
        points = [self.best]
        step = self.first
        lower, upper = self.bounds
        bound = upper if direction > 0 else lower
        # A step may triple each time, so that the 40th point lies beyond any crossing.
        while len(points) < 40:
            last = points[-1]
            room = abs(bound - last.value)
            # Also true for NaN.
            if not room > 0:
                return points, "bound"
            value = last.value + direction * step if step < room else bound
            ahead = on_line(value, last, points[-2]) if len(points) > 1 else last

            point = self.point(value, ahead, *self.starts)
            rise = direction * (self.root(point) - self.root(last))
            # A step over the crossing would leave out the curve before the crossing.
            if rise > limit and step > 1e-3 * self.first:
                step = min(step, room) / GROWTH
                continue
            if math.isinf(rise):
                return points, "failed"
            points.append(point)
            # The last point lies 20 % beyond the limit, so that the points enclose the crossing.
            if direction * self.root(point) > 1.2 * limit:
                return points, "crossed"
            # A cost that is still flat this far from the estimate has no crossing.
            if abs(value - self.best.value) > 1e6 * self.size:
                break
            step *= min(max(STEP * limit / max(rise, 1e-12), 1 / GROWTH), GROWTH)

        return points, "flat"

    def crossing(self, inner: Point, outer: Point, root: float) -> float:
        """Return where the root has a value between two points."""
        # The import of scipy.optimize takes a tenth of a second.
        from scipy.optimize import root_scalar  # noqa: PLC0415

        ends = {point.value: point for point in (inner, outer)}
        takes_long = self.minima.nlp.has_states

        def height(value: float) -> float:
            starts = (on_line(value, inner, outer),) if takes_long else (inner, outer)
            return self.root(ends.get(value) or self.point(value, *starts)) - root

        tolerance = max(1e-3 * abs(outer.value - inner.value), 1e-12 * self.size)
        return root_scalar(height, bracket=(inner.value, outer.value), xtol=tolerance).root


def on_line(value: float, point: Point, other: Point) -> Point:
    """Return where a quantity has a value on the line through two points."""
    # The other parameters move nearly along this line, so a minimization from here takes few
    # iterations.
    share = (value - point.value) / (other.value - point.value)
    return replace(point, z=point.z + share * (other.z - point.z))


@one_thread_at_a_time
def _value_of(nlp: CompiledProblem, name: str) -> ca.Function:
    """Return the function (z) -> value of a tied or derived quantity."""
    z = ca.SX.sym("z", len(nlp.free))
    x = ca.vertcat(*nlp.scaling.expressions(z), *nlp.constant_values)
    return ca.Function("value", [z], [quantity_function(nlp, [name])(x)])


# --- profiles


def _profiles(
    nlp: CompiledProblem, fit: Fit, quantities: Sequence[Quantity], level: float, fresh: int
) -> Profiles:
    """Return the profiles of some quantities; every point starts from `fresh` Sobol points, too.

    Raises
    ------
    NoProfileError
        If the cost is no likelihood, or the minimum is not found again.
    """
    minima = HeldMinima(nlp, _estimate(nlp, fit))
    for refusal in _refusals(nlp, minima.x, fit):
        raise NoProfileError(f"no profile of {fit.name!r}: {refusal}.")
    starts = []
    if fresh:
        # Sobol points need finite bounds and SciPy, which takes long to import.
        boxes = {name: nlp.problem.parameters[name] for name in nlp.free}
        starts = [Point(z) for z in nlp.scaling.to_solver(Sobol(fresh, 0).draw(boxes))]

    profiles = []
    limits = {}
    for quantity in bar(quantities, desc="profiles", unit="profile"):
        dof = quantity.dof if math.isfinite(quantity.dof) else fit.dof
        limit = t_quantile(level, dof)
        limits[quantity.name] = limit
        search = _search(minima, fit, quantity, limit, starts)
        profiles.append(_profile_of(search, quantity, limit))

    lowest = min((profile.costs.min() for profile in profiles), default=math.inf)
    warnings = ()
    # The tolerance of 1e-4 is above the change of costs by smoothing, which is up to 6e-5.
    best = minima.best.cost
    if lowest < best - 1e-4 * max(abs(best), 1.0):
        warnings = (
            f"a profile found the cost {number(lowest)} below the fit's {number(best)}: "
            "fit from more starts.",
        )

    return Profiles(fit.name, level, limits, nlp.free, tuple(profiles), warnings)


def _search(
    minima: HeldMinima, fit: Fit, quantity: Quantity, limit: float, starts: Sequence[Point]
) -> _Search:
    """Return the search along one parameter or derived quantity."""
    nlp, x = minima.nlp, minima.x
    dz_dx = nlp.scaling.slope(x)
    if quantity.name in nlp.free:
        place = nlp.free.index(quantity.name)
        held: Held = place
        gradient = np.eye(len(x))[place]
        value = float(x[place])
    else:
        held = _value_of(nlp, quantity.name)
        gradient = slope_of(held, minima.best.z) * dz_dx
        value = quantity.value
        # A constraint fixes a derived quantity. From distant starts such a run takes long.
        starts = ()

    size = float(np.abs([quantity.value, *(gradient / dz_dx)]).max())
    error = quantity.standard_error
    first = STEP * limit * error if error > 0 else 0.02 * size
    # A bound that the estimate has reached, to within rounding, does not shorten the first step.
    if not quantity.at_bound:
        for bound in quantity.bounds:
            distance = abs(bound - quantity.value)
            if distance > 0:
                first = min(first, STEP * distance)
    return _Search(
        minima=minima,
        held=held,
        best=replace(minima.best, value=value),
        factor=likelihood_factor(fit, gradient),
        bounds=quantity.bounds,
        size=size,
        first=first,
        starts=starts,
    )


def _profile_of(search: _Search, quantity: Quantity, limit: float) -> ProfileOf:
    """Walk from the estimate to both sides, and return the profile with its interval."""
    # A relative criterion biases the estimate by b. At the true value, the mean of r is then -b
    # over the standard error. The interval contains the values at which r plus this ratio is within
    # the limit. Like the interval from the standard error, it is centered about the estimate less
    # b.
    bias = quantity.bias / quantity.standard_error if quantity.standard_error > 0 else 0.0
    lowest, highest = -limit - bias, limit - bias
    # If the bias exceeds the limit, both ends lie on one side of the estimate. The walk to the
    # other side still takes one step, to show the curve there.
    down, low_end = search.walk(-1, max(-lowest, STEP * limit))
    up, high_end = search.walk(1, max(highest, STEP * limit))
    points = [*down[::-1], *up[1:]]
    roots = np.array([search.root(point) for point in points])
    inside = np.flatnonzero((roots >= lowest) & (roots <= highest))
    # The interval may lie beyond the bound at which the walk ended.
    if not inside.size:
        inside = np.array([np.argmin(np.abs(roots + bias))])

    first, last = int(inside[0]), int(inside[-1])
    at_best = search.minima.at_bounds(search.best) | {quantity.name}

    def limit_beyond(k: int, side: int, root: float, end: End) -> tuple[float, End, set[str]]:
        """Return the limit of the interval, how it was found, and other parameters at a bound."""
        if not 0 <= k + side < len(points):
            return side * math.inf, end, set()
        inner, outer = points[k], points[k + side]
        at_bound = search.minima.at_bounds(outer) - at_best
        return search.crossing(inner, outer, root), "crossed", at_bound

    low, low_end, at_low_bound = limit_beyond(first, -1, lowest, low_end)
    high, high_end, at_high_bound = limit_beyond(last, 1, highest, high_end)
    scaling = search.minima.nlp.scaling
    return ProfileOf(
        name=quantity.name,
        unit=quantity.unit,
        estimate=quantity.value,
        standard_error=quantity.standard_error,
        values=np.array([point.value for point in points]),
        costs=np.array([point.cost for point in points]),
        roots=roots,
        others=scaling.to_parameters(np.array([point.z for point in points])),
        interval=(low, high),
        ends=(low_end, high_end),
        bounds=quantity.bounds,
        bias=bias,
        at_bound=(tuple(sorted(at_low_bound)), tuple(sorted(at_high_bound))),
        connected=len(inside) == last - first + 1,
    )
