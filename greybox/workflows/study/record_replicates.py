"""Refits of records whose outputs are drawn anew, from the estimate."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.covariance.part_accuracy import PartAccuracy
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.runs import Outcome
from greybox.statistics.error_spectrum import ErrorSpectrum
from greybox.workflows.study.replicates import Draws, Replicates


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


def _centered(stretches: Sequence[Array]) -> Array:
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
        solver = GaussNewton(replace(self.nlp, parts=tuple(parts)))
        outcome = solver.solved_from(self.start, self.nodes)
        # The states of the fit are a good start only if the drawn errors are small.
        if not outcome.converged:
            outcome = solver.run(self.start)
        # States and signature would multiply the size of the stored runs: nothing reads them.
        seconds = time.perf_counter() - began
        return replace(outcome, seconds=seconds, signature=None, nodes=None)
