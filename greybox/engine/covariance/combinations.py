"""Combinations of parameters that the data do not determine, or determine poorly."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.data.files.arrays import Array, sum_of_squares, unit_length
from greybox.data.files.grouping import unique
from greybox.engine.covariance.known_directions import BLIND
from greybox.statistics.column_space import triangle_of


@dataclass(frozen=True)
class Combination:
    """Parameters that the data determine only together.

    Attributes
    ----------
    names : tuple of str
        The parameters involved, the most affected first.
    index : float
        Collinearity index: 1 / smallest singular value of the Jacobian with columns scaled to unit
        length; infinite when the data do not see the combination at all. Above 10 to 20 parameters
        compensate one another. Source: Brun, Reichert and Künsch (2001), Water Resources Research
        37(4).
    directions : int
        In how many directions the parameters move without effect.
    states : tuple of str
        States whose unknown initial values take part.
    """

    names: tuple[str, ...]
    index: float
    directions: int = 1
    states: tuple[str, ...] = ()

    @property
    def members(self) -> tuple[str, ...]:
        """The parameters and the initial states, in words."""
        return (*self.names, *(f"the initial state of {name}" for name in self.states))


def invisible_groups(
    invisible: Array, size: Array, names: tuple[str, ...], initial: Sequence[Mapping[str, Array]]
) -> tuple[Combination, ...]:
    """Return the groups of parameters that move without effect in `invisible` directions (p, b).

    Directions without a common parameter are different groups, however the directions are mixed.
    """
    if not invisible.any():
        return ()  # as of most fits, without the import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (imports slowly)

    # The projector does not depend on how the singular vectors mix equal singular values.
    projector = invisible @ invisible.T
    # No parameter that takes part has an error, however small its part is.
    places = np.flatnonzero(np.diag(projector) > BLIND**2)
    linked = np.abs(projector[np.ix_(places, places)]) > BLIND
    count, labels = connected_components(linked)
    groups = []

    for label in range(count):
        group = places[labels == label].tolist()
        members = sorted(group, key=lambda k: (-round(float(projector[k, k]), 6), k))
        block = projector[np.ix_(members, members)]
        moves = np.zeros((len(names), len(members)))
        moves[members] = block * size[members, None]
        states = unique(
            state
            for of_part in initial
            for state, follow in of_part.items()
            # Initial states that change by less than this share take no part.
            if np.any(np.abs(follow[:, : len(names)] @ moves) > 1e-3)
        )
        directions = max(round(float(np.trace(block))), 1)
        members_by_name = tuple(names[k] for k in members)
        groups.append(Combination(members_by_name, math.inf, directions, states))

    return tuple(sorted(groups, key=lambda group: names.index(group.names[0])))


def collinear_groups(
    jacobian: Array,
    active: Array,
    names: tuple[str, ...],
    at_bound: Sequence[str],
    invisible: Array,
) -> tuple[Combination, ...]:
    """Return combinations whose effects nearly cancel, apart from `invisible` ones (p, b).

    Singular vectors of the same parameters are one combination, with the largest index. `active`
    (a, p) has the gradients of active constraints.
    """
    rows = np.vstack([jacobian, active])
    inside = [k for k, name in enumerate(names) if name not in at_bound and rows[:, k].any()]
    # Columns of unit length: the index measures how parallel effects are, not how large.
    unit = np.vstack([unit_length(jacobian[:, inside], 0), unit_length(active[:, inside], 1)])
    _, singular, rows = np.linalg.svd(triangle_of(unit), full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(rows) - len(singular))])
    # The smallest singular values belong to the invisible directions, which have groups already.
    seen = len(rows) - round(sum_of_squares(invisible[inside]))
    groups: dict[frozenset[str], Combination] = {}

    for value, row in zip(singular[:seen][::-1], np.abs(rows[:seen][::-1]), strict=True):
        if value > 1 / 20:  # above an index of 20 parameters hardly compensate one another
            break
        # Rounding must not order what takes part alike.
        order = np.argsort(-row.round(3), kind="stable")
        group = tuple(names[inside[i]] for i in order if row[i] > 0.2 * row.max())
        groups.setdefault(frozenset(group), Combination(group, float(1 / max(value, 1e-300))))

    return tuple(groups.values())
