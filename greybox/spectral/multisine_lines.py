"""Frequency responses of multisines from whole periods in steady state, free of leakage.

At a line, the transforms of the periods k obey Y_k = P U_k + V_k with independent noise V_k of one
variance. With regressors X (the input and conditioned inputs) and instruments Z, the estimate is the
first row a of A = (ZᴴX)⁻¹Zᴴ, applied to Y, and its variance is E|V|² aaᴴ. The residuals QV with Q =
I - XA give E|V|² = |residuals|² / tr QQᴴ, with 2 (tr QQᴴ)² / tr (QQᴴ)² degrees of freedom
(Satterthwaite). Noise that a feedback returns to U biases the direct estimate, Z = X, but not the
joint input-output estimate with an injected signal as instrument (Tischler and Remple, 2nd ed.,
section 5.7).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.files.arrays import Array, ComplexArray, IntArray
from greybox.spectral.estimated_points import (
    EPS,
    HZ,
    STRONG,
    WORST_CONDITION,
    EstimatedPoint,
    response_at,
    without_incoherent,
)
from greybox.spectral.uniform_stretches import UniformStretch, uniform_stretches

# Amplitude of an excited line over the largest one. `greybox.experiment.multisine` gives all lines
# one amplitude; the limit of -30 dB only has to exceed noise and distortion between them.
EXCITED = 0.03

# Relative error of the period: after 100 periods the phase of the fundamental is off by 2π/1000.
WHOLE = 1e-5

LEAST_DOF = 3  # from here on, Student's t has a finite variance


def periodic_response(
    records: Record | Sequence[Record],
    period: float,
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] = (),
    omega: ArrayLike | None = None,
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from whole periods of a signal in steady state.

    The periods are transformed one by one, so there is no leakage. The variance comes from their
    scatter, assumed independent (Pintelon and Schoukens, System Identification, 2nd ed., chapter
    2). An incomplete period is left out at the beginning. Arguments not listed here are those of
    `spectral_response`.

    Parameters
    ----------
    period : float, s
        A whole number of samples.
    omega : (n,) array, rad/s, optional
        Multiples of 2π / period; by default, the excited ones without those of low coherence.

    Raises
    ------
    ValueError
        If the period is not a whole number of samples, there are fewer than three periods, or
        `omega` holds other frequencies.
    """
    signals = [input, output, instrument or input, *conditioned]
    stretches, spectra = period_spectra(records, period, signals)
    if len(spectra) < 3:
        raise ValueError(
            f"the records hold fewer than three periods of {period:g} s: record longer."
        )

    fundamental = HZ / period
    if omega is None:
        amplitude = np.sqrt(np.sum(np.abs(spectra[:, 2]) ** 2, axis=0))
        multiple = 1 + np.flatnonzero(amplitude > EXCITED * amplitude.max())
    else:
        multiple = _multiples(np.atleast_1d(np.asarray(omega, dtype=float)), fundamental)
        if multiple.max() > spectra.shape[2]:
            raise ValueError(
                f"omega = {multiple.max() * fundamental:g} rad/s is not below half of the sampling "
                "rate: leave it out."
            )

    points = [_estimate(spectra[:, :, k - 1]) for k in multiple]
    response = response_at(multiple * fundamental, points, (input, output, name), stretches)
    return response if omega is not None else without_incoherent(response)


