"""Variable projection: least squares for the linear unknowns within a search over the others."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from greybox.files.arrays import Array
from greybox.formulation.starts import Sobol
from greybox.modeling.parameter import Parameter
from greybox.regression.least_squares import (
    Block,
    residuals,
    solve,
    spread,
    undetermined,
)
from greybox.regression.regressors import Regressors
from greybox.regression.smoothing import reach, stretches

# Share of the interval between bounds, closer than which a value is at its bound.
TOUCHING = 1e-6


@dataclass(frozen=True, eq=False)
class Projection:
    """The solution over all equations.

    Attributes
    ----------
    names : tuple of str
        The estimated parameters, in the order of `values`.
    at_bound : tuple of str
    r_squared, rows, spread : tuple
        For every equation; 0 rows if no stretch was long enough.
    undetermined : tuple of tuples of names
        Parameters that have no effect, alone or in a combination.
    """

    names: tuple[str, ...]
    values: Array
    at_bound: tuple[str, ...]
    r_squared: tuple[float, ...]
    rows: tuple[int, ...]
    spread: tuple[float, ...]
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
        search = self.search.on(data)
        blocks = search.full(self.point, self.unknowns)
        free = [
            k for k, n in enumerate(search.columns) if n in self.names and n not in self.at_bound
        ]
        linear = slice(len(self.unknowns))
        remaining = [
            Block(
                b.equation,
                b.target - b.base - b.slopes[:, linear] @ self.unknowns,
                0 * b.base,
                b.slopes[:, free],
            )
            for b in blocks
        ]
        # Values at their bounds are held; a bound would cut the small steps of the others.
        unbounded = np.full(len(free), np.inf)
        step = np.zeros(len(search.columns))
        step[free] = (
            solve(remaining, self.weights, -unbounded, unbounded) if remaining else math.nan
        )
        return step[[search.columns.index(n) for n in self.names]]


@dataclass(frozen=True, eq=False)
class _Search:
    """The data as functions of the nonlinear unknowns, `point`."""

    data: Regressors
    parameters: Mapping[str, Parameter]
    start: Array
    last: dict[bytes, list[Block]] = field(default_factory=dict)  # the regressions asked for last

    @property
    def linear(self) -> tuple[str, ...]:
        return self.data.equations.linear

    @property
    def nonlinear(self) -> tuple[str, ...]:
        return self.data.equations.nonlinear

    @property
    def columns(self) -> tuple[str, ...]:
        return (*self.linear, *self.nonlinear)

    def on(self, data: Regressors) -> "_Search":
        return _Search(data, self.parameters, self.start)

    def bounds(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        low, high = np.reshape([self.parameters[n].bounds for n in names], (-1, 2)).T
        return low, high

    def blocks(self, point: Array) -> list[Block]:
        """Return the regressions at the nonlinear values `point`, in their own units."""
        if point.tobytes() not in self.last:
            self.last.clear()
            self.last[point.tobytes()] = self.data.blocks(self.vector(point))
        return self.last[point.tobytes()]

    def vector(self, point: Array) -> Array:
        """Return all free parameters, the linear ones at their start."""
        p = self.start.copy()
        for name, value in zip(self.nonlinear, point, strict=True):
            p[self.data.equations.free.index(name)] = value
        return p

    def full(self, point: Array, unknowns: Array) -> list[Block]:
        """Return the regressions with slopes to the nonlinear unknowns appended."""
        blocks = self.blocks(point)
        slopes: list[list[Array]] = []
        widths = _widths(*self.bounds(self.nonlinear), point)
        for k, width in enumerate(widths):
            # Central differences err by the square of 1e-4, and rounding by 1e-12.
            size = 1e-4 * min(width, max(abs(point[k]), 1e-3 * width))
            ends = [
                self.blocks(point + sign * size * (np.arange(len(point)) == k)) for sign in (1, -1)
            ]
            if any([len(b.base) for b in end] != [len(b.base) for b in blocks] for end in ends):
                # A simulated state becomes unstable there, or rows are lost: a difference of these
                # residuals does not exist.
                slopes.append([0 * b.base for b in blocks])
                continue
            above, below = ([b.base + b.slopes @ unknowns for b in end] for end in ends)
            slopes.append([(a - b) / (2 * size) for a, b in zip(above, below, strict=True)])
        return [
            Block(
                b.equation, b.target, b.base, np.column_stack([b.slopes, *(s[k] for s in slopes)])
            )
            for k, b in enumerate(blocks)
        ]


def project(data: Regressors, parameters: Mapping[str, Parameter], start: Array) -> Projection:
    """Estimate the free `parameters`, from the values `start`, by the regressions of `data`.

    Raises
    ------
    ValueError
        If no stretch is long enough, a simulated state is not stable, or nothing is determined.
    """
    search = _Search(data, parameters, start)
    first = search.blocks(np.array([parameters[n].start for n in search.nonlinear]))
    if not first:
        raise ValueError(_too_short(data))
    point = _located(search)

    # The equations are weighted by the sizes of their residuals, known only after a first solution.
    blocks = search.blocks(point)
    weights = _weights(blocks, [b.target for b in blocks])
    weights = _weights(blocks, residuals(blocks, _inner(search, blocks, weights)))
    # Weights and estimate determine one another; each pass changes the weights less.
    for _ in range(3 if len(weights) > 1 else 1):
        point = _refine(search, point, weights)
        blocks = search.blocks(point)
        unknowns = _inner(search, blocks, weights)
        weights = _weights(blocks, residuals(blocks, unknowns))
    unknowns = _inner(search, blocks, weights)
    return _judged(search, point, unknowns, weights)


def _widths(low: Array, high: Array, point: Array) -> Array:
    """Return the intervals between bounds, or the size of the value without bounds."""
    return np.where(np.isfinite(high - low), high - low, np.maximum(np.abs(point), 1))


def _too_short(data: Regressors) -> str:
    longest = max(rows.stop - rows.start for rows in stretches(data.time, data.time))
    lost = 2 * reach(min(data.bands)) + data.lateness
    return (
        "no stretch without a gap is long enough: the longest piece of the record has "
        f"{longest * data.step:.3g} s, of which smoothing, delays and simulated states need "
        f"{lost:.3g} s at its ends; give a longer or less noisy record."
    )


def _inner(search: _Search, blocks: list[Block], weights: Array) -> Array:
    return solve(blocks, weights, *search.bounds(search.linear))


def _weights(blocks: list[Block], errors: list[Array]) -> Array:
    return 1 / spread(blocks, errors)


def _errors(search: _Search, point: Array, weights: Array) -> Array | None:
    """Return the weighted residuals at `point`; None where the model has none."""
    blocks = search.blocks(point)
    if not blocks:
        return None
    errors = residuals(blocks, _inner(search, blocks, weights))
    return np.concatenate([weights[b.equation] * e for b, e in zip(blocks, errors, strict=True)])


def _located(search: _Search) -> Array:
    """Return the best result of searches from the start and from a good point."""
    start = np.array([search.parameters[n].start for n in search.nonlinear])
    if not start.size:
        return start
    blocks = search.blocks(start)
    weights = _weights(blocks, [b.target for b in blocks])
    size = sum(b.target.size for b in blocks)

    def cost(point: Array) -> float:
        errors = _errors(search, point, weights)
        # Rows are lost where a simulated state is unstable.
        return math.inf if errors is None or errors.size != size else float(np.mean(errors**2))

    # There are one to three nonlinear unknowns, delays and lags: eight points are enough.
    boxes = {n: search.parameters[n] for n in search.nonlinear}
    is_bounded = all(np.all(np.isfinite(p.box)) for p in boxes.values())
    points = sorted(Sobol(8).draw(boxes), key=cost)[:1] if is_bounded else []
    ends = [
        _refine(search, point, weights) for point in [start, *points] if math.isfinite(cost(point))
    ]
    return min(ends, key=cost)


def _refine(search: _Search, point: Array, weights: Array) -> Array:
    """Minimize over the nonlinear unknowns within their bounds."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (imports slowly)

    if not point.size:
        return point
    low, high = search.bounds(search.nonlinear)
    width = _widths(low, high, point)
    begin = _errors(search, point, weights)
    assert begin is not None

    def errors(values: Array) -> Array:
        residual = _errors(search, values, weights)
        if residual is None or residual.size != begin.size:
            return np.full(begin.size, 1e3)  # worse than any that exist
        return residual

    # `least_squares` begins strictly within the bounds.
    inside = np.clip(point, low + TOUCHING * width, high - TOUCHING * width)
    end = least_squares(errors, inside, bounds=(low, high), x_scale=width, xtol=1e-8, ftol=1e-10)
    values = np.where(end.x - low < 2 * TOUCHING * width, low, end.x)
    values = np.where(high - values < 2 * TOUCHING * width, high, values)
    return values if 2 * end.cost <= begin @ begin else point


