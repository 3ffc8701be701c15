"""Refits of records whose outputs are drawn anew, from the estimate.

As in `response_replicates`, a run draws its data by its number. A worker receives the compiled
problem with the fitted outputs and the residuals.
"""

import math
import time
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.files.arrays import Array, IntArray
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.local_solver import Runner
from greybox.solve.outcome import Outcome
from greybox.statistics.error_spectrum import ErrorSpectrum

Drawn = Literal["blocks", "parametric", "parts"]


@dataclass(frozen=True, eq=False)
class Stretched:
    """One stretch of a record, without gaps: its measured and fitted outputs (k, n)."""

    measured: Array
    fitted: Array


@dataclass(frozen=True, eq=False)
class RecordDraws:
    """How the outputs of replicates of a problem of records are drawn.

    Attributes
    ----------
    drawn : "blocks", "parametric" or "parts"
    seed : int
    stretches : tuple of tuple of Stretched
        Of every part.
    residuals : tuple of (k, samples) arrays
        Of every part, of mean zero: whitened where there is a spectrum, elsewhere as large as
        errors. Where an output is missing, NaN, the replicate draws from its others.
    spectra : tuple of ErrorSpectrum or None
        What gives whitened residuals their color again, of every part.
    block : int
        Samples of a block.
    roots : tuple of (k, k) arrays
        Square roots of the covariance of the errors of the outputs, of every part.
    """

    drawn: Drawn
    seed: int
    stretches: tuple[tuple[Stretched, ...], ...]
    residuals: tuple[Array, ...]
    spectra: tuple[ErrorSpectrum | None, ...]
    block: int
    roots: tuple[Array, ...]

    def outputs(self, number: int) -> list[list[Array]]:
        """Return the outputs (k, n) of every stretch of every part for a replicate."""
        random = np.random.default_rng([self.seed, number])
        return [
            [self._drawn(random, one, part) for one in some]
            for part, some in enumerate(self.stretches)
        ]

    def _drawn(self, random: np.random.Generator, one: Stretched, part: int) -> Array:
        k, n = one.measured.shape
        if self.drawn == "parametric":
            errors = self.roots[part] @ random.standard_normal((k, n))
        elif (spectrum := self.spectra[part]) is None:
            errors = self._residuals(random, n, part)
        else:
            # Of a circle twice as long, so that no sample is the neighbor of the last one.
            errors = spectrum.colored(self._residuals(random, 2 * n, part))[:, :n]
        return np.where(np.isfinite(one.measured), one.fitted + errors, np.nan)

    def _residuals(self, random: np.random.Generator, count: int, part: int) -> Array:
        """Draw `count` residuals of all outputs in blocks."""
        given = self.residuals[part]
        drawn = given[:, drawn_blocks(random, count, given.shape[1], self.block)]
        for row, residuals in zip(drawn, given, strict=True):
            missing = np.isnan(row)
            row[missing] = random.choice(residuals[np.isfinite(residuals)], int(missing.sum()))
        return drawn

    def counts(self, number: int) -> Array:
        """Return how often every part is in a replicate of whole parts."""
        random = np.random.default_rng([self.seed, number])
        many = len(self.stretches)
        return np.bincount(random.integers(0, many, many), minlength=many).astype(float)


