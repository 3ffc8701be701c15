"""Spectra of residuals that are correlated in time.

No single family of spectra fits short records of every kind: a small slow drift under white noise
needs an autoregression of order 30, whose coefficients 300 samples do not determine, and wind moves
several outputs together. So several families are fitted and averaged by their evidence:

- for every output by itself, autoregressions of every order, and white noise plus slow noise whose
  correlation decays exponentially;
- for all outputs together, the same with a coherency that is constant in blocks of frequencies, and
  white noise of the sensors with process noise through the dynamics of the model. Records of a few
  correlation times determine this last family only.

The disagreement of the families shows how well the variance is known.

Sources: Burnham and Anderson (2002), Model Selection and Multimodel Inference, 2nd ed., chapter 4
(averaging by AICc and the variance between models); Whittle (1953), Arkiv för Matematik 2
(likelihood of a spectrum); Worsley et al. (2002), NeuroImage 15 (residuals are less correlated than
the errors, because the fit removes a part of the errors).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import AnyArray, Array, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.statistics.averaged_spectrum import (
    TINY,
    AveragedSpectrum,
    aicc_penalty,
    averaged,
    stacked,
)
from greybox.statistics.error_spectrum import ROUNDING
from greybox.statistics.frequency_grid import FrequencyGrid, filtered, products
from greybox.statistics.residual_autocorrelation import HIGHEST_ORDER, levinson
from greybox.statistics.variance_components import LEAST, variance_components, whittle_score

# Number of samples above which the spectrum is not corrected for the part of the errors that the
# fit removed. In longer records this part is far below the uncertainty of the spectrum, and the
# number of parameters is a sufficient correction, as for white errors.
LONGEST_CORRECTED = 50_000

# Numbers of blocks of frequencies in which the coherency of the outputs is constant. One block
# suits sensors that share their errors; many blocks suit wind that reaches several outputs through
# the dynamics.
BLOCKS = (1, 24)

# Number of samples of an output above which process noise through the dynamics of the model is left
# out: so long a record shows its spectrum without the model.
LONGEST_WITH_PROCESS_NOISE = 10_000

# Difference of scores (-2 log likelihood) above which a spectrum is left out of an average: it is
# less likely than the best one by exp(-9), about 1 to 10 000.
LARGEST_DIFFERENCE = 18.0

# Shares of the slow part in the variance. A grid denser by 1.5 changes no standard error by 2 %.
SHARES = np.array([0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.55, 0.75, 0.9, 1.0])

# Correlations of gusts from one sample to the next: time constants of 4, 16, 64 and 256 samples.
# Between these and white noise the likelihood has no other maximum.
GUSTS = (0.78, 0.94, 0.984, 0.996)


@frozen
class StretchSensitivities:
    """Sensitivities of a stretch to the parameters, followed by those to the initial states.

    Attributes
    ----------
    values : (k, q, n) array
    transform : (k, q, f) complex array
        Their Fourier transforms.
    noise_transform, noise_values : (k, q, f) and (k, q, n) arrays
        The noise covariance times `transform`, over the square root of the counts, and the noise
        covariance times `values`.
    present : (k, 1, n) array
        One over the square root of the counts where a sample is measured, else zero.
    """

    values: Array
    transform: ComplexArray
    noise_transform: ComplexArray
    noise_values: Array
    present: Array


@frozen
class ResidualSpectra:
    """Spectra that may explain the residuals, in units of every output's standard deviation.

    The attributes are the parameters of `colored_information`, for the outputs that have residuals.
    """

    weighted: Sequence[Array]
    directions: Array
    residuals: Sequence[Array]
    noise: Array
    initial: Sequence[Array]
    shocks: Callable[[], Array]

    @cached_property
    def grid(self) -> FrequencyGrid:
        """Frequencies of transforms of the longest stretch."""
        return FrequencyGrid.of(max(e.shape[1] for e in self.residuals))

    @cached_property
    def counts(self) -> Array:
        """Measured samples (k,) of every output."""
        return np.maximum(sum(np.count_nonzero(e, axis=1) for e in self.residuals), 1)

    @cached_property
    def deviation(self) -> Array:
        """Standard deviations (k,) of the residuals."""
        return np.sqrt(sum((e**2).sum(axis=1) for e in self.residuals) / self.counts)

    @cached_property
    def white(self) -> Array:
        """The density (k, k, b) of the given noise."""
        size = self.deviation[:, None]
        return np.repeat((self.noise / size / size.T)[..., None], len(self.grid.omega), axis=2)

    @cached_property
    def periodogram(self) -> tuple[Array, ComplexArray]:
        """Autocovariances (lags, k), and band means (k, k, b) of the power, of the residuals."""
        # `covariances` adds the adjoint, so that every transform contributes half of the power.
        scale = (self.deviation * np.sqrt(2 * self.counts))[:, None]

        def factors() -> Iterator[tuple[ComplexArray, ComplexArray]]:
            for e in self.residuals:
                transform = np.fft.rfft(e / scale, self.grid.size)[:, None]
                yield transform, transform

        lags, banded = self.grid.covariances(factors(), self.highest_order)
        # Outputs that are combinations of others have a singular covariance.
        lags[0] += ROUNDING

        return lags, banded + ROUNDING * np.eye(len(scale))[..., None]

    @property
    def highest_order(self) -> int:
        """The highest order of an autoregression: AICc needs four samples for each."""
        # Gaps may leave stretches with fewer lags.
        return int(min(HIGHEST_ORDER, self.counts.max() // 4, self.grid.longest - 1))

    @cached_property
    def power(self) -> ComplexArray:
        """Power (k, k, b) of the sensitivities. `taken_by` is its mean product with a spectrum."""
        factors = ((transform, transform) for transform in self.transforms())
        _, banded = self.grid.covariances(factors)
        return banded.conj() / 2

    @cached_property
    def slow(self) -> Array:
        """Spectra (m, b), of mean one, of white noise with an exponentially correlated part.

        The spectra combine many correlation times with every share in `SHARES`.
        """
        # In a record of this length, slower errors look like a constant.
        times = np.geomspace(1.0, max(self.grid.longest / 3, 2.0), 14)
        omega, share = self.grid.omega, SHARES[:, None]
        phi = np.exp(-1 / times)[:, None, None]
        slow = (1 - phi**2) / (1 - 2 * phi * np.cos(omega) + phi**2)
        return np.maximum(1 - share + share * slow, ROUNDING).reshape(-1, len(omega))

    @cached_property
    def _slow_level(self) -> Array:
        return self.grid.mean(np.log(self.slow))

    def transforms(self) -> Iterator[Any]:
        """Yield, for every stretch, the transforms of its weighted sensitivities.

        Every stretch has a transform (p, frequencies) of every output. The transforms of several
        long stretches are computed anew at each call, because all have as many frequencies as the
        longest stretch and would need much memory.
        """
        if self.is_short:
            for stretch in self._stretches:
                yield stretch.transform[:, : self.directions.shape[1]]
        elif len(self.weighted) == 1:
            yield self._only_transform
        else:
            for J in self.weighted:
                yield self.grid.transform(J, self.directions, self.deviation)

    @cached_property
    def is_short(self) -> bool:
        """Whether the record is short enough to correct the spectrum for the fitted part."""
        return sum(e.shape[1] for e in self.residuals) <= LONGEST_CORRECTED

    @cached_property
    def _only_transform(self) -> list[ComplexArray]:
        return self.grid.transform(self.weighted[0], self.directions, self.deviation)

    def others(self, lags: Array, banded: ComplexArray) -> AveragedSpectrum:
        """Return the average of spectra that may explain the residuals without process noise."""
        k = len(self.counts)
        alone = [self.one_output(i, lags[:, i], banded[i, i].real) for i in range(k)]
        # Independent outputs need the fewest coefficients, so AICc prefers them in short records.
        candidates = [self.independent_outputs(alone)]

        if k > 1:
            candidates += [self.joint_outputs(candidates[0], banded, n) for n in BLOCKS]
        if self.white_process_noise:
            candidates = [self.judged_on_residuals(average, banded) for average in candidates]

        shares = remaining_products(self.residuals)
        score, densities, taken, uncertainty = stacked(candidates)
        density = np.array([unmasked(spectrum, shares, self.grid) for spectrum in densities])
        return averaged(score, density, taken, uncertainty)

    def with_process_noise(self, others: AveragedSpectrum) -> AveragedSpectrum:
        """Return the average with process noise; its score is the evidence for process noise."""
        process = self.white_process_noise
        if process is None:
            return replace(others, score=0.0)
        return replace(averaged(*stacked([others, process])), score=others.score - process.score)

    def independent_outputs(self, alone: Sequence[AveragedSpectrum]) -> AveragedSpectrum:
        """Return the joint spectrum of outputs whose errors are independent."""
        score, density, taken, uncertainty = stacked(alone)
        total = float(taken.sum())

        return AveragedSpectrum(
            density=density[:, None] * np.eye(len(density), dtype=complex)[..., None],
            taken=total,
            uncertainty=float(uncertainty @ taken**2) / max(total**2, TINY),
            score=float(score.sum()),
        )

    def judged_on_residuals(
        self, average: AveragedSpectrum, banded: ComplexArray
    ) -> AveragedSpectrum:
        """Replace the likelihood of the errors by that of the residuals, with the same penalty."""
        # Process noise is scored on the uncorrected residuals, so the other spectra must be, too.
        errors, *_ = whittle_score(average.density.T, banded.T, self._numbers)
        penalty = average.score - errors + self._numbers.sum()
        expected = self._left(self.grid.spread_out(average.density))
        score, *_ = whittle_score(expected, self.periodogram[1].T, self._numbers)
        return replace(average, score=penalty + score)

    @cached_property
    def _numbers(self) -> Array:
        """Independent numbers (k, b) of every output in a band."""
        return self.counts[:, None] * self.grid.band_weight

    def process_noise(self, correlation: float) -> AveragedSpectrum | None:
        """Return white sensor noise with process noise, by the variances of the residuals.

        `correlation` is that of the process noise from one sample to the next. None if no output
        shows process noise, and for long records.
        """
        parts = self.noise_parts(correlation)
        if parts is None:
            return None
        densities, expected_periodograms = parts
        _, banded = self.periodogram
        variance, covariance, score = variance_components(
            expected_periodograms, banded.T, self._numbers, len(self.counts)
        )
        density = np.tensordot(variance, densities, 1)
        taken = np.array([self.taken_by(part) for part in densities]) * variance
        total = float(taken.sum())
        share = taken / max(total, TINY)

        return AveragedSpectrum(
            density=density,
            taken=total,
            uncertainty=float(share @ covariance @ share),
            score=score + aicc_penalty(len(variance), self.counts.sum()),
        )

    def gain_of_gusts(self) -> float:
        """Return the gain in score of gusts of the best time constant over white process noise."""
        process = self.white_process_noise
        if process is None:
            return 0.0
        scores = [gusts.score for gusts in map(self.process_noise, GUSTS) if gusts]
        # The time constant is one more parameter, which costs 2 in the criterion of Akaike.
        return max(process.score - min(scores) - 2, 0.0)

    @cached_property
    def white_process_noise(self) -> AveragedSpectrum | None:
        """White sensor noise with white process noise, which does not depend on corrections."""
        return self.process_noise(0.0)

    def noise_parts(self, correlation: float) -> tuple[ComplexArray, ComplexArray] | None:
        """Return the spectra of white sensor noise and of process noise, of variance one.

        Every sensor and every state with a visible effect adds a part. The first array contains the
        spectra (c, k, k, b) of these c parts. The second contains the expected periodograms
        (c, b, k, k) of the residuals, which account for the fit and for missing samples.
        """
        if self.counts.max() > LONGEST_WITH_PROCESS_NOISE:
            return None

        colored_shocks = self._shock_transforms / np.fft.rfft([1.0, -correlation], self.grid.size)
        process_parts = []
        # Process noise of a state that affects no output cannot be estimated.
        for H in colored_shocks.swapaxes(0, 1):
            spectrum = np.einsum("if,jf->ijf", H, H.conj())
            power = (np.abs(H) ** 2 @ self.grid.weight).mean()
            if power > TINY:
                spectrum /= power
                process_parts.append((self.grid.banded(spectrum), self._left(spectrum)))

        if not process_parts:
            return None
        parts = [*self._sensor_parts, *process_parts]
        densities = np.array([density for density, _ in parts])
        expected_periodograms = np.array([expected for _, expected in parts])
        return densities, expected_periodograms

    @cached_property
    def _shock_transforms(self) -> ComplexArray:
        return np.fft.rfft(self.shocks() / self.deviation[:, None, None], self.grid.size)

    @cached_property
    def _sensor_parts(self) -> list[tuple[AnyArray, ComplexArray]]:
        flat = np.ones(len(self.grid.omega), dtype=complex)
        white = [np.diag(row)[..., None] * flat for row in np.eye(len(self.counts))]
        return [(density, self._left(self.grid.spread_out(density))) for density in white]

    def _left(self, spectrum: NDArray) -> ComplexArray:
        """Return the transposed expected periodogram (b, k, k) of the residuals.

        The `spectrum` (k, k, f) is that of the errors, at all frequencies. The periodogram includes
        the smearing of lines by a finite record. Without it, the fit would seem to remove more
        power than the errors have.
        """
        pairs = np.fft.irfft(spectrum, self.grid.size) * self._measured_pairs
        expected = self.grid.banded(np.fft.rfft(pairs, self.grid.size))
        return _positive(expected - self.taken_power(spectrum)[1]).T

    @cached_property
    def _measured_pairs(self) -> Array:
        """Shares (k, k, lags) of pairs of samples without a missing one."""
        # A missing sample reduces the expected covariance at every lag at which it is missing.
        masks = [np.fft.rfft(e != 0, self.grid.size) for e in self.residuals]
        pairs = np.fft.irfft(sum(mask[:, None] * mask.conj() for mask in masks), self.grid.size)
        return pairs / np.sqrt(self.counts * self.counts[:, None])[..., None]

    def one_output(self, i: int, r: Array, banded: Array) -> AveragedSpectrum:
        """Average the spectra of one output, of autocovariances r (lags,) and periodogram (b,)."""
        n = self.counts[i]
        grid = self.grid

        coefficients, variances = levinson(r)
        unknowns = 1 + np.arange(len(variances))
        score = n * np.log(variances) + aicc_penalty(unknowns, n)
        # The family of slow parts includes the autoregression of first order.
        score[1:2] = np.inf

        slow_scale = (grid.band_weight / self.slow) @ np.maximum(banded, ROUNDING)
        # All members of the family have the same prior probability, so that the family counts with
        # its mean likelihood, whatever the number of its members.
        slow_score = n * (np.log(slow_scale) + self._slow_level)
        slow_score += 2 * math.log(len(slow_scale)) + aicc_penalty(1, n)
        scale = np.concatenate([variances, slow_scale])
        score = np.concatenate([score, slow_score])
        within = np.concatenate([2 * unknowns / n, np.full(len(slow_scale), 2 / n)])

        is_likely = score < score.min() + LARGEST_DIFFERENCE
        is_likely_regression, is_likely_slow = np.split(is_likely, [len(variances)])
        responses = coefficients[is_likely_regression] @ grid.delays[: len(r)]
        shapes = [1 / np.abs(responses) ** 2, self.slow[is_likely_slow]]
        spectra = scale[is_likely, None] * np.concatenate(shapes)
        taken = grid.mean(spectra * self.power[i, i].real)
        return averaged(score[is_likely], spectra, taken, within[is_likely])

    def slow_errors(self, *, corrected: bool) -> Array:
        """Return the evidence for slow errors and the number of informative lines, (2, k).

        The first row is twice the logarithm of the evidence for slow errors over white errors. The
        second row is the number of Fourier frequencies of the longest stretch in which an output
        depends on the parameters: the width of a flat band with as much power (Parzen). The
        parameters may fit most of a drift, and the residuals then look white. If `corrected`, the
        residuals are therefore compared with the residuals of white errors.
        """
        banded = self.periodogram[1] + (self.taken_power(self.white)[1] if corrected else 0.0)
        power = np.einsum("iib->ib", banded).real
        scale = power @ (self.grid.band_weight / self.slow).T / self.grid.mean(power)[:, None]
        half = -self.counts[:, None] / 2 * (np.log(scale) + self._slow_level)
        total = np.logaddexp.reduce(half, axis=1)
        information = np.einsum("iib->ib", self.power).real
        width = self.grid.mean(information) ** 2 / (self.grid.mean(information**2) + TINY)
        lines = self.grid.longest / 2 * width
        return np.array([2 * (total - math.log(half.shape[1])), lines])

    def joint_outputs(
        self, apart: AveragedSpectrum, banded: ComplexArray, blocks: int
    ) -> AveragedSpectrum:
        """Return the joint spectrum of outputs with a coherency constant in blocks of bands.

        Every output has the spectrum that it has in `apart`.
        """
        k = len(self.counts)
        root = np.sqrt(np.einsum("iib->ib", apart.density).real)
        weight = self.grid.band_weight
        blocks = min(blocks, len(weight))
        starts = np.linspace(0, len(weight), blocks, endpoint=False).astype(int)
        shares = np.add.reduceat(weight, starts)
        white = banded / (root[:, None] * root)
        means: Any = np.add.reduceat(white * weight, starts, axis=-1) / shares
        # The correction for the fitted part is an estimate, which may leave a negative part.
        matrices = _positive(means).T + LEAST * np.eye(k)
        size = np.sqrt(np.einsum("bii->bi", matrices).real)
        coherency = matrices / (size[..., None] * size[:, None])
        # Only the samples that all outputs have in common inform the coherency.
        common = self.counts.min()
        gain = common * float(shares @ np.linalg.slogdet(coherency)[1])
        widths = np.diff(starts, append=len(weight))
        density = np.repeat(coherency, widths, axis=0).T * root[:, None] * root

        return replace(
            apart,
            density=density,
            taken=self.taken_by(density),
            score=apart.score + gain + aicc_penalty(k * (k - 1) * blocks, k * common),
        )

    def taken_by(self, density: NDArray) -> float:
        """Return the power that the fit removes from errors with this spectrum."""
        return float(self.grid.mean(np.einsum("ijb,ijb->b", self.power, density).real))

    def taken_power(self, spectrum: NDArray, order: int = -1) -> tuple[Array, ComplexArray]:
        """Return the power that the fit removes from errors with a `spectrum` (k, k, f).

        The results are autocovariances up to an order and a periodogram, as in
        `FrequencyGrid.covariances`. The residuals r = (1 - P) e, with P = J (R⁻¹ J)ᵀ, have the
        covariance Σ - P Σ - Σ Pᵀ + P Σ Pᵀ. The errors of the other data of the fit are assumed to
        have the same color.
        """
        grid, p = self.grid, self.directions.shape[1]
        is_white = np.all(spectrum == spectrum[..., :1])

        colored, covariances = [], []
        meat: Any = 0
        bread: Any = 0
        for stretch in self._stretches:
            A = stretch.values
            if is_white:
                # White errors are uncorrelated in time, so no transform is needed.
                filtered_by_errors = filtered(np.real(spectrum[..., :1]), A)
            else:
                transform = filtered(spectrum, stretch.transform)
                filtered_by_errors = np.fft.irfft(transform, grid.size)[..., : A.shape[2]]
            colored.append(filtered_by_errors)
            covariances.append(products(A, filtered_by_errors))
            meat = meat + covariances[-1][:p, :p]
            bread = bread + products(A, stretch.noise_values)[:p, :p]
        middle = meat + np.trace(meat) / max(np.trace(bread), TINY) * (np.eye(p) - bread)

        # The errors of a stretch's initial states are correlated with those of the parameters,
        # which other stretches determine, too.
        for covariance in covariances:
            covariance[:p, :p] = middle

        def factors() -> Iterator[tuple[ComplexArray, ComplexArray]]:
            # A generator, because the transforms of all stretches would fill the memory.
            for stretch, C, covariance in zip(self._stretches, colored, covariances, strict=True):
                left = (C - covariance.T / 2 @ stretch.noise_values) * stretch.present
                yield stretch.noise_transform, np.fft.rfft(left, grid.size)

        return grid.covariances(factors(), order)

    @cached_property
    def _stretches(self) -> list[StretchSensitivities]:
        """Sensitivities of every stretch. Records that are corrected are short enough to store."""
        noise, root = self.white[..., 0], np.sqrt(self.counts)[:, None]
        stretches = []
        for J, X, e in zip(self.weighted, self.initial, self.residuals, strict=True):
            A = np.hstack([self.directions.T @ J, X]) * self.deviation[:, None, None]
            transform = np.fft.rfft(A, self.grid.size)
            stretches.append(
                StretchSensitivities(
                    values=A,
                    transform=transform,
                    noise_transform=np.tensordot(noise / root, transform, 1),
                    noise_values=np.tensordot(noise, A, 1),
                    present=((e != 0) / root)[:, None],
                )
            )
        return stretches


def _positive(matrices: ComplexArray) -> ComplexArray:
    """Return Hermitian matrices (k, k, b) without the negative parts that approximations leave."""
    values, vectors = np.linalg.eigh(matrices.T)
    return ((vectors * np.maximum(values, 0.0)[:, None]) @ vectors.conj().mT).T


def unmasked(density: ComplexArray, shares: Array, grid: FrequencyGrid) -> ComplexArray:
    """Return the spectrum of the errors if samples are missing at random.

    The `shares` (k,) are the measured parts of the samples. Missing samples multiply the
    covariances at all lags but zero by the share, as if a part of the errors were white.
    """
    # Uncorrected covariances are then at most 5 % too small, which is below the uncertainty of the
    # spectrum.
    if shares.min() >= 0.95:
        return density
    variance = grid.mean(np.einsum("iib->ib", density).real)
    density = density - np.diag((1 - shares) * variance)[..., None]
    density = density / np.sqrt(shares * shares[:, None])[..., None]
    return _positive(density)


def remaining_products(stretches: Sequence[Array]) -> Array:
    """Return the share (k,) of pairs of samples, at the most frequent lag, that are both measured.

    The share is near 1 if blocks are missing or if every n-th sample is measured. It is smaller if
    samples are missing at random. The lag is the most frequent distance from one measured sample to
    the next, because an output with a lower sampling rate may have no two samples within the lags
    of the autoregressions.
    """
    shares = []
    for rows in zip(*stretches, strict=True):
        distances = np.concatenate([np.diff(np.flatnonzero(e)) for e in rows])
        shares.append(np.bincount(distances).max(initial=0) / max(distances.size, 1))
    return np.clip(shares, 1e-3, 1.0)