def period_spectra(
    records: Record | Sequence[Record], period: float, signals: Sequence[str]
) -> tuple[list[UniformStretch], ComplexArray]:
    """Return the stretches, and the transforms (periods, signals, lines) of their whole periods.

    The lines are the multiples of 2π / period below half of the sampling rate, without zero. If the
    sampling rates differ, the lowest one decides.

    Raises
    ------
    ValueError
        If the period is not a whole number of samples.
    """
    stretches = [whole_periods(s, period) for s in uniform_stretches(records, signals)]
    stretches = [s for s in stretches if s.values.shape[1]]
    spectra = []
    for stretch in stretches:
        count = round(stretch.values.shape[1] * stretch.step / period)
        for values in np.split(stretch.values, count, axis=1):
            lines = np.fft.rfft(values, axis=1)[:, 1 : (values.shape[1] + 1) // 2]
            spectra.append(lines * stretch.step)
    fewest = min((s.shape[1] for s in spectra), default=0)
    return stretches, np.array([s[:, :fewest] for s in spectra])


def whole_periods(stretch: UniformStretch, period: float) -> UniformStretch:
    """Return the last whole periods of a stretch."""
    count = round(period / stretch.step)
    if count < 2 or abs(count * stretch.step - period) > WHOLE * stretch.step * count:
        raise ValueError(
            f"a period of {period:g} s has {period / stretch.step:.6g} samples: resample the record "
            "so that it has a whole number."
        )
    remainder = stretch.values.shape[1] % count
    origin = stretch.origin
    if origin is not None:
        origin = replace(origin, start=min(origin.start + remainder * stretch.step, origin.end))
    return stretch._replace(
        values=stretch.values[:, remainder:], step=period / count, origin=origin
    )


def _multiples(omega: Array, fundamental: float) -> IntArray:
    """Return the frequencies as whole multiples of the fundamental."""
    multiple = omega / fundamental
    odd = (np.abs(multiple - np.rint(multiple)) > 1e-6) | (multiple < 0.5)
    if odd.any():
        raise ValueError(
            f"omega = {omega[odd][0]:g} rad/s is not a multiple of 2π / period = {fundamental:g} "
            "rad/s: leave it out."
        )
    return np.rint(multiple).astype(int)


def _estimate(spectra: ComplexArray) -> EstimatedPoint:
    """Estimate from the spectra (periods, signals) of input, output, instrument, other inputs."""
    u, y, r, *conditioned = spectra.T
    x = np.array([u, *conditioned]).T
    z = np.array([r, *conditioned]).T
    if not _solvable(z, x):
        return EstimatedPoint()

    solution = np.linalg.solve(z.conj().T @ x, z.conj().T)
    projection = np.eye(len(x)) - x @ solution
    square = projection @ projection.conj().T
    trace = np.trace(square).real
    dof = 2 * trace**2 / np.sum(np.abs(square) ** 2)
    if dof < LEAST_DOF:
        return EstimatedPoint()

    spread = np.sum(np.abs(solution[0]) ** 2)
    if not np.array_equal(z, x) and STRONG * spread * _unexplained(u, z) > 1:
        return EstimatedPoint(weak=True)
    response = complex(solution[0] @ y)
    variance = np.sum(np.abs(projection @ y) ** 2) / trace * spread
    rounding = (4 * EPS * abs(response)) ** 2  # the least variance, for data without noise
    return EstimatedPoint(response, max(variance, rounding), dof, _coherence(x, z, y))


def _solvable(z: ComplexArray, x: ComplexArray) -> bool:
    """Return whether there is a residual, and ZᴴX with columns of length one is well conditioned."""
    if len(x) <= x.shape[1]:
        return False
    tiny = np.finfo(float).tiny
    z, x = (side / np.maximum(np.linalg.norm(side, axis=0), tiny) for side in (z, x))
    return bool(np.linalg.cond(z.conj().T @ x) < WORST_CONDITION)


def _unexplained(input: ComplexArray, z: ComplexArray) -> float:
    """Return the power of the part of an input that the instruments do not explain."""
    basis = np.linalg.qr(z)[0]
    residual = input - basis @ (basis.conj().T @ input)
    return float(np.sum(np.abs(residual) ** 2)) / (len(z) - z.shape[1])


def _coherence(x: ComplexArray, z: ComplexArray, y: ComplexArray) -> float:
    """Return the partial γ² of the first instrument with output or first regressor, if lower."""
    basis = np.linalg.qr(x[:, 1:])[0]
    r, *signals = (v - basis @ (basis.conj().T @ v) for v in (z[:, 0], y, x[:, 0]))
    squares = (abs(np.vdot(r, v)) ** 2 / (np.vdot(r, r).real * np.vdot(v, v).real) for v in signals)
    return float(np.clip(min(squares), EPS, 1))