def record_draws(
    nlp: CompiledProblem,
    trajectories: tuple[Trajectory, ...],
    spectra: Sequence[ErrorSpectrum | None],
    drawn: Drawn,
    seed: int,
    block: int,
) -> RecordDraws:
    """Return how replicates are drawn of a problem of records, along its best `trajectories`.

    Residuals are whitened by the `spectra` of the errors, one for every part; where there is none,
    they are enlarged for the parameters and initial states that were fitted.

    Raises
    ------
    ValueError
        Where the residuals correct the states, for a block that is longer than the records, and for
        data that are fitted exactly.
    """
    stretches, drawn_from, colors, roots = [], [], [], []
    share = len(nlp.free) / len(nlp.parts)
    for part, trajectory, spectrum in zip(nlp.parts, trajectories, spectra, strict=True):
        assert isinstance(part, RecordPart)
        if part.gains and drawn != "parts":
            raise ValueError(
                f"the residuals of {part.name!r} correct its states, so that they cannot be drawn and added: use "
                "OutputError, or resampling='parts' of several records."
            )
        left = max(
            1 - (share + part.unknown_initial_states) / max(part.numbers, 1),
            1 / max(part.numbers, 1),
        )
        larger = 1 / math.sqrt(left)
        fitted = part.data.unpadded(part.simulated_outputs(trajectory))
        own = [
            Stretched(one.outputs, values)
            for one, values in zip(part.data.stretches, fitted, strict=True)
        ]
        stretches.append(tuple(own))
        each = [one.measured - one.fitted for one in own]
        residuals = _centered(each)
        if not np.nan_to_num(residuals).any(axis=1).all():
            raise ValueError(
                f"{part.name!r} is fitted exactly, so that the size of its errors is not known."
            )
        if spectrum is None:
            drawn_from.append(larger * residuals)
            colors.append(None)
        else:
            drawn_from.append(_centered([spectrum.whitened(values) for values in each]))
            colors.append(spectrum.of_draws(drawn_from[-1]))
        longest = max(one.measured.shape[1] for one in own)
        if not 1 <= block <= longest:
            raise ValueError(
                f"block is {block}: give a number of samples from 1 to {longest}, those of the record."
            )
        given = part.covariance.known is not None
        covariance = part.covariance.covariance(trajectory.products) * (1.0 if given else larger**2)
        roots.append(np.linalg.cholesky(covariance))
    return RecordDraws(
        drawn, seed, tuple(stretches), tuple(drawn_from), tuple(colors), block, tuple(roots)
    )


def drawn_blocks(random: np.random.Generator, count: int, size: int, length: int) -> IntArray:
    """Return `count` places in a series of `size` samples, in blocks of this length; the series is a circle."""
    first = random.integers(0, size, -(-count // length))
    return ((first[:, None] + np.arange(length)) % size).ravel()[:count]


def _centered(stretches: Sequence[Array]) -> Array:
    """Return the values (k, n) of stretches side by side, less their means."""
    values = np.hstack(stretches)
    counts = np.isfinite(values).sum(axis=1, keepdims=True)
    return values - np.nansum(values, axis=1, keepdims=True) / np.maximum(counts, 1)


class RecordReplicates(Runner):
    """Gauss-Newton steps from the estimate for records with other outputs, or for some of the records.

    Parameters
    ----------
    nlp : CompiledProblem
    draws : RecordDraws
    start : (p,) array
        The estimate.
    nodes : tuple of (s, n) arrays
        Its states at the beginning of every segment, of every part.
    """

    def __init__(
        self, nlp: CompiledProblem, draws: RecordDraws, start: Array, nodes: tuple[Array, ...]
    ) -> None:
        """Keep them."""
        self._nlp, self._draws, self._start, self._nodes = nlp, draws, start, nodes

    def __reduce__(self) -> tuple[Callable[..., "RecordReplicates"], tuple[Any, ...]]:
        """Return what builds the same."""
        return RecordReplicates, (self._nlp, self._draws, self._start, self._nodes)

    def constants_of(self, number: int) -> Array:
        """Return the constants (c,) of a run."""
        return self._nlp.constant_values

    def run(self, start: Array) -> Outcome:
        """Make the run of a number, (1,)."""
        began = time.perf_counter()
        number = int(start[0])
        if self._draws.drawn == "parts":
            counts = self._draws.counts(number)
            kept = np.flatnonzero(counts).tolist()
            parts = [self._part(k).with_weight(float(counts[k])) for k in kept]
            nodes = tuple(self._nodes[k] for k in kept)
        else:
            outputs = self._draws.outputs(number)
            parts = [self._part(k).with_outputs(values) for k, values in enumerate(outputs)]
            nodes = self._nodes
        nlp = copy(self._nlp)
        object.__setattr__(nlp, "parts", tuple(parts))
        solver = GaussNewton(nlp)
        near = solver.run_simulated(self._start, nodes, self._nlp.strategies.max_iterations)
        found = near if near is not None and near.converged else solver.run(self._start)
        return Outcome(
            found.estimate,
            found.status,
            found.iterations,
            time.perf_counter() - began,
            converged=found.converged,
            cost=found.cost,
        )

    def _part(self, k: int) -> RecordPart:
        part = self._nlp.parts[k]
        assert isinstance(part, RecordPart)
        return part
