"""How the outputs of a record would follow terms that its model does not have.

The outputs follow a term to first order, with the initial states fitted too, as they follow a
parameter. No other model is compiled, and models that are unstable without feedback are served.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from greybox.compiled.condensing import solve_continuity
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.segments import Linearization
from greybox.files.arrays import Array
from greybox.modeling.added_terms import factors_of_derivatives

Effect = tuple[Array, Array]
"""What every sample adds to the next state (n, columns) and to the outputs (k, columns)."""


class DisturbedRecord:
    """A record along its best trajectory, with its signals (·, samples) in order."""

    def __init__(self, part: RecordPart, trajectory: Trajectory) -> None:
        self.part, self.trajectory, self._placed = part, trajectory, trajectory.detail
        segments, q, data = part.segments, self._placed.q, self._placed.data
        m, k = len(part.system.inputs), len(part.outputs)
        self._slopes = segments.sample_derivatives(trajectory.states, q, data)
        self.states = segments.in_order(trajectory.states)
        self.outputs = part.simulated_outputs(trajectory)
        self.residuals = part.residuals(trajectory)
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
        """Return the effect of values (samples,) that add to an output."""
        outputs = np.zeros_like(self.present)
        outputs[place] = values
        return np.zeros_like(self.trajectory.states), self.part.segments.columns(outputs)

    def by_parameter(self, place: int, values: Array) -> Effect:
        """Return the effect of an active parameter that changes by values (samples,)."""
        change = self.part.segments.columns(values[None])[0]
        following, residuals = (slope[self.part.states + place] for slope in self._slopes)
        return following * change, -residuals * change

    def by_state(self, place: int, values: Array) -> Effect:
        """Return the effect of values (samples,) that add to the derivative of a state."""
        derivatives = np.zeros_like(self.states)
        derivatives[place] = values
        outputs = self.measured_derivatives[:, [place]] * values
        return self._by_derivatives(derivatives), self.part.segments.columns(outputs)

    def by_input(self, place: int, values: Array) -> Effect:
        """Return the effect of values (samples,) that add to an input."""
        way = self.part.model.between[place]
        return self.by_formulas(place - self.inputs.shape[0], values, way.held)

    def by_formulas(self, place: int, values: Array, is_held: bool = False) -> Effect:
        """Return the effect of values (samples,) that add to a parameter, also to a fixed one."""
        changes, n = self._slopes_of_formulas[:, place] * values, self.part.states
        effect = self._by_derivatives(changes[:n], is_held)
        return effect, self.part.segments.columns(changes[n:])

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

    def _by_derivatives(self, derivatives: Array, is_held: bool = False) -> Array:
        """Return the mean of additional derivatives over a step, propagated over half of it."""
        # Terms have values at samples, and a step lasts until the next sample.
        later = np.hstack([derivatives[:, 1:], derivatives[:, -1:]])
        later = derivatives if self.is_predicted or is_held else later
        mean = self.part.segments.columns((derivatives + later) / 2)
        # Most terms add to one state: of 20 states the others take a quarter of the test's time.
        moved = mean.any(axis=1)
        A = self._slopes[0][: self.part.states][moved]
        return self._placed.data[-1] / 2 * (mean + np.einsum("jac,jc->ac", A, mean[moved]))

    @cached_property
    def _linearized(self) -> tuple[Array, Linearization]:
        weight = self.part.residual_weight(self.trajectory)
        return weight, self.part.linearize(self.trajectory, weight)

    def followed_by(self, effects: Iterable[Effect]) -> Array:
        """Return how outputs (k, c, samples) follow effects, with initial states fitted too."""
        # Numbers of the effects in memory at once: 40 MB. A rod of 100 states has 2700 terms, 300
        # MB.
        effects, size = iter(effects), max(5_000_000 // max(self.states.size, 1), 1)
        batches = iter(lambda: list(itertools.islice(effects, size)), [])
        return np.concatenate([self._followed_by(batch) for batch in batches], axis=1)

    def _followed_by(self, effects: Sequence[Effect]) -> Array:
        part, n = self.part, self.part.states
        # No residual follows where nothing was measured.
        present = part.segments.columns(self.present)
        A, C = (slope[:n] for slope in self._slopes)
        ends, J = part.segments.propagated(
            np.stack([*A, *(-following for following, _ in effects)]),
            np.stack([*C, *(outputs * present for _, outputs in effects)]),
            part.segments.count,
        )
        J = J.transpose(3, 0, 1, 2)
        if n:
            weight, linearization = self._linearized
            rows = np.einsum("ab,slbv->slav", weight, J).reshape(len(J), -1, J.shape[-1])
            known = part.known_states
            cross = -rows[:, :, :n].swapaxes(1, 2) @ rows[:, :, n:]
            cross[known] = 0
            nodes, _ = solve_continuity(
                linearization.node_hessian,
                linearization.transition,
                part.data.coupled,
                cross,
                -ends.transpose(2, 0, 1)[:, :, n:],
                np.zeros(n),
            )
            # Known initial states cannot compensate for a term.
            nodes[known] = 0
            J = J[..., :n] @ nodes[:, None] + J[..., n:]
        return J.transpose(2, 3, 0, 1).reshape(*J.shape[2:], -1)