def _judged(search: _Search, point: Array, unknowns: Array, weights: Array) -> Projection:
    values = np.concatenate([unknowns, point])
    low, high = search.bounds(search.columns)
    groups = undetermined(search.full(point, unknowns))
    in_groups = {k for group in groups for k in group}
    determined = [k for k in range(len(values)) if k not in in_groups]
    if not determined:
        raise ValueError(
            f"the record determines none of {', '.join(search.columns)}: the signals that they "
            "multiply are constant, or only a combination of them is determined; fix some."
        )

    blocks = search.blocks(point)
    errors = residuals(blocks, unknowns)
    rows, r_squared = _explained(blocks, errors, len(search.data.equations.equations))
    return Projection(
        names=tuple(search.columns[k] for k in determined),
        values=values[determined],
        at_bound=tuple(search.columns[k] for k in determined if not low[k] < values[k] < high[k]),
        r_squared=r_squared,
        rows=rows,
        spread=tuple(spread(blocks, errors)),
        undetermined=tuple(tuple(search.columns[k] for k in group) for group in groups),
        search=search,
        point=point,
        unknowns=unknowns,
        weights=weights,
    )


def _explained(
    blocks: list[Block], errors: list[Array], count: int
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the number of rows and the explained share of variance of every equation."""
    rows = []
    shares = []
    for k in range(count):
        target = np.concatenate([np.zeros(0), *(b.target for b in blocks if b.equation == k)])
        error = np.concatenate(
            [np.zeros(0), *(e for b, e in zip(blocks, errors, strict=True) if b.equation == k)]
        )
        rows.append(target.size)
        variance = float(np.sum((target - np.mean(target)) ** 2)) if target.size else 0.0
        shares.append(1 - float(error @ error) / variance if variance > 0 else math.nan)
    return tuple(rows), tuple(shares)
