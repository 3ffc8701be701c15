"""Averages of spectra by their evidence."""

import math
from collections.abc import Iterable, Iterator
from operator import attrgetter
from typing import Any

import numpy as np

from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.frozen_values import frozen

TINY = 1e-300


@frozen
class AveragedSpectrum:
    """An average of spectra.

    Attributes
    ----------
    density : (k, k, b) array, or (b,) of one output
    taken : float
        What the fit takes from such errors, the trace of their meat.
    uncertainty : float
        Variance of its logarithm.
    score : float
        -2 log of the evidence; of the average of all, the evidence for process noise over others.
    """

    density: AnyArray
    taken: float
    uncertainty: float
    score: float


def averaged(score: Array, density: AnyArray, taken: Array, within: Array) -> AveragedSpectrum:
    """Return the average of m spectra by their scores (m,), -2 log of their likelihoods.

    Their disagreement on what the fit took is part of the uncertainty, besides that `within` each.
    """
    weight = np.exp(-(score - score.min()) / 2)
    evidence = float(score.min() - 2 * math.log(weight.sum()))
    weight /= weight.sum()
    logarithm = np.log(np.maximum(taken, TINY))
    between = (logarithm - weight @ logarithm) ** 2
    return AveragedSpectrum(
        np.tensordot(weight, density, 1),
        float(weight @ taken),
        float(weight @ (between + within)),
        evidence,
    )


def stacked(averages: Iterable[AveragedSpectrum]) -> Iterator[AnyArray]:
    """Return scores (m,), densities, what was taken, and its uncertainties."""
    fields = attrgetter("score", "density", "taken", "uncertainty")
    return map(np.array, zip(*map(fields, averages), strict=True))


def aicc_penalty(unknowns: Any, n: float) -> Any:
    """Return the penalty of AICc, which grows without limit as unknowns approach the numbers."""
    return 2 * unknowns * n / np.maximum(n - unknowns - 1, 1e-3)
