"""The information of a record on all values of a problem, for the covariance of the estimate."""

from dataclasses import replace

import numpy as np

from greybox.compiled.colored_errors import colored_errors, independent_numbers
from greybox.compiled.part import ColoredErrors, Information, Trajectory
from greybox.compiled.record_sensitivity import sensitivity
from greybox.compiled.segmented_part import SegmentedPart
from greybox.files.arrays import Array


def record_information(
    part: SegmentedPart, trajectory: Trajectory, by_values: Array
) -> Information:
    """Return the information of a record on all values (k,), the initial states fitted along.

    `by_values` (columns, k) are the derivatives of the part's variables by all values, of which
    the free ones come first.

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
    meat = by_values.T @ score @ by_values * independent / (independent - initial)

    def spread(correction: float) -> tuple[float, Array]:
        return 1.0, meat * (1.0 if model.is_prior else correction**2)

    def colored(root: Array) -> ColoredErrors:
        directions = by_values[:, : len(root)] @ root
        errors = colored_errors(
            [directions.T @ J for J in data.unpadded(weighted)],
            data.unpadded(part.residuals(trajectory)),
            np.eye(root.shape[1]),
            weight,
            initial,
            max(data.stretches, key=len).step,
            initial=data.unpadded(slopes.by_initial),
            shocks=slopes.shocks,
        )
        by_covariance = directions.T @ slopes.by_covariance @ directions
        return replace(errors, meat=errors.meat + by_covariance)

    # Rows without a time have no neighbors with which they could be correlated.
    in_order = model.has_time and not model.is_prior
    return Information(
        part,
        slopes.triangle @ by_values,
        part.numbers - initial,
        spread,
        reach=slopes.reach @ np.abs(by_values),
        initial={name: rows @ by_values for name, rows in slopes.initial.items()},
        colored=colored if in_order else None,
    )
