"""The records of a problem at points of an iteration: paths, cost, and what a step makes of them."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.record_part import RecordPart
from greybox.compiled.sensitivities import Blocks
from greybox.solve.constraints import Limits
from greybox.solve.gauss_newton.iterate import Move, Point
from greybox.solve.ipopt import SMOOTHING

Array = NDArray[np.float64]
FEW = 0.1  # of the segments, beyond which the step is too long as a whole
PULLS = 4  # of nodes that leave the domain of the model
CLOSINGS = 5  # of gaps after a step
ASTRAY = 10.0  # root mean square of the residuals, in the spread of a signal, beyond which a simulation is lost
CONTINUOUS = 1e-9  # gap relative to the largest value of the state


class Points:
    """All records together, and what else costs: `rest` of the solver's variables z (p,) and a smoothing."""

    def __init__(self, records: tuple[RecordPart, ...], rest: Callable[[Array, float], float], limits: Limits) -> None:
        self._records, self._rest, self._limits = records, rest, limits

    def at(self, z: Array, nodes: Sequence[Array], like: Point | None = None) -> Point:
        """Return the point at z with these nodes; followed from the first ones where the paths of `like` are."""
        follow = [path.followed for path in like.paths] if like else [False] * len(nodes)
        return self._at(z, nodes, follow)

    def _at(self, z: Array, nodes: Sequence[Array], follow: Sequence[bool]) -> Point:
        places = tuple(part.place(z) for part in self._records)
        ways = zip(self._records, nodes, places, follow, strict=True)
        paths = tuple(part.followed(n, place) if on else part.path(n, place) for part, n, place, on in ways)
        return Point(z, places, paths)

    def near_data(self, z: Array) -> Point:
        """Return the point at z whose nodes come from the data."""
        return self.at(z, [part.first_nodes(part.place(z)) for part in self._records])

    def simulated(self, z: Array, nodes: Sequence[Array]) -> Point:
        """Return the point at z followed from the first node of every stretch to its end."""
        return self._at(z, nodes, [True] * len(nodes))

    def stays(self, point: Point) -> bool:
        """Tell whether the outputs stay where the data are, which those of an unstable simulation do not."""
        return point.finite and all(
            np.all(np.diag(path.products) <= part.noise.counts * (ASTRAY * part.noise.spread) ** 2)
            for part, path in zip(self._records, point.paths, strict=True)
        )

    def cost(self, point: Point, smoothing: float = SMOOTHING) -> float:
        """Return the cost, infinite where anything diverges."""
        if not point.finite:
            return math.inf
        costs = (
            part.part.weight * part.noise.cost(p.products) for part, p in zip(self._records, point.paths, strict=True)
        )
        return float(sum(costs)) + self._rest(point.z, smoothing)

    def gap_cost(self, point: Point, force: Sequence[Array]) -> float:
        """Return what gaps cost at these forces (n,) on every state."""
        three = zip(self._records, point.paths, force, strict=True)
        return sum(part.part.weight * float((np.abs(path.gaps) * f).sum()) for part, path, f in three)

    def noise_weights(self, point: Point) -> list[Array]:
        """Return square roots of the inverse covariances that the residuals show."""
        return [part.noise.weight(path.products) for part, path in zip(self._records, point.paths, strict=True)]

    def is_continuous(self, point: Point) -> bool:
        """Tell whether what gaps are left is rounding."""
        return all(
            np.all(np.abs(p.gaps).max(axis=0, initial=0.0) <= CONTINUOUS * np.abs(p.states).max(axis=1, initial=0.0))
            for p in point.paths
        )

    def linearized(self, point: Point, weights: Sequence[Array], moments: bool = False) -> list[Blocks]:
        """Return the blocks of every record, with `moments` where the noise is estimated."""
        return [
            part.linearize(path, place, weight, moments)
            for part, path, place, weight in zip(self._records, point.paths, point.places, weights, strict=True)
        ]

    def moved(self, point: Point, move: Move, length: float) -> Point:
        """Return the point after a step, of which `length` is taken."""
        nodes = [
            part.moved(path.nodes, r, move.dz, length)
            for part, path, r in zip(self._records, point.paths, move.reduced, strict=True)
        ]
        z = self._limits.clipped(point.z + length * move.dz) if move.dz.any() else point.z
        return self._kept(point, self.at(z, nodes, point))

    def _kept(self, before: Point, after: Point) -> Point:
        """Return the point with the nodes pulled back from which a segment leaves the domain of the model.

        A root or logarithm of a single node would otherwise cut the steps of all nodes short.
        """
        share, before_it = 0.5, math.inf
        for _ in range(PULLS):
            if after.finite or all(path.followed for path in after.paths):
                break
            ways = zip(self._records, after.paths, after.places, strict=True)
            lost = [part.lost(path, place) for part, path, place in ways]
            count, every = sum(int(v.sum()) for v in lost), sum(v.size for v in lost)
            if count > FEW * every or count > 0.5 * before_it:
                break  # the parameters, or the whole step, are at fault
            before_it = count
            nodes = [
                np.where(there[:, None], old.nodes + share * (path.nodes - old.nodes), path.nodes)
                for there, old, path in zip(lost, before.paths, after.paths, strict=True)
            ]
            after, share = self.at(after.z, nodes, after), 0.25 * share
        return after

    def closed(self, point: Point, move: Move, force: Sequence[Array], enough: float) -> Point:
        """Return the point with the gaps closed that curvature has left, by the least changes of the outputs.

        They would cut every step short otherwise (Maratos effect; Nocedal and Wright, Numerical Optimization, 15.5).
        """
        cost = self.gap_cost(point, force)
        for _ in range(CLOSINGS):
            if not point.finite or cost <= enough:
                break
            nodes = [
                path.nodes + part.closing(blocks, path.gaps)
                for part, path, blocks in zip(self._records, point.paths, move.blocks, strict=True)
            ]
            closer = self.at(point.z, nodes, point)
            now = self.gap_cost(closer, force)
            if not closer.finite or now > 0.5 * cost:
                break
            point, cost = closer, now
        return point

    def trace(self, point: Point) -> Array:
        """Return simulated outputs in units of the measured ones' spread, thinned, by which runs are told apart."""
        rows = []
        for part, path, place in zip(self._records, point.paths, point.places, strict=True):
            step = max(place.data.shape[1] // 500, 1)
            outputs = part.shooting.outputs(path.states[:, ::step], place.q, place.data[:, ::step])
            rows.append((outputs / part.noise.spread[:, None]).ravel())
        return np.concatenate(rows)
