"""Refits of frequency responses to drawn data, many at once, from the estimate.

A run draws its data by its number: seed and number determine its random numbers. A worker receives
the measured data and the fitted response as numbers, and the compiled cost.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING, ResponsePart
from greybox.compiled.scaling import Scaling
from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.modeling.one_thread import cached_property
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.interruption import reason_to_end
from greybox.solve.ipopt import CONVERGED, WARM, Ipopt
from greybox.solve.local_solver import Runner
from greybox.solve.response_solver import AT_MINIMUM, ITERATIONS, TOLERANCE, fits_a_batch
from greybox.solve.runs import IMPROVED, Outcome
from greybox.study.open_data import program_input

# Share of the variance of an error that is left in its residual, at least: a fit that nearly passes
# through a point shows nothing of the error there, and must not make it infinite.
LEAST_LEFT = 0.1


@dataclass(frozen=True, eq=False)
class DrawnPart:
    """The fitted response of one part, and the errors of its data.

    Attributes
    ----------
    omega : (n,) array, rad/s
    response : (n,) complex array
        The fitted response.
    size : (n,) array
        Relative sizes of the errors.
    deviation : float
        Standard deviation of one component of an error, in multiples of `size`.
    dof : (n,) array or None
        Degrees of freedom of `size` where it was estimated.
    common : (m, n) complex array or None
        Errors that all points have in common; `size` does not contain them.
    neighbors : (float, float) or None
        If errors are correlated along frequency: the correlation of neighbors, and the factor on
        the variance.
    """

    omega: Array
    response: ComplexArray
    size: Array
    deviation: float
    dof: Array | None = None
    common: ComplexArray | None = None
    neighbors: tuple[float, float] | None = None

    def drawn(self, random: np.random.Generator) -> ComplexArray:
        """Return the fitted response with normal errors."""
        measured = self.response + self.size * self._normal_errors(random)
        if self.common is not None:
            measured = measured + random.standard_normal(len(self.common)) @ self.common
        return measured

    def _normal_errors(self, random: np.random.Generator) -> ComplexArray:
        count = len(self.response)
        normal = random.standard_normal(count) + 1j * random.standard_normal(count)
        if self.neighbors is not None:
            normal = self._correlated(normal, *self.neighbors)
        # The size is an estimate itself: the errors over it have Student's t distribution.
        if self.dof is not None:
            normal = normal / np.sqrt(random.chisquare(self.dof) / self.dof)
        return self.deviation * normal

    def _correlated(self, normal: ComplexArray, correlation: float, scale: float) -> ComplexArray:
        """Return errors that are correlated between neighbors, along and across the response."""
        # Noise in magnitude and noise in phase are correlated each along frequency, while real and
        # imaginary part turn with the response.
        from scipy.signal import lfilter  # noqa: PLC0415 - takes a third of a second to import

        order = np.argsort(self.omega, kind="stable")
        normal = math.sqrt(scale) * normal[order]
        normal[1:] *= math.sqrt(1 - correlation**2)
        normal = np.asarray(lfilter([1.0], [1.0, -correlation], normal))
        return normal[np.argsort(order)] * np.exp(1j * np.angle(self.response))


@dataclass(frozen=True, eq=False)
class ResponseDraws:
    """How the data of replicates of a problem of responses are drawn.

    Attributes
    ----------
    seed : int
    parts : tuple of DrawnPart
    constants : (c,) array
        Constants of the problem.
    root : (c, r) array
        A square root of their covariance.
    """

    seed: int
    parts: tuple[DrawnPart, ...]
    constants: Array
    root: Array

    def replicate(self, number: int) -> Array:
        """Return the data of a replicate as input (g,) of the program."""
        random = np.random.default_rng([self.seed, number])
        constants = self._constants(random)
        return program_input(constants, [part.drawn(random) for part in self.parts])

    def constants_of(self, number: int) -> Array:
        """Return the constants (c,) of a replicate."""
        return self._constants(np.random.default_rng([self.seed, number]))

    def _constants(self, random: np.random.Generator) -> Array:
        return self.constants + self.root @ random.standard_normal(self.root.shape[1])


def response_draws(
    nlp: CompiledProblem,
    x: Array,
    at_bound: BoolArray,
    covariance: Array,
    seed: int,
    neighbors: Sequence[tuple[float, float] | None] = (),
) -> ResponseDraws:
    """Return how replicates of a problem of responses are drawn, at the estimate x (p,).

    Source: Davison and Hinkley (1997), Bootstrap Methods and their Application, section 6.2.2.

    Parameters
    ----------
    nlp : CompiledProblem
    x : (p,) array
    at_bound : (p,) array of bool
        Parameters that are held by a bound.
    covariance : (c, c) array
        Covariance of the constants.
    seed
        See `ResponseDraws`.
    neighbors
        For every part, see `DrawnPart`.

    Raises
    ------
    ValueError
        If the data are fitted exactly.
    """
    values = nlp.all_values(x)
    parts = [part for part in nlp.parts if isinstance(part, ResponsePart)]
    fitted = [_fitted(part, values) for part in parts]
    slopes = [
        part.sensitivity(values)[:, : len(x)][:, ~at_bound] / (points.size * points.rms)[:, None]
        for part, points in zip(parts, fitted, strict=True)
    ]
    # The fit makes a residual smaller than its error by the root of one minus its leverage. A
    # parameter at its bound takes nothing from the residuals.
    leverages = _leverages(slopes, nlp.scaling.slope(x)[~at_bound])
    pairs = neighbors or [None] * len(parts)
    # Cholesky needs a definite matrix, and constants without errors make this one singular.
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))[:, eigenvalues > 0]
    return ResponseDraws(
        seed,
        tuple(map(_drawn_part, parts, fitted, leverages, pairs)),
        constants=nlp.constant_values,
        root=root,
    )


class _Fitted(NamedTuple):
    response: ComplexArray
    size: Array
    residuals: ComplexArray
    rms: float


def _fitted(part: ResponsePart, values: Array) -> _Fitted:
    """Return the fitted response of a part, and its residuals over the size of the errors."""
    response = part.response(values)
    size = part.criterion.error_size(response, part.data)
    # What all points have in common is drawn once for all of them, not point by point.
    if part.criterion.known_noise:
        size = size * np.sqrt(np.maximum(part.data.independent_share, LEAST_LEFT))

    residuals = (part.data.response - response) / size
    rms = math.sqrt(float(np.mean(np.abs(residuals) ** 2)))
    if not rms > math.sqrt(np.finfo(float).eps):
        raise ValueError(f"{part.name!r} is fitted exactly: the size of its errors is not known.")
    return _Fitted(response, size, residuals, rms)


def _drawn_part(
    part: ResponsePart, fitted: _Fitted, leverage: Array, neighbors: tuple[float, float] | None
) -> DrawnPart:
    has_variances = part.criterion.known_noise
    square = float(np.mean(np.abs(fitted.residuals) ** 2 / np.maximum(1 - leverage, LEAST_LEFT)))
    if has_variances:  # given variances are believed, unless the residuals are larger
        square = max(square, 1.0)
    return DrawnPart(
        part.data.omega,
        fitted.response,
        fitted.size,
        math.sqrt(square / 2),
        dof=part.data.dof if has_variances else None,
        common=part.data.common_errors,
        neighbors=neighbors,
    )


def _leverages(slopes: Sequence[ComplexArray], scale: Array) -> list[Array]:
    """Return the leverages (n,) of the points by part, from the derivatives (n, p) of errors."""
    rows = [np.vstack([slope.real, slope.imag]) for slope in slopes]
    basis, singular, _ = np.linalg.svd(np.vstack(rows) / scale, full_matrices=False)
    # Below this singular value a direction takes nothing from the residuals.
    seen = basis[:, singular > 1e-7 * singular.max(initial=0.0)]
    leverage = (seen**2).sum(axis=1)
    ends = np.cumsum([len(row) for row in rows])[:-1]
    return [part.reshape(2, -1).mean(axis=0) for part in np.split(leverage, ends)]


class ResponseReplicates(Runner):
    """Newton's method on many data sets at once from the estimate; IPOPT where it fails.

    Parameters
    ----------
    draws : ResponseDraws
    program : casadi.Function
        (z, smoothing, given) -> cost, limits.
    start : (p,) array
        The estimate.
    lower, upper : (p,) arrays
        Bounds of the parameters.
    scaling : Scaling
    """

    # A batch of 128 takes a tenth of a second for the tilt model: enough for workers to share a
    # thousand replicates evenly, at 0.2 ms more for each than in one batch.
    together = 128

    def __init__(
        self,
        draws: ResponseDraws,
        program: ca.Function,
        start: Array,
        lower: Array,
        upper: Array,
        scaling: Scaling,
    ) -> None:
        self._arguments = draws, program, start, lower, upper, scaling
        self._draws = draws
        self._program = program
        self._limits = lower, upper
        self._scaling = scaling
        self._bounds = scaling.to_solver(lower), scaling.to_solver(upper)
        self._start = np.clip(scaling.to_solver(start), *self._bounds)

    def __reduce__(self) -> tuple[Callable[..., "ResponseReplicates"], tuple[Any, ...]]:
        return ResponseReplicates, self._arguments

    def constants_of(self, number: int) -> Array:
        """Return the constants (c,) of a replicate."""
        return self._draws.constants_of(number)

    def run(self, start: Array) -> Outcome:
        """Refit the replicate with this number (1,)."""
        return self.run_together(start[None])[0]

    def run_together(self, starts: Array) -> list[Outcome]:
        """Refit the replicates with these numbers (r, 1)."""
        began = time.perf_counter()
        numbers = starts[:, 0].astype(int).tolist()
        outcomes = self._solved(np.array([self._draws.replicate(number) for number in numbers]).T)
        seconds = (time.perf_counter() - began) / len(starts)
        return [replace(outcome, seconds=seconds) for outcome in outcomes]

    def _solved(self, numbers: Array) -> list[Outcome]:
        """Solve for the data in the columns of `numbers` (g, m)."""
        if self._newton is None:
            return [self._by_ipopt(column) for column in numbers.T]
        ends = self._newton.minimize(
            np.tile(self._start[:, None], numbers.shape[1]),
            max_iterations=ITERATIONS,
            tolerance=TOLERANCE,
            from_near=True,
            given=numbers,
        )
        return [
            Outcome(
                self._estimate(ends.z[:, k]),
                AT_MINIMUM,
                int(ends.iterations[k]),
                0.0,
                converged=True,
                stage=IMPROVED,
            )
            if ends.at_minimum[k]
            else self._by_ipopt(column)
            for k, column in enumerate(numbers.T)
        ]

    @cached_property
    def _newton(self) -> BatchedNewton | None:
        return BatchedNewton(self._program, *self._bounds) if fits_a_batch(self._program) else None

    @cached_property
    def _ipopt(self) -> Ipopt:
        kind: Any = ca.SX if self._program.is_a("SXFunction") else ca.MX
        z = kind.sym("z", self._program.numel_in(0))
        p = kind.sym("p", 1 + self._program.numel_in(2))
        cost, limits = self._program(z, p[0], p[1:])
        return Ipopt({"x": z, "p": p, "f": cost, "g": limits}, WARM)

    def _by_ipopt(self, numbers: Array) -> Outcome:
        # IPOPT takes much longer than a batch: check the time limit before each solve.
        if cut := reason_to_end():
            return Outcome(np.full(len(self._start), np.nan), cut, 0, 0.0, converged=False)
        lower, upper = self._bounds
        bounds = {"lbx": lower, "ubx": upper, "lbg": 0.0, "ubg": math.inf}
        p = np.concatenate([[SMOOTHING], numbers])
        end, status, iterations = self._ipopt.solve(self._start, p, bounds)
        return Outcome(self._estimate(end), status, iterations, 0.0, converged=status in CONVERGED)

    def _estimate(self, z: Array) -> Array:
        return np.clip(self._scaling.to_parameters(z), *self._limits)
