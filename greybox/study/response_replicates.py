"""Refits of frequency responses whose data are drawn anew, from the estimate, many at once.

A run draws its data by its number: its random numbers follow from the seed and the number alone. A
worker receives the measured data and the fitted response as numbers, and the compiled cost.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING, ResponsePart
from greybox.compiled.scaling import Scaling
from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.batched_solver import AT_MINIMUM, ITERATIONS, TOLERANCE, fits_a_batch
from greybox.solve.interruption import reason_to_end
from greybox.solve.ipopt import CONVERGED, WARM, Ipopt
from greybox.solve.local_solver import Runner
from greybox.solve.outcome import IMPROVED, Outcome
from greybox.study.open_data import data_table, formulas_of_frequency, given, open_program

Drawn = Literal["residuals", "points", "parametric", "parts"]

# Of the variance of a residual, what is taken to be left of that of its error at least: a fit that
# all but passes through a point says nothing of the error there, and must not make it infinite.
LEAST_LEFT = 0.1
UNSEEN = 1e-7  # of the largest singular value of the sensitivities, below which a direction takes nothing from residuals

FEW = (
    "too few distinct points"  # status of a replicate whose points cannot determine the parameters
)

OMEGA, RE, IM = 0, 1, 2  # rows of a table


@dataclass(frozen=True, eq=False)
class ResponseDraws:
    """How the data of replicates of a problem of responses are drawn.

    Attributes
    ----------
    drawn : "residuals", "points", "parametric" or "parts"
    seed : int
    tables : tuple of (rows, n) arrays
        The measured data of every part, see `greybox.study.open_data`.
    responses : tuple of (n,) complex arrays
        The fitted ones.
    sizes : tuple of (n,) arrays
        What the errors are in proportion to.
    errors : tuple of (n,) complex arrays
        Residuals over these, each as large as the error that it stands for.
    deviations : tuple of float
        Standard deviation of one component of the errors over their sizes, of every part.
    dofs : tuple of (n,) arrays or None
        Degrees of freedom of the sizes, where these were estimated.
    common : tuple of (m, n) complex arrays or None
        Errors that all points of a part have in common, which `sizes` and `errors` do not contain.
    constants : (c,) array
        The constants of the problem.
    root : (c, r) array
        A square root of their covariance.
    unknowns : int
        How many parameters are free.
    neighbors : tuple of (float, float) or None
        Of every part whose errors are correlated along frequency, the correlation of neighbors, and
        how many times larger the variances are than `deviations` say.
    """

    drawn: Drawn
    seed: int
    tables: tuple[Array, ...]
    responses: tuple[ComplexArray, ...]
    sizes: tuple[Array, ...]
    errors: tuple[ComplexArray, ...]
    deviations: tuple[float, ...]
    dofs: tuple[Array | None, ...]
    common: tuple[ComplexArray | None, ...]
    constants: Array
    root: Array
    unknowns: int
    neighbors: tuple[tuple[float, float] | None, ...] = ()

    def replicate(self, number: int) -> Array | None:
        """Return what is given for a replicate, (g,); None where its points are too few."""
        random = np.random.default_rng([self.seed, number])
        constants = self._constants(random)
        counts = np.ones(len(self.tables))
        if self.drawn == "points":
            places = [random.integers(0, table.shape[1], table.shape[1]) for table in self.tables]
            if 2 * sum(np.unique(place).size for place in places) <= self.unknowns:
                return None
            return given(
                constants,
                counts,
                [t[:, place] for t, place in zip(self.tables, places, strict=True)],
            )
        if self.drawn == "parts":
            chosen = random.integers(0, len(self.tables), len(self.tables))
            return given(
                constants,
                np.bincount(chosen, minlength=len(self.tables)).astype(float),
                self.tables,
            )
        tables = []
        for k, table in enumerate(self.tables):
            measured = self.responses[k] + self.sizes[k] * self._errors(random, k)
            common = self.common[k]
            if common is not None:
                measured = measured + random.standard_normal(len(common)) @ common
            drawn = table.copy()
            drawn[RE], drawn[IM] = measured.real, measured.imag
            tables.append(drawn)
        return given(constants, counts, tables)

    def constants_of(self, number: int) -> Array:
        """Return the constants (c,) of a replicate."""
        return self._constants(np.random.default_rng([self.seed, number]))

    def _constants(self, random: np.random.Generator) -> Array:
        return self.constants + self.root @ random.standard_normal(self.root.shape[1])

    def _errors(self, random: np.random.Generator, k: int) -> ComplexArray:
        """Return errors of part k over their sizes: with the residuals' magnitudes, or normal ones, at any angle."""
        count = self.tables[k].shape[1]
        if self.drawn == "residuals":
            turn = np.exp(2j * math.pi * random.random(count))
            return self.errors[k][random.integers(0, count, count)] * turn
        normal = random.standard_normal(count) + 1j * random.standard_normal(count)
        if self.neighbors and (known := self.neighbors[k]) is not None:
            from scipy.signal import lfilter  # noqa: PLC0415 - takes a third of a second to import

            correlation, scale = known
            order = np.argsort(self.tables[k][OMEGA], kind="stable")
            normal = math.sqrt(scale) * normal[order]
            normal[1:] *= math.sqrt(1 - correlation**2)
            normal = lfilter([1.0], [1.0, -correlation], normal)
            # As the residuals are compared: along and across the response.
            normal = normal[np.argsort(order)] * np.exp(1j * np.angle(self.responses[k]))
        dof = self.dofs[k]
        if dof is not None:
            normal = normal / np.sqrt(random.chisquare(dof) / dof)
        return self.deviations[k] * normal


