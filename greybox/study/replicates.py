"""Replicates of a problem: data that are drawn anew, and the runner that refits them.

Seed and number of a replicate determine its random numbers. A run is this number, so that the
result does not depend on how many workers there are.

Refits of records whose outputs are drawn anew, from the estimate.

Refits of frequency responses to drawn data, many at once, from the estimate.
"""

import math
import time
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.accuracy import Accuracy
from greybox.estimate.covariance import known_covariances
from greybox.estimate.part_accuracy import PartAccuracy
from greybox.files.arrays import (
    Array,
    Arrays,
    ComplexArray,
    frozen,
    nans,
    real_root,
    sum_of_squares,
)
from greybox.modeling.one_thread import cached_property
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.interruption import reason_to_end
from greybox.solve.ipopt import WARM
from greybox.solve.local_solver import Runner
from greybox.solve.response_solver import AT_MINIMUM, ITERATIONS, TOLERANCE, ResponseSolver
from greybox.solve.runs import IMPROVED, Outcome, Outcomes
from greybox.statistics.error_spectrum import ErrorSpectrum
from greybox.statistics.neighbor_correlation import NeighborCorrelation


@frozen
class Draws:
    """How the data of replicates are drawn.

    Attributes
    ----------
    seed : int
    parts : tuple of DrawnResponse or of DrawnRecord
    constants : (c,) array
        Constants of the problem.
    root : (c, r) array
        A square root of their covariance.
    about : str
        Description of the draws.
    """

    seed: int
    parts: tuple[Any, ...]
    constants: Array
    root: Array
    about: str

    def of(self, number: int) -> tuple[Array, Iterator[Any]]:
        """Return the constants (c,) of a replicate, and yield the data of its parts."""
        random = np.random.default_rng([self.seed, number])
        constants = self.constants + self.root @ random.standard_normal(self.root.shape[1])
        return constants, (part.drawn(random) for part in self.parts)


@frozen
class Replicates(Runner):
    """The runner that refits replicates of a compiled problem.

    Attributes
    ----------
    nlp : CompiledProblem
    draws : Draws
    start : (p,) array
        The estimate, from which every replicate is solved.
    """

    nlp: CompiledProblem
    draws: Draws
    start: Array

    def without_end(self, start: Array, status: str) -> Outcome:
        """Return the outcome of a refit that ended nowhere: it has no estimate (p,)."""
        return replace(super().without_end(start, status), estimate=nans(len(self.start)))


@frozen
class DrawnRecord:
    """The fitted outputs of one part, and the errors of its data.

    Attributes
    ----------
    measured, fitted : tuples of (k, n) arrays
        Outputs of every stretch without gaps.
    residuals : (k, samples) array
        Residuals of mean zero: whitened with a spectrum, otherwise as large as errors. If an output
        is missing, NaN, a replicate draws from the others of this output.
    spectrum : ErrorSpectrum or None
        Gives whitened residuals their color again.
    """

    measured: tuple[Array, ...]
    fitted: tuple[Array, ...]
    residuals: Array
    spectrum: ErrorSpectrum | None

    def drawn(self, random: np.random.Generator) -> list[Array]:
        """Return the fitted outputs (k, n) of every stretch with drawn residuals."""
        outputs = []
        for measured, fitted in zip(self.measured, self.fitted, strict=True):
            count = measured.shape[1]
            if self.spectrum is None:
                errors = self._drawn_residuals(random, count)
            else:
                # The filter is circular: with twice the length, the last sample that is used is not
                # a neighbor of the first one.
                white = self._drawn_residuals(random, 2 * count)
                errors = self.spectrum.colored(white)[:, :count]
            outputs.append(np.where(np.isfinite(measured), fitted + errors, np.nan))
        return outputs

    def _drawn_residuals(self, random: np.random.Generator, count: int) -> Array:
        """Draw `count` residuals of all outputs together."""
        drawn = self.residuals[:, random.integers(0, self.residuals.shape[1], count)]
        # A missing residual is replaced by another one of the same output: outputs have noise of
        # different sizes.
        for row, residuals in zip(drawn, self.residuals, strict=True):
            missing = np.isnan(row)
            row[missing] = random.choice(residuals[np.isfinite(residuals)], int(missing.sum()))
        return drawn


def record_draws(accuracy: Accuracy, seed: int) -> Draws:
    """Return how replicates of a problem of records are drawn, along its best trajectories.

    Raises
    ------
    ValueError
        If the data are fitted exactly.
    """
    nlp = accuracy.nlp
    rows = nlp.rows_of(RecordPart, accuracy.trajectories, accuracy.parts)
    records = [_drawn_record(*row) for row in rows]
    about = "residuals drawn"
    if any(record.spectrum for record in records):
        about += " with their correlation in time"
    constants = nlp.constant_values
    return Draws(seed, tuple(records), constants, np.zeros((len(constants), 0)), about)


