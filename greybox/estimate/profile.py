"""Profile likelihood: the lowest cost that is left when one quantity is held at a value, as a function of that value.

With C the cost and Ĉ its minimum, the signed root of the likelihood ratio is r = ±√(2 c (C - Ĉ)),
and the interval is where |r| is below Student's t. The factor c makes the ratio of the cost one of
likelihood: 1 for a likelihood of known errors; for the sums of relative errors what errors
isotropic in the complex plane and of one relative size give, with their size estimated. It is the
curvature that the cost has over the one that its covariance says, so that profile and standard
error agree where the cost is quadratic. Sources: Bates and Watts (1988), Nonlinear Regression
Analysis and Its Applications, section 6.1; Chandler and Bate (2007), Inference for clustered data
using the independence loglikelihood, Biometrika 94.

With N numbers whose variance is estimated along, as of records, the cost is N/2 log of a sum of
squares, and r² is the F statistic that this sum gives, N c (exp(2 (C - Ĉ) / N) - 1): exact where
the model is linear, however few the numbers.

A relative criterion biases the estimate by b (`Quantity.bias`), so that at the truth r has the mean
-b over the standard error. The interval is where r plus that is within ± t: as that of the standard
error, about the value less b.

A parameter is held by its two bounds, any other quantity by an equation: one program for each
quantity, whatever the number of points. Those of records are in `held_records`.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import AnyProblem, CompiledProblem
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import SMOOTHING, ResponsePart
from greybox.estimate.covariance import Accuracy, assess
from greybox.estimate.fitted_problem import compiled_again
from greybox.estimate.held_records import HeldRecords, NoMinimumError, best_of_records, slope_of
from greybox.estimate.profiles import Contour, End, ProfileOf, Profiles
from greybox.estimate.quantities import Formula, formulas
from greybox.estimate.result import Fit, Quantity
from greybox.files.arrays import Array
from greybox.files.progress import counted_off
from greybox.files.text_table import alternatives, number
from greybox.formulation.starts import Sobol
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.batched_solver import TOLERANCE, BatchedSolver
from greybox.solve.executors import call_all, require_executor
from greybox.solve.ipopt import CONVERGED, WARM, Ipopt

STEP = 0.35  # of the limit of |r|, from one point to the next: three points to a crossing, as few as show a curve
BEYOND = 1.2  # of the limit, to where a profile goes on: the crossing lies between two points
MOST_POINTS = 40  # a side; a step may triple, so that the last lies beyond any crossing
GROWTH = 3.0
FEWEST_DIRECTIONS = 8  # of a contour: fewer show no shape
WIDER = 1.5  # from one point of a ray to the next: two or three to the crossing where the cost is quadratic
CROSSING = 1e-3  # of its distance, to which a crossing is found: less than a line is wide
MOST_HELD, MOST_ROWS = (
    12,
    1000,
)  # profiles times unknowns, and rows, of which profiles take up to a second
FRESH_STARTS = 2  # of a point of frequency responses
LEVEL = 0.95  # of the profiles that a fit makes by itself
LARGE_ERROR = 0.5  # of a value: its interval by the standard error reaches to zero and beyond
FAR = 1e6  # in sizes of the quantity: what does not change the cost up to there is not limited
EVEN = 1e-6  # relative, up to which errors of the points count as equal in size
SWEEPS = 3  # over the points, while neighbors improve one another
CLOSE = 1e-4  # relative, within which IPOPT's barrier leaves what a bound holds
LOWER = 1e-4  # relative: the smoothing moves costs by up to 6e-5
LARGEST = 100.0  # logarithm of a ratio of squares, beyond any limit
MOST_STEPS = WARM["max_iter"]  # of Newton's method, as of IPOPT's
MOST_BIAS = 0.9  # of the limit of a contour: its rays begin at the estimate, which must lie within


def profile(
    fit: Fit,
    names: Sequence[str] | str | None = None,
    *,
    problem: AnyProblem | None = None,
    level: float = 0.95,
    fresh_starts: int | None = None,
    executor: Executor | None = None,
) -> Profiles:
    """Profile the likelihood along parameters and derived quantities of a fit.

    What the cost says as a likelihood depends on the criterion:

    ====================================================
    ===========================================================
    `RelativeError` (4.26), `SquaredRelativeError`        errors isotropic in the complex plane and of one relative
                                                          size, estimated: Student's t
    `RelativeLikelihood`                                  the same errors
    `MaximumLikelihood`                                   errors of the given variances, scaled up if the residuals
                                                          are larger
    `OutputError`, `PredictionError`                      normal errors of the outputs, of the variances that the
                                                          residuals show; where these are correlated
                                                          in time, scaled so that small changes have
                                                          the standard errors of the fit
    `MagnitudePhase`; one of your own that weighs points  none: refused otherwise than their errors;
    manoeuvres ====================================================
    ===========================================================

    Parameters
    ----------
    fit : Fit
    names : sequence of str, optional
        By default all free parameters and derived quantities.
    problem : Problem or Sum, optional
        What was fitted; needed where it has ties, constraints, or values fixed by an earlier fit.
    level : float
        Of the intervals.
    fresh_starts : int, optional
        Sobol points from which every point of a profile is solved again, beside its neighbors on
        both sides; by default two, and none of records, whose neighbors' states lead to the
        minimum.
    executor : concurrent.futures.Executor, optional
        What makes the profiles, one a task, as of `greybox.fit`; this process by default. They are
        the same.

    Raises
    ------
    ValueError
        Where the criterion admits no likelihood ratio, for manoeuvres, and for a problem that is
        not the fit's.
    LookupError
        If a loaded fit does not know its model.
    RuntimeError
        When the executor has lost its workers.
    """
    require_executor(executor)
    nlp = _compiled(fit, problem, level)
    # What follows from constants alone has the error zero, and no profile.
    known = {q.name: q for q in fit.quantities if q.kind != "fixed" and q.standard_error != 0}
    if fit.records:
        known = {name: q for name, q in known.items() if not q.at_bound}
    wanted = list(known) if names is None else [names] if isinstance(names, str) else list(names)
    for name in wanted:
        if name not in known:
            raise ValueError(
                f"there is no {name!r} to profile; there are {alternatives(name, list(known))}."
            )
    fresh = (0 if fit.records else FRESH_STARTS) if fresh_starts is None else fresh_starts
    return _profiles(nlp, fit, [known[name] for name in wanted], level, fresh, executor)


def _compiled(fit: Fit, problem: AnyProblem | None, level: float) -> CompiledProblem:
    """Compile what was fitted, if a likelihood can be profiled."""
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate to profile around: {fit.status}.")
    if not 0 < level < 1:
        raise ValueError(f"level {level} must lie between 0 and 1, e.g. 0.95.")
    if fit.priors:
        raise ValueError(
            f"the fit {fit.name!r} has a-priori knowledge, with which its cost is no likelihood: use fit.interval()."
        )
    if len(fit.responses) + len(fit.records) < len(fit.parts):
        raise ValueError(
            f"the fit {fit.name!r} has manoeuvres, of which no profiles are made: use fit.interval(), which is Wald's."
        )
    return compiled_again(fit, problem)


def profiled_where_misleading(nlp: CompiledProblem, fit: Fit) -> Profiles | None:
    """Return profiles of the parameters whose standard error says little; None where none does, or none can be made.

    That is where the interval of the standard error leaves the bounds, or the error exceeds half
    the value. A profile takes some forty solves: problems too large for the batched search, records
    with states and long tables are not profiled unasked.
    """
    if fit.white is None or nlp.limits or nlp.roots is not None or fit.priors:
        return None
    static = all(isinstance(part, RecordPart) and part.is_static for part in nlp.parts)
    if not (static or (len(fit.responses) == len(fit.parts) and BatchedSolver.serves(nlp))):
        return None
    intervals = fit.interval(LEVEL)
    lines = [
        q
        for q in fit.quantities
        if q.kind == "free" and not q.at_bound and _misleads(q, intervals[q.name])
    ]
    if not lines or ratio_refusal(nlp, np.array([fit.estimate[name] for name in nlp.free])):
        return None
    rows = sum(part.samples for part in nlp.parts)
    if static and (len(lines) * len(nlp.free) > MOST_HELD or rows > MOST_ROWS):
        return None
    try:
        return _profiles(nlp, fit, lines, LEVEL, fresh=0)
    except NoMinimumError:
        return None


def _misleads(line: Quantity, interval: tuple[float, float]) -> bool:
    leaves = interval[0] < line.bounds[0] or interval[1] > line.bounds[1]
    return leaves or line.standard_error > LARGE_ERROR * abs(line.value)


# --- what the cost says as a likelihood


def ratio_refusal(nlp: CompiledProblem, x: Array) -> str:
    """Return why the costs of a problem admit no likelihood ratio at the estimate x (p,); empty where they do."""
    values = nlp.all_values(x)
    for part in nlp.parts:
        if not isinstance(part, ResponsePart):
            continue
        bread, meat = part.criterion.spread(part.response(values), part.data, 1.0)
        if not np.isfinite(bread) or not meat.size or not np.all(meat > 0):
            return f"{part.problem.name!r} is fitted exactly, so that the size of its errors is not known"
        if not part.criterion.weighs_alike and np.ptp(meat) > EVEN * meat.max():
            return (
                f"{type(part.criterion).__name__} weighs the points of {part.problem.name!r} otherwise than their "
                "errors, so that differences of its cost are no ratio of likelihoods: use RelativeError, "
                "SquaredRelativeError or MaximumLikelihood, or a bootstrap"
            )
    return ""


def _factor(accuracy: Accuracy, gradient: Array) -> float:
    """Return c, the variance that the curvature of the cost says over that of the estimate, along a gradient (p,).

    Where the data leave the gradient open, what holds on average of what they determine.
    """
    assert accuracy.white is not None
    p = len(accuracy.white)
    covariance = accuracy.covariance[:p, :p]
    size = accuracy.size[:p]
    says, has = gradient @ accuracy.white @ gradient, gradient @ covariance @ gradient
    if not (np.isfinite(has) and has > 0 and says > 0):
        says, has = (
            np.trace(matrix / np.outer(size, size)) for matrix in (accuracy.white, covariance)
        )
    return float(says / has)


# --- minimizing with a quantity held


class _Programs:
    """What minimizes a problem beside its estimate, built when it is asked for: once for all parameters."""

    def __init__(self, nlp: CompiledProblem, value: ca.Function | None) -> None:
        self._nlp, self._value = nlp, value
        self.lower, self.upper = nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper)

    @cached_property
    def newton(self) -> BatchedNewton | None:
        """Newton's method, where bounds are all that holds; it takes a tenth of IPOPT's time."""
        if self._value is not None or self._nlp.limits or not BatchedSolver.serves(self._nlp):
            return None
        return BatchedNewton(self._nlp.explicit[-1], self.lower, self.upper, self._nlp.roots)

    @cached_property
    def ipopt(self) -> tuple[Ipopt, dict[str, Array]]:
        """IPOPT, and the bounds of its equations."""
        program, value = self._nlp.program, self._value
        kind: Any = ca.SX if program.is_a("SXFunction") else ca.MX
        z, p = kind.sym("z", len(self._nlp.free)), kind.sym("p", 2)
        cost, limits = program(z, p[0])
        equation = kind(0, 1) if value is None else value(z) - p[1]
        ipopt = Ipopt({"x": z, "p": p, "f": cost, "g": ca.vertcat(limits, equation)}, WARM)
        many, held = limits.numel(), equation.numel()
        return ipopt, {
            "lbg": np.zeros(many + held),
            "ubg": np.concatenate([np.full(many, np.inf), np.zeros(held)]),
        }


class _Held:
    """The problem with one quantity held, built once: a parameter by its bounds, another by the equation of its value.

    Pickled, it is the problem and the quantity, and is built anew where it arrives.
    """

    def __init__(
        self,
        nlp: CompiledProblem,
        places: Sequence[int],
        value: ca.Function | None,
        programs: _Programs | None = None,
    ) -> None:
        self._nlp, self._places, self._value = nlp, list(places), value
        self._programs = programs or _Programs(nlp, value)

    def __reduce__(
        self,
    ) -> tuple[type["_Held"], tuple[CompiledProblem, Sequence[int], ca.Function | None]]:
        return _Held, (self._nlp, self._places, self._value)

    def of(self, *places: int) -> "_Held":
        """Return the same program for the parameters at these places."""
        return _Held(self._nlp, places, None, self._programs)

    def of_quantity(self, quantity: ca.Function) -> "_Held":
        """Return the program for a quantity (z) -> value."""
        return _Held(self._nlp, (), quantity)

    def solve(
        self, starts: Sequence[Array], values: Sequence[float | Array]
    ) -> list[tuple[Array, float]]:
        """Return the best variables z (p,) with the quantity at a value, from each start, and their cost; inf if none.

        Several parameters have as many values.
        """
        if not starts:  # of a profile that could leave the best point on neither side
            return []
        nlp, programs = self._nlp, self._programs
        lower, upper = (
            np.tile(bound, (len(starts), 1)) for bound in (programs.lower, programs.upper)
        )
        if self._places:
            x = np.ones(lower.shape)
            x[:, self._places] = np.array([np.ravel(value) for value in values])
            held = nlp.scaling.to_solver(x)[:, self._places]
            lower[:, self._places] = upper[:, self._places] = held
        ends, arrived = np.clip(np.array(starts), lower, upper), np.zeros(len(starts), bool)
        left = np.ones(len(starts), bool)
        if programs.newton is not None:
            limits = {
                "max_iterations": MOST_STEPS,
                "tolerance": TOLERANCE,
                "bounds": (lower.T, upper.T),
            }
            found = programs.newton.minimize(ends.T, from_near=True, **limits)
            ends[found.at_minimum], arrived = found.z.T[found.at_minimum], found.at_minimum
            # Where rounding ended it, IPOPT may see a minimum; what took all steps runs away.
            left = ~arrived & (found.iterations < MOST_STEPS)
        for k in np.flatnonzero(left).tolist():
            ipopt, equations = programs.ipopt
            bounds = {"lbx": lower[k], "ubx": upper[k], **equations}
            ends[k], status, _ = ipopt.solve(ends[k], [SMOOTHING, np.ravel(values[k])[0]], bounds)
            arrived[k] = status in CONVERGED
        costs = np.where(arrived, nlp.costs(nlp.scaling.to_parameters(ends)), np.inf)
        return list(zip(ends, np.where(np.isfinite(costs), costs, np.inf).tolist(), strict=True))


def _numbers(nlp: CompiledProblem) -> float:
    """Return how many numbers there are of whose variance the cost is a logarithm; infinite where it is not."""
    numbers = 0
    for part in nlp.parts:
        if (
            not isinstance(part, RecordPart)
            or part.covariance.known is not None
            or part.model.driven
        ):
            return math.inf
        numbers += part.numbers
    return numbers


@dataclass(frozen=True, eq=False)
class _Point:
    value: float
    z: Array
    cost: float


@dataclass(frozen=True, eq=False)
class _Search:
    """What the points of one profile share."""

    held: _Held | HeldRecords
    best: _Point
    factor: float
    numbers: float
    limit: float
    bounds: tuple[float, float]
    size: float
    first: float
    starts: Array
    bias: float = 0.0

    def root(self, point: _Point) -> float:
        """Return |r|."""
        more = 2 * max(point.cost - self.best.cost, 0.0)
        if math.isfinite(self.numbers) and math.isfinite(more):
            more = self.numbers * math.expm1(min(more / self.numbers, LARGEST))
        return math.sqrt(self.factor * more)

    def signed_root(self, point: _Point) -> float:
        """Return r, negative below the estimate."""
        return math.copysign(self.root(point), point.value - self.best.value)

    def point(self, value: float, *starts: Array) -> _Point:
        """Return the best of what these starts reach."""
        z, cost = min(self.held.solve(starts, [value] * len(starts)), key=lambda pair: pair[1])
        return _Point(value, z, cost)

    def side(self, direction: int) -> tuple[list[_Point], End]:
        """Walk from the estimate until the limit is crossed; the points, and how that ended."""
        points, step = [self.best], self.first
        bound = self.bounds[direction > 0]
        while len(points) < MOST_POINTS:
            last = points[-1]
            room = abs(bound - last.value)
            if not room > 0:
                return points, "bound"
            value = last.value + direction * step if step < room else bound
            ahead = last.z
            if len(points) > 1:
                before = points[-2]
                share = (value - last.value) / (last.value - before.value)
                ahead = last.z + share * (last.z - before.z)
            point = self.point(value, ahead, *self.starts)
            rise = self.root(point) - self.root(last) if math.isfinite(point.cost) else math.inf
            # A jump over the crossing tells nothing of the curve before it.
            if rise > self.limit and step > 1e-3 * self.first:
                step = min(step, room) / GROWTH
                continue
            if not math.isfinite(point.cost):
                point = self.point(value, last.z)
            if not math.isfinite(point.cost):
                return points, "failed"
            points.append(point)
            if self.root(point) > BEYOND * self.limit:
                return points, "crossed"
            if abs(value - self.best.value) > FAR * self.size:
                break
            step *= min(max(STEP * self.limit / max(rise, 1e-12), 1 / GROWTH), GROWTH)
        return points, "flat"

    def swept(self, points: list[_Point]) -> list[_Point]:
        """Solve every point again from its neighbors on both sides, while that finds lower costs.

        First all at once, which shows in most profiles that there is nothing to find.
        """
        points = list(points)
        pairs = [pair for pair in itertools.pairwise(points) for pair in (pair, pair[::-1])]
        pairs = [pair for pair in pairs if pair[1] is not self.best]
        found = self.held.solve(
            [neighbor.z for neighbor, _ in pairs], [point.value for _, point in pairs]
        )
        if not any(
            cost < point.cost - LOWER * abs(point.cost)
            for (_, point), (_, cost) in zip(pairs, found, strict=True)
        ):
            return points
        for _ in range(SWEEPS):
            improved = False
            for order, neighbor in (
                (range(len(points) - 2, -1, -1), 1),
                (range(1, len(points)), -1),
            ):
                for k in order:
                    if points[k] is self.best:
                        continue
                    again = self.point(points[k].value, points[k + neighbor].z)
                    if again.cost < points[k].cost:
                        improved |= again.cost < points[k].cost - LOWER * abs(points[k].cost)
                        points[k] = again
            if not improved:
                break
        return points

    def along(self, center: Array, ray: Array, bounds: Array) -> tuple[float, End]:
        """Return how far along a ray (2,) from the center the limit is crossed, or the `bounds` (2, 2) reached."""
        with np.errstate(divide="ignore"):
            room = np.where(ray > 0, bounds[:, 1] - center, bounds[:, 0] - center) / np.where(
                ray == 0, np.nan, ray
            )
        most = float(np.nanmin(room))
        inside, reach = self.best, min(self.limit / 2, most)
        while True:
            [(z, cost)] = self.held.solve([inside.z], [center + reach * ray])
            if not math.isfinite(
                cost
            ):  # nearer to a solution that is known, before it counts as failed
                if reach - inside.value < CROSSING * self.limit:
                    return math.nan, "failed"
                reach = (inside.value + reach) / 2
                continue
            point = _Point(reach, z, cost)
            if self.root(point) > self.limit:
                break
            if reach >= most:
                return most, "bound"
            if reach > FAR * self.limit:
                return math.inf, "flat"
            inside, reach = point, min(WIDER * reach, most)
        outside = point

        def between(value: float) -> _Point:
            tried = self.held.solve([inside.z, outside.z], [center + value * ray] * 2)
            return _Point(value, *min(tried, key=lambda pair: pair[1]))

        found = _zero(
            lambda at: self.root(at) - self.limit,
            between,
            inside,
            outside,
            CROSSING * outside.value,
        )
        return found, "crossed"

    def crossing(self, one: _Point, other: _Point, root: float) -> float:
        """Return where the signed root has a value between two points."""
        tolerance = max(1e-3 * abs(other.value - one.value), 1e-12 * self.size)
        return _zero(
            lambda at: self.signed_root(at) - root,
            lambda value: self.point(value, one.z, other.z),
            one,
            other,
            tolerance,
        )


def _zero(
    height: Callable[[_Point], float],
    between: Callable[[float], _Point],
    one: _Point,
    other: _Point,
    tolerance: float,
) -> float:
    """Return the value at which the height changes its sign from one point to the other."""
    from scipy.optimize import brentq  # noqa: PLC0415  (takes a tenth of a second to import)

    ends = {point.value: point for point in (one, other)}
    found: Any = brentq(
        lambda v: height(ends[v] if v in ends else between(v)),
        one.value,
        other.value,
        xtol=tolerance,
    )
    return float(found)


@one_thread_at_a_time
def _value_of(nlp: CompiledProblem, formula: Formula) -> ca.Function:
    """Return the function (z) -> value of a formula."""
    z = ca.SX.sym("z", len(nlp.free))
    named = dict(zip(nlp.names, [*nlp.scaling.expressions(z), *nlp.constant_values], strict=True))
    return ca.Function("value", [z], [ca.SX(formula.evaluate(named))])


def contour(
    fit: Fit,
    first: str,
    second: str,
    *,
    problem: AnyProblem | None = None,
    level: float = 0.95,
    directions: int = 36,
) -> Contour:
    """Return the region of two parameters whose likelihood ratio is within its limit, all others fitted again.

    From the estimate it is followed in `directions` that are even in the metric of the covariance,
    each to where the root of the ratio crosses √(2 F), F the quantile of Fisher's distribution with
    2 and the fit's degrees of freedom, or to the bounds of the two. Source: Bates and Watts (1988),
    section 6.1.

    Parameters
    ----------
    fit : Fit
    first, second : str
        Free parameters.
    problem, level
        As of `profile`, and the same criteria allow it.
    directions : int
        At least 8.

    Raises
    ------
    ValueError
        As of `profile`; and for names that are not two free parameters within their bounds.
    """
    nlp = _compiled(fit, problem, level)
    lines = {q.name: q for q in fit.quantities if q.kind == "free" and not q.at_bound}
    for name in (first, second):
        if name not in lines:
            raise ValueError(
                f"no free {name!r} is within its bounds; there are {alternatives(name, list(lines))}."
            )
    if first == second:
        raise ValueError(
            f"a contour of {first!r} needs another parameter: there are {', '.join(lines)}."
        )
    if directions < FEWEST_DIRECTIONS:
        raise ValueError(f"directions is {directions}: give at least {FEWEST_DIRECTIONS}.")
    return _contour(nlp, fit, lines[first], lines[second], level, directions)


def _contour(
    nlp: CompiledProblem, fit: Fit, first: Quantity, second: Quantity, level: float, directions: int
) -> Contour:
    from scipy.special import fdtri  # noqa: PLC0415  (takes a tenth of a second to import)

    best = _best(nlp, fit)
    x, accuracy = best.x, best.accuracy
    places = [nlp.free.index(first.name), nlp.free.index(second.name)]
    limit = math.sqrt(2 * float(fdtri(2, min(first.dof, second.dof, 1e9), level)))
    block = accuracy.covariance[np.ix_(places, places)]
    axes = (
        np.linalg.cholesky(block) if np.linalg.det(block) > 0 else np.diag(accuracy.size[places])
    ).astype(float)
    search = _Search(
        held=best.held.of(*places),
        best=_Point(0.0, best.point, best.cost),
        factor=float(np.mean([_factor(accuracy, np.eye(len(x))[place]) for place in places])),
        numbers=_numbers(nlp),
        limit=limit,
        bounds=(0.0, math.inf),
        size=1.0,
        first=limit,
        starts=np.zeros((0, len(x))),
    )
    center, bounds = x[places], np.array([first.bounds, second.bounds])
    bias = np.linalg.solve(axes, [first.bias, second.bias])
    bias *= min(1.0, MOST_BIAS * limit / max(float(np.linalg.norm(bias)), 1e-300))
    points, ends = [], []
    for angle in 2 * math.pi * np.arange(directions) / directions:
        direction = np.array([math.cos(angle), math.sin(angle)])
        ray, along = axes @ direction, float(direction @ bias)
        own = replace(search, limit=math.sqrt(limit**2 - bias @ bias + along**2) - along)
        reach, end = own.along(center, ray, bounds)
        points.append(center + reach * ray)
        ends.append(end)
    return Contour(
        names=(first.name, second.name),
        units=(first.unit, second.unit),
        level=level,
        estimate=center,
        covariance=block,
        limit=limit,
        points=np.array(points),
        ends=tuple(ends),
    )


@dataclass(frozen=True, eq=False)
class _Best:
    """The estimate: its parameters x (p,) and their accuracy, its cost, and what minimizes beside it, from a point."""

    x: Array
    accuracy: Accuracy
    cost: float
    point: Array
    held: _Held | HeldRecords


def _best(nlp: CompiledProblem, fit: Fit) -> _Best:
    """Return the estimate of a fit, if costs are ratios of likelihoods there."""
    x = np.array([fit.estimate[name] for name in nlp.free])
    refusal = ratio_refusal(nlp, x)
    if any(part.has_states for part in nlp.parts):
        held, point, cost, trajectories = best_of_records(nlp, x)
        x = nlp.scaling.to_parameters(point[: len(x)])
        best = _Best(x, assess(nlp, x, trajectories), cost, point, held)
    else:
        point = nlp.scaling.to_solver(x)
        accuracy = assess(nlp, x, tuple(part.initial_trajectory(point) for part in nlp.parts))
        best = _Best(x, accuracy, nlp.cost(nlp.all_values(x)), point, _Held(nlp, (), None))
    if refusal or best.accuracy.white is None:
        raise ValueError(f"no profile of {fit.name!r}: {refusal or 'its errors are not known'}.")
    return best


def _profiles(
    nlp: CompiledProblem,
    fit: Fit,
    lines: Sequence[Quantity],
    level: float,
    fresh: int,
    executor: Executor | None = None,
) -> Profiles:
    from scipy.special import stdtrit  # noqa: PLC0415

    best = _best(nlp, fit)
    x, accuracy, cost = best.x, best.accuracy, best.cost
    parameters = nlp.problem.parameters
    drawn = (
        Sobol(fresh, 0).draw({name: parameters[name] for name in nlp.free})
        if fresh
        else np.zeros((0, len(x)))
    )
    starts = nlp.scaling.to_solver(drawn)
    by_name = {formula.name: formula for formula in formulas(nlp.problem)}
    searches, limits = [], {}
    for line in lines:
        place = nlp.free.index(line.name) if line.name in nlp.free else None
        if place is None:
            value = _value_of(nlp, by_name[line.name])
            held = best.held.of_quantity(value)
            slope = slope_of(value, nlp.scaling.to_solver(x)) * nlp.scaling.slope(x)
        else:
            held, slope = best.held.of(place), np.eye(len(x))[place]
        dof = accuracy.dof if not math.isfinite(line.dof) else line.dof
        limit = float(stdtrit(min(dof, 1e9), 0.5 + level / 2))
        limits[line.name] = limit
        bounds = line.bounds if place is not None else (-math.inf, math.inf)
        size = float(np.max(np.abs([line.value, *(slope * nlp.scaling.slope(x) ** -1)])))
        error = line.standard_error
        first = STEP * limit * error if math.isfinite(error) and error > 0 else 0.02 * size
        search = _Search(
            held=held,
            best=_Point(line.value if place is None else x[place], best.point, cost),
            factor=_factor(accuracy, slope),
            numbers=_numbers(nlp),
            limit=limit,
            bounds=bounds,
            size=size,
            first=min(first, *(STEP * abs(b - line.value) or math.inf for b in bounds)),
            starts=starts,
            bias=line.bias / error if error > 0 else 0.0,
        )
        searches.append((nlp, search, line))
    found = call_all(
        _profile_of, searches, executor, lambda each: counted_off(each, "profiles", "profile")
    )
    lower = min((float(one.costs.min()) for one in found), default=math.inf)
    warnings = ()
    if lower < cost - LOWER * max(abs(cost), 1.0):
        warnings = (
            f"a profile found the cost {number(lower)} below the fit's {number(cost)}: fit from more starts.",
        )
    return Profiles(fit.name, level, limits, nlp.free, tuple(found), warnings)


def _profile_of(nlp: CompiledProblem, search: _Search, line: Quantity) -> ProfileOf:
    lowest, highest = -search.limit - search.bias, search.limit - search.bias
    walks = [replace(search, limit=max(limit, STEP * search.limit)) for limit in (-lowest, highest)]
    (down, low_end), (up, high_end) = walks[0].side(-1), walks[1].side(1)
    points = search.swept([*down[::-1], *up[1:]])
    roots = np.array([search.signed_root(point) for point in points])
    inside = np.flatnonzero((roots >= lowest) & (roots <= highest))
    if not inside.size:  # beyond the bound at which the walk ended
        inside = np.array([np.argmin(np.abs(roots + search.bias))])
    first, last = inside[0], inside[-1]
    low = search.crossing(points[first - 1], points[first], lowest) if first > 0 else -math.inf
    high = (
        search.crossing(points[last], points[last + 1], highest)
        if last < len(points) - 1
        else math.inf
    )
    ends: tuple[End, End] = (
        "crossed" if first > 0 else low_end,
        "crossed" if last < len(points) - 1 else high_end,
    )

    def held(point: _Point, is_open: bool) -> tuple[str, ...]:
        """Name the parameters at a bound, but for the one that is held and those that the estimate has there too."""
        x, best = (nlp.scaling.to_parameters(z[: len(nlp.free)]) for z in (point.z, search.best.z))
        room, was = (np.minimum(v - nlp.lower, nlp.upper - v) for v in (x, best))
        near = (room <= CLOSE * np.abs(x)) & (was > CLOSE * np.abs(best))
        names = [name for name, at in zip(nlp.free, near, strict=True) if at and name != line.name]
        return () if is_open else tuple(names)

    outer = points[max(first - 1, 0)], points[min(last + 1, len(points) - 1)]
    return ProfileOf(
        name=line.name,
        unit=line.unit,
        estimate=line.value,
        standard_error=line.standard_error,
        values=np.array([point.value for point in points]),
        costs=np.array([point.cost for point in points]),
        roots=roots,
        others=nlp.scaling.to_parameters(np.array([point.z[: len(nlp.free)] for point in points])),
        interval=(low, high),
        ends=ends,
        bounds=line.bounds,
        bias=search.bias,
        at_bound=(held(outer[0], math.isinf(low)), held(outer[1], math.isinf(high))),
        connected=len(inside) == int(last - first) + 1,
    )
