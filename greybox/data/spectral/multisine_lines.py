"""Frequency responses of multisines from whole periods in steady state, free of leakage.

At a line, the transforms of n periods obey Y = P U + V with independent noise V of one variance.
The estimate is P̂ = aY with a = Rᴴ / (RᴴU) and an instrument R: the input itself (direct), or an
injected signal (joint input-output), since noise that a feedback returns to U biases the direct
estimate (Tischler and Remple, 2nd ed., section 5.7). Its variance is E|V|² aaᴴ. The residuals are
QV with Q = I - Ua. The eigenvalues of QQᴴ are 0, k = |U|² |a|², and n - 2 ones: so E|V|² =
|residuals|² / (n - 2 + k), with 2 (n - 2 + k)² / (n - 2 + k²) degrees of freedom (Satterthwaite).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.spectral.estimated_points import (
    EPS,
    HZ,
    STRONG,
    EstimatedPoints,
    response_at,
    without_incoherent,
)
from greybox.data.spectral.uniform_stretches import UniformStretch, uniform_stretches

# Amplitude of an excited line over the largest one. `greybox.workflows.experiment.excitation` gives
# all lines one amplitude; the limit of -30 dB only has to exceed noise and distortion between them.
EXCITED = 0.03

# The signal-to-noise ratio expected at a line is a mean over two neighbors on each side, without
# the line itself. These are the weights.
BESIDE = (0.25, 0.25, 0.0, 0.25, 0.25)


@public
def periodic_response(
    records: Record | Sequence[Record],
    period: float,
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from whole periods of a signal in steady state.

    The periods are transformed one by one, so there is no leakage. The variance comes from their
    scatter, assumed independent (Pintelon and Schoukens, System Identification, 2nd ed., chapter
    2). An incomplete period is left out at the beginning. The frequencies are the excited lines
    without those of low coherence. Arguments not listed here are those of `spectral_response`.

    Parameters
    ----------
    period : float, s
        A whole number of samples.

    Raises
    ------
    ValueError
        If the period is not a whole number of samples, or there are fewer than three periods.
    """
    stretches, spectra = period_spectra(records, period, (input, output, instrument or input))
    # The lines are selected by the instrument, which contains no noise from the feedback.
    u, y, r = np.moveaxis(spectra, 1, 0)
    amplitude = np.linalg.norm(r, axis=0)
    lines = np.flatnonzero(amplitude > EXCITED * amplitude.max())
    # The first line is the fundamental: zero frequency is left out.
    omega = (1 + lines) * (HZ / period)
    points = _estimates(omega, u[:, lines], y[:, lines], r[:, lines])
    return without_incoherent(response_at(points, stretches, input, output, name))


def period_spectra(
    records: Record | Sequence[Record], period: float, signals: Sequence[str]
) -> tuple[list[UniformStretch], ComplexArray]:
    """Return the stretches, and the transforms (periods, signals, lines) of their whole periods.

    The lines are the multiples of 2π / period below half of the sampling rate, without zero. If the
    sampling rates differ, the lowest one decides.

    Raises
    ------
    ValueError
        If the period is not a whole number of samples, or there are fewer than three periods.
    """
    stretches = [whole_periods(s, period) for s in uniform_stretches(records, signals)]
    stretches = [s for s in stretches if s.values.shape[1]]
    spectra = []
    for stretch in stretches:
        count = round(stretch.values.shape[1] * stretch.step / period)
        for values in np.split(stretch.values, count, axis=1):
            lines = np.fft.rfft(values, axis=1)[:, 1 : (values.shape[1] + 1) // 2]
            spectra.append(lines * stretch.step)
    if len(spectra) < 3:
        raise ValueError(
            f"the records hold {counted(len(spectra), 'whole period')} of {period:g} s, and a "
            "variance needs at least three: record longer."
        )
    # Stretches of a lower rate have fewer lines, and only common lines can be averaged.
    fewest = min(s.shape[1] for s in spectra)
    return stretches, np.array([s[:, :fewest] for s in spectra])


def whole_periods(stretch: UniformStretch, period: float) -> UniformStretch:
    """Return the last whole periods of a stretch.

    An incomplete period is dropped at the start, where the plant may still settle.
    """
    count = round(period / stretch.step)
    # After 100 such periods the phase of the fundamental is off by 2π/1000.
    if count < 2 or abs(count * stretch.step - period) > 1e-5 * stretch.step * count:
        raise ValueError(
            f"a period of {period:g} s has {period / stretch.step:.6g} samples: resample the "
            "record so that it has a whole number."
        )
    remainder = stretch.values.shape[1] % count
    # The origin moves along, so that the response names the samples that it used.
    origin = stretch.origin
    start = min(origin.start + remainder * stretch.step, origin.end)
    return stretch._replace(
        values=stretch.values[:, remainder:],
        step=period / count,
        origin=replace(origin, start=start),
    )


def _estimates(omega: Array, u: ComplexArray, y: ComplexArray, r: ComplexArray) -> EstimatedPoints:
    """Return the estimates at all lines from the spectra (periods, lines) of the three signals."""
    from scipy.ndimage import correlate1d  # noqa: PLC0415  (takes a tenth of a second)

    n = len(u)

    def power(signal: ComplexArray) -> Array:
        return np.sum(np.abs(signal) ** 2, axis=0)

    # A line without excitation has no estimate. Its variance is NaN, from 0 / 0 without a warning.
    with np.errstate(all="ignore"):
        a = r.conj() / np.sum(r.conj() * u, axis=0)
        response = np.sum(a * y, axis=0)
        spread = power(a)
        k = power(u) * spread
        noise = power(y - response * u) / (n - 2 + k)
        dof = 2 * (n - 2 + k) ** 2 / (n - 2 + k**2)
        # The instrument's coherences with input and output.
        coherences = np.array([1 / k, np.abs(response) ** 2 / (power(y) * spread)])
    if not np.array_equal(r, u):
        # Noise that adds to a weak line makes it look strong, its response too large and its
        # variance too small: its own coherence would select it. Its neighbors have other noise of
        # about the same size, and the power of the instrument says what to expect beside them.
        drive = power(r)
        sure = np.clip(coherences, EPS, 1 - EPS)
        odds = correlate1d(np.log(sure / (1 - sure) / drive), BESIDE, mode="mirror")
        coherences = 1 / (1 + np.exp(-odds) / drive)
        # Likewise, noise that feedback adds to the input makes a line strong, and its response
        # wrong in one direction: weights by its own strength would bias a fit in this direction.
        # The residuals grow as the input shrinks, too: both factors are replaced.
        expected = np.exp(correlate1d(np.log(spread * drive), BESIDE, mode="mirror")) / drive
        spread[2:-2] = (expected**2 / spread)[2:-2]
    weak = STRONG * (1 / coherences[0] - 1) > n - 1
    variance = np.where(weak, np.nan, noise * spread)
    return EstimatedPoints(omega, response, variance, dof, coherences.min(axis=0), weak)
