"""Frequency responses of sweeps and noise, band by band: the local polynomial method.

At the lines of the discrete Fourier transform of a whole stretch, input and output obey Y = P U + T
+ V. The transient T, from before the stretch or lasting beyond it, is as smooth as P (Pintelon and
Schoukens, System Identification, 2nd ed., chapter 7). In a band of lines, P is a polynomial in the
frequency and T one in its inverse, as integrators and drift leave it. They are estimated by least
squares, or by instrumental variables with an instrument r from outside the loop. There is no
window, so nothing is smeared. The remaining error is that of the polynomials; it falls with the
fourth power of the width of the band, the error of windows with the square.

Resolution
    A quadratic over a band has three coefficients. It is evaluated at the three Gauss nodes of the
    band, where the errors of a fitted polynomial are uncorrelated, and where a cubic would change
    nothing (Davis and Rabinowitz, Methods of Numerical Integration, section 2.7). Bands do not
    overlap. So the errors of all points are nearly independent, and three points contain all
    information of the band.
Error of the polynomials
    In a band twice as wide, the quadratic is compared with a quartic. If they differ by more than
    noise explains, the band is halved, down to the narrowest band that still leaves residuals for
    the noise. There, a pole is added: the error of the polynomials for a response with that pole is
    known, and subtracted (the local rational method: McKelvey and Guérin (2012), 16th IFAC
    Symposium on System Identification).
Noise
    Its spectrum S is estimated from the residuals of the band, with the pole if one is needed, and
    of the bands beside it if these are few. The variance E|P̂ - P|² of an
    estimate P̂ = aY is S aaᴴ. With an instrument, it is the one that follows from the noise at the
    neighboring points.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from greybox.data.files.arrays import (
    AnyArray,
    Array,
    ComplexArray,
    IntArray,
    all_finite,
    sum_of_squares,
)
from greybox.data.spectral.estimated_points import HZ, STRONG, EstimatedPoints
from greybox.data.spectral.uniform_stretches import UniformStretch

# Order of the response in a band. The error of order R in a band of half-width b at the distance ρ
# from a pole is proportional to (b/ρ)**(R + 1), but 2R + 2 unknowns need more lines and so a wider
# band: orders from 2 to 4 are equally good.
ORDER = 2
NODES = ORDER + 1  # points in a band: as many as a polynomial has coefficients

# Order of the transient. Its share of the output is small, about (memory / duration)**0.5, so one
# order less leaves an error as small as that of the response.
TRANSIENT_ORDER = 1

DOUBLED = 2  # width of the band of that check over the width of the band
GROWTH = DOUBLED ** (ORDER + 2)  # growth of the error at the nodes in that wider band

# Squared difference of quadratic and quartic over its variance, which has an exponential
# distribution for noise alone. A band is halved above the value that noise exceeds in 1 % of cases,
# and a pole is estimated above the value that it exceeds in 0.01 %.
VISIBLE = 4.6
CERTAIN = 9.2

LEAST_RESIDUALS = 3  # complex residuals in the narrowest band of a point: six degrees of freedom

# Residuals from which the noise is estimated: 24 degrees of freedom. A band with fewer residuals
# uses those of the bands beside it, up to an octave away.
NEIGHBORHOOD = 12

# Noise is assumed to fall or rise with a power of the frequency. The exponent is estimated from an
# octave on either side, by least squares on logarithms, with a prior of this standard deviation.
STEEP = 1.0

# Points by which the gain from instrument to input is expected.
BESIDE = 6
# Standard deviations of noise in that gain that count as noise.
LIKELY = 2

# Largest half-width of a band over its frequency: 0.15 decades on either side.
WIDEST = 0.35


class Lines(NamedTuple):
    """Spectral lines of all stretches, sorted by frequency.

    Attributes
    ----------
    omega : (n,) array, rad/s
    values : (signals, n) complex array
        Input, output, instrument, conditioned inputs, and their instruments; scaled so that the
        variance of noise is its spectral density.
    stretch : (n,) array
        Index of the stretch of each line.
    spacing : float, rad/s
        Distance of the lines of the longest stretch.
    direct : bool
        The instrument is the input itself.
    """

    omega: Array
    values: ComplexArray
    stretch: IntArray
    spacing: float
    direct: bool


class BandLines(NamedTuple):
    """The lines in a band, with m conditioned inputs.

    Attributes
    ----------
    rows : (n,) array of int
        Their indices.
    x : (n,) array
        Their positions in the band, -1 to 1.
    output : (n,) complex array
    inputs, instruments : (1 + m, n) complex arrays
    transients : (n, t) array
        An orthonormal basis of the transients.
    """

    rows: IntArray
    x: Array
    output: ComplexArray
    inputs: ComplexArray
    instruments: ComplexArray
    transients: Array


class Solution(NamedTuple):
    """Coefficients of n lines by instruments: an orthonormal basis Z (n, m), and (ZᴴX)⁻¹Zᴴ."""

    basis: ComplexArray
    coefficients: ComplexArray


class Fitted(NamedTuple):
    """Polynomials fitted in one band.

    Attributes
    ----------
    center, half : float, rad/s
    rows : (n,) array of int
        Indices of the lines in the band.
    x : (n,) array
        Their positions in the band, -1 to 1.
    regressors, instruments, basis : (n, m) complex arrays
        Regressors of the response, then of conditioned inputs; their instruments; an orthonormal
        basis of these. Transients are projected out of all.
    solution : (m, n) complex array
        Maps the output to the coefficients.
    transients : (n, t) array
        An orthonormal basis of the transients.
    order : int
        Order of the response.
    alone : (m, n) complex array
        The solution if the input were the instrument.
    """

    center: float
    half: float
    rows: IntArray
    x: Array
    regressors: ComplexArray
    instruments: ComplexArray
    basis: ComplexArray
    solution: ComplexArray
    transients: Array
    order: int
    alone: ComplexArray

    def weights(self, omega: Array) -> ComplexArray:
        """Return the matrix (k, n) from the output at the lines to the response at `omega` (k,)."""
        powers = np.vander((omega - self.center) / self.half, self.order + 1, increasing=True)
        return powers @ self.solution[: self.order + 1]

    @property
    def number(self) -> int:
        """The number of residual degrees of freedom (complex)."""
        return self.rows.size - self.basis.shape[1] - self.transients.shape[1]

    def residuals(self, y: ComplexArray) -> ComplexArray:
        """Return the residuals of the output (n,)."""
        return _without(self.transients, y) - self.regressors @ (self.solution @ y)

    def trace(self) -> float:
        """Return E|residuals|² for noise of variance one: tr QQᴴ, with residuals = Q noise."""
        gram = (self.solution @ self.solution.conj().T) @ (
            self.regressors.conj().T @ self.regressors
        )
        return self.number - len(self.solution) + float(np.trace(gram).real)


class Band(NamedTuple):
    """A band, the frequencies at which its polynomials are evaluated, and their error there.

    Attributes
    ----------
    fitted : Fitted
    omega : (k,) array, rad/s
    correction : (k,) complex array
        Subtracted from the response.
    squared_error : (k,) array
        Squared error that remains after the correction.
    squares, number : float
        Sum of squared residuals, for noise of variance one their number; with a pole, if the
        polynomials alone are visibly wrong.
    """

    fitted: Fitted
    omega: Array
    correction: ComplexArray
    squared_error: Array
    squares: float
    number: float

    def corrected(self, error: ComplexArray) -> "Band":
        """Subtract an error (k,) that is known for a response near the true one."""
        # A hundredth of the squared error remains after the correction by a pole.
        remaining = self.squared_error + 0.01 * np.abs(error) ** 2
        return self._replace(correction=self.correction + error, squared_error=remaining)


def lines_of(stretches: Sequence[UniformStretch]) -> Lines:
    """Transform stretches; their rows are those of `Lines`."""
    omega, values, stretch = [], [], []
    for index, piece in enumerate(stretches):
        count = piece.values.shape[1]
        # The line at zero is left out: it has the mean, and the transient is infinite there.
        spectrum = np.fft.rfft(piece.values, axis=1)[:, 1:] * math.sqrt(piece.step / count)
        omega.append(HZ / (count * piece.step) * np.arange(1, spectrum.shape[1] + 1))
        values.append(spectrum)
        stretch.append(np.full(spectrum.shape[1], index))

    together = np.concatenate(omega)
    order = np.argsort(together, kind="stable")
    together, signals = together[order], np.hstack(values)[:, order]
    return Lines(
        together,
        signals,
        np.concatenate(stretch)[order],
        float(together[0]),  # the first line of a stretch is at its spacing
        np.array_equal(signals[0], signals[2]),
    )


def tiled_points(
    lines: Lines,
    low: float,
    high: float,
    points: int,
    near: Callable[[Array], ComplexArray] | None = None,
) -> EstimatedPoints:
    """Return the estimates at frequencies between `low` and `high`.

    If the response is smooth, there are about `points`, log spaced; more where it is not, and fewer
    where the lines do not resolve as many. The bands do not depend on the response `near` the true
    one: they resolve what both may differ in.
    """
    narrowest = _narrowest(lines, math.sqrt(low * high))
    # Equal ratios, as the gain and phase of a plant vary with log frequency.
    ratio = (high / low) ** (1 / max(round(points / NODES), 1))
    edges = [low]
    while edges[-1] < high * (1 - 1e-9):
        edges.append(max(edges[-1] * ratio, edges[-1] + narrowest))
    # A last band that is too narrow joins the one before.
    if len(edges) > 2 and high - edges[-2] < narrowest:
        edges.pop()
    edges[-1] = max(high, low + narrowest)
    bands = [
        band for first, last in pairwise(edges) for band in _halved(lines, first, last, narrowest)
    ]
    if near is not None:
        bands = _beside(lines, bands, near)
    return _estimates(lines, bands)


def points_at(lines: Lines, omega: Array) -> EstimatedPoints:
    """Return the estimates at `omega` (n,), each from a band that reaches halfway to its neighbors.

    Frequencies with too few lines have none. If they are closer than the resolution, the bands
    overlap and the errors of neighbors are correlated.
    """
    narrowest = _narrowest(lines, float(np.exp(np.mean(np.log(omega)))))
    gaps = np.abs(omega[:, None] - omega)
    np.fill_diagonal(gaps, np.inf)
    halves = np.maximum(np.minimum(gaps.min(axis=1) / 2, WIDEST * omega), narrowest / 2)
    bands = [
        _centered(lines, center, half, narrowest)
        for center, half in zip(omega, halves, strict=True)
    ]
    return _estimates(lines, [band for band in bands if band])


def _narrowest(lines: Lines, omega: float) -> float:
    """Return the narrowest width of a band with enough residuals.

    The number of lines in a band of given width depends on its position: the worst case counts.
    """
    half_lines = 2
    while True:
        half = half_lines / 2 * lines.spacing
        center = max(omega, half + lines.spacing)
        if center + half > lines.omega[-1]:
            raise ValueError(
                "the records are too short for a polynomial in frequency: record longer."
            )
        fits = [
            fit_band(lines, center + shift * lines.spacing, half, residuals=LEAST_RESIDUALS)
            for shift in (0.0, 0.25, 0.5)
        ]
        # Transients may use half of the lines; several short stretches need many of them.
        if all(fit is not None and fit.transients.shape[1] <= 0.5 * fit.rows.size for fit in fits):
            return 2 * half
        half_lines += 1


def fit_band(
    lines: Lines, center: float, half: float, *, extra: int = 0, residuals: int = 1
) -> Fitted | None:
    """Fit polynomials in a band, of orders raised by `extra`; None if they are not determined.

    A stretch with no more lines in the band than its transient has coefficients has no information,
    and is left out.
    """
    order, transient_order = ORDER + extra, TRANSIENT_ORDER + extra
    band = _in_band(lines, center, half, transient_order)
    transients = band.transients
    powers = np.vander(band.x, order + 1, increasing=True)
    if band.rows.size - (order + 1) * len(band.inputs) - transients.shape[1] < residuals:
        return None

    # Least squares is the special case in which the regressors are their own instruments.
    regressors = np.hstack([signal[:, None] * powers for signal in band.inputs])
    regressors = _without(transients, regressors)
    instruments = np.hstack([signal[:, None] * powers for signal in band.instruments])
    instruments = _without(transients, instruments)

    solved = _solved(regressors, instruments)
    alone = solved if lines.direct else _solved(instruments, instruments)
    if solved is None or alone is None:
        return None
    return Fitted(
        center=center,
        half=half,
        rows=band.rows,
        x=band.x,
        regressors=regressors,
        instruments=instruments,
        basis=solved.basis,
        solution=solved.coefficients,
        transients=transients,
        order=order,
        alone=alone.coefficients,
    )


def _without(basis: AnyArray, columns: ComplexArray) -> ComplexArray:
    """Return the part of columns (n, ...) that is orthogonal to an orthonormal basis (n, t)."""
    return columns - basis @ (basis.conj().T @ columns)


def _in_band(lines: Lines, center: float, half: float, order: int) -> BandLines:
    """Return the lines in a band, with a basis of their transients of this order."""
    ends = [(center - half) * (1 - 1e-9), (center + half) * (1 + 1e-9)]
    rows = np.arange(*np.searchsorted(lines.omega, ends))
    numbers, counts = np.unique(lines.stretch[rows], return_counts=True)
    stretches = numbers[counts > order + 1]
    rows = rows[np.isin(lines.stretch[rows], stretches)]
    omega = lines.omega[rows]
    # Integrators and drift leave transients that are proportional to 1/ω.
    powers = np.vander(center / omega - 1, order + 1, increasing=True)
    basis = [
        np.linalg.qr(powers * (lines.stretch[rows] == number)[:, None])[0] for number in stretches
    ]
    transients = np.hstack([np.zeros((rows.size, 0)), *basis])
    u, y, r, *conditioned = lines.values[:, rows]
    m = len(conditioned) // 2
    inputs, instruments = np.array([u, *conditioned[:m]]), np.array([r, *conditioned[m:]])
    return BandLines(rows, (omega - center) / half, y, inputs, instruments, transients)


def _solved(regressors: ComplexArray, instruments: ComplexArray) -> Solution | None:
    """Return the solution for regressors X by their instruments; None if ill conditioned."""
    x_length, z_length = (np.linalg.norm(columns, axis=0) for columns in (regressors, instruments))
    if not (np.all(x_length > 0) and np.all(z_length > 0)):
        return None
    # With an orthonormal basis of the instruments, the condition number is that of the problem, not
    # that of its units.
    basis, _ = np.linalg.qr(instruments / z_length)
    square = basis.conj().T @ (regressors / x_length)
    # Rounding errors of the solution reach this condition number times 2e-16.
    if not np.linalg.cond(square) < 1e6:
        return None
    return Solution(basis, np.linalg.solve(square, basis.conj().T) / x_length[:, None])


def _halved(lines: Lines, low: float, high: float, narrowest: float) -> list[Band]:
    """Return the band, or its halves if its polynomials are visibly wrong."""
    center, half = (low + high) / 2, (high - low) / 2
    fitted = fit_band(lines, center, half, residuals=LEAST_RESIDUALS)
    if fitted is None:
        return []
    band = _judged(lines, fitted, gauss_nodes(lines, fitted))
    if band.squared_error.any() and high - low >= 2 * narrowest:
        halves = [_halved(lines, low, center, narrowest), _halved(lines, center, high, narrowest)]
        # A half without enough lines would leave a hole in the band.
        if all(halves):
            return halves[0] + halves[1]
    return [band]


def _centered(lines: Lines, center: float, half: float, narrowest: float) -> Band | None:
    """Return the widest band around `center`, up to `half`, whose polynomials are accurate."""
    while True:
        fitted = fit_band(lines, center, half, residuals=LEAST_RESIDUALS)
        if fitted is None:
            return None
        band = _judged(lines, fitted, np.array([center]))
        if not band.squared_error.any() or half <= narrowest / 2:
            return band
        half = max(half / 2, narrowest / 2)


def gauss_nodes(lines: Lines, fitted: Fitted) -> Array:
    """Return the zeros of the next orthogonal polynomial, weighted by the excitation of the lines.

    They are the eigenvalues of multiplication by x, projected on the polynomials of the fitted
    order (Golub and Welsch (1969), Mathematics of Computation 23).
    """
    u, _, r, *_ = lines.values[:, fitted.rows]
    # With an instrument, a line informs in proportion to both amplitudes.
    amplitude = np.sqrt(np.abs(u) * np.abs(r))
    basis, _ = np.linalg.qr(amplitude[:, None] * np.vander(fitted.x, NODES, increasing=True))
    return fitted.center + fitted.half * np.linalg.eigvalsh(basis.T @ (fitted.x[:, None] * basis))


def _beside(
    lines: Lines, bands: Sequence[Band], near: Callable[[Array], ComplexArray]
) -> list[Band]:
    """Return the bands with polynomials for what a response `near` the true one leaves.

    The estimate is linear in the output. So the polynomials have the error A Q U - Q for a response
    Q, which is known, and for P that of the small difference P - Q, as have their residuals.
    """
    u, y, *others = lines.values
    output = near(lines.omega) * u
    rest = lines._replace(values=np.array([u, y - output, *others]))
    judged = (_judged(rest, band.fitted, band.omega) for band in bands)
    return [
        b.corrected(b.fitted.weights(b.omega) @ output[b.fitted.rows] - near(b.omega))
        for b in judged
    ]


def _judged(lines: Lines, fitted: Fitted, omega: Array) -> Band:
    """Return the band evaluated at `omega`, with an error if its polynomials are visibly wrong."""
    squares = sum_of_squares(fitted.residuals(lines.values[1, fitted.rows]))
    squares *= fitted.number / fitted.trace()
    plain = Band(fitted, omega, 0j * omega, 0 * omega, squares, fitted.number)
    quadratic, quartic = (
        fit_band(lines, fitted.center, DOUBLED * fitted.half, extra=extra) for extra in (0, 2)
    )
    if quadratic is None or quartic is None or not np.array_equal(quadratic.rows, quartic.rows):
        return plain

    y = lines.values[1, quartic.rows]
    weights = quartic.weights(omega) - quadratic.weights(omega)
    noise = sum_of_squares(quartic.residuals(y)) / quartic.trace()
    # Noise alone makes the two polynomials differ by this variance.
    squared = np.abs(weights @ y) ** 2
    variance = noise * np.sum(np.abs(weights) ** 2, axis=1)
    response = fitted.weights(omega) @ lines.values[1, fitted.rows]
    # A relative error of 1e-4, a thousandth of a dB, never matters.
    if not np.any(
        (squared > VISIBLE * variance) & (np.sqrt(squared) > GROWTH * 1e-4 * np.abs(response))
    ):
        return plain

    # A pole has two coefficients more: it is estimated only if the error is beyond doubt.
    certain = np.any(squared > CERTAIN * variance)
    with_pole = _with_pole(lines, plain) if certain else None
    wrong = plain._replace(squared_error=np.maximum(squared - variance, 0) / GROWTH**2)
    return with_pole or wrong


def _with_pole(lines: Lines, band: Band) -> Band | None:
    """Return a band with the error of its polynomials given a pole, and the residuals of the pole.

    Y = (B U + T) / (1 + a x) + V is linear in the coefficients of B, T and a as Y + a x Y = B U +
    T. The noise in Y would bias a: the instrumental variable for x Y is the next power of x times
    the input, which has no such noise.
    """
    fitted, omega = band.fitted, band.omega
    center = fitted.center
    half = DOUBLED * fitted.half
    wide = _in_band(lines, center, half, TRANSIENT_ORDER)
    rows, x, y, transients = wide.rows, wide.x, wide.output, wide.transients

    # Divided by the frequency, the numerator allows for an integrator beside the pole.
    powers = np.vander(x, ORDER + 2, increasing=True) * (center / lines.omega[rows])[:, None]
    lower = powers[:, :-1]
    regressors = np.hstack([*(u[:, None] * lower for u in wide.inputs), -(x * y)[:, None]])
    instrument, *conditioned = wide.instruments
    instruments = np.hstack(
        [instrument[:, None] * powers, *(signal[:, None] * lower for signal in conditioned)]
    )
    number = rows.size - regressors.shape[1] - transients.shape[1]
    if number < LEAST_RESIDUALS:
        return None
    solved = _solved(_without(transients, regressors), _without(transients, instruments))
    if solved is None:
        return None

    # The correction compares both models on the lines of the narrow band, a part of the wide one.
    places = np.searchsorted(rows, fitted.rows)

    coefficients = solved.coefficients @ y
    pole = coefficients[-1]
    transient = transients @ (transients.T @ (y - regressors @ coefficients))
    # Without the column of the pole, the regressors give the numerator times the input.
    coefficients[-1] = 0.0
    output = (regressors @ coefficients + transient) / (1 + pole * x)
    at = (omega - center) / half
    numerator = np.vander(at, ORDER + 1, increasing=True) @ coefficients[: ORDER + 1]
    response = numerator * (center / omega) / (1 + pole * at)
    correction = fitted.weights(omega) @ output[places] - response
    squares = sum_of_squares(y - output)
    if not all_finite(correction, squares):
        return None
    return band._replace(squares=squares, number=number).corrected(correction)


def _estimates(lines: Lines, bands: Sequence[Band]) -> EstimatedPoints:
    """Return the estimates of bands at their frequencies."""
    # Arrays (k,) for the k points of every band.
    responses, spreads, spreads_alone = [], [], []
    # Numbers that all points of a band have in common.
    noises, numbers, coherences, input_noises = [], [], [], []
    for band in bands:
        fitted = band.fitted
        weights = fitted.weights(band.omega)
        responses.append(weights @ lines.values[1, fitted.rows] - band.correction)
        spreads.append(np.sum(np.abs(weights) ** 2, axis=1))
        weights_alone = fitted._replace(solution=fitted.alone).weights(band.omega)
        spreads_alone.append(np.sum(np.abs(weights_alone) ** 2, axis=1))

        density, number = _noise(band, bands)
        noises.append(density)
        numbers.append(number)
        coherence_of_band, input_noise_of_band = _coherence(lines, fitted, density)
        coherences.append(coherence_of_band)
        input_noises.append(input_noise_of_band)

    response = np.concatenate([np.zeros(0, dtype=complex), *responses])
    omega, error, spread, alone = (
        np.concatenate([np.zeros(0), *arrays])
        for arrays in (
            [band.omega for band in bands],
            [band.squared_error for band in bands],
            spreads,
            spreads_alone,
        )
    )
    points = np.array([band.omega.size for band in bands], dtype=int)
    noise, dof, own, coherence, input_noise = (
        np.repeat(np.array(values, dtype=float), points)
        for values in (noises, numbers, [band.number for band in bands], coherences, input_noises)
    )

    change = _change(omega, spread, alone, input_noise)
    weak = STRONG * input_noise * spread * np.exp(change) > 1
    variance = np.where(weak, np.nan, noise * spread * np.exp((1 + 2 * own / dof) * change) + error)
    return EstimatedPoints(omega, response, variance, dof, coherence, weak)


def _change(omega: Array, spread: Array, alone: Array, input_noise: Array) -> Array:
    """Return the logarithm (n,) of the spreads that neighbors expect over those of the estimates.

    Noise that feedback adds to the input makes it strong where the response is wrong in one
    direction: variances by its own strength, or a choice of points by it, would bias a fit. The
    residuals of a band grow as the input shrinks, too.
    """
    gain = np.log(alone / spread)  # from instrument to input, of the power
    change = np.zeros_like(gain)
    if gain.size > BESIDE:
        for k, away in enumerate(np.log(omega / omega[:, None])):
            near = np.argsort(np.abs(away))[1 : 1 + BESIDE]
            change[k] = gain[k] - np.polyfit(away[near], gain[near], 1)[1]
    # Beyond what noise can change, the gain is no straight line.
    limit = LIKELY * np.sqrt(2 * input_noise * spread * np.exp(np.minimum(change, 0)))
    return np.clip(change, -limit, limit)


def _noise(band: Band, bands: Sequence[Band]) -> tuple[float, float]:
    """Return the noise density in a band, by its residuals and those beside, and its dof."""
    table = np.array(
        [(math.log(b.fitted.center / band.fitted.center), b.squares, b.number) for b in bands]
    )
    table = table[np.argsort(np.abs(table[:, 0]), kind="stable")]
    away, squares, number = table[np.abs(table[:, 0]) <= math.log(2)].T

    level = np.log(np.maximum(squares / number, np.finfo(float).tiny))
    x = away - number @ away / number.sum()
    # The logarithm of the mean of n residuals has a variance of 1/n.
    slope = (number * x) @ level / (number @ x**2 + 1 / STEEP**2)

    used = np.cumsum(number) - number < NEIGHBORHOOD
    total = number[used].sum()
    return float(np.exp(-slope * away[used]) @ squares[used] / total), 2 * float(total)


def _coherence(lines: Lines, fitted: Fitted, noise: float) -> tuple[float, float]:
    """Return the partial γ² of instrument and output, and the noise density of the input.

    Transients and conditioned inputs are removed. With an instrument, the coherence is the lower of
    those with input and output, and the noise is the part of the input that it does not explain.
    """
    u, y, *_ = lines.values[:, fitted.rows]
    n = fitted.rows.size
    conditioned = np.linalg.qr(fitted.instruments[:, fitted.order + 1 :])[0]
    nuisance = np.hstack([fitted.transients, conditioned])
    complete = np.hstack([fitted.transients, fitted.basis])

    def unexplained(signal: ComplexArray, basis: AnyArray) -> float:
        residual = _without(basis, signal)
        return sum_of_squares(residual) / (n - basis.shape[1])

    output = max(unexplained(y, nuisance), np.finfo(float).tiny)
    if lines.direct:
        return 1 - noise / output, 0.0
    input = max(unexplained(u, nuisance), np.finfo(float).tiny)
    input_noise = unexplained(u, complete)
    shares = unexplained(y, complete) / output, input_noise / input
    return 1 - max(shares), input_noise
