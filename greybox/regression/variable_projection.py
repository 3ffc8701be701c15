"""Variable projection: least squares for the linear unknowns within a search over the others."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from greybox.files.arrays import Array
from greybox.formulation.starts import Sobol
from greybox.modeling.parameter import Parameter
from greybox.regression.least_squares import Rows, solve, undetermined
from greybox.regression.regressors import Regressors
from greybox.regression.smoothing import reach, stretches

# Share of the interval between bounds, closer than which a value is at its bound.
TOUCHING = 1e-6


@dataclass(frozen=True)
class UsedEquation:
    """One regression: left side, R², number of rows, band of its terms (Hz), and residual (rms).

    It has 0 rows if no stretch was long enough.
    """

    left: str
    parameters: tuple[str, ...]
    r_squared: float
    rows: int
    band: float
    residual: float


@dataclass(frozen=True, eq=False)
class Projection:
    """The solution over all equations.

    Attributes
    ----------
    names : tuple of str
        The estimated parameters, in the order of `values`.
    at_bound : tuple of str
    equations : tuple of UsedEquation
    undetermined : tuple of tuples of names
        Parameters that have no effect, alone or in a combination.
    """

    names: tuple[str, ...]
    values: Array
    at_bound: tuple[str, ...]
    equations: tuple[UsedEquation, ...]
    undetermined: tuple[tuple[str, ...], ...]
    search: "_Search" = field(repr=False)
    point: Array = field(repr=False)
    unknowns: Array = field(repr=False)
    weights: Array = field(repr=False)

    @property
    def vector(self) -> Array:
        """All free parameters, those that enter linearly at their start."""
        return self.search.vector(self.point)

    def step(self, data: Regressors) -> Array:
        """Return the Gauss-Newton step (k,) from here for other data of the same equations."""
        search = replace(self.search, data=data, last={})
        rows = search.rows(self.point)
        weights = self.weights[rows.equation]
        columns = search.columns
        # Values at their bounds are held; a bound would cut the small steps of the others.
        free = [k for k, n in enumerate(columns) if n in self.names and n not in self.at_bound]
        unbounded = np.full(len(free), np.inf)
        slopes = search.slopes(self.point, self.unknowns)[:, free]
        errors = rows.errors(self.unknowns)
        step = np.zeros(len(columns))
        step[free] = solve(weights[:, None] * slopes, weights * errors, -unbounded, unbounded)
        return step[[columns.index(n) for n in self.names]]


@dataclass(frozen=True, eq=False)
class _Search:
    """The data as functions of the nonlinear unknowns, `point`."""

    data: Regressors
    parameters: Mapping[str, Parameter]
    start: Array
    size: int = 0  # number of rows, the same wherever simulated states are stable
    last: dict[bytes, Rows] = field(default_factory=dict)  # the rows that were needed last

    @property
    def linear(self) -> tuple[str, ...]:
        return self.data.equations.linear

    @property
    def nonlinear(self) -> tuple[str, ...]:
        return self.data.equations.nonlinear

    @property
    def columns(self) -> tuple[str, ...]:
        return (*self.linear, *self.nonlinear)

    def bounds(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        low, high = np.reshape([self.parameters[n].bounds for n in names], (-1, 2)).T
        return low, high

    def rows(self, point: Array) -> Rows:
        """Return the regressions at the nonlinear values `point`, in their own units."""
        if point.tobytes() not in self.last:
            self.last.clear()
            self.last[point.tobytes()] = self.data.rows(self.vector(point))
        return self.last[point.tobytes()]

    def vector(self, point: Array) -> Array:
        """Return all free parameters, the linear ones at their start."""
        p = self.start.copy()
        p[[self.data.equations.free.index(name) for name in self.nonlinear]] = point
        return p

    def linear_unknowns(self, point: Array, weights: Array) -> Array:
        return self.rows(point).solution(weights, *self.bounds(self.linear))

    def weights(self, point: Array, unknowns: Array | None = None) -> Array:
        """Return one over the rms error of every equation, without unknowns of its target."""
        rows = self.rows(point)
        errors = rows.target if unknowns is None else rows.errors(unknowns)
        return 1 / rows.spread(errors, len(self.data.equations.equations))

    def slopes(self, point: Array, unknowns: Array) -> Array:
        """Return the slopes of the rows to the linear and the nonlinear unknowns."""
        rows = self.rows(point)
        columns = [rows.slopes]
        widths = _widths(*self.bounds(self.nonlinear), point)
        for k, width in enumerate(widths):
            # Central differences err by the square of 1e-4, and rounding by 1e-12.
            size = 1e-4 * min(width, max(abs(point[k]), 1e-3 * width))
            moves = [sign * size * (np.arange(len(point)) == k) for sign in (1, -1)]
            ends = [self.rows(point + move) for move in moves]
            if any(end.target.size != rows.target.size for end in ends):
                # A simulated state becomes unstable there, or rows are lost: a difference of these
                # residuals does not exist.
                columns.append(np.zeros((rows.target.size, 1)))
                continue
            above, below = (end.base + end.slopes @ unknowns for end in ends)
            columns.append((above - below)[:, None] / (2 * size))
        return np.hstack(columns)


def project(data: Regressors, parameters: Mapping[str, Parameter], start: Array) -> Projection:
    """Estimate the free `parameters`, from the values `start`, by the regressions of `data`.

    Raises
    ------
    ValueError
        If no stretch is long enough, a simulated state is not stable, or nothing is determined.
    """
    search = _Search(data, parameters, start)
    first = np.array([parameters[n].start for n in search.nonlinear])
    search = replace(search, size=search.rows(first).target.size)
    if not search.size:
        longest = max(rows.stop - rows.start for rows in stretches(data.time, data.time))
        lost = 2 * reach(min(data.bands)) + data.lateness
        raise ValueError(
            "no stretch without a gap is long enough: the longest piece of the record has "
            f"{longest * data.step:.3g} s, of which smoothing, delays and simulated states need "
            f"{lost:.3g} s at its ends; give a longer or less noisy record."
        )
    point = _located(search, first)

    # The equations are weighted by the sizes of their residuals, known only after a first solution.
    weights = search.weights(point)
    weights = search.weights(point, search.linear_unknowns(point, weights))
    # Weights and estimate determine one another; each pass changes the weights less.
    for _ in range(3 if len(weights) > 1 else 1):
        point = _refine(search, point, weights)
        weights = search.weights(point, search.linear_unknowns(point, weights))
    return _judged(search, point, search.linear_unknowns(point, weights), weights)


def _widths(low: Array, high: Array, point: Array) -> Array:
    """Return the intervals between bounds, or the size of the value without bounds."""
    return np.where(np.isfinite(high - low), high - low, np.maximum(np.abs(point), 1))


def _errors(search: _Search, point: Array, weights: Array) -> Array:
    """Return the weighted residuals at `point`."""
    rows = search.rows(point)
    # Rows are lost where a simulated state is unstable.
    if rows.target.size != search.size:
        return np.full(search.size, 1e3)  # worse than any that exist
    return weights[rows.equation] * rows.errors(search.linear_unknowns(point, weights))


def _located(search: _Search, start: Array) -> Array:
    """Return the best result of searches from the start and from a good point."""
    if not start.size:
        return start
    weights = search.weights(start)

    def cost(point: Array) -> float:
        return float(np.mean(_errors(search, point, weights) ** 2))

    # There are one to three nonlinear unknowns, delays and lags: eight points are enough.
    boxes = {n: search.parameters[n] for n in search.nonlinear}
    is_bounded = all(np.all(np.isfinite(p.box)) for p in boxes.values())
    points = [min(Sobol(8).draw(boxes), key=cost)] if is_bounded else []
    ends = [_refine(search, point, weights) for point in [start, *points]]
    return min(ends, key=cost)


def _refine(search: _Search, point: Array, weights: Array) -> Array:
    """Minimize over the nonlinear unknowns within their bounds."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (imports slowly)

    if not point.size:
        return point
    low, high = search.bounds(search.nonlinear)
    width = _widths(low, high, point)
    begin = _errors(search, point, weights)

    # `least_squares` begins strictly within the bounds.
    inside = np.clip(point, low + TOUCHING * width, high - TOUCHING * width)
    end = least_squares(
        lambda values: _errors(search, values, weights),
        inside,
        bounds=(low, high),
        x_scale=width,
        xtol=1e-8,
        ftol=1e-10,
    )
    at_bound = 2 * TOUCHING * width
    values = np.where(high - end.x < at_bound, high, end.x)
    values = np.where(end.x - low < at_bound, low, values)
    return values if 2 * end.cost <= begin @ begin else point


