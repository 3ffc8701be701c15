"""The spectrum of residuals that are correlated in time, and what it means for the covariance of an estimate.

No one family of spectra serves short records of every kind: a small slow drift under white noise
needs an autoregression of order 30, whose coefficients 300 samples do not determine, and wind moves
several outputs together. So several families are fitted and averaged by their evidence:
autoregressions of every order, white noise with a slow part (a correlation that decays
exponentially), and white noise with a part of the color of the sensitivities, which is where errors
harm the estimate most (process noise passes through the same dynamics), each for every output
alone; and vector autoregressions, which correlate the outputs. Process noise moves all outputs
together, through dynamics that are known: with white noise of the sensors it is the last of them,
the only one that records of a few correlation times tell enough of. How far they disagree says how
well the variance is known.

Sources: Burnham and Anderson (2002), Model Selection and Multimodel Inference, 2nd ed., chapter 4
(averaging by AICc and the variance between models); Whittle (1953), Arkiv för Matematik 2
(likelihood of a spectrum) and (1963), Biometrika 50 (recursion of the vector autoregression);
Worsley et al. (2002), NeuroImage 15 (residuals have less correlation than the errors, by what the
fit took from them).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array, ComplexArray, IntArray
from greybox.statistics.error_spectrum import ROUNDING, ErrorSpectrum
from greybox.statistics.residual_autocorrelation import levinson
from greybox.statistics.variance_components import (
    LEAST,
    VarianceComponents,
    variance_components,
    whittle_score,
)

HIGHEST_ORDER = 50  # of an autoregression
SAMPLES_PER_ORDER = 4  # at least, so that AICc is defined
NUMBERS_PER_COEFFICIENT = 5  # at least, of a vector autoregression

# Slow parts: correlation times from one sample to a third of the longest stretch, which is as slow
# as a record can tell from a constant, and shares of the variance. Denser grids, by 1.5, change no
# standard error by 2 %.
SLOW_TIMES = 14
SLOWEST = 1 / 3
SHARES = np.array([0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.55, 0.75, 0.9, 1.0])

# Frequencies over which the power of the sensitivities is smoothed, twice: the lines of a
# narrow-band input are in it, which errors do not have.
SMOOTHED = (8, 32)

# Frequencies at which spectra are compared: the lowest ones each, higher ones in bands whose
# relative width is this.
LOWEST = 256
BAND = 0.015

LEAST_WEIGHT = 1e-4  # of a model in an average; what is below does not show

# How often the residuals are corrected for what the fit took from the errors; the third time
# changes standard errors by less than 2 % (records of 100 samples, correlation times of 10).
CORRECTIONS = 2
# Relative change of a variance by a correction from which another one follows: that would change it
# by the square, 1 %.
CORRECTED_AGAIN = 0.1
# Samples above which they are not: what the fit takes is then far below the uncertainty of the
# spectrum, and counting it, as for white errors, will do.
LONGEST_CORRECTED = 50_000

# Samples above which process noise is not looked for with the model's dynamics: so long a record
# shows its spectrum.
LONGEST_MODELED = 10_000

COLUMNS = 65536  # frequencies at once in memory: 25 MB for three outputs and eight parameters
MOST_KEPT = (
    1 << 24
)  # numbers of the transforms that are kept for later use: 256 MB; of more, they are made again

# Share of the products of samples some lag apart that must remain for missing samples to be
# ignored: below it, the covariances at all lags but zero are more than 5 % too small.
NEARLY_ALL = 0.95

# Share of the sum of absolute autocorrelations within the correlation time: that of an exponential
# within its time constant.
WITHIN = 1 - math.exp(-1)

# -2 log likelihood above its least value from which the residuals exclude a spectrum: chi-squared,
# one number, 95 %.
EXCLUDED = 3.84

# Variances of process noise that are tried, in units of the outputs' residuals: beyond, no record
# fails to exclude it.
PROCESS_NOISE = np.geomspace(1e-3, 30.0, 40)

TINY = 1e-300


@dataclass(frozen=True, eq=False)
class ColoredInformation:
    """What correlated errors make of the score of an estimate.

    Attributes
    ----------
    meat : (p, p) array
        Σ J' Σ_e J for sensitivities J over noise covariance.
    taken : float
        tr(B⁻¹ meat): the sum of squares, in units of the given noise, that the parameters take from
        the errors.
    uncertainty : float
        Variance of the logarithm of `taken`, over the spectra that the residuals may have.
    correlation_times : (k,) array
        Of the errors of every output, samples: the lag within which 63 % of their absolute
        autocorrelations lie, which is the time constant of an exponential decay.
    corrected : bool
        Whether what the fit took from the errors is accounted for.
    hidden : float
        How many times larger the variances would be by the worst spectrum that the residuals do not
        exclude.
    spectrum : ErrorSpectrum or None
        Of the errors; None where all residuals are zero.
    """

    meat: Array
    taken: float
    uncertainty: float
    correlation_times: Array
    corrected: bool
    hidden: float
    spectrum: ErrorSpectrum | None


def colored_information(
    weighted: Sequence[Array],
    residuals: Sequence[Array],
    inverse: Array,
    noise: Array,
    initial: Sequence[Array] | None = None,
    shocks: Callable[[], Array] | None = None,
) -> ColoredInformation:
    """Return Σ J' Σ_e J (p, p) for errors with the spectrum of the residuals: the middle of the sandwich.

    Parameters
    ----------
    weighted : sequence of (k, p, n) arrays
        R⁻¹ dy/dθ, one for every stretch, zero where a sample is missing.
    residuals : sequence of (k, n) arrays
        Zero where a sample is missing.
    inverse : (p, p) array
        The covariance of the estimate for white errors of covariance R, other data included.
    noise : (k, k) array
        R.
    initial : sequence of (k, m, n) arrays, optional
        R⁻¹ dy/dx by directions x of the initial states, which the fit moved along, of unit variance
        for white errors of covariance R: what these took from the errors.
    shocks : function, optional
        Returns (k, s, n), dy of the longest stretch after unit jumps of s states, through which
        process noise reaches the outputs. Long records do not ask for it.

    Source of the sandwich: Morelli and Klein (1997), Accuracy of aerodynamic model parameters
    estimated from flight test data, Journal of Guidance, Control, and Dynamics 20(1).
    """
    there = np.any([e.any(axis=1) for e in residuals], axis=0)
    if not there.any():
        nothing = np.zeros(there.size)
        return ColoredInformation(
            np.zeros_like(inverse), 0.0, 0.0, nothing, corrected=True, hidden=1.0, spectrum=None
        )
    if there.all():
        problem = _Sandwich.of(weighted, residuals, inverse, noise, initial, shocks)
    else:
        problem = _Sandwich.of(
            [J[there] for J in weighted],
            [e[there] for e in residuals],
            inverse,
            noise[np.ix_(there, there)],
            None if initial is None else [X[there] for X in initial],
            None if shocks is None else lambda: shocks()[there],
        )
    corrected = False
    mixture = problem.mixture(*problem.periodogram)
    for _ in range(CORRECTIONS if sum(e.shape[1] for e in residuals) <= LONGEST_CORRECTED else 0):
        before = mixture.taken
        lags, banded = problem.taken_power(mixture.density)
        lags += problem.periodogram[0]
        if not np.all(lags[0].diagonal() > 0):
            break  # a fit to such errors would bring more power into an output than its residuals have
        corrected = True
        mixture = problem.mixture(lags, problem.periodogram[1] + banded)
        if abs(mixture.taken - before) < CORRECTED_AGAIN * before:
            break
    meat = problem.grid.score_covariance(problem.transforms(), mixture.density)
    hidden = problem.hidden(meat, mixture.density)
    problem.forget_transforms()
    times = np.zeros(there.size)
    times[there] = problem.grid.correlation_times(mixture.typical)
    taken = float(np.sum(inverse * meat))
    density = np.zeros((there.size, there.size, len(problem.grid.omega)), dtype=complex)
    density[np.ix_(there, there)] = mixture.density
    deviation = np.ones(there.size)
    deviation[there] = problem.deviation
    spectrum = ErrorSpectrum(problem.grid.omega, density, deviation)
    return ColoredInformation(meat, taken, mixture.uncertainty, times, corrected, hidden, spectrum)


def score_covariance(weighted: Sequence[Array], spectrum: ErrorSpectrum | None) -> Array:
    """Return Σ J' Σ_e J (p, p) for errors of a spectrum that comes from residuals of as many samples; None has none.

    `weighted` (k, p, n) of every stretch is as in `colored_information`.
    """
    p = weighted[0].shape[1]
    if spectrum is None:
        return np.zeros((p, p))
    grid = _Grid.of(max(J.shape[2] for J in weighted))
    return grid.score_covariance(
        (grid.transform(J, spectrum.deviation) for J in weighted), spectrum.density
    )


@dataclass(frozen=True, eq=False)
class _Grid:
    """Frequencies of a transform of `size` samples, and the bands (b,) over which spectra are compared.

    Attributes
    ----------
    starts : (b,) array
        First frequency of every band.
    weight : (frequencies,) array
        Of the positive frequencies in the mean over all.
    band_weight, omega : (b,) arrays
        Sum of the weights, and mean frequency, rad/sample.
    longest : int
        Samples of the longest stretch.
    """

    size: int
    longest: int
    starts: IntArray
    weight: Array
    band_weight: Array
    omega: Array

    @classmethod
    def of(cls, longest: int) -> "_Grid":
        size = _fast(2 * longest)
        count = size // 2 + 1
        weight = np.where(np.arange(count) % (size // 2) == 0, 1.0, 2.0) / size
        bands = max(math.ceil(math.log(max(count / LOWEST, 1.0)) / BAND), 1)
        edges = np.geomspace(LOWEST, max(count, LOWEST), bands + 1).astype(int)
        starts = np.concatenate([np.arange(min(LOWEST, count)), edges[edges < count]])
        starts = starts[_changes(starts)]
        band_weight = np.add.reduceat(weight, starts)
        omega = np.add.reduceat(weight * 2 * np.pi * np.arange(count) / size, starts) / band_weight
        return cls(size, longest, starts, weight, band_weight, omega)

    def banded(self, values: NDArray) -> NDArray:
        """Return means over the bands of values (..., frequencies): (..., b)."""
        return np.add.reduceat(values * self.weight, self.starts, axis=-1) / self.band_weight

    def spread_out(self, values: NDArray, part: slice = slice(None)) -> NDArray:
        """Return values (..., b) of the bands at the frequencies of a part, interpolated: (..., f)."""
        omega = 2 * np.pi * np.arange(len(self.weight))[part] / self.size
        above = np.clip(np.searchsorted(self.omega, omega), 1, len(self.omega) - 1)
        low, high = self.omega[above - 1], self.omega[above]
        share = np.clip((omega - low) / (high - low), 0.0, 1.0)
        # Indexing would put the frequencies first in memory, where all that follows runs over them.
        return (
            np.take(values, above - 1, axis=-1) * (1 - share)
            + np.take(values, above, axis=-1) * share
        )

    @cached_property
    def delays(self) -> ComplexArray:
        """Responses (l, b) of delays of 0 to `HIGHEST_ORDER` samples."""
        return np.exp(-1j * np.outer(np.arange(HIGHEST_ORDER + 1), self.omega))

    def mean(self, values: NDArray) -> NDArray:
        """Return the mean over all frequencies of values (..., b) of the bands."""
        return values @ self.band_weight

    def transform(self, weighted: Array, deviation: Array) -> ComplexArray:
        """Return the transforms (k, p, frequencies) of sensitivities (k, p, n) times deviations (k,)."""
        result = np.empty((*weighted.shape[:2], len(self.weight)), dtype=complex)
        for out, J, size in zip(result, weighted, deviation, strict=True):
            out[:] = np.fft.rfft(size * J, self.size)
        return result

    def covariances(
        self, density: Callable[[int, int], ComplexArray], k: int, order: int
    ) -> tuple[Array, ComplexArray]:
        """Return autocovariances (order + 1, k, k) and means over the bands (k, k, b) of a periodogram of k outputs.

        `density` gives it at all frequencies for two outputs, in both orders the conjugate.
        """
        lags = np.zeros((order + 1, k, k))
        banded = np.zeros((k, k, len(self.starts)), dtype=complex)
        for i, j in _pairs_of(k):
            values = density(i, j)
            r = np.fft.irfft(values, self.size)
            lags[:, i, j] = r[: order + 1]
            lags[1:, j, i] = r[: -order - 1 : -1]
            lags[0, j, i] = r[0]
            banded[i, j] = self.banded(values)
            banded[j, i] = banded[i, j].conj()
        return lags, banded

    def score_covariance(self, transforms: Iterable[ComplexArray], density: ComplexArray) -> Array:
        """Return Σ J' Σ_e J (p, p) by the transforms (k, p, frequencies) of all stretches."""
        total: Array | float = 0.0
        for transform in transforms:
            for start in range(0, len(self.weight), COLUMNS):
                part = slice(start, start + COLUMNS)
                spread = self.spread_out(density, part) * self.weight[part]
                each = transform[..., part]
                total = total + _real_products(np.ascontiguousarray(each), _filtered(spread, each))
        assert isinstance(total, np.ndarray)
        return (total + total.T) / 2

    def correlation_times(self, spectra: Array) -> Array:
        """Return the correlation times (k,) of spectra (k, b), samples."""
        found = []
        for spectrum in spectra:
            total = np.cumsum(
                np.abs(np.fft.irfft(self.spread_out(spectrum), self.size)[: self.longest])
            )
            found.append(float(np.sum(total < WITHIN * total[-1])))
        return np.array(found)


