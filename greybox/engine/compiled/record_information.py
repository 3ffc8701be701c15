"""The information of a record, with its initial states fitted too."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.colored_errors import colored_errors
from greybox.engine.compiled.information import ColoredErrors, Information
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_sensitivity import Sensitivity, sensitivity
from greybox.statistics.column_space import triangle_of


@frozen
class RecordInformation(Information):
    """The information of a record.

    Errors have the autocorrelation of the residuals, unless the criterion assumes white ones.

    Attributes
    ----------
    trajectory : Trajectory
        The motion at the values.
    by_values : (columns, k) array
        Derivatives of the part's variables by all values.
    slopes : Sensitivity
        Derivatives of the residuals by the part's variables.
    weight : (k, k) array
        Weight of the residuals of the outputs.
    meat : (m, k) array
        A root of the meat for white errors of the size of the residuals.
    unseen : (rows, columns) array
        Information that is not in the residuals themselves.
    is_colored : bool
        Whether samples have neighbors with which their errors could be correlated.
    """

    trajectory: Trajectory
    by_values: Array
    slopes: Sensitivity
    weight: Array
    meat: Array
    unseen: Array
    is_colored: bool

    def spread(self, correction: float) -> tuple[float, Array]:
        """Return the bread and a root of the meat, see `Information`."""
        return 1.0, self.meat * (1.0 if self.part.model.is_prior else correction)

    def colored(self, root: Array) -> ColoredErrors | None:
        """Return the effect of the correlation of the errors in time."""
        if not self.is_colored:
            return None
        part, slopes = self.part, self.slopes
        data = part.data
        directions = self.by_values[:, : len(root)] @ root
        errors = colored_errors(
            data.unpadded(slopes.weighted),
            directions,
            data.unpadded(part.residuals(self.trajectory)),
            self.weight,
            part.unknown_initial_states,
            initial=data.unpadded(slopes.by_initial),
            shocks=slopes.shocks,
        )
        rows = self.unseen @ directions
        return replace(errors, meat=errors.meat + rows.T @ rows)


def record_information(part: Any, trajectory: Trajectory, by_values: Array) -> RecordInformation:
    """Return the information of a record on all values (k,).

    `by_values` (columns, k) are the derivatives of the part's variables by all values, of which
    the free ones come first.
    """
    model = part.model
    weight = part.residual_weight(trajectory)
    slopes = sensitivity(part, trajectory, weight)
    score, unseen = slopes.triangle, slopes.by_covariance
    known = part.covariance.known
    if known is not None and not model.is_prior:
        score, unseen = _of_given_noise(part, trajectory, slopes, known)

    # Fitted initial states make residuals smaller than errors, and the covariance too small.
    initial = part.unknown_initial_states
    independent = max(part.numbers, initial + 0.5)
    meat = math.sqrt(independent / (independent - initial)) * score @ by_values

    # Rows without a time have no neighbors, nor has a single sample of an output.
    in_order = model.has_time and not model.is_prior and part.covariance.counts.max() > 1
    return RecordInformation(
        trajectory,
        by_values,
        slopes,
        weight,
        meat,
        unseen,
        in_order,
        part=part,
        jacobian=slopes.triangle @ by_values,
        numbers=part.numbers - initial,
        reach=slopes.reach @ np.abs(by_values),
        initial={name: rows @ by_values for name, rows in slopes.initial.items()},
    )


def _of_given_noise(
    part: Any, trajectory: Trajectory, slopes: Sensitivity, known: Array
) -> tuple[Array, Array]:
    """Return a root of the score's variance, and the information beside the residuals.

    The residuals show whether the `known` covariance (k, k) is right, unless there are so few that
    the parameters may fit them exactly.
    """
    counts = np.maximum(part.covariance.counts, 1)
    shown = trajectory.products / np.sqrt(np.multiply.outer(counts, counts))
    if not part.covariance.correlated:
        shown = np.diag(np.diag(shown))
    given = np.sqrt(np.maximum(1 - (part.covariance.counts / 8) ** 2, 0.0))
    beyond = np.multiply.outer(given, given) * (known - shown)
    sizes, directions = np.linalg.eigh(beyond)
    excess = directions * np.sqrt(np.maximum(sizes, 0.0))
    sizes, directions = np.linalg.eigh(shown + beyond)
    root = directions * np.sqrt(np.maximum(sizes, 0.0))

    def scores(root: Array) -> list[Array]:
        """Return roots of the scores of errors with the covariance `root` `root`ᵀ."""
        return [triangle_of(J.T) for J in np.tensordot(root.T, slopes.weighted, 1)]

    return np.vstack(scores(root)), np.vstack([slopes.by_covariance, *scores(excess)])
