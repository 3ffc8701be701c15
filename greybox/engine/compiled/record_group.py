"""Records of one model, evaluated and condensed together: one call for all of them.

A call from Python costs as much as the arithmetic of some hundred samples, so a hundred short
records one after the other take ten times as long as one record with as many samples. Parameters,
residual covariances and delays that differ between them are an axis of arrays. The rest of greybox
sees parts, one for every problem; `Groups` translates.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, IntArray, diagonal
from greybox.data.files.grouping import grouped
from greybox.engine.compiled.part import Part, Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.residual_covariance import ResidualCovariance
from greybox.engine.compiled.sampled_data import joined
from greybox.engine.compiled.segmented_part import Placed, SegmentedPart
from greybox.engine.compiled.segments import Segments
from greybox.engine.compiled.vectorized import Columns
from greybox.modeling.cached_property import cached_property
from greybox.modeling.one_thread import one_thread_at_a_time


class RecordGroup(SegmentedPart):
    """Several records with one compiled sample, segments of one length and one weight, as one part.

    Its trajectories have the nodes of all records, one after the other, and the products of the
    residuals of each, (records, k, k); so have residual weights.
    """

    def __init__(self, parts: Sequence[RecordPart]) -> None:
        """Join the data; records have parameters of their own where their expressions differ."""
        self.parts = tuple(parts)
        first = self.parts[0]
        counts = [part.data.segments for part in self.parts]
        data = joined([part.data for part in self.parts])
        segments = Segments(
            first.step,
            data.segments,
            data.segment_length,
            first.model.active,
            records=np.repeat(np.arange(len(counts)), counts),
            # Equal expressions of z have equal values and derivatives in all records.
            own=len({part.model.expressions for part in self.parts}) > 1,
        )
        covariances = [part.covariance for part in self.parts]
        covariance = ResidualCovariance(
            np.array([c.counts for c in covariances]),
            np.array([c.spread for c in covariances]),
            covariances[0].known,  # records of one kind have one criterion
            covariances[0].correlated,
        )
        super().__init__(first.model, data, segments, covariance)

    # --- placement

    @cached_property
    @one_thread_at_a_time
    def _located(self) -> tuple[Columns, IntArray]:
        """Return the placement of all distinct records as a function of z, and their indices."""
        distinct = {part.model.expressions: part.model for part in self.parts}
        keys = [*distinct]
        [z] = self.model.locate.function.sx_in()
        results = (model.locate.function(z) for model in distinct.values())
        stacked = [ca.vertcat(*map(ca.vec, values)) for values in zip(*results, strict=True)]
        index = np.array([keys.index(part.model.expressions) for part in self.parts])
        return Columns(ca.Function("located", [z], stacked)), index

    def place(self, z: Array) -> Placed:
        """Return the parameters and data at z (p,), by record where records differ."""
        function, index = self._located
        count, active = index.max() + 1, len(self.model.active)
        q, slope, delay, initial, initial_slope = (
            values.reshape(count, -1) for values in function(z[:, None])
        )
        slope = slope.reshape(count, active, len(z))
        initial_slope = initial_slope.reshape(count, self.states, active)
        # One placement is used for all records: nothing needs an axis of records.
        if count == 1:
            return Placed(q[0], slope[0], self.data_at(delay[0]), initial[0], initial_slope[0])

        stretches = np.repeat(index, [len(part.data.stretches) for part in self.parts])
        return Placed(
            q=q.T[:, index[self.segments.records]],
            slope=slope[index],
            data=self.data_at(delay.T[:, stretches]),
            initial=initial[index],
            initial_slope=initial_slope[index],
        )

    def initial_nodes(self, q: Array, known: Array) -> Array:
        """Return nodes (s, n) from the data of each record."""
        nodes = []
        firsts = self.segments.first_of_record
        for k, (part, first) in enumerate(zip(self.parts, firsts, strict=True)):
            q_of_part = q if q.ndim == 1 else q[:, first]
            nodes.append(part.initial_nodes(q_of_part, known if known.ndim == 1 else known[k]))
        return np.concatenate(nodes)


class Groups:
    """The parts of a problem as a solver takes them: similar records are one."""

    def __init__(self, parts: Sequence[Part]) -> None:
        """Group the parts."""
        self._all: Any = tuple(parts)
        self._lots = grouped(range(len(parts)), lambda k: parts[k].group or k)
        lots = [[self._all[k] for k in lot] for lot in self._lots]
        self.parts = [RecordGroup(lot) if len(lot) > 1 else lot[0] for lot in lots]

    def joined(self, nodes: Sequence[Array]) -> list[Array]:
        """Return the nodes of every group, given those of every part."""
        return [np.concatenate([nodes[k] for k in lot]) for lot in self._lots]

    def nodes_by_part(self, nodes: Sequence[Array]) -> list[Array]:
        """Return the nodes of every part, given those of every group."""
        result: dict[int, Array] = {}
        for lot, group, of_group in zip(self._lots, self.parts, nodes, strict=True):
            firsts = group.segments.first_of_record if isinstance(group, RecordGroup) else [0]
            result |= dict(zip(lot, np.split(of_group, firsts[1:]), strict=True))
        return [result[k] for k in sorted(result)]

    def split(self, trajectories: Sequence[Trajectory]) -> list[Trajectory]:
        """Return the trajectories of every part, given those of every group."""
        nodes = self.nodes_by_part([t.nodes for t in trajectories])
        result = dict[int, Trajectory]()
        for lot, t in zip(self._lots, trajectories, strict=True):
            for k in lot:
                result[k] = t if len(lot) == 1 else self._all[k].trajectory(t.z, nodes[k])
        return sharing(self._all, [result[k] for k in sorted(result)])


def sharing(parts: Sequence[Part], trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Return trajectories with `shared_products`, where some part has few numbers."""
    if not any(part.few.any() for part in parts):
        return [*trajectories]
    result = [*trajectories]
    products = [trajectory.products for trajectory in trajectories]
    # The end terms of manoeuvres depend on the variances of their outputs, and change them.
    for _ in range(50):
        shared = shared_products(parts, products)
        next_result = []
        next_products = []
        for part, trajectory, of_part in zip(parts, result, shared, strict=True):
            changed, own = part.with_products(trajectory, of_part)
            next_result.append(changed)
            next_products.append(own)
        result = next_result
        if all(a is b or np.allclose(a, b) for a, b in zip(next_products, products, strict=True)):
            break
        products = next_products
    return result


def shared_products(parts: Sequence[Part], products: Sequence[Array]) -> list[Array]:
    """Return the products of residuals; those of few numbers are means of their noise group.

    With a variance of its own, a record of few samples that chances to be fitted well would decide
    the estimate, and so would a manoeuvre of few lines.

    Source: Neyman and Scott (1948), Consistent estimates based on partially consistent
    observations, Econometrica 16.
    """
    result = [*products]
    short = {k: part for k, part in enumerate(parts) if part.few.any()}
    for lot in grouped(short, lambda k: short[k].noise_group):
        squares = [np.linalg.diagonal(products[k]) for k in lot]
        counts = np.vstack([short[k].few for k in lot])
        sums = np.sum(np.vstack(squares), axis=0, where=counts > 0)
        variance = sums / np.maximum(counts.sum(axis=0), 1)
        for k, own in zip(lot, squares, strict=True):
            change = short[k].few * variance - own
            result[k] = products[k] + diagonal(change * (short[k].few > 0))
    return result