def _judged(search: _Search, point: Array, unknowns: Array, weights: Array) -> Projection:
    values = np.concatenate([unknowns, point])
    low, high = search.bounds(search.columns)
    groups = undetermined(search.slopes(point, unknowns))
    in_groups = {k for group in groups for k in group}
    determined = [k for k in range(len(values)) if k not in in_groups]
    if not determined:
        raise ValueError(
            f"the record determines none of {', '.join(search.columns)}: the signals that they "
            "multiply are constant, or only a combination of them is determined; fix some."
        )

    return Projection(
        names=tuple(search.columns[k] for k in determined),
        values=values[determined],
        at_bound=tuple(search.columns[k] for k in determined if not low[k] < values[k] < high[k]),
        equations=tuple(_used_equations(search, point, unknowns)),
        undetermined=tuple(tuple(search.columns[k] for k in group) for group in groups),
        search=search,
        point=point,
        unknowns=unknowns,
        weights=weights,
    )


def _used_equations(search: _Search, point: Array, unknowns: Array) -> Iterator[UsedEquation]:
    data, rows = search.data, search.rows(point)
    errors = rows.errors(unknowns)
    residuals = 1 / search.weights(point, unknowns)
    for k, (equation, band) in enumerate(zip(data.equations.equations, data.bands, strict=True)):
        of = rows.equation == k
        share, count = explained(rows.target[of], errors[of]), int(of.sum())
        band_hz = band / (2 * math.pi)
        left, names = equation.left, equation.parameters
        yield UsedEquation(left, names, share, count, band_hz, float(residuals[k]))


def explained(target: Array, errors: Array) -> float:
    """Return the explained share of the variance of an equation; NaN if it is constant."""
    variance = float(np.sum((target - np.mean(target)) ** 2)) if target.size else 0.0
    return 1 - float(errors @ errors) / variance if variance > 0 else math.nan
