"""Averages of spectra by their evidence."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import AnyArray, Array
from greybox.data.files.frozen_values import frozen

# Replaces zero in a logarithm or a divisor.
TINY = 1e-300


@frozen
class AveragedSpectrum:
    """An average of spectra.

    Attributes
    ----------
    density : (k, k, b) array, or (b,) of one output
        The spectrum of k outputs in b bands.
    taken : float
        Power that the fit removes from errors with this spectrum: the trace of the meat of the
        sandwich covariance.
    uncertainty : float
        Variance of the logarithm of `taken`.
    score : float
        -2 log of the evidence for these spectra. In the average with process noise, twice the
        logarithm of the ratio of evidences: process noise against the other spectra.
    """

    density: AnyArray
    taken: float
    uncertainty: float
    score: float


def averaged(score: Array, density: AnyArray, taken: Array, within: Array) -> AveragedSpectrum:
    """Return the average of m spectra, weighted by their evidence.

    Parameters
    ----------
    score : (m,) array
        -2 log of the likelihood of each spectrum.
    density : (m, ...) array
    taken : (m,) array
        See `AveragedSpectrum`.
    within : (m,) array
        Variance of the logarithm of `taken` by each spectrum. The disagreement of the spectra is
        added.
    """
    weight = np.exp(-(score - score.min()) / 2)
    evidence = float(score.min() - 2 * math.log(weight.sum()))
    weight /= weight.sum()
    logarithm = np.log(np.maximum(taken, TINY))
    between = (logarithm - weight @ logarithm) ** 2
    return AveragedSpectrum(
        density=np.tensordot(weight, density, 1),
        taken=float(weight @ taken),
        uncertainty=float(weight @ (between + within)),
        score=evidence,
    )


def stacked(
    averages: Sequence[AveragedSpectrum],
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return the scores, densities, `taken` and uncertainties of m averages: the arguments above.

    Each is an array with the axis m first.
    """
    return (
        np.array([average.score for average in averages]),
        np.array([average.density for average in averages]),
        np.array([average.taken for average in averages]),
        np.array([average.uncertainty for average in averages]),
    )


def aicc_penalty(unknowns: Any, n: float) -> Any:
    """Return the penalty of AICc for unknowns that are estimated from n numbers.

    It grows without limit as the unknowns approach the numbers, and stays large beyond.
    """
    return 2 * unknowns * n / np.maximum(n - unknowns - 1, 1e-3)