def response_draws(
    nlp: CompiledProblem,
    x: Array,
    at_bound: BoolArray,
    covariance: Array,
    drawn: Drawn,
    seed: int,
    neighbors: Sequence[tuple[float, float] | None] = (),
) -> ResponseDraws:
    """Return how replicates of a problem of responses are drawn, at the estimate x (p,).

    Residuals are as large as the errors that they stand for once each is divided by the root of one
    less its leverage, the mean of both components. Source: Davison and Hinkley (1997), Bootstrap
    Methods and their Application, section
    6.2.2.

    Parameters
    ----------
    nlp : CompiledProblem
    x : (p,) array
    at_bound : (p,) array of bool
        Parameters that a bound holds.
    covariance : (c, c) array
        Of the constants.
    drawn, seed, neighbors
        As of `ResponseDraws`.

    Raises
    ------
    ValueError
        For data that are fitted exactly.
    """
    values = nlp.all_values(x)
    parts = [part for part in nlp.parts if isinstance(part, ResponsePart)]
    responses = [part.response(values) for part in parts]
    sizes = [
        part.criterion.error_size(r, part.data) for part, r in zip(parts, responses, strict=True)
    ]
    sizes = [
        size * np.sqrt(np.maximum(part.data.independent_share, LEAST_LEFT))
        if part.criterion.known_noise
        else size
        for part, size in zip(parts, sizes, strict=True)
    ]
    errors = [
        (part.data.response - r) / size
        for part, r, size in zip(parts, responses, sizes, strict=True)
    ]
    spreads = [math.sqrt(float(np.mean(np.abs(error) ** 2))) for error in errors]
    for part, spread in zip(parts, spreads, strict=True):
        if not spread > math.sqrt(np.finfo(float).eps):
            raise ValueError(
                f"{part.name!r} is fitted exactly, so that the size of its errors is not known."
            )
    slopes = [
        part.sensitivity(values)[:, : len(x)][:, ~at_bound] / (size * spread)[:, None]
        for part, size, spread in zip(parts, sizes, spreads, strict=True)
    ]
    leverages = _leverages(slopes, nlp.scaling.slope(x)[~at_bound])
    errors = [
        e / np.sqrt(np.maximum(1 - h, LEAST_LEFT)) for e, h in zip(errors, leverages, strict=True)
    ]
    deviations = []
    for k, part in enumerate(parts):
        square = float(np.mean(np.abs(errors[k]) ** 2))
        if part.criterion.known_noise and square < 1:  # what was given is believed
            errors[k], square = errors[k] / math.sqrt(square), 1.0
        deviations.append(math.sqrt(square / 2))
    found, vectors = np.linalg.eigh(covariance)
    return ResponseDraws(
        drawn=drawn,
        seed=seed,
        tables=tuple(data_table(part.data) for part in parts),
        responses=tuple(responses),
        sizes=tuple(sizes),
        errors=tuple(errors),
        deviations=tuple(deviations),
        dofs=tuple(part.data.dof if part.criterion.known_noise else None for part in parts),
        common=tuple(part.data.common_errors for part in parts),
        constants=nlp.constant_values,
        root=(vectors * np.sqrt(np.maximum(found, 0.0)))[:, found > 0],
        unknowns=len(x),
        neighbors=tuple(neighbors),
    )


