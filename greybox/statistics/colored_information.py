"""The covariance of the score of an estimate under errors that are correlated in time."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.averaged_spectrum import AveragedSpectrum
from greybox.statistics.error_spectrum import ErrorSpectrum
from greybox.statistics.residual_spectrum import ResidualSpectra

# Difference of -2 log evidence that is very strong: Kass and Raftery (1995), JASA 90.
VERY_STRONG = 10.0


@frozen
class ColoredInformation:
    """The covariance of the score of an estimate under correlated errors.

    Attributes
    ----------
    meat : (p, p) array
        Σ J' Σ_e J for sensitivities J over noise covariance.
    taken : float
        Its trace: the sum of squares, in units of the given noise, that the parameters take from
        the errors.
    taken_of_white : float
        The same of errors with this noise.
    uncertainty : float
        Variance of the logarithm of `taken`, over the spectra that the residuals may have.
    correlation_times : (k,) array
        Correlation times of the errors of every output, samples: the lag within which 63 % of their
        absolute autocorrelations lie, which is the time constant of an exponential decay.
    corrected : bool
        Whether the spectrum is corrected for what the fit took from the errors.
    spectrum : ErrorSpectrum or None
        Spectrum of the errors; None where all residuals are zero.
    process_noise : function
        Returns -2 log of the evidence for other errors, less that for process noise: white, or
        gusts if the evidence for white one is not very strong. It takes time, and is rarely needed.
    slow_errors : function
        Returns the evidence for slow errors of every output, and the lines that show the
        parameters: (2, k), see `ResidualSpectra.slow_errors`.
    """

    meat: Array
    taken: float
    taken_of_white: float
    uncertainty: float
    correlation_times: Array
    corrected: bool
    spectrum: ErrorSpectrum | None
    process_noise: Callable[[], float] = float
    slow_errors: Callable[[], Array] = lambda: np.zeros((2, 0))


def colored_information(
    weighted: Sequence[Array],
    directions: Array,
    residuals: Sequence[Array],
    noise: Array,
    initial: Sequence[Array],
    shocks: Callable[[], Array],
) -> ColoredInformation:
    """Return Σ J' Σ_e J (r, r), the middle of the sandwich, for the spectrum of the residuals.

    Parameters
    ----------
    weighted : sequence of (k, p, n) arrays
        R⁻¹ dy/dθ for the parameters θ, one for every stretch, zero where a sample is missing.
    directions : (p, r) array
        Directions J of the parameters, of unit variance for white errors of covariance R, other
        data included.
    residuals : sequence of (k, n) arrays
        Zero where a sample is missing.
    noise : (k, k) array
        R.
    initial : sequence of (k, m, n) arrays
        R⁻¹ dy/dx by directions x of the fitted initial states, of unit variance for white errors of
        covariance R.
    shocks : function
        Returns (k, s, n), the outputs of the longest stretch after unit jumps of s states: process
        noise reaches the outputs in this way. It is not called for long records.

    Source of the sandwich: Morelli and Klein (1997), Accuracy of aerodynamic model parameters
    estimated from flight test data, Journal of Guidance, Control, and Dynamics 20(1).
    """
    compared = np.any([e.any(axis=1) for e in residuals], axis=0)
    k = compared.size
    if not compared.any():
        nothing = np.zeros((directions.shape[1],) * 2)
        return ColoredInformation(nothing, 0, 0, 0, np.zeros(k), corrected=True, spectrum=None)

    # An output without residuals has no spectrum, and would make matrices singular. A slice makes
    # no copy, which would fill the memory of long records.
    rows = slice(None) if compared.all() else compared
    spectra = ResidualSpectra(
        [J[rows] for J in weighted],
        directions,
        [e[rows] for e in residuals],
        noise[np.ix_(compared, compared)],
        [X[rows] for X in initial],
        lambda: shocks()[rows],
    )
    mixture, corrected = _corrected_mixture(spectra)
    meat = spectra.grid.score_covariance(spectra.transforms(), mixture.density)
    # For a long record this frees a fifth of all memory: from here on only the power is needed.
    vars(spectra).pop("_only_transform", None)
    embedded = np.eye(k)[compared]
    times = spectra.grid.correlation_times(np.einsum("iib->ib", mixture.density).real) @ embedded
    density: Any = (embedded.T @ mixture.density.T @ embedded).T
    deviation = np.maximum(spectra.deviation @ embedded, ~compared)

    return ColoredInformation(
        meat=meat,
        taken=float(np.trace(meat)),
        taken_of_white=spectra.taken_by(spectra.white),
        uncertainty=mixture.uncertainty,
        correlation_times=times,
        corrected=corrected,
        spectrum=ErrorSpectrum(spectra.grid.omega, density, deviation),
        # Gusts leave no residuals that look white. With eight outputs, their test takes two fifths
        # of a fit: white process noise that is certain does not need it.
        process_noise=lambda: (
            mixture.score
            + (spectra.gain_of_gusts() if times.max() > 1 and mixture.score < VERY_STRONG else 0.0)
        ),
        slow_errors=lambda: spectra.slow_errors(corrected=corrected) @ embedded,
    )


def _corrected_mixture(spectra: "ResidualSpectra") -> "tuple[AveragedSpectrum, bool]":
    """Return the average of the spectra, and whether it is corrected for what the fit took."""
    lags, banded = spectra.periodogram
    others, corrected = spectra.others(lags, banded), False

    # A third correction changes standard errors by less than 2 % (records of 100 samples,
    # correlation times of 10).
    for _ in range(2 * spectra.is_short):
        taken, score = others.taken, others.score
        # What they took if these spectra hold: process noise has its own expectation, and an
        # average of both would be the spectrum of neither.
        taken_lags, taken_banded = spectra.taken_power(
            spectra.grid.spread_out(others.density), spectra.highest_order
        )
        if not np.all((lags + taken_lags)[0] > 0):
            # A fit to such errors would bring more power into an output than its residuals have.
            break
        others = spectra.others(lags + taken_lags, banded + taken_banded)
        # They are as likely as the best of them.
        others, corrected = replace(others, score=min(score, others.score)), True
        # Another correction would change the variance by the square of this change, 1 %.
        if abs(others.taken - taken) < 0.1 * taken:
            break

    return spectra.with_process_noise(others), corrected
