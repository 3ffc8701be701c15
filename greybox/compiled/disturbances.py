"""How the outputs of a record would follow terms that its model does not have.

A term acts on the derivative of a state, on an input, on an output, or on a parameter that changes
along the record. The outputs follow it to first order, with the initial states fitted along, as
they follow a parameter: no other model is compiled, and models that are unstable without feedback
are served too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.compiled.condensing import solve_in_outputs
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.segmented_part import Placed
from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property

# Change of an input, as a share of its size, for central differences.
SHARE = 1e-4


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A term that a model does not have.

    Attributes
    ----------
    kind : "state", "held state", "input", "output" or "parameter"
        A held one keeps its value until the next sample, as most inputs do.
    place : int
        Which state, input or output it adds to, or which active parameter it multiplies.
    values : (samples,) array
        In the order of the samples, segments filled up.
    """

    kind: str
    place: int
    values: Array


class DisturbedRecord:
    """A record along its best trajectory, and how its outputs follow disturbances."""

    def __init__(self, part: RecordPart, trajectory: Trajectory) -> None:
        self._part = part
        self.trajectory = trajectory
        self._placed: Placed = trajectory.detail

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        states, placed = self.trajectory.states, self._placed
        return self._part.segments.sample_derivatives(states, placed.q, placed.data)

    @property
    def parameters(self) -> Array:
        """The values (m,) of the declared parameters."""
        return self._placed.q

    def states(self) -> Array:
        """Return the states (n, samples) in the order of the samples."""
        return self._part.segments.in_order(self.trajectory.states)

    def inputs(self) -> Array:
        """Return the inputs (m, samples) as they act, delayed."""
        m = len(self._part.system.inputs)
        return self._part.segments.in_order(self._placed.data[m : 4 * m])[1::3]

    def followed_by(self, disturbances: Sequence[Disturbance]) -> list[Array]:
        """Return the changes (k, c, n) of the outputs of every stretch."""
        part, segments, n = self._part, self._part.segments, self._part.states
        A, C = self._slopes
        moved = [self._first_effect(disturbance) for disturbance in disturbances]
        ends, J = segments.disturbed(
            np.concatenate([A[:n], np.array([following for following, _ in moved])]),
            np.concatenate([C[:n], np.array([-outputs for _, outputs in moved])]),
        )
        weight = part.residual_weight(self.trajectory)
        rows = np.einsum("ab,slbv->slav", weight, J).reshape(len(J), -1, J.shape[-1])
        cross = -rows[:, :, :n].transpose(0, 2, 1) @ rows[:, :, n:]
        continuity = -ends[:, :, n:].copy()
        if n:
            known = np.ix_(part.data.begins_record, part.model.known_states)
            cross[known] = 0
            linearization = part.linearize(self.trajectory, weight)
            nodes, _ = solve_in_outputs(
                linearization, part.data.coupled, cross, continuity, np.zeros(n)
            )
            nodes[known] = 0
            J = np.einsum("slkn,snc->slkc", J[..., :n], nodes) + J[..., n:]
        outputs = -J.transpose(2, 3, 0, 1).reshape(J.shape[2], J.shape[3], -1)
        return part.data.unpadded(outputs)

    def _first_effect(self, disturbance: Disturbance) -> tuple[Array, Array]:
        """Return the effect on the next state (n, columns) and on the outputs (k, columns)."""
        part, n, k = self._part, self._part.states, len(self._part.outputs)
        segments, placed, place = part.segments, self._placed, disturbance.place
        values = segments.columns(disturbance.values[None])[0]
        following, outputs = np.zeros((n, values.size)), np.zeros((k, values.size))
        A, C = self._slopes
        measured = placed.data[-1 - k : -1]

        if disturbance.kind == "output":
            outputs[place] = values
        elif disturbance.kind == "parameter":
            following = A[n + place] * values
            outputs = -C[n + place] * values
        elif disturbance.kind.endswith("state"):
            # The mean of the derivative over a step, carried on for half of it.
            mean = values
            if disturbance.kind == "state":
                later = np.append(disturbance.values[1:], disturbance.values[-1:])
                mean = segments.columns((disturbance.values + later)[None] / 2)[0]
            following = A[place] / 2 * mean
            following[place] += mean / 2
            following = following * placed.data[-1]
        else:
            direction = self._input_direction(place, disturbance.values)
            size = np.abs(placed.data).max() * SHARE
            following, outputs = segments.along(
                self.trajectory.states, placed.q, placed.data, direction, size or SHARE
            )
        return following, outputs * measured

    def _input_direction(self, place: int, values: Array) -> Array:
        """Return the change of the data (width, columns) by values (samples,) of an input."""
        part, m = self._part, len(self._part.system.inputs)
        data = part.data
        stretches = tuple(
            replace(stretch, inputs=np.where(np.arange(m)[:, None] == place, row, 0.0))
            for stretch, row in zip(data.stretches, data.unpadded(values), strict=True)
        )
        delays = part.model.locate(self.trajectory.z)[2].full().ravel()
        windows = replace(data, stretches=stretches).delayed_inputs(delays)[1]
        direction = np.zeros_like(self._placed.data)
        direction[m : 4 * m] = part.segments.columns(windows)
        return direction
