"""Refits of frequency responses to drawn data, many at once, from the estimate."""

import math
import time
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, real_root, sum_of_squares
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.covariance.covariance import known_covariances
from greybox.engine.covariance.part_accuracy import PartAccuracy
from greybox.engine.solve.batched_newton import BatchedNewton
from greybox.engine.solve.interruption import reason_to_end
from greybox.engine.solve.ipopt import WARM
from greybox.engine.solve.response_solver import AT_MINIMUM, ITERATIONS, TOLERANCE, ResponseSolver
from greybox.engine.solve.runs import IMPROVED, Outcome, Outcomes
from greybox.modeling.cached_property import cached_property
from greybox.statistics.neighbor_correlation import NeighborCorrelation
from greybox.workflows.study.replicates import Draws, Replicates


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

        outcomes = []
        for k, z in enumerate(ends.z.T):
            if not ends.at_minimum[k]:
                outcomes.append(self._by_ipopt(data[:, k]))
                continue
            estimate, count = self.nlp.estimate_at(z), int(ends.iterations[k])
            outcomes.append(
                Outcome(estimate, AT_MINIMUM, count, 0.0, converged=True, stage=IMPROVED)
            )
        return outcomes

    def _by_ipopt(self, data: Array) -> Outcome:
        # IPOPT takes much longer than a batch: check the time limit before each solve.
        if cut := reason_to_end():
            return Outcome(np.full(len(self.start), np.nan), cut, 0, 0.0, converged=False)
        # The compiled functions are shared; near the estimate, no other criterion is needed to
        # locate the minimum.
        nlp = replace(self.nlp, data=data, programs=self.nlp.programs[-1:])
        return ResponseSolver(nlp, WARM, batched=False).run(self.start)

    @cached_property
    def _newton(self) -> BatchedNewton | None:
        program = self.nlp.programs[-1]
        # Where Newton's method finds operating points too, it left the minimum of the fit for a
        # higher one in three of 100 replicates of the paper's operating points; IPOPT in one.
        serves = program.roots is None and ResponseSolver.serves(self.nlp)
        return BatchedNewton.of(self.nlp, program) if serves else None
