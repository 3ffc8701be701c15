"""How the outputs of a record would follow terms that its model does not have.

The outputs follow a term to first order, from some initial states, which are fitted afterwards. No
other model is compiled, and models that are unstable without feedback are served.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.condensing import solve_continuity
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.modeling.added_terms import factors_of_derivatives

Effect = Array
"""What c terms add to next states and residuals of segments, (length, s, n + k, c)."""

# Logarithm of the growth of an error over a record, beyond which its model counts as unstable.
UNSTABLE = 4.6


class DisturbedRecord:
    """A record along its best trajectory, with its signals (·, samples) in order.

    Where its residuals are means, their deviations were `spread` (k, 1) times as large before.
    """

    def __init__(
        self, part: RecordPart, trajectory: Trajectory, spread: Array | float = 1.0
    ) -> None:
        self.part, self.trajectory, self.spread = part, trajectory, spread
        placed = trajectory.detail
        segments, data = part.segments, placed.data
        m, k = len(part.system.inputs), len(part.outputs)
        # Slopes of the next states and the residuals, (length, s, n + k, v).
        slopes = segments.sample_derivatives(trajectory.course)
        self._slopes = slopes.reshape(segments.length, segments.count, *slopes.shape[1:])
        self.states = segments.in_order(trajectory.states)
        self.outputs = part.simulated_outputs(trajectory)
        self.residuals = part.residuals(trajectory)
        self.step = part.data.stretches[0].step
        self.weight = part.residual_weight(trajectory)
        # The future of a predictor contains its errors of today.
        self.is_predicted = bool(part.gains)
        self.inputs = segments.in_order(data[m : 4 * m])[1::3]
        self.present = segments.in_order(data[-1 - k : -1])
        self._half_steps = self._by_sample(part.data.steps)[..., None] / 2
        self.parameters = placed.q

    @cached_property
    def growth(self) -> float:
        """The logarithm of how much errors of the states grow over the record without inputs."""
        n = self.part.states
        A = self._slopes[:, :, :n, :n].mean(axis=(0, 1))
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
        return self._by_formulas(row, values)

    def by_parameter(self, place: int, values: Array) -> Effect:
        """Return the effect of an active parameter that changes by values (c, samples)."""
        slopes = self._slopes[..., [self.part.states + place]]
        return slopes * self._by_sample(values)[:, :, None]

    def by_state(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to the derivative of a state."""
        row = np.append(np.eye(self.part.states)[place], self.measured_derivatives[:, place])
        return self._by_formulas(row, values)

    def by_input(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to an input."""
        slopes = self._slopes_of_formulas[:, place - self.inputs.shape[0]]
        return self._by_formulas(slopes.T, values, self.part.model.between[place].held)

    def by_constant(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to a parameter, also a fixed one."""
        return self._by_formulas(self._slopes_of_formulas[:, place].T, values)

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
        system = self.part.system
        # A gain that ended at zero would hide every term of its input.
        q = self.parameters[: len(system.parameters)]
        return system.slopes(self.states, self.inputs, np.where(q == 0, 1e-12, q))

    def _by_formulas(self, slopes: Array, values: Array, is_held: bool = False) -> Effect:
        """Return the effect of values (c, samples) times the slopes (samples, n + k) of formulas.

        The next states get the mean of the additional derivatives over a step, propagated over half
        of it.
        """
        n = self.part.states
        slopes = np.broadcast_to(slopes, (self.part.samples, slopes.shape[-1])).T
        # Most terms add to a single state: with 20 states, multiplying the zeros of the others
        # would take a quarter of the test's time.
        moved = slopes[:n].any(axis=1)
        mean = slopes[:n][moved] * values[:, None]
        if not (self.is_predicted or is_held):
            # Terms have values at samples, and a step lasts until the next sample.
            mean[..., :-1] += mean[..., 1:]
            mean[..., :-1] /= 2
        mean = self._by_sample(mean)
        change = np.einsum("lsnj,lsjc->lsnc", self._slopes[:, :, :n, :n][..., moved], mean)
        change[:, :, moved] += mean
        change *= self._half_steps
        outputs = self._by_sample(slopes[n:])[..., None] * -self._by_sample(values)[:, :, None]
        return np.concatenate([change, outputs], axis=2)

    def _by_sample(self, values: Array) -> Array:
        """Return values (c, r, samples) as (length, s, r, c): sample by sample of all segments."""
        segments = self.part.segments
        by_segment = values.reshape(*values.shape[:-1], segments.count, segments.length)
        return np.ascontiguousarray(by_segment.T)

    def followed_by(self, changes: Sequence[tuple[Any, Array]]) -> Array:
        """Return how outputs (k, c, samples) follow changes, up to what initial states can do.

        Changes are pairs of a function of values (c, samples) that returns their effect, and of
        values (samples,). Changes with the same function should follow one another.
        """
        part = self.part
        # Residuals are measured less simulated outputs: they follow what is subtracted as outputs
        # follow what is added.
        effects = [
            place(-np.array([values for _, values in group]))
            for place, group in groupby(changes, itemgetter(0))
        ]
        ends, rows = self._carried(np.concatenate(effects, axis=3))
        if part.states:
            rows += self._by_nodes[1] @ self._nodes(ends, rows)
        return rows.reshape(part.samples, -1, len(changes)).transpose(1, 2, 0)

    def _nodes(self, ends: Array, rows: Array) -> Array:
        """Return the nodes (s, n, c) that follow such ends and residuals from zero ones."""
        transition, J = self._by_nodes
        coupled, nodes = self.part.data.coupled, np.zeros_like(ends)
        if self.growth > UNSTABLE:
            # Simulated from zero, they would lose their digits: fitted, they remain small.
            inverse = np.kron(np.eye(self.part.segments.length), self.weight.T @ self.weight)
            weighted = J.mT @ inverse
            return solve_continuity(weighted @ J, transition, coupled, -weighted @ rows, -ends)[0]
        for j in np.flatnonzero(coupled).tolist():
            nodes[j + 1] = transition[j] @ nodes[j] + ends[j]
        return nodes

    @cached_property
    def _by_nodes(self) -> tuple[Array, Array]:
        """How ends (s, n, n) and residuals (s, length · k, n) follow the nodes."""
        part, n, weight = self.part, self.part.states, np.eye(len(self.weight))
        ends, J = part.segments.sensitivities(self.trajectory.course, slice(None), weight)
        # Known initial states cannot compensate for a term.
        unknown = ~part.known_states[:, None]
        return ends[..., :n] * unknown, J[..., :n] * unknown

    def _carried(self, effects: Effect) -> tuple[Array, Array]:
        """Carry the effects of c terms through the segments, from zero nodes.

        Returns those on ends (s, n, c) and on residuals (s, length · k, c).
        """
        n = self.part.states
        # No residual follows where nothing was measured.
        present = self._by_sample(self.present)[..., None]
        S, rows = np.zeros_like(effects[0, :, :n]), list[Array]()
        for slopes, effect, measured in zip(self._slopes, effects, present, strict=True):
            following = slopes[..., :n] @ S + effect
            S = following[:, :n]
            rows.append(following[:, n:] * measured)
        return S, np.hstack(rows)
