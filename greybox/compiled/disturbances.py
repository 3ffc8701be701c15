"""How the outputs of a record would follow terms that its model does not have.

The outputs follow a term to first order, with the initial states fitted too, as they follow a
parameter. No other model is compiled, and models that are unstable without feedback are served.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from greybox.compiled.condensing import solve_continuity
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.files.arrays import Array
from greybox.modeling.added_terms import factors_of_derivatives

Effect = tuple[Array, Array]
"""What c terms add to the next states (c, n, columns) and to the residuals (c, k, columns)."""


class DisturbedRecord:
    """A record along its best trajectory, with its signals (·, samples) in order."""

    def __init__(self, part: RecordPart, trajectory: Trajectory) -> None:
        self.part, self.trajectory, self._placed = part, trajectory, trajectory.detail
        segments, data = part.segments, self._placed.data
        m, k = len(part.system.inputs), len(part.outputs)
        self._slopes = segments.sample_derivatives(self._placed.along(trajectory.states))
        self.states = segments.in_order(trajectory.states)
        self.outputs = part.simulated_outputs(trajectory)
        self.residuals = part.residuals(trajectory)
        self.step = part.data.stretches[0].step
        self.weight = part.residual_weight(trajectory)
        # The future of a predictor contains its errors of today.
        self.is_predicted = bool(part.gains)
        self.inputs = segments.in_order(data[m : 4 * m])[1::3]
        self.present = segments.in_order(data[-1 - k : -1])
        self.parameters = self._placed.q

    @property
    def growth(self) -> float:
        """The logarithm of how much errors of the states grow over the record without inputs."""
        A = self._slopes[0][: self.part.states].mean(axis=2)
        growth = np.abs(np.linalg.eigvals(A)).max(initial=1.0)
        return float(self.part.samples * np.log(growth))

    def by_stretch(self, function: Callable[..., Array], row: Array, *arguments: Any) -> Array:
        """Return a function of the samples and the step of every stretch, segments filled up."""
        data = self.part.data
        pieces = zip(data.unpadded(row), data.stretches, strict=True)
        rows = [function(piece, stretch.step, *arguments)[None] for piece, stretch in pieces]
        return data.padded(rows)[0]

    def by_output(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to an output."""
        row = np.eye(len(self._slopes_of_formulas))[self.part.states + place]
        return self._by_formulas(row[:, None], values)

    def by_parameter(self, place: int, values: Array) -> Effect:
        """Return the effect of an active parameter that changes by values (c, samples)."""
        change = self.part.segments.columns(values)[:, None]
        following, residuals = (slope[self.part.states + place] for slope in self._slopes)
        return following * change, residuals * change

    def by_state(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to the derivative of a state."""
        row = np.append(np.eye(self.part.states)[place], self.measured_derivatives[:, place])
        return self._by_formulas(row[:, None], values)

    def by_input(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to an input."""
        slopes = self._slopes_of_formulas[:, place - self.inputs.shape[0]]
        return self._by_formulas(slopes, values, self.part.model.between[place].held)

    def by_constant(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to a parameter, also a fixed one."""
        return self._by_formulas(self._slopes_of_formulas[:, place], values)

    @cached_property
    def measured_derivatives(self) -> Array:
        """The factors (k, n) of the derivatives of states in outputs: of accelerations, say.

        A term that such a derivative lacks is then missing in the output, too.
        """
        n = self.part.states
        return factors_of_derivatives(self._slopes_of_formulas[:n], self._slopes_of_formulas[n:])

    @cached_property
    def _slopes_of_formulas(self) -> Array:
        """The slopes of derivatives and outputs (n + k, parameters and inputs, samples)."""
        system, n = self.part.system, self.part.states
        rows = [*range(n), *(n + system.outputs.index(name) for name in self.part.outputs)]
        # A gain that ended at zero would hide every term of its input.
        q = self._placed.q[: len(system.parameters)]
        return system.slopes(self.states, self.inputs, np.where(q == 0, 1e-12, q))[rows]

    def _by_formulas(self, slopes: Array, values: Array, is_held: bool = False) -> Effect:
        """Return the effect of values (c, samples) times the slopes (n + k, samples) of formulas.

        The next states get the mean of the additional derivatives over a step, propagated over half
        of it.
        """
        segments, n = self.part.segments, self.part.states
        # Most terms add to a single state: with 20 states, multiplying the zeros of the others
        # would take a quarter of the test's time.
        moved = slopes[:n].any(axis=1)
        mean = slopes[:n][moved] * values[:, None]
        if not (self.is_predicted or is_held):
            # Terms have values at samples, and a step lasts until the next sample.
            mean[..., :-1] += mean[..., 1:]
            mean[..., :-1] /= 2
        mean = segments.columns(mean)
        change = np.einsum("jac,vjc->vac", self._slopes[0][:n][moved], mean)
        change[:, moved] += mean
        return self._placed.data[-1] / 2 * change, segments.columns(slopes[n:] * -values[:, None])

    def followed_by(self, changes: Sequence[tuple[Any, Array]]) -> Array:
        """Return how outputs (k, c, samples) follow changes, with initial states fitted too.

        Changes are pairs of a function of values (c, samples) that returns their effect, and of
        values (samples,). Those of the same function are best neighbors.
        """
        # Numbers of the effects in memory at once: 40 MB. A rod of 100 states has 2700 terms, 300
        # MB.
        size = max(5_000_000 // max(self.states.size, 1), 1)
        batches = [changes[k : k + size] for k in range(0, len(changes), size)]
        return np.concatenate([self._followed_by(batch) for batch in batches], axis=1)

    def _followed_by(self, changes: Sequence[tuple[Any, Array]]) -> Array:
        part, n = self.part, self.part.states
        A, C = ([slope[:n]] for slope in self._slopes)
        # Residuals are measured less simulated outputs: they follow what is subtracted as outputs
        # follow what is added.
        for place, group in groupby(changes, itemgetter(0)):
            following, residuals = place(-np.array([values for _, values in group]))
            A.append(following)
            # No residual follows where nothing was measured.
            C.append(residuals * part.segments.columns(self.present))
        ends, J = part.segments.propagated(
            np.concatenate(A), np.concatenate(C), part.segments.count
        )
        J = J.transpose(3, 2, 0, 1).reshape(*J.shape[:1:-1], -1)
        ends = ends.transpose(2, 0, 1)
        if n:
            # Known initial states cannot compensate for a term.
            J[:, :n][part.known_states] = 0
            ends.swapaxes(1, 2)[:, :n][part.known_states] = 0
            weighted = J[:, :n].reshape(-1, len(self.weight)) @ (self.weight.T @ self.weight)
            products = weighted.reshape(len(J), n, -1) @ J.swapaxes(1, 2)
            moved, _ = solve_continuity(
                products[:, :, :n],
                ends[:, :, :n],
                part.data.coupled,
                -products[:, :, n:],
                -ends[:, :, n:],
                np.zeros(n),
            )
            J[:, n:] += moved.swapaxes(1, 2) @ J[:, :n]
        J = J[:, n:].swapaxes(0, 1).reshape(J.shape[1] - n, -1, len(self.weight))
        return J.transpose(2, 0, 1)
