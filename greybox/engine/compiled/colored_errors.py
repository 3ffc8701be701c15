"""Residuals that are correlated in time: how much less information they carry than white ones.

J is the Jacobian of the weighted residuals by p directions of the parameters, the initial states
fitted too; e are the residuals. For errors with the spectrum of the residuals, Jᵀe has the
covariance M (the *meat*); for white ones it is JᵀJ. Correlated residuals count as fewer independent
numbers: as many white ones as would lose the same share of their variance to the parameters.
"""

from collections.abc import Callable, Sequence

import numpy as np

from greybox.data.files.arrays import Array, sum_of_squares
from greybox.engine.compiled.information import ColoredErrors
from greybox.statistics.colored_information import colored_information


def colored_errors(
    weighted: Sequence[Array],
    directions: Array,
    residuals: Sequence[Array],
    weight: Array,
    initial_states: int,
    *,
    initial: Sequence[Array],
    shocks: Callable[[], Array],
) -> ColoredErrors:
    """Return the effect of correlated residuals on the accuracy of an estimate.

    Parameters
    ----------
    weighted : sequence of (k, p, n) arrays
        WᵀW dy/dθ, one for every stretch, initial states fitted too.
    directions : (p, r) array
        Directions of θ of unit variance for white errors of covariance (WᵀW)⁻¹, other data
        included.
    residuals : sequence of (k, n) arrays
    weight : (k, k) array
        W.
    initial_states : int
        Fitted along.
    initial : sequence of (k, m, n) arrays
        WᵀW dy/dx by directions x of the initial states, of unit variance for white errors.
    shocks : function
        Returns (k, s, n), dy of the longest stretch after unit jumps of s states.
    """
    # If the noise of outputs is almost dependent, as in predictions from measured accelerations, a
    # small error in the spectrum of each would be a large one in the combination without noise. So
    # their spectra are those of uncorrelated combinations, if no sample lacks some of the outputs.
    mixing = np.eye(len(weight))
    is_whole = all(np.all(np.all(e, axis=0) | ~np.any(e, axis=0)) for e in residuals)
    if is_whole and np.any(weight != np.diag(np.diag(weight))):
        whitening = weight
        mixing = np.linalg.inv(weight)
        weighted = [np.tensordot(mixing.T, J, 1) for J in weighted]
        residuals = [whitening @ e for e in residuals]
        initial = [np.tensordot(mixing.T, X, 1) for X in initial]
        jumps = shocks
        shocks = lambda: np.tensordot(whitening, jumps(), 1)  # noqa: E731
        weight = np.eye(len(weight))

    noise = np.linalg.inv(weight.T @ weight)
    effect = colored_information(weighted, directions, residuals, noise, initial, shocks)
    numbers = sum(map(np.count_nonzero, residuals))

    # The share of these residuals that the parameters absorb, and of white ones of equal variance.
    paid = effect.taken_of_white
    squares = sum(sum_of_squares(weight @ e) for e in residuals) / max(numbers, 1)
    factor = max(effect.taken / max(paid * squares, 1e-300), 1.0)

    independent = independent_numbers(numbers, initial_states, paid, factor)
    larger = independent / (independent - initial_states)
    # If nothing remains, half a degree of freedom keeps the results finite.
    remaining = max(independent - initial_states - paid, 0.5)
    if not effect.corrected:
        larger *= (remaining + paid) / remaining
    samples = sum(e.shape[1] for e in residuals)
    slowest = max(effect.correlation_times.max(), 1e-300)
    dof = 1 / (1 / remaining + effect.uncertainty / 2)
    # With less than one, spectra that are hardly possible would decide the interval.
    # At least two correlation times per degree of freedom: the spectrum of an exponential
    # correlation has one for four at zero frequency, since the coefficient φ of n samples has the
    # variance (1 - φ²)/n, and 1/(1 - φ)² the relative variance of 8 times per n. Estimates depend
    # on higher frequencies too, which are known better. Intervals of 2050 records of five plants,
    # with 16 kinds of errors, contained the truth in 96 to 100 % of records shorter than 16
    # correlation times, and in 92 to 96 % of longer ones. With a limit for the shortest records
    # only, intervals of equal experiments differed by factors of two to six.
    dof = max(min(dof, samples / slowest / 2), 1.0)

    return ColoredErrors(
        meat=larger * effect.meat,
        dof=dof,
        spectrum=effect.spectrum and effect.spectrum.mixed(np.sqrt(larger) * mixing),
        process_noise=effect.process_noise,
        slow_errors=effect.slow_errors,
    )


def independent_numbers(
    measured: int, initial_states: int, parameters: float, factor: float
) -> float:
    """Return the number of independent values that the measured ones are worth.

    `parameters` is not rounded to a whole number: rounding errors would then decide which one.
    `factor` is the share of the residuals that the parameters absorb, over the share that they
    would absorb of white ones.
    """
    # Degrees of freedom that correlation leaves, at least: twice as many as Student's t needs for a
    # finite variance.
    most = measured / (initial_states + parameters + 4)
    return max(measured / min(factor, max(most, 1.0)), initial_states + 0.5)