def _leverages(slopes: Sequence[ComplexArray], scale: Array) -> list[Array]:
    """Return the leverage (n,) of the points of every part, from the derivatives (n, p) of their errors."""
    stacked = np.vstack([np.vstack([slope.real, slope.imag]) for slope in slopes]) / scale
    left, singular, _ = np.linalg.svd(stacked, full_matrices=False)
    seen = left[:, singular > UNSEEN * singular.max(initial=0.0)]
    each = (seen**2).sum(axis=1)
    found, begin = [], 0
    for slope in slopes:
        found.append(each[begin : begin + 2 * len(slope)].reshape(2, -1).mean(axis=0))
        begin += 2 * len(slope)
    return found


def response_replicates(
    nlp: CompiledProblem, draws: ResponseDraws, x: Array
) -> "ResponseReplicates":
    """Return what makes the refits of a problem of responses, with its costs compiled for data that are given.

    Raises
    ------
    ValueError
        Where a criterion takes data as numbers alone, or points are drawn of a response that is
        known at the measured frequencies alone.
    """
    formulas = formulas_of_frequency(nlp)
    sizes = [table.shape[1] for table in draws.tables]
    if formulas is None and draws.drawn == "points":
        raise ValueError(
            f"the response of {nlp.problem.name!r} is compiled at its own frequencies alone (sines of finite "
            "amplitude, or a trim by Newton's method), so that no points can be drawn: use resampling='residuals'."
        )
    program = open_program(nlp, formulas, sizes)
    return ResponseReplicates(
        draws, program, nlp.scaling.to_solver(x), nlp.lower, nlp.upper, nlp.scaling
    )


class ResponseReplicates(Runner):
    """Newton's method on many data sets at once from the estimate; IPOPT for those that it does not solve.

    Parameters
    ----------
    draws : ResponseDraws
    program : casadi.Function
        (z, smoothing, given) -> cost, limits.
    start : (p,) array
        The estimate, in the solver's variables.
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
        self._start = np.clip(start, *self._bounds)

    def __reduce__(self) -> tuple[Callable[..., "ResponseReplicates"], tuple[Any, ...]]:
        return ResponseReplicates, self._arguments

    def constants_of(self, number: int) -> Array:
        """Return the constants (c,) of a run."""
        return self._draws.constants_of(number)

    def run(self, start: Array) -> Outcome:
        """Make the run of a number, (1,)."""
        return self.run_together(start[None])[0]

    def run_together(self, starts: Array) -> list[Outcome]:
        """Make the runs of all numbers (r, 1)."""
        began = time.perf_counter()
        drawn = [self._draws.replicate(number) for number in starts[:, 0].astype(int).tolist()]
        solvable = [numbers for numbers in drawn if numbers is not None]
        outcomes = iter(self._solved(np.array(solvable).T) if solvable else [])
        too_few = Outcome(np.full(len(self._start), np.nan), FEW, 0, 0.0, converged=False)
        each = (time.perf_counter() - began) / len(starts)
        return [
            replace(too_few if numbers is None else next(outcomes), seconds=each)
            for numbers in drawn
        ]

    def _solved(self, numbers: Array) -> list[Outcome]:
        """Solve for the data in the columns of `numbers` (g, m)."""
        count = numbers.shape[1]
        if self._newton is None:
            return [self._by_ipopt(column) for column in numbers.T]
        ends = self._newton.minimize(
            np.tile(self._start[:, None], count),
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
            else self._by_ipopt(numbers[:, k])
            for k in range(count)
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
        if cut := reason_to_end():
            return Outcome(np.full(len(self._start), np.nan), cut, 0, 0.0, converged=False)
        lower, upper = self._bounds
        bounds = {"lbx": lower, "ubx": upper, "lbg": 0.0, "ubg": math.inf}
        p = np.concatenate([[SMOOTHING], numbers])
        end, status, iterations = self._ipopt.solve(self._start, p, bounds)
        return Outcome(self._estimate(end), status, iterations, 0.0, converged=status in CONVERGED)

    def _estimate(self, z: Array) -> Array:
        return np.clip(self._scaling.to_parameters(z), *self._limits)