def _drawn_record(part: RecordPart, trajectory: Trajectory, errors: PartAccuracy) -> DrawnRecord:
    """Return the errors of a part along its best trajectory."""
    fitted = tuple(part.data.unpadded(part.simulated_outputs(trajectory)))
    measured = tuple(stretch.outputs for stretch in part.data.stretches)
    differences = [y - model for y, model in zip(measured, fitted, strict=True)]
    residuals = _centered(differences)
    if not np.nan_to_num(residuals).any(axis=1).all():
        raise ValueError(f"{part.name!r} is fitted exactly: the size of its errors is not known.")

    # White residuals are too small by the fitted parameters and initial states. The spectrum of
    # colored residuals is already corrected for the fit.
    spectrum = errors.colored and errors.colored.spectrum
    if spectrum is None:
        deviation = math.sqrt(part.numbers / errors.numbers)
        return DrawnRecord(measured, fitted, deviation * residuals, None)
    white = _centered([spectrum.whitened(values) for values in differences])
    return DrawnRecord(measured, fitted, white, spectrum.of_draws(white))


def _centered(stretches: Arrays) -> Array:
    """Return the values (k, n) of stretches side by side, minus their means."""
    values = np.hstack(stretches)
    counts = np.isfinite(values).sum(axis=1, keepdims=True)
    return values - np.nansum(values, axis=1, keepdims=True) / np.maximum(counts, 1)


@frozen
class RecordReplicates(Replicates):
    """Gauss-Newton steps from the estimate, for records with drawn outputs.

    Attributes
    ----------
    nodes : tuple of (s, n) arrays
        The states of the fit at the beginning of every segment, for every part.
    """

    nodes: tuple[Array, ...]

    def run(self, start: Array) -> Outcome:
        """Refit the replicate with this number (1,)."""
        began = time.perf_counter()
        _, outputs = self.draws.of(int(start[0]))
        pairs = zip(self.nlp.parts_of(RecordPart), outputs, strict=True)
        parts = [part.with_outputs(rows) for part, rows in pairs]

        # Only the data change: what was compiled is shared with the original.
        nlp = copy(self.nlp)
        vars(nlp)["parts"] = tuple(parts)
        solver = GaussNewton(nlp)
        outcome = solver.solved_from(self.start, self.nodes)
        # The states of the fit are a good start only if the drawn errors are small.
        if not outcome.converged:
            outcome = solver.run(self.start)
        # States and signature would multiply the size of the stored runs: nothing reads them.
        seconds = time.perf_counter() - began
        return replace(outcome, seconds=seconds, signature=None, nodes=None)


