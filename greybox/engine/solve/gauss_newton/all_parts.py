"""All parts of a problem at one iterate: trajectories, cost, and where a step leads."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.kalman_gain import kalman_gain
from greybox.engine.compiled.part import ASSUMED_ERROR, SMOOTHING
from greybox.engine.compiled.record_group import Groups, sharing
from greybox.engine.solve.constraints import Limits
from greybox.engine.solve.gauss_newton.iterate import EXACT, Iterate, Nodes, Progress, Step, relaxed
from greybox.engine.solve.gauss_newton.settings import Settings
from greybox.engine.solve.stationarity import rounding_of

GAP_CLOSINGS = 5  # iterations of the second-order correction


def with_rounding(cost: float) -> float:
    """Return the largest cost that may differ from this one by rounding alone."""
    return cost + rounding_of(cost)


class AllParts:
    """The parts of one problem, whose costs add, with Kalman gains, limits and settings.

    Records that can be evaluated together are one part here; `groups` translates.
    """

    def __init__(self, nlp: CompiledProblem, limits: Limits, settings: Settings) -> None:
        """Group the parts."""
        self.nlp = nlp
        self.groups = Groups(nlp.parts)
        self.parts = self.groups.parts
        self.gains = [kalman_gain(part) for part in self.parts]
        gains = [
            gain.part.model.outside_names[k] for gain in self.gains if gain for k in gain.unknowns
        ]
        self.is_gain = np.isin(nlp.free, gains)  # or process noise: neither has a scale
        self.samples = sum(part.samples for part in self.parts)
        delays = {name: output for part in nlp.parts for name, (_, output) in part.delays.items()}
        self.is_delay = np.isin(nlp.free, [*delays])
        self.is_discontinuous = np.isin(nlp.free, [name for name in delays if delays[name]])
        self.limits = limits
        self.settings = settings

    # --- iterates

    def at(self, z: Array, nodes: Nodes | None = None, like: Iterate | None = None) -> Iterate:
        """Return the iterate at z, simulated where the iterate `like` is.

        Without `nodes`, they come from the data.
        """
        flags = [t.simulated for t in like.trajectories] if like else [False] * len(self.parts)
        zipped = zip(self.parts, nodes or [None] * len(self.parts), flags, strict=True)
        trajectories = [part.trajectory(z, n, simulated=flag) for part, n, flag in zipped]
        return Iterate(z, tuple(sharing(self.parts, trajectories)))

    def simulated(self, z: Array) -> Iterate:
        """Return the iterate at z with nodes that are simulated from the first ones."""
        run = [replace(part.trajectory(z, simulated=True), simulated=False) for part in self.parts]
        return Iterate(z, tuple(sharing(self.parts, run)))

    def continuous(self, iterate: Iterate) -> Iterate:
        """Return the iterate after a step of its nodes alone that closes all gaps."""
        if not iterate.finite:
            return iterate
        nodes = []
        for part, t in self.along(iterate):
            weight = part.initial_weight()
            condensed = part.condense(part.linearize(t, weight), t, weight=weight)
            nodes.append(t.nodes + condensed.change_of_nodes(np.zeros(len(iterate.z))))
        return self.at(iterate.z, nodes, iterate)

    def along(self, iterate: Iterate, *others: Sequence[Any]) -> Iterator[Any]:
        """Yield every part with its trajectory, and with its member of the others."""
        return zip(self.parts, iterate.trajectories, *others, strict=True)

    def first_progress(self) -> Progress:
        """Return the progress of an iteration with nodes from the data; exact without nodes."""
        with_nodes = [bool(part.gains) for part in self.parts if part.has_nodes]
        return relaxed(predicts=all(with_nodes)) if with_nodes else EXACT

    # --- judging an iterate

    def is_continuous(self, iterate: Iterate) -> bool:
        """Return whether all gaps are rounding, relative to the largest value of a state."""
        # Relative to the largest value, since a state may pass through zero.
        return all(
            np.all(
                np.abs(t.gaps).max(axis=0, initial=0.0)
                <= 1e-9 * np.abs(t.nodes).max(axis=0, initial=0.0)
            )
            for t in iterate.trajectories
        )

    def has_stable_steps(self, iterate: Iterate) -> bool:
        """Return whether explicit steps of all parts are stable at an iterate."""
        nodes = self.groups.nodes_by_part(iterate.nodes)
        return self.nlp.has_stable_steps(iterate.z, nodes)

    def signature(self, iterate: Iterate) -> Array:
        """Return numbers by which runs are distinguished, see `Part.signature`."""
        return np.concatenate(
            [part.signature(trajectory) for part, trajectory in self.along(iterate)]
        )

    # --- cost

    def cost(self, iterate: Iterate, smoothing: float = SMOOTHING) -> float:
        """Return the cost, infinite where anything diverges."""
        if not iterate.finite:
            return math.inf
        return float(sum(part.weight * part.cost(t, smoothing) for part, t in self.along(iterate)))

    def gap_cost(self, iterate: Iterate, multipliers: Sequence[Array]) -> float:
        """Return the l1 penalty of the gaps, with multipliers (n,) for every state."""
        pairs = self.along(iterate, multipliers)
        return sum(part.weight * float((np.abs(t.gaps) * m).sum()) for part, t, m in pairs)

    def squared_cost(
        self, iterate: Iterate, residual_weights: Sequence[Array], variances: Sequence[Array]
    ) -> float:
        """Return half the weighted squares of residuals and gaps of a finite iterate.

        The variances (n,) of the gaps are those of every state. Gaps whose variance is zero do
        not count: the next step closes them.
        """
        total = 0.0
        for part, t, weight, v in self.along(iterate, residual_weights, variances):
            gaps = float((t.gaps[:, v > 0] ** 2 / v[v > 0]).sum()) / 2
            total += part.weight * (part.squared_cost(t, weight) + gaps)
        return total

    def unexplained(self, iterate: Iterate) -> float:
        """Return the share of the records' variance that predictions over segments leave."""
        if not iterate.finite:
            return math.inf
        records = [(part, t) for part, t in self.along(iterate) if part.has_nodes]
        squares = sum(part.squared_cost(t, part.initial_weight()) for part, t in records)
        return 2 * ASSUMED_ERROR**2 * squares / max(sum(part.numbers for part, _ in records), 1)

    def residual_weights(self, iterate: Iterate) -> list[Array]:
        """Return square roots of the inverse residual covariances at an iterate."""
        return [part.residual_weight(trajectory) for part, trajectory in self.along(iterate)]

    # --- linearization and steps

    def linearize(self, iterate: Iterate, weights: Sequence[Array]) -> list[Any]:
        """Return the linearization of every part."""
        return [part.linearize(t, weight) for part, t, weight in self.along(iterate, weights)]

    def moved(self, iterate: Iterate, step: Step, length: float) -> Iterate:
        """Return the iterate after the share `length` of a step."""
        # The nodes follow from the condensed step, which already knows their gaps.
        zipped = zip(step.condensed, iterate.trajectories, strict=True)
        nodes = [t.nodes + length * condensed.change_of_nodes(step.dz) for condensed, t in zipped]
        z = self.limits.after(iterate.z, length * step.dz) if step.dz.any() else iterate.z
        return self.at(z, nodes, iterate)

    def close_gaps(self, iterate: Iterate, step: Step, length: float) -> Iterate:
        """Return the iterate with the gaps of curvature closed, by the least change of the outputs.

        The gaps would cut every step short otherwise (Maratos effect; Nocedal and Wright, Numerical
        Optimization, section 15.5).
        """
        # An error of a hundredth of the predicted decrease changes no decision of the line search.
        enough = 0.01 * length * step.decrease
        penalty = self.gap_cost(iterate, step.multipliers)
        for _ in range(GAP_CLOSINGS):
            if not iterate.finite or penalty <= enough:
                break
            zipped = self.along(iterate, step.linearizations, step.condensed)
            nodes = [part.close_gaps(b, t, system.held) for part, t, b, system in zipped]
            closer = self.at(iterate.z, nodes, iterate)
            closer_penalty = self.gap_cost(closer, step.multipliers)

            # Newton's method for the gaps converges fast or not at all.
            if not closer.finite or closer_penalty > 0.5 * penalty:
                break
            iterate, penalty = closer, closer_penalty
        return iterate

    def made_continuous(self, iterate: Iterate, step: Step) -> Iterate:
        """Return the iterate after a step with all gaps closed to rounding."""
        for _ in range(GAP_CLOSINGS):
            if not iterate.finite or self.is_continuous(iterate):
                break
            iterate = self.close_gaps(iterate, step, 0.0)
        return iterate
