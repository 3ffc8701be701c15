"""How the outputs of a record would change if a term were added to its model.

The changes are of first order in the term. They begin at arbitrary initial states, since a fit of
the term also fits initial states. No other model is compiled, and the model may be unstable without
feedback.

Shapes: a record has `samples` in s segments of `length` samples. The model has n states, m inputs
and k outputs; c is the number of terms.
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
"""The additions of c terms to next states and residuals, (length, s, n + k, c)."""

# A model counts as unstable if an error of its states grows a hundredfold over the record; this is
# the logarithm of that factor.
UNSTABLE = 4.6

# Replaces a parameter that is zero: the slopes of the formulas with respect to what it multiplies
# would be zero, too.
NONZERO = 1e-12


class DisturbedRecord:
    """A record along its best trajectory.

    Attributes
    ----------
    part : RecordPart
    trajectory : Trajectory
    spread : (k, 1) array, or 1.0
        Where the residuals are means over some samples: the factor by which averaging reduced their
        standard deviations.
    states : (n, samples) array
    inputs : (m, samples) array
    outputs, residuals : (k, samples) arrays
    present : (k, samples) array
        Whether an output was measured.
    step : float, s
    weight : (k, k) array
        Weight of the residuals.
    is_predicted : bool
        Whether residuals correct the states.
    parameters : array
        Values of the parameters.
    """

    def __init__(
        self, part: RecordPart, trajectory: Trajectory, spread: Array | float = 1.0
    ) -> None:
        self.part, self.trajectory, self.spread = part, trajectory, spread
        placed = trajectory.detail
        segments, data = part.segments, placed.data
        m, k = len(part.system.inputs), len(part.outputs)
        # Slopes of the n next states and the k residuals with respect to the states and the active
        # parameters, v in all: (length, s, n + k, v).
        slopes = segments.sample_derivatives(trajectory.course)
        self._slopes = slopes.reshape(segments.length, segments.count, *slopes.shape[1:])
        self.states = segments.in_order(trajectory.states)
        self.outputs = part.simulated_outputs(trajectory)
        self.residuals = part.residuals(trajectory)
        self.step = part.data.stretches[0].step
        self.weight = part.residual_weight(trajectory)
        self.is_predicted = bool(part.gains)
        # The rows of the data, see `SampledData.rows`: m delays; every input at the sample before,
        # at the sample, and after it; k outputs; k marks of measured outputs; the step.
        before_at_and_after = segments.in_order(data[m : 4 * m])
        self.inputs = before_at_and_after[1::3]
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
        """Apply `function(samples, step, ...)` to every stretch of a row (samples,).

        The result has as many samples as all segments, of which the last ones are padded.
        """
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
        # The columns are parameters, then inputs.
        column = len(self.part.system.parameters) + place
        slopes = self._slopes_of_formulas[:, column]
        return self._by_formulas(slopes.T, values, self.part.model.between[place].held)

    def by_constant(self, place: int, values: Array) -> Effect:
        """Return the effect of values (c, samples) that add to a parameter, also a fixed one."""
        return self._by_formulas(self._slopes_of_formulas[:, place].T, values)

    @cached_property
    def measured_derivatives(self) -> Array:
        """The factors (k, n) of the derivatives of states in outputs, such as accelerations.

        A term that is missing in such a derivative is missing in the output, too.
        """
        n = self.part.states
        return factors_of_derivatives(self._slopes_of_formulas[:n], self._slopes_of_formulas[n:])

    @cached_property
    def _slopes_of_formulas(self) -> Array:
        """The slopes of derivatives and outputs (n + k, parameters and inputs, samples)."""
        system = self.part.system
        q = self.parameters[: len(system.parameters)]
        return system.slopes(self.states, self.inputs, np.where(q == 0, NONZERO, q))

    def _by_formulas(self, slopes: Array, values: Array, is_held: bool = False) -> Effect:
        """Return the effect of values (c, samples) times the slopes (samples, n + k) of formulas.

        With the step T and the transition A of the states, additional derivatives of mean d over a
        step change the next states by (A + 1) d T/2.
        """
        n = self.part.states
        slopes = np.broadcast_to(slopes, (self.part.samples, slopes.shape[-1])).T
        # Most terms add to a single state: with 20 states, multiplying the zeros of the others
        # would take a quarter of the test's time.
        is_driven = slopes[:n].any(axis=1)
        mean = slopes[:n][is_driven] * values[:, None]
        # Terms have values at samples, and a step lasts until the next sample. In a predictor the
        # next value contains the correction by the current residual, so it is not used.
        if not (self.is_predicted or is_held):
            mean[..., :-1] += mean[..., 1:]
            mean[..., :-1] /= 2
        mean = self._by_sample(mean)
        transition = self._slopes[:, :, :n, :n][..., is_driven]
        change = np.einsum("lsnj,lsjc->lsnc", transition, mean)
        change[:, :, is_driven] += mean
        change *= self._half_steps
        # Residuals are measured less simulated outputs.
        residuals = self._by_sample(slopes[n:])[..., None] * -self._by_sample(values)[:, :, None]
        return np.concatenate([change, residuals], axis=2)

    def _by_sample(self, values: Array) -> Array:
        """Return values (c, r, samples) as (length, s, r, c): sample by sample of all segments."""
        segments = self.part.segments
        by_segment = values.reshape(*values.shape[:-1], segments.count, segments.length)
        return np.ascontiguousarray(by_segment.T)

    def followed_by(self, changes: Sequence[tuple[Any, Array]]) -> Array:
        """Return the responses of the outputs (k, c, samples) to changes, from any initial states.

        A change is a pair: a function of values (c, samples) that returns their effect, such as
        `by_output` for one place, and the values (samples,). Changes with the same function should
        follow one another.
        """
        part = self.part
        effects = []
        for effect_of, group in groupby(changes, itemgetter(0)):
            values = np.array([values for _, values in group])
            # A residual is the measured output less the simulated one. With the sign of the values
            # reversed, the change of the residuals is that of the outputs.
            effects.append(effect_of(-values))
        ends, rows = self._carried(np.concatenate(effects, axis=3))
        if part.states:
            _, residuals_by_nodes = self._by_nodes
            rows += residuals_by_nodes @ self._nodes(ends, rows)
        return rows.reshape(part.samples, -1, len(changes)).transpose(1, 2, 0)

    def _nodes(self, ends: Array, rows: Array) -> Array:
        """Return the changes of the nodes (s, n, c) that make the segments continuous again.

        The changes of `ends` (s, n, c) and of residuals `rows` (s, length · k, c) are those from
        unchanged nodes.
        """
        transition, J = self._by_nodes
        coupled = self.part.data.coupled
        if self.growth > UNSTABLE:
            # Simulated nodes would grow until their digits are lost. Fitted nodes remain small.
            weights = np.kron(np.eye(self.part.segments.length), self.weight.T @ self.weight)
            weighted = J.mT @ weights
            nodes, _ = solve_continuity(weighted @ J, transition, coupled, -weighted @ rows, -ends)
            return nodes
        nodes = np.zeros_like(ends)
        for j in np.flatnonzero(coupled).tolist():
            nodes[j + 1] = transition[j] @ nodes[j] + ends[j]
        return nodes

    @cached_property
    def _by_nodes(self) -> tuple[Array, Array]:
        """Derivatives of ends (s, n, n) and residuals (s, length · k, n) by the nodes."""
        part = self.part
        n = part.states
        unweighted = np.eye(len(self.weight))
        ends, J = part.segments.sensitivities(self.trajectory.course, slice(None), unweighted)
        # Known initial states cannot compensate for a term.
        unknown = ~part.known_states[:, None]
        return ends[..., :n] * unknown, J[..., :n] * unknown

    def _carried(self, effects: Effect) -> tuple[Array, Array]:
        """Carry the effects of c terms through the segments, from unchanged nodes.

        Returns the changes of the ends (s, n, c) and of the residuals (s, length · k, c).
        """
        n = self.part.states
        # Samples without a measurement have no residual.
        present = self._by_sample(self.present)[..., None]
        states = np.zeros_like(effects[0, :, :n])
        rows = []
        for slopes, effect, is_measured in zip(self._slopes, effects, present, strict=True):
            following = slopes[..., :n] @ states + effect
            states = following[:, :n]
            rows.append(following[:, n:] * is_measured)
        return states, np.hstack(rows)
