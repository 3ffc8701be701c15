"""The information of a record on all values of a problem, for the covariance of the estimate."""

from dataclasses import dataclass

import numpy as np

from greybox.compiled.colored_errors import colored_errors, independent_numbers
from greybox.compiled.part import ColoredErrors, Information, Trajectory
from greybox.compiled.record_sensitivity import sensitivity
from greybox.compiled.segmented_part import SegmentedPart
from greybox.files.arrays import Array


@dataclass(frozen=True, eq=False)
class Columns:
    """Which of all values (k,) are the columns of a Jacobian, and the scale of each.

    Attributes
    ----------
    places : tuple of int
    scale : (columns,) array
        Derivatives of the solver's variables by the values.
    size : int
        Number of all values.
    """

    places: tuple[int, ...]
    scale: Array
    size: int

    def derivatives(self, by_columns: Array) -> Array:
        """Return derivatives (..., k) by all values, for those (..., columns) by the columns."""
        result = np.zeros((*by_columns.shape[:-1], self.size))
        result[..., self.places] = by_columns * self.scale
        return result

    def directions(self, free: Array) -> Array:
        """Return directions (columns, r) for those (p, r) of the free values, the first ones."""
        padding = len(self.places) - len(free)
        return np.pad(free, ((0, padding), (0, 0))) * self.scale[:, None]


def record_information(
    part: SegmentedPart, trajectory: Trajectory, columns: Columns
) -> Information:
    """Return the information of a record on all values, the initial states fitted along.

    For errors with the autocorrelation of the residuals, or white ones where the criterion takes
    them so.
    """
    model, data = part.model, part.data
    weight = part.residual_weight(trajectory)
    slopes = sensitivity(part, trajectory, weight)
    weighted, score = slopes.weighted, slopes.white
    if part.covariance.known is not None and not model.is_prior:
        # The residuals show whether the given noise is right.
        variance = np.diag(trajectory.products) / np.maximum(part.covariance.counts, 1)
        pairs = zip(variance, weighted, strict=True)
        score = sum((v * J @ J.T for v, J in pairs), np.zeros_like(score))

    initial = part.unknown_initial_states
    # Fitted initial states make residuals smaller than errors, and the covariance too small.
    independent = independent_numbers(part.numbers, initial, len(score), 1.0)
    meat = score * independent / (independent - initial)
    meat = columns.derivatives(columns.derivatives(meat).T)

    def spread(correction: float) -> tuple[float, Array]:
        return 1.0, meat * (1.0 if model.is_prior else correction**2)

    def colored(root: Array) -> ColoredErrors:
        directions = columns.directions(root)
        return colored_errors(
            [directions.T @ J for J in data.unpadded(weighted)],
            data.unpadded(part.residuals(trajectory)),
            np.eye(root.shape[1]),
            weight,
            initial,
            max(data.stretches, key=len).step,
            initial=data.unpadded(slopes.by_initial),
            shocks=slopes.shocks,
        )

    in_order = model.has_time and not model.errors_are_white
    return Information(
        part,
        columns.derivatives(slopes.triangle),
        part.numbers - initial,
        spread,
        reach=np.abs(columns.derivatives(slopes.reach)),
        initial={name: columns.derivatives(rows) for name, rows in slopes.initial.items()},
        colored=colored if in_order else None,
    )