@frozen
class DrawnResponse:
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
    neighbors : NeighborCorrelation or None
        If errors are correlated along frequency.
    """

    omega: Array
    response: ComplexArray
    size: Array
    deviation: float
    dof: Array | None = None
    common: ComplexArray | None = None
    neighbors: NeighborCorrelation | None = None

    def drawn(self, random: np.random.Generator) -> ComplexArray:
        """Return the fitted response with normal errors."""
        count = len(self.response)
        normal = random.standard_normal(count) + 1j * random.standard_normal(count)
        if self.neighbors is not None:
            # Noise in magnitude and noise in phase are correlated each along frequency, while real
            # and imaginary part turn with the response.
            places = np.argsort(np.argsort(self.omega, kind="stable"))
            normal = self.neighbors.drawn(random, normal)[places]
            normal = normal * np.exp(1j * np.angle(self.response))
        # The size is an estimate itself: the errors over it have Student's t distribution.
        if self.dof is not None:
            normal = normal / np.sqrt(random.chisquare(self.dof) / self.dof)
        measured = self.response + self.size * (self.deviation * normal)
        if self.common is not None:
            measured = measured + random.standard_normal(len(self.common)) @ self.common
        return measured


def response_draws(accuracy: Accuracy, seed: int) -> Draws:
    """Return how replicates of a problem of responses are drawn, at the estimate.

    Source: Davison and Hinkley (1997), Bootstrap Methods and their Application, section 6.2.2.

    Raises
    ------
    ValueError
        If the data are fitted exactly, or a criterion accepts only numbers.
    """
    nlp, free = accuracy.nlp, len(accuracy.x)
    values = nlp.all_values(accuracy.x)
    parts = tuple(
        _drawn_part(part, values, errors)
        for part, errors in nlp.rows_of(ResponsePart, accuracy.parts)
    )
    about = "normal errors of the fitted size"
    if any(errors.neighbors for errors in accuracy.parts):
        about += " with their correlation along frequency"

    nothing = np.zeros((len(values), len(values)))
    covariance = sum((earlier for earlier, _ in known_covariances(nlp)), nothing)
    # Cholesky needs a definite matrix, and constants without errors make this one singular.
    eigenvalues, vectors = np.linalg.eigh(covariance[free:, free:])
    root = (vectors * real_root(eigenvalues))[:, eigenvalues > 0]
    return Draws(seed, parts, nlp.constant_values, root, about)


def _drawn_part(part: ResponsePart, values: Array, errors: PartAccuracy) -> DrawnResponse:
    """Return the errors of a part at all values (k,)."""
    if not part.is_open:
        raise ValueError(
            f"{type(part.criterion).__name__} accepts only numbers, but the bootstrap gives it "
            "symbols for the data: write its cost with data.response, abs and the functions of "
            "greybox."
        )
    response = part.response(values)
    size = part.criterion.error_size(response, part.data)
    has_variances = part.criterion.known_noise
    # What all points have in common is drawn once for all of them, not point by point.
    if has_variances:
        # Where nearly all of a variance is common to the points, residuals over the rest would be
        # infinite.
        size = size * np.sqrt(np.maximum(part.data.independent_share, 0.1))

    variance = sum_of_squares((part.data.response - response) / size) / errors.numbers
    if not variance > np.finfo(float).eps:
        raise ValueError(f"{part.name!r} is fitted exactly: the size of its errors is not known.")
    if has_variances:  # given variances are believed, unless the residuals are larger
        variance = errors.noise / 2 if errors.noise else max(variance, 0.5)
    return DrawnResponse(
        part.data.omega,
        response,
        size,
        math.sqrt(variance),
        dof=part.data.dof if has_variances else None,
        common=part.data.common_errors,
        neighbors=errors.neighbors,
    )


@frozen
class ResponseReplicates(Replicates):
    """Newton's method on many data sets at once from the estimate; IPOPT where it fails."""

    # A batch of 128 takes a tenth of a second for the tilt model: enough for workers to share a
    # thousand replicates evenly, at 0.2 ms more for each than in one batch.
    together = 128

    def run(self, start: Array) -> Outcome:
        """Refit the replicate with this number (1,)."""
        return self.run_together(start[None])[0]

    def run_together(self, starts: Array) -> Outcomes:
        """Refit the replicates with these numbers (r, 1)."""
        began = time.perf_counter()
        data = [self.nlp.data_of(*self.draws.of(int(number))) for [number] in starts]
        outcomes = self._solved(np.array(data).T)
        seconds = (time.perf_counter() - began) / len(starts)
        return [replace(outcome, seconds=seconds) for outcome in outcomes]

    def _solved(self, data: Array) -> Outcomes:
        """Solve for the data in the columns (g, m)."""
        if self._newton is None:
            return [self._by_ipopt(column) for column in data.T]
        begin = np.clip(self.nlp.scaling.to_solver(self.start), *self.nlp.bounds)
        ends = self._newton.minimize(
            np.tile(begin[:, None], data.shape[1]),
            max_iterations=ITERATIONS,
            tolerance=TOLERANCE,
            from_near=True,
            given=data,
        )
        return [
            Outcome(self.nlp.estimate_at(z), AT_MINIMUM, count, 0.0, converged=True, stage=IMPROVED)
            if at_minimum
            else self._by_ipopt(column)
            for z, count, at_minimum, column in zip(
                ends.z.T, ends.iterations.tolist(), ends.at_minimum, data.T, strict=True
            )
        ]

    def _by_ipopt(self, data: Array) -> Outcome:
        # IPOPT takes much longer than a batch: check the time limit before each solve.
        if cut := reason_to_end():
            return Outcome(nans(len(self.start)), cut, 0, 0.0, converged=False)
        # The compiled functions are shared; near the estimate, no other criterion is needed to
        # locate the minimum.
        nlp = copy(self.nlp)
        vars(nlp).update(data=data, programs=self.nlp.programs[-1:])
        return ResponseSolver(nlp, WARM, batched=False).run(self.start)

    @cached_property
    def _newton(self) -> BatchedNewton | None:
        program = self.nlp.programs[-1]
        # Where Newton's method finds operating points too, it left the minimum of the fit for a
        # higher one in three of 100 replicates of the paper's operating points; IPOPT in one.
        serves = program.roots is None and ResponseSolver.serves(self.nlp)
        return BatchedNewton.of(self.nlp, program) if serves else None