@dataclass(frozen=True, eq=False)
class _Mixture:
    """An average of spectra.

    Attributes
    ----------
    density : (k, k, b) array
    typical : (k, b) array
        The geometric mean.
    taken : float
        tr(B⁻¹ M).
    uncertainty : float
        Variance of its logarithm.
    """

    density: ComplexArray
    typical: Array
    taken: float
    uncertainty: float


@dataclass(frozen=True, eq=False)
class _Family:
    """Spectra of one form, (m, b) and of mean one, and the means (m,) of their logarithms."""

    shapes: Array
    logarithm: Array
    inverse: Array

    @classmethod
    def of(cls, shapes: Array, grid: _Grid) -> "_Family":
        """Prepare the mean over the frequencies of a periodogram over every shape."""
        return cls(shapes, grid.mean(np.log(shapes)), grid.band_weight / shapes)

    def scores(self, banded: Array, n: float) -> tuple[Array, Array]:
        """Return the variances (m,) for n samples of a periodogram (b,), and -2 log likelihood with its penalty.

        Every member is equally likely before: the family counts with its mean likelihood.
        """
        scale = self.inverse @ np.maximum(banded, ROUNDING)
        return scale, n * (np.log(scale) + self.logarithm) + 2 * math.log(len(scale)) + _aicc(1, n)


