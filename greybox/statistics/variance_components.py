"""The variances of parts of the errors whose spectra are known up to a factor.

Every sensor has white noise, and process noise reaches the outputs through the dynamics of the
model. A few variances then determine the whole spectrum, while an autoregression has to find the
dynamics again, on which a record of a few correlation times has little information. The periodogram
is compared with its expectation, so that neither leakage in a short record nor what a fit took from
the errors makes the variances too small.

Sources: Sykulski, Olhede, Guillaumin, Lilly and Early (2019), The debiased Whittle likelihood,
Biometrika 106; Harville (1977), Maximum likelihood approaches to variance component estimation,
JASA 72.
"""

from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray

# Share of the first part in the variance at the beginning; any from 0.1 to 0.9 ends at the same
# variances.
WHITE = 0.7
LONGEST_STEP = 1.5  # of the logarithm of a variance

# Share of the variance of an output below which a variance is zero. A ridge of this size also
# keeps expected covariances invertible at a frequency where the fit explains all power.
LEAST = 1e-4


def whittle_score(
    spectrum: ComplexArray, periodogram: ComplexArray, numbers: Array
) -> tuple[float, ComplexArray, ComplexArray, Array]:
    """Return -2 log likelihood of a periodogram (b, k, k) of `numbers` (k, b), given its mean.

    Also returned are the inverse of the mean, and its product with the periodogram. All outputs
    count as if they had the most numbers: the transform of one that is measured at every fourth
    sample repeats itself four times. Its repetitions are subtracted, and their slopes (b, k) with
    respect to its own mean are returned last.
    """
    spectrum = spectrum + LEAST * np.eye(spectrum.shape[1])
    inverse, logarithm = np.linalg.inv(spectrum), np.linalg.slogdet(spectrum)[1]
    ratio = inverse @ periodogram
    terms = logarithm + np.linalg.trace(ratio).real
    most = numbers.max(0)
    repeated = (most - numbers).T
    mean, power = np.einsum("abii->abi", [spectrum, periodogram]).real
    score = most @ terms - np.sum(repeated * (np.log(mean) + power / mean))
    return float(score), inverse, ratio, repeated * (1 - power / mean) / mean


def variance_components(
    expected: ComplexArray, periodogram: ComplexArray, numbers: Array, sensors: int
) -> tuple[Array, Array, float]:
    """Return the variances of c parts of the errors that make a periodogram most likely.

    Returns
    -------
    variance : (c,) array
        In units of the expected periodograms.
    covariance : (c, c) array
        Covariance of their logarithms.
    score : float
        -2 log likelihood.

    Parameters
    ----------
    expected : (c, b, k, k) array
        Expected periodograms of k outputs in b bands for parts of variance one, positive
        semidefinite.
    periodogram : (b, k, k) array
        With about one unit of power for each output.
    numbers : (k, b) array
        Independent numbers of each output in every band.
    sensors : int
        Number of the first parts, each of which is the noise of one output.
    """
    k = periodogram.shape[1]
    most = numbers.max(0)
    variance = np.full(len(expected), WHITE)
    variance[sensors:] = (1 - WHITE) / max(len(expected) - sensors, 1)

    def spectrum(variance: Array) -> ComplexArray:
        return np.tensordot(variance, expected, 1)

    def slopes(variance: Array, inverse: Any, ratio: Any, repeated: Any) -> tuple[Array, Array]:
        # The expected curvature is positive, that of the likelihood need not be: Fisher scoring.
        parts = inverse @ expected
        # Traces of products as products of rows: einsum spends more time on finding its order.
        rows = (most[:, None, None] * parts).reshape(len(parts), -1)
        gradient = (rows @ (np.eye(k) - ratio).mT.ravel()).real * variance
        # Repetitions make the information too large, which only shortens the steps.
        gradient -= np.einsum("cbii,bi->c", expected, repeated).real * variance
        information = (rows @ parts.mT.reshape(len(parts), -1).T).real
        return gradient, information * variance * variance[:, None]

    score, *products = whittle_score(spectrum(variance), periodogram, numbers)
    gradient, information = slopes(variance, *products)
    damping = 1e-2  # at the beginning, of Levenberg and Marquardt
    for _ in range(50):  # five to twenty are needed
        # Scaled by its diagonal, damping does not depend on the units of the parts. The rest is for
        # a part that is not seen. A larger one would slow variances that tend to zero.
        curvature = information + np.diag(damping * information.diagonal() + LEAST**2)
        step = np.clip(-np.linalg.solve(curvature, gradient), -LONGEST_STEP, LONGEST_STEP)
        # Steps of the logarithm keep variances positive.
        trial = np.maximum(variance * np.exp(step), LEAST**2)
        new, *products = whittle_score(spectrum(trial), periodogram, numbers)
        better = score - new
        if better > 0:
            score, variance = new, trial
            gradient, information = slopes(variance, *products)
            damping = max(damping / 5, 1e-6)
        else:
            damping *= 5
        # In -2 log likelihood: a ten-thousandth of the errors of the variances. At the minimum,
        # rounding makes a step better or worse; with so much damping there is no better point.
        if abs(better) < 1e-8 or damping > 1e6:
            break

    # Along smaller eigenvalues of the information, the likelihood does not change.
    covariance = 2 * np.linalg.pinv(information, 1e-8, hermitian=True)
    return variance, covariance, score
