"""A record for IPOPT: states as unknowns, weighted residuals, continuity as equations."""

import casadi as ca
import numpy as np

from greybox.compiled.part import Program, Trajectory
from greybox.compiled.segmented_part import SegmentedPart
from greybox.files.arrays import Array


class RecordProgram(Program):
    """A record transcribed: continuity and known initial states are equations.

    Its parameters are the square root of the inverse residual covariance (k, k), then the data
    (width, samples), both column by column.
    """

    def __init__(self, part: SegmentedPart, z: ca.MX) -> None:
        """Transcribe the record."""
        self._part = part
        if part.model.driven:
            raise ValueError(
                f"{part.problem.name!r} has process_noise, whose gains "
                f"{part.model.method.label} does not follow: use MultipleShooting()."
            )

        q = part.model.locate(z)[0]
        weight = ca.MX.sym("W", len(part.outputs), len(part.outputs))
        data = ca.MX.sym("data", part.step.width, part.data.samples)
        self._transcribed = part.model.method.transcribe(part.step, part.data, q, data)
        residuals = self._transcribed.residuals
        self.unknowns = self._transcribed.unknowns
        self.parameters = ca.vertcat(ca.vec(weight), ca.vec(data))
        self.error = ca.vec(weight @ residuals)
        self.cost = ca.MX(0.0)
        self.equations = ca.vertcat(self._transcribed.equations, self._known_states(q))
        # Without weights: the covariance that follows must not depend on those in use.
        self._products = ca.Function(
            "products", [z, self.unknowns, self.parameters], [residuals @ residuals.T]
        )

    def _known_states(self, q: ca.MX) -> ca.MX:
        """Return the known states at the first samples of stretches less their known values."""
        part = self._part
        begins = part.data.begins_stretch
        places = np.flatnonzero(part.known_states[begins]).tolist()
        if not places:
            return ca.MX(0, 1)  # CasADi reads an empty column as an empty row
        values = ca.repmat(part.model.initial(q)[0], int(begins.sum()), 1)
        values += part.delays_at_rest[begins].ravel()
        return ca.vec(self._transcribed.initial)[places] - values[places]

    def initial_unknowns(self, trajectory: Trajectory) -> Array:
        """Return the unknowns for the states along a trajectory."""
        return self._transcribed.start(self._part.segments.in_order(trajectory.states))

    def initial_parameters(self, z: Array) -> Array:
        """Return the weights of small residuals, and the data at z (p,)."""
        return self._joined(self._part.initial_weight(), self._part.place(z).data)

    def products(self, z: Array, unknowns: Array, w: Array) -> Array:
        """Return the products of residuals."""
        return self._products(z, unknowns, w).full()

    def outcome(self, z: Array, products: Array, w: Array) -> tuple[float, Array, bool]:
        """Return the cost, the weights and data that follow, and whether the data stayed."""
        covariance = self._part.covariance
        following = self._joined(covariance.weight(products), self._part.place(z).data)
        # The weights come first; what follows them changes only where a delay passes a sample.
        size = len(self._part.outputs) ** 2
        return covariance.cost(products), following, np.array_equal(following[size:], w[size:])

    def _joined(self, weight: Array, data: Array) -> Array:
        return np.concatenate(
            [weight.ravel(order="F"), self._part.segments.in_order(data).ravel(order="F")]
        )