@dataclass(frozen=True, eq=False)
class _Sandwich:
    """Sensitivities and residuals, and their spectra, in units of every output's deviation.

    Attributes
    ----------
    periodogram : (lags, k, k) and (k, k, b) arrays
        Autocovariances of the residuals, and the bands of their periodogram.
    root : (p, p) array
        Its product with its transpose is the covariance for white errors.
    power : (k, k, b) array
        Of the sensitivities, so that the mean of its product with a spectrum is tr(B⁻¹ M).
    deviation : (k,) array
        Of the residuals.
    counts, seen : (k,) arrays
        Samples that are there, and the share of the products of samples some lag apart that missing
        ones leave.
    families : sequence of sequences
        For every output, the forms of spectra beside autoregressions.
    kept : list of (k, p, frequencies) arrays
        Transforms of the weighted sensitivities; empty where they would fill the memory, or are
        needed no more.
    """

    weighted: Sequence[Array]
    residuals: Sequence[Array]
    inverse: Array
    noise: Array
    grid: _Grid
    periodogram: tuple[Array, ComplexArray]
    root: Array
    power: ComplexArray
    deviation: Array
    counts: Array
    seen: Array
    families: Sequence[Sequence[_Family]]
    kept: list[ComplexArray]
    initial: Sequence[Array] | None = None
    shocks: Callable[[], Array] | None = None

    @classmethod
    def of(
        cls,
        weighted: Sequence[Array],
        residuals: Sequence[Array],
        inverse: Array,
        noise: Array,
        initial: Sequence[Array] | None = None,
        shocks: Callable[[], Array] | None = None,
    ) -> "_Sandwich":
        k = len(weighted[0])
        grid = _Grid.of(max(e.shape[1] for e in residuals))
        counts = np.maximum(sum(np.count_nonzero(e, axis=1) for e in residuals), 1)
        size = np.sqrt(sum((e**2).sum(axis=1) for e in residuals) / counts)
        each = [np.fft.rfft(e / (size * np.sqrt(counts))[:, None], grid.size) for e in residuals]
        nothing = np.zeros(len(grid.weight), dtype=complex)
        periodogram = grid.covariances(
            lambda i, j: sum((z[i] * z[j].conj() for z in each), nothing), k, _highest_order(counts)
        )
        ridge = ROUNDING * np.eye(k)  # for outputs that are combinations of others
        periodogram[0][0] += ridge
        periodogram[1][:] += ridge[:, :, None]

        values, vectors = np.linalg.eigh((inverse + inverse.T) / 2)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        power = np.zeros((k, k, len(grid.starts)), dtype=complex)
        kept: list[ComplexArray] = []
        keeps = len(weighted) * weighted[0].shape[1] * k * len(grid.weight) <= MOST_KEPT
        product = np.empty(len(grid.weight), dtype=complex)
        for J in weighted:
            transform = grid.transform(J, size)
            if keeps:
                kept.append(transform)
            for i, j in _pairs_of(k):
                for start in range(0, len(product), COLUMNS):
                    part = slice(start, start + COLUMNS)
                    one, other = (root.T @ transform[row, :, part] for row in (i, j))
                    product[part] = (one.conj() * other).sum(axis=0)
                banded = grid.banded(product)
                power[i, j] += banded
                if i != j:
                    power[j, i] += banded.conj()

        slow = _Family.of(_slow_parts(grid), grid)
        families = [
            [slow, _Family.of(_with_white(_smoothed_shapes(grid, own)), grid)]
            if own.max() > 0
            else [slow]
            for own in (power[i, i].real for i in range(k))
        ]
        return cls(
            weighted,
            residuals,
            inverse,
            noise,
            grid,
            periodogram,
            root,
            power,
            size,
            counts.astype(float),
            _seen(residuals),
            families,
            kept,
            initial,
            shocks,
        )

    def transforms(self) -> Iterator[ComplexArray]:
        """Yield the transforms (k, p, frequencies) of the weighted sensitivities of every stretch."""
        if self.kept:
            yield from self.kept
            return
        for J in self.weighted:
            yield self.grid.transform(J, self.deviation)

    def forget_transforms(self) -> None:
        """Free the memory of the transforms."""
        self.kept.clear()

    def mixture(self, lags: Array, banded: ComplexArray) -> _Mixture:
        """Return the average of the spectra that may have made a periodogram, as in `periodogram`."""
        k = len(self.counts)
        candidates = [
            self._apart([self._one_output(i, lags[:, i, i], banded[i, i].real) for i in range(k)])
        ]
        if k > 1:
            candidates.append(self._together(lags))
        if self.noise_parts is not None:
            candidates = [self._judged_on_residuals(one, banded) for one in candidates]
        candidates = [replace(one, density=self._unmasked(one.density)) for one in candidates]
        if self.noise_parts is not None:
            candidates.append(self._process_noise(self.noise_parts))

        score = np.array([one.score for one in candidates])
        weight = np.exp(-(score - score.min()) / 2)
        weight /= weight.sum()
        logarithm = np.log([max(one.taken, TINY) for one in candidates])
        spread = (logarithm - weight @ logarithm) ** 2 + [one.uncertainty for one in candidates]
        return _Mixture(
            np.tensordot(weight, [one.density for one in candidates], 1),
            np.exp(np.tensordot(weight, [one.typical for one in candidates], 1)),
            float(weight @ [one.taken for one in candidates]),
            float(weight @ spread),
        )

    def _apart(self, alone: Sequence["_Evidence"]) -> "_Evidence":
        """Return the spectra of outputs whose errors are independent, from those of every one."""
        k = len(alone)
        density: NDArray = np.zeros((k, k, len(self.grid.omega)), dtype=complex)
        for i, one in enumerate(alone):
            density[i, i] = one.density
        taken = sum(one.taken for one in alone)
        uncertainty = sum(one.uncertainty * one.taken**2 for one in alone) / max(taken**2, TINY)
        return _Evidence(
            density,
            np.array([one.typical for one in alone]),
            sum(one.score for one in alone),
            taken,
            uncertainty,
        )

    def _judged_on_residuals(self, one: "_Evidence", banded: ComplexArray) -> "_Evidence":
        """Return what the residuals say of a spectrum, with its penalty, instead of a periodogram of the errors."""
        errors = whittle_score(
            one.density.transpose(2, 0, 1), banded.transpose(2, 0, 1), self._numbers
        )
        penalty = one.score - errors + self._numbers.sum() * len(self.counts)
        return replace(one, score=penalty + self._score(one.density))

    @cached_property
    def _variances(self) -> VarianceComponents:
        parts = self.noise_parts
        assert parts is not None
        return variance_components(
            parts.of_residuals, self._of_residuals, self._numbers, sensors=len(self.counts)
        )

    @cached_property
    def _numbers(self) -> Array:
        """Independent numbers (b,) of every output in a band."""
        return self.counts.max() * self.grid.band_weight

    @cached_property
    def _of_residuals(self) -> ComplexArray:
        return self.periodogram[1].transpose(2, 0, 1)

    def _process_noise(self, parts: "_NoiseParts") -> "_Evidence":
        """Return white noise of every sensor with process noise, of the variances that the residuals show."""
        k, n = len(self.counts), self.counts.max()
        found = self._variances
        score = found.score + _aicc(len(found.variance), n * k)
        density = np.tensordot(found.variance, parts.density, 1)
        each = np.array([self._taken(part) for part in parts.density]) * found.variance
        taken = float(each.sum())
        share = each / max(taken, TINY)
        typical = np.log(np.maximum(np.einsum("iib->ib", density).real, TINY))
        return _Evidence(density, typical, score, taken, float(share @ found.covariance @ share))

    @cached_property
    def noise_parts(self) -> "_NoiseParts | None":
        """White noise of every sensor and process noise in every state, each of variance one; None without shocks."""
        if self.shocks is None or self.counts.max() > LONGEST_MODELED:
            return None
        k, grid = len(self.counts), self.grid
        transforms = np.fft.rfft(self.shocks() / self.deviation[:, None, None], grid.size)
        spectra = [np.einsum("if,jf->ijf", H, H.conj()) for H in transforms.transpose(1, 0, 2)]
        power = [
            float(np.einsum("iif->f", spectrum).real @ grid.weight) / k for spectrum in spectra
        ]
        spectra = [spectrum / p for spectrum, p in zip(spectra, power, strict=True) if p > TINY]
        if not spectra:
            return None
        sensors = np.eye(k)[:, :, None] * np.eye(k)[:, None, :]
        spectra = [
            np.repeat(one[:, :, None], len(grid.weight), 2).astype(complex) for one in sensors
        ] + spectra

        # Products of samples some lag apart that are there.
        there = [np.fft.rfft((e != 0).astype(float), grid.size) for e in self.residuals]
        pairs = np.fft.irfft(sum(mask[:, None] * mask.conj() for mask in there), grid.size)
        pairs /= np.sqrt(self.counts * self.counts[:, None])[:, :, None]
        density, of_residuals = [], []
        for spectrum in spectra:
            expected = np.fft.rfft(np.fft.irfft(spectrum, grid.size) * pairs, grid.size)
            density.append(grid.banded(spectrum))
            left = grid.banded(expected) - self.taken_power(density[-1])[1]
            of_residuals.append(_positive(left.transpose(2, 0, 1)))
        return _NoiseParts(np.array(density), np.array(of_residuals))

    def _one_output(self, i: int, r: Array, banded: Array) -> "_Evidence":
        """Average the spectra of one output, of autocovariances r (lags,) and periodogram (b,)."""
        n = self.counts[i]
        grid = self.grid

        # Autoregressions, but for that of first order, which is among the slow parts.
        steps = [(a, variance) for order, (a, variance) in enumerate(levinson(r)) if order != 1]
        scores = [np.array([n * math.log(variance) + _aicc(len(a), n) for a, variance in steps])]
        within = [2 * np.array([len(a) for a, _ in steps]) / n]
        scales = [np.array([variance for _, variance in steps])]
        for family in self.families[i]:
            scale, score = family.scores(banded, n)
            scales.append(scale)
            scores.append(score)
            within.append(np.full(len(scale), 2 / n))

        score = np.concatenate(scores)
        least = float(score.min())
        weight = np.exp(-(score - least) / 2)
        evidence = least - 2 * math.log(weight.sum())
        likely = weight > LEAST_WEIGHT * weight.sum()
        weight = weight[likely] / weight[likely].sum()

        kept = np.split(likely, np.cumsum([len(scale) for scale in scales[:-1]]))
        responses = [
            np.abs(a @ grid.delays[: len(a)]) ** 2
            for (a, _), k in zip(steps, kept[0], strict=True)
            if k
        ]
        shapes = [1 / np.array(responses).reshape(-1, len(grid.omega))]
        shapes += [family.shapes[k] for family, k in zip(self.families[i], kept[1:], strict=True)]
        every = np.concatenate(
            [
                scale[k][:, None] * shape
                for scale, k, shape in zip(scales, kept, shapes, strict=True)
            ]
        )
        taken = grid.mean(every * self.power[i, i].real)
        logarithm = np.log(np.maximum(taken, TINY))
        spread = (logarithm - weight @ logarithm) ** 2 + np.concatenate(within)[likely]
        return _Evidence(
            weight @ every,
            weight @ np.log(every),
            evidence,
            float(weight @ taken),
            float(weight @ spread),
        )

    def _together(self, lags: Array) -> "_Evidence":
        """Return the vector autoregression of all outputs of the order that AICc chooses, from lags (l, k, k)."""
        k = lags.shape[1]
        n = self.counts.max()
        longest = int(min(len(lags) - 1, n // (NUMBERS_PER_COEFFICIENT * k)))
        steps = list(_whittle(lags[: longest + 1]))
        innovations = np.array([innovation for _, innovation in steps])
        penalties = [_aicc(a.size + k * (k + 1) / 2, n * k) for a, _ in steps]
        scores = n * np.linalg.slogdet(innovations)[1] + penalties
        best = int(np.argmin(scores))
        a, innovation = steps[best]
        delays = self.grid.delays[1 : best + 1]
        response = np.linalg.inv(np.eye(k) + np.tensordot(delays, a.reshape(k, best, k), (0, 1)))
        density = (response @ innovation @ response.conj().transpose(0, 2, 1)).transpose(1, 2, 0)
        typical = np.log(np.maximum(np.einsum("iib->ib", density).real, TINY))
        return _Evidence(
            density, typical, float(scores[best]), self._taken(density), 2 * (best + 1) / n
        )

    def hidden(self, meat: Array, density: ComplexArray) -> float:
        """Return how many times larger the variances would be by the worst spectra that the residuals do not exclude.

        The geometric mean over all directions, so that a bias, which a slow error is not told from
        in records of any length, does not stand for all. Every output may have another spectrum;
        their limits combine as those of independent numbers (Zou and Donner, 2008, Statistics in
        Medicine 27).
        """
        p = len(self.root)
        if p == 0:
            return 1.0
        outputs = [self._not_excluded(i) for i in range(len(self.counts))]
        others = np.eye(p) - sum(told for told, _ in outputs)
        likely = others + sum(meats[0] for _, meats in outputs)
        size = _size(likely)
        added = [float((_size(likely - meats[0] + meats) - size).max()) for _, meats in outputs]
        found = float(_size(others + self.root.T @ meat @ self.root))
        worst = [float(size) + math.hypot(*added)]
        if self.noise_parts is not None:
            worst += [
                float(
                    _size(
                        others
                        + self.root.T
                        @ self.grid.score_covariance(self.transforms(), one)
                        @ self.root
                    )
                )
                for one in self._process_noise_not_excluded(self.noise_parts, density)
            ]
        return math.exp(max(*worst, found) - found)

    def _process_noise_not_excluded(
        self, parts: "_NoiseParts", likely: ComplexArray
    ) -> Iterator[ComplexArray]:
        """Yield the spectrum with most process noise that the residuals do not exclude beside a likely one, if any."""
        k = len(self.counts)
        found = self._variances
        limit = min(found.score, self._score(likely)) + EXCLUDED
        shares = np.maximum(found.variance[k:], LEAST)
        for total in PROCESS_NOISE[::-1]:
            variance = np.concatenate([found.variance[:k], total * shares / shares.sum()])
            spectrum = np.tensordot(variance, parts.of_residuals, 1)
            if whittle_score(spectrum, self._of_residuals, self._numbers) < limit:
                yield np.tensordot(variance, parts.density, 1)
                return

    def _score(self, density: ComplexArray) -> float:
        """Return -2 log likelihood of the residuals for errors of a spectrum (k, k, b)."""
        left = density - self.taken_power(density)[1]
        return whittle_score(_positive(left.transpose(2, 0, 1)), self._of_residuals, self._numbers)

    def _not_excluded(self, i: int) -> tuple[Array, Array]:
        """Return what one output tells (p, p), and the scores' covariances by spectra that are not excluded (m, p, p).

        The likeliest stands first, by the restricted likelihood (Patterson and Thompson, 1971,
        Biometrika 58), since a fit takes most from slow errors. Cosine transforms make these nearly
        independent, with no samples beyond the ends.
        """
        from scipy.fft import dct  # noqa: PLC0415  (importing greybox stays light)

        shapes = np.concatenate(
            [np.ones((1, len(self.grid.omega)))] + [family.shapes for family in self.families[i]]
        )
        p = len(self.root)
        given = self.noise[i, i] / self.deviation[i] ** 2
        moments = np.zeros((len(self.grid.starts), p + 1, p + 1))
        counts = np.zeros(len(self.grid.starts))
        for J, e in zip(self.weighted, self.residuals, strict=True):
            n = e.shape[1]
            rows = np.vstack(
                [e[i] / self.deviation[i], self.root.T @ J[i] * given * self.deviation[i]]
            )
            rows = np.asarray(dct(rows, axis=1, norm="ortho"))
            band = (
                np.searchsorted(
                    self.grid.starts, np.arange(n) * self.grid.size / (2 * n), side="right"
                )
                - 1
            )
            first = _changes(band)
            there = band[first]
            counts += np.bincount(band, minlength=len(counts))
            for a in range(p + 1):
                moments[there, a] += np.add.reduceat(rows[a] * rows, first, axis=1).T
        white = moments.sum(axis=0) / given
        told = white[1:, 1:]
        over = np.tensordot(1 / shapes, moments, 1)
        information = np.eye(p) - told + over[:, 1:, 1:]
        gradient = over[:, 0, 1:] - white[0, 1:]
        step = np.linalg.solve(information, gradient[:, :, None])[:, :, 0]
        left = max(self.counts[i] - np.trace(told), 1.0)
        scale = np.maximum(over[:, 0, 0] - np.sum(gradient * step, axis=1), TINY) / left
        score = left * np.log(scale) + np.log(shapes) @ counts + p * _size(information)
        order = np.argsort(score)
        order = order[: np.searchsorted(score[order], score.min() + EXCLUDED)]
        meats = np.tensordot(shapes[order] * scale[order, None] / given**2, moments[:, 1:, 1:], 1)
        return told, meats

    def _taken(self, density: ComplexArray) -> float:
        return float(self.grid.mean(np.einsum("ijb,ijb->b", self.power, density).real))

    def _unmasked(self, density: ComplexArray) -> ComplexArray:
        """Return the spectrum of errors of which a share `seen` (k,) was present, at random.

        Missing samples multiply covariances at all lags but zero by the share, as if part of the
        errors were white.
        """
        seen = self.seen
        if seen.min() >= NEARLY_ALL:
            return density
        variance = self.grid.mean(np.einsum("iib->ib", density).real)
        density = density - np.diag((1 - seen) * variance)[:, :, None]
        density = density / np.sqrt(seen * seen[:, None])[:, :, None]
        return _positive(density.transpose(2, 0, 1)).transpose(1, 2, 0)

    def taken_power(self, density: ComplexArray) -> tuple[Array, ComplexArray]:
        """Return the periodogram, as in `periodogram`, of what the fit took from errors of this spectrum.

        Residuals r = (1 - P) e, with P = J B⁻¹ (R⁻¹ J)ᵀ, have the covariance Σ - P Σ - Σ Pᵀ + P Σ
        Pᵀ. What other data bring to the estimate is taken to have errors of the same color.
        """
        transforms = list(self.transforms())
        spread = self.grid.spread_out(density)
        filtered = [
            self._in_time(_filtered(spread, F), J)
            for J, F in zip(self.weighted, transforms, strict=True)
        ]
        size = self.deviation[:, None, None]
        bread, meat = np.zeros_like(self.inverse), np.zeros_like(self.inverse)
        for J, G in zip(self.weighted, filtered, strict=True):
            bread += product_over_time(J, self.noise)
            meat += _products(J * size, G)
        own = self.inverse @ bread @ self.inverse
        factor = np.sum(self.inverse * meat) / max(float(np.sum(self.inverse * bread)), 1e-300)
        middle = self.inverse @ meat @ self.inverse + factor * (self.inverse - own)

        pairs = []
        sizes = self.noise / size[:, 0]
        unit = np.sqrt(self.counts)
        for s, e in enumerate(self.residuals):
            J, transform, moved, covariance = (
                self.weighted[s],
                transforms[s],
                self.inverse @ filtered[s],
                middle,
            )
            if self.initial is not None:
                # Every stretch has initial states of its own, whose errors are correlated with
                # those of the parameters.
                X = self.initial[s]
                of_initial = self.grid.transform(X, self.deviation)
                G = self._in_time(_filtered(spread, of_initial), X)
                both = self.inverse @ _products(J * size, G)
                own = _products(X * size, G)
                covariance = np.block([[middle, both], [both.T, own]])
                J, moved = np.concatenate([J, X], axis=1), np.concatenate([moved, G], axis=1)
                transform = np.concatenate([transform, of_initial], axis=1)
            half = moved - covariance.T @ np.tensordot(sizes, J, 1) / 2
            half *= (e != 0)[:, None] / unit[:, None, None]
            one = np.tensordot(sizes / self.deviation / unit[:, None], transform, 1)
            pairs.append((one, np.fft.rfft(half, self.grid.size).conj()))

        def product(i: int, j: int) -> ComplexArray:
            total = np.zeros(len(self.grid.weight), dtype=complex)
            for one, other in pairs:
                total += (one[i] * other[j]).sum(axis=0) + (one[j] * other[i]).sum(axis=0).conj()
            return total

        return self.grid.covariances(product, len(unit), _highest_order(self.counts))

    def _in_time(self, transform: ComplexArray, like: Array) -> Array:
        """Return the samples (k, p, n) of a transform, as many as another array has."""
        return np.fft.irfft(transform, self.grid.size)[..., : like.shape[2]]


@dataclass(frozen=True, eq=False)
class _NoiseParts:
    """Parts of the errors, of variance one: their spectra, and the periodograms of residuals to be expected.

    Attributes
    ----------
    density : (c, k, k, b) array
    of_residuals : (c, b, k, k) array
        Of what the fit leaves of errors as long as the record, and with its missing samples.
    """

    density: ComplexArray
    of_residuals: ComplexArray


@dataclass(frozen=True, eq=False)
class _Evidence:
    """An average of spectra and its mean logarithm, -2 log of its evidence, tr(B⁻¹ M), and the variance of its log."""

    density: NDArray
    typical: Array
    score: float
    taken: float
    uncertainty: float


def _filtered(density: NDArray, transform: ComplexArray) -> ComplexArray:
    """Return the product of a density (k, k, f) and transforms (k, p, f), frequency by frequency."""
    result = density[:, 0, None] * transform[0]
    for j in range(1, len(transform)):
        result += density[:, j, None] * transform[j]
    return result


def _products(one: Array, other: Array) -> Array:
    """Return the sums (p, q) over k and n of the products of arrays (k, p, n) and (k, q, n)."""
    return (one @ other.transpose(0, 2, 1)).sum(axis=0)


def _real_products(one: ComplexArray, other: ComplexArray) -> Array:
    """Return the real part of the same with `one` conjugated: that of pairs of real numbers."""
    return _products(one.view(float), other.view(float))


def _positive(matrices: ComplexArray) -> ComplexArray:
    """Return Hermitian matrices (b, k, k) without their negative parts, which approximations leave."""
    values, vectors = np.linalg.eigh(matrices)
    return (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.conj().transpose(0, 2, 1)


def _size(matrices: Array) -> Array:
    """Return the logarithm of the geometric mean of the eigenvalues of matrices (..., p, p)."""
    return np.linalg.slogdet(matrices)[1] / matrices.shape[-1]


def _aicc(unknowns: float, n: float) -> float:
    """Return the penalty of AICc, which grows without limit as the unknowns become as many as the numbers."""
    return 2 * unknowns * n / max(n - unknowns - 1, 1e-3)


def product_over_time(weighted: Array, noise: Array) -> Array:
    """Return Σ Jᵀ R J (p, p) over the samples of weighted sensitivities J (k, p, n), for R (k, k)."""
    p = weighted.shape[1]
    each = (J @ np.tensordot(row, weighted, 1).T for J, row in zip(weighted, noise, strict=True))
    return sum(each, np.zeros((p, p)))


def _pairs_of(k: int) -> list[tuple[int, int]]:
    """Return the pairs of k outputs, each with itself too, the later one first."""
    return [(i, j) for i in range(k) for j in range(i + 1)]


def _highest_order(counts: Array) -> int:
    """Return the highest order of autoregressions of outputs with so many samples (k,)."""
    return int(min(HIGHEST_ORDER, counts.max() // SAMPLES_PER_ORDER))


def _slow_parts(grid: _Grid) -> Array:
    """Return the spectra (m, b), of mean one, of white noise with a part whose correlation decays exponentially."""
    times = np.geomspace(1.0, max(SLOWEST * grid.longest, 2.0), SLOW_TIMES)
    phi = np.exp(-1 / times)[:, None]
    return _with_white((1 - phi**2) / (1 - 2 * phi * np.cos(grid.omega) + phi**2))


def _smoothed_shapes(grid: _Grid, power: Array) -> Array:
    """Return the spectra (m, b), of mean one, of the color of the sensitivities and of its root.

    The sensitivities pass through the dynamics twice, process noise once.
    """
    shapes = []
    for width in SMOOTHED:
        smooth = _smoothed(_smoothed(power, width), width)
        shapes += [smooth, np.sqrt(smooth)]
    return np.array([shape / max(float(grid.mean(shape)), 1e-300) for shape in shapes])


def _with_white(shapes: Array) -> Array:
    """Return spectra of every share of the `shapes` (m, b) in white noise, (m shares, b)."""
    mixed = (1 - SHARES)[:, None] + SHARES[:, None] * shapes[:, None]
    return np.maximum(mixed.reshape(-1, shapes.shape[1]), ROUNDING)


def _smoothed(values: Array, width: int) -> Array:
    """Return the moving average of values (b,), mirrored at their ends."""
    half = min(width // 2, len(values) - 1)
    padded = np.pad(values, half, mode="reflect")
    total = np.cumsum(np.concatenate([[0.0], padded]))
    return np.maximum((total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1), 0.0)


def _whittle(r: Array) -> Iterator[tuple[Array, Array]]:
    """Yield the vector autoregressions of every order: coefficients (k, order * k) and innovation covariance (k, k).

    The coefficients A_1, A_2 ... stand side by side. From r (lags + 1, k, k), with r(l) = E e(t +
    l) e(t)ᵀ, by Whittle's recursion, so that all are stable.
    """
    k = r.shape[1]
    last_first = r[:0:-1].reshape(-1, k)
    # The backward coefficients stand in reverse order, as the recursion uses them.
    forward = backward = np.zeros((k, 0))
    ahead = behind = r[0]
    yield forward, ahead
    for order in range(1, len(r)):
        delta = r[order] + forward @ last_first[len(last_first) - (order - 1) * k :]
        gain, back = -np.linalg.solve(
            np.array([behind.T, ahead]), np.array([delta.T, delta])
        ).transpose(0, 2, 1)
        forward, backward = (
            np.hstack([forward + gain @ backward, gain]),
            np.hstack([back, backward + back @ forward]),
        )
        ahead = ahead + gain @ delta.T
        behind = behind + back @ delta
        ahead = (ahead + ahead.T) / 2
        behind = (behind + behind.T) / 2
        if np.linalg.eigvalsh(np.array([ahead, behind])).min() < ROUNDING * np.trace(r[0]) / k:
            return  # rounding errors: the series is predictable
        yield forward, ahead


def _changes(values: IntArray) -> IntArray:
    """Return where each of the sorted values stands first; np.unique imports masked arrays, 8 ms."""
    return np.flatnonzero(np.diff(values, prepend=-1))


def _fast(count: int) -> int:
    """Return an even length of at least `count` whose Fourier transform is fast."""
    return min(m << max((-(-count // m) - 1).bit_length(), 1) for m in (1, 3, 5, 9, 15))


def _seen(stretches: Sequence[Array]) -> Array:
    """Return the share (k,) of the products of samples some lag apart that missing ones leave, at the best such lag.

    Near 1 where blocks are missing, or every n-th sample is present; less where samples are missing
    at random.
    """
    present = [(e != 0).astype(float) for e in stretches]
    if all(np.all(e) for e in present):
        return np.ones(len(present[0]))
    pairs = np.array([_pairs([e[i] for e in present]) for i in range(len(present[0]))])
    whole = _pairs([np.ones(e.shape[1]) for e in stretches])
    taper = np.maximum(whole / whole[0], 1e-12)
    return np.clip((pairs[:, 1:] / taper[1:]).max(axis=1) / np.maximum(pairs[:, 0], 1), 1e-3, 1.0)


def _pairs(stretches: Sequence[Array]) -> Array:
    """Return the summed products of samples up to `HIGHEST_ORDER` apart, (lags,)."""
    total = np.zeros(HIGHEST_ORDER + 1)
    for e in stretches:
        for lag in range(min(HIGHEST_ORDER + 1, e.size)):
            total[lag] += e[lag:] @ e[: e.size - lag]
    return total
