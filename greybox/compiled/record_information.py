"""The information of a record on all values of a problem, for the covariance of the estimate."""

import math
from dataclasses import dataclass

import numpy as np

from greybox.compiled.colored_errors import colored_errors, independent_numbers
from greybox.compiled.part import TIME_BINS, ColoredErrors, Information, Trajectory
from greybox.compiled.record_sensitivity import Sensitivity, sensitivity
from greybox.compiled.segmented_part import SegmentedPart
from greybox.files.arrays import Array
from greybox.statistics.residual_spectrum import score_covariance


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

    def covariance(self, of_values: Array) -> Array:
        """Return the covariance of the columns for that of all values (k, k)."""
        places = np.ix_(self.places, self.places)
        return of_values[places] * self.scale * self.scale[:, None]


def record_information(
    part: SegmentedPart, trajectory: Trajectory, columns: Columns
) -> Information:
    """Return the information of a record on all values, the initial states fitted along.

    For errors with the autocorrelation of the residuals, or white ones where the criterion takes
    them so.
    """
    model, data = part.model, part.data
    weight = part.residual_weight(trajectory)
    noise = np.asarray(np.linalg.inv(weight.T @ weight), dtype=float)
    slopes = sensitivity(part, trajectory, weight)
    weighted, score = slopes.weighted, slopes.white
    if part.covariance.known is not None and not model.is_prior:
        # The residuals show whether the given noise is right.
        variance = np.diag(trajectory.products) / np.maximum(part.covariance.counts, 1)
        pairs = zip(variance, weighted, strict=True)
        score = sum((v * J @ J.T for v, J in pairs), np.zeros_like(score))
    initial = part.unknown_initial_states
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

    def by_point(directions: Array) -> Array:
        return _information_by_time(part, weighted, noise, columns.directions(directions))

    def output_errors(covariance: Array, errors: ColoredErrors | None) -> Array:
        return _output_errors(part, slopes, noise, columns.covariance(covariance), errors)

    in_order = model.has_time and not model.errors_are_white
    return Information(
        part,
        columns.derivatives(slopes.triangle),
        part.numbers - initial,
        spread,
        relative_noise=math.nan,
        reach=np.abs(columns.derivatives(slopes.reach)),
        initial={name: columns.derivatives(rows) for name, rows in slopes.initial.items()},
        colored=colored if in_order else None,
        by_point=by_point,
        output_errors=output_errors,
    )


def _information_by_time(
    part: SegmentedPart, weighted: Array, noise: Array, directions: Array
) -> Array:
    """Return the information of every output in every part of the record on directions (columns, q)."""
    information = np.zeros((directions.shape[1], len(part.outputs), TIME_BINS))
    rows = len(part.model.record)
    for stretch, J in zip(part.data.stretches, part.data.unpadded(weighted), strict=True):
        place = np.arange(rows)[stretch.rows] * TIME_BINS // rows
        begins = np.flatnonzero(np.diff(place, prepend=-1))
        # One by one: all directions at once would fill the memory.
        for total, direction in zip(information, directions.T, strict=True):
            along = np.tensordot(J, direction, (1, 0))
            total[:, place[begins]] += np.add.reduceat(along * (noise @ along), begins, axis=-1)
    return information.reshape(len(information), -1)


def _output_errors(
    part: SegmentedPart,
    slopes: Sensitivity,
    noise: Array,
    covariance: Array,
    errors: ColoredErrors | None,
) -> Array:
    """Return the standard errors (k, rows) of the outputs at this covariance of the columns.

    `errors` are those of the record where their correlation in time counts.
    """
    data = part.data
    variance = _variances(slopes.weighted, noise, covariance)
    m = slopes.by_initial.shape[1]
    if m:
        meat = np.eye(m)
        if errors is not None:
            # Of directions of unit variance, the mean over the stretches that have them: known
            # states have none.
            pieces = data.unpadded(slopes.by_initial)
            count = sum(piece.any(axis=(0, 2)).astype(int) for piece in pieces)
            scale = 1 / np.sqrt(np.maximum(count, 1))
            meat = score_covariance(pieces, errors.spectrum) * scale * scale[:, None]
        variance += _variances(slopes.by_initial, noise, meat)

    result = np.full((len(part.outputs), len(part.model.record)), np.nan)
    values = data.unpadded(np.sqrt(np.maximum(variance, 0)))
    for stretch, error in zip(data.stretches, values, strict=True):
        result[:, stretch.rows] = np.where(np.isfinite(stretch.outputs), error, np.nan)
    return result


def _variances(weighted: Array, noise: Array, covariance: Array) -> Array:
    """Return the variances (k, samples) of the outputs by a covariance (p, p), for WᵀJ (k, p, samples)."""
    variances = np.empty((len(noise), weighted.shape[2]))
    for variance, row in zip(variances, noise, strict=True):
        J = np.tensordot(row, weighted, 1)
        variance[:] = np.einsum("pt,pt->t", covariance @ J, J)
    return variances
