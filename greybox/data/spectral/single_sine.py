"""Finite-frequency estimate of a response from single-sine tests, the paper's (3.15)-(3.16)."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from greybox.data.clock import median_step
from greybox.data.excited_segment import Segment, checked_segments
from greybox.data.files.arrays import Array, ComplexArray, all_finite, sum_of_squares
from greybox.data.files.grouping import unique
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.data.intersample import hold_of_response
from greybox.data.record import Record, require_time
from greybox.data.saturation import at_limit
from greybox.data.spectral.demodulation import (
    UnusableSegmentError,
    least_squares,
    spectral_line,
    whole_periods,
)
from greybox.data.spectral.frequency_points import (
    FiniteFrequency,
    FrequencyPoint,
    averaged,
    with_findings,
    with_unexplained,
)
from greybox.data.spectral.harmonic_distortion import Harmonics, harmonics_of, unexplained
from greybox.data.spectral.pooled_noise import pooled_levels

# Share of the peak-to-peak value of a control. A sine is that close to its peaks for 2.8 % of the
# time: if the levels of a control are farther apart, rounding looks like saturation.
RESOLUTION = 5e-4


class SinePoint(NamedTuple):
    """One point of the response, its variance and dof, and the standard error of the control."""

    response: complex
    variance: float
    dof: float
    control_noise: float


@public
def finite_frequency(
    record: Record,
    segments: Iterable[Segment],
    *,
    input: str = "u",
    output: str = "theta",
    setpoint: str = "",
    settle: float = 2.0,
) -> FiniteFrequency:
    """Estimate the response at the frequencies of single-sine tests, (3.15)-(3.16).

    Sine, cosine, constant, trend and two harmonics are fitted to control and output over all q
    periods together, which is exact on any sampling; the sums of (3.16) are exact only if a period
    is a whole number of samples. The residual e = y - P u is examined beside ω, on the lines ω(1 ±
    m/q), m = 1 ... M: a periodic signal has no power there, noise and transients do. A straight
    line through these values is the leakage of a plant whose state differs between the ends of the
    window (integrators, unstable poles); its value at ω is subtracted. The scatter about the line
    is the noise near ω. The variance follows from it, with 2(2M - 2) degrees of freedom (two
    periods: 2). In a closed loop, the plain scatter of periods would overstate the variance several
    times.

    Noise that the feedback brings into the control is in both y and P u, and cancels in e. Both
    amplitudes refer to the phase of the setpoint, so the ratio has no closed-loop bias, unlike a
    ratio of the spectra of y and u.

    Parameters
    ----------
    record : Record
        Holds the signals on one time base.
    segments : iterable of Segment
        Unusable segments, and those that are not sines, are left out.
    input, output, setpoint : str
        Signal names. With a setpoint, its amplitude is reported and its true frequency is used.
    settle : float, s
        Least time to leave out at the start of each test.

    Returns
    -------
    FiniteFrequency
        `response` has no variance if a test has a single period: fly longer tests.

    Raises
    ------
    ValueError
        If no segment can be used, or if they are of several axes.
    """
    require_time(record, "a frequency response")
    segments = checked_segments(segments)
    axes = sorted({s.axis for s in segments if s.usable and s.kind == "sine"})
    if len(axes) > 1:
        raise ValueError(
            f"the segments are of several axes ({', '.join(axes)}): choose one by segment.axis."
        )

    signals = np.stack([record[name] for name in (input, output, setpoint) if name])

    # Only samples that all signals have: a ratio needs both sides at the same time.
    present = np.isfinite(signals).all(axis=0)
    time, signals = record.time[present], signals[:, present]
    points = []
    measured = []
    left_out = []
    for segment in segments:
        try:
            point, harmonics = _point(time, signals, segment, settle)
            points.append(point)
            measured.append(harmonics)
        except UnusableSegmentError as reason:
            left_out.append((segment, str(reason)))
    if not points:
        reasons = "; ".join(unique(reason for _, reason in left_out)) or "there is none"
        raise ValueError(f"no segment gives a point of the response: {reasons}.")
    points = _with_pooled_noise(points)

    # The harmonics of one test are compared with the responses of the others. So the mean is taken
    # twice: first for the response, then with the error that the harmonics imply.
    frequencies = sorted({p.omega for p in points})

    def means(points: list[FrequencyPoint]) -> tuple[FrequencyPoint, ...]:
        return tuple(averaged([p for p in points if p.omega == omega]) for omega in frequencies)

    responses = np.array([p.response for p in means(points)])
    shares = [
        unexplained(np.array(frequencies), responses, abs(p.u), harmonics)
        for p, harmonics in zip(points, measured, strict=True)
    ]
    points = [with_unexplained(p, share) for p, share in zip(points, shares, strict=True)]
    merged = means(points)
    values = np.array([p.response for p in merged])
    errors = np.array([p.standard_error for p in merged])
    # Data without noise have at least errors of rounding.
    variance = np.maximum(errors, 1e-12 * np.abs(values)) ** 2
    has_variance = all_finite(variance)
    response = FrequencyResponse(
        np.array([p.omega for p in merged]),
        values,
        input,
        output,
        variance=variance if has_variance else None,
        dof=np.array([p.dof for p in merged]) if has_variance else None,
        name=record.name,
        source=record.source,
        stretches=tuple(Stretch(record.checksum, p.start, p.end) for p in points),
        units={name: unit for name in (input, output) if (unit := record.units.get(name))},
        about=hold_of_response(input, output, [(record.hold, record.step)]),
    )
    # Sines were flown one after another; only distortion is alike at neighboring frequencies.
    if not np.any(shares):
        response = response.with_independent_errors()
    return FiniteFrequency(response, merged, tuple(left_out))


def _point(
    time: Array, signals: Array, segment: Segment, settle: float
) -> tuple[FrequencyPoint, Harmonics]:
    """Estimate one point of the response and its harmonics, or raise `UnusableSegmentError`.

    The rows of `signals` are control, output and perhaps setpoint.
    """
    if not segment.usable or segment.kind != "sine":
        raise UnusableSegmentError(
            "; ".join(segment.findings) or f"a {segment.kind} is not a single sine"
        )
    inside = (time >= segment.start) & (time <= segment.end)
    time, signals = time[inside], signals[:, inside]
    omega = segment.omega
    notes = []

    rows, q = whole_periods(time, omega, settle)

    # The announced frequency may be rounded; the setpoint in the log is exact.
    if len(signals) == 3 and q > 1:
        error = frequency_error(time[rows], signals[2, rows], omega)
        # Below a phase of 0.05 rad over a window, the amplitude is low by less than 0.05² / 24 =
        # 1e-4.
        if abs(error) * math.tau * q / omega > 0.05:
            omega += error
            notes.append(f"the setpoint runs at {omega:.5g} rad/s, which was used")
            rows, q = whole_periods(time, omega, settle)

    t = time[rows]
    x = signals[:, rows]
    # The first three harmonics: a symmetric nonlinearity has odd ones, a rounded or biased one even
    # ones.
    amplitudes, drift, residual = least_squares(t, x, omega, segment.start, 3)
    estimate = estimate_by_lines(t, amplitudes[:, 0], residual, omega, segment.start, q)

    u, y, *_ = map(complex, amplitudes[:, 0])
    noise = estimate.control_noise
    # Noise alone exceeds three standard errors with a probability of exp(-9) = 1e-4. Data without
    # noise still have rounding errors.
    if abs(u) <= max(3.0 * noise, 1e-12 * float(np.abs(x[0]).max())):
        raise UnusableSegmentError(
            f"barely excited: the control's amplitude is {abs(u):.2g}, its noise {noise:.2g}"
        )

    harmonics = np.linalg.norm(amplitudes[:2, 1:], axis=1)
    distortion = harmonics / np.maximum(np.abs(amplitudes[:2, 0]), 1e-300)
    point = FrequencyPoint(
        omega,
        estimate.response,
        math.sqrt(estimate.variance),
        estimate.dof,
        q,
        start=float(t[0]),
        end=float(t[-1]),
        u=u,
        y=y,
        distortion=(float(distortion[0]), float(distortion[1])),
        drift=(float(drift[0]), float(drift[1])),
        saturation=saturation(x[0]),
        notes=tuple(notes),
    )
    missing = 1 - t.size * median_step(t) * omega / (q * math.tau)
    return with_findings(point, missing), harmonics_of(t, amplitudes, residual, omega, q)


def _with_pooled_noise(points: list[FrequencyPoint]) -> list[FrequencyPoint]:
    """Return the points with standard errors from the pooled noise density of all points."""
    # Referred to the output and to one second, the noise of all tests is comparable.
    level = [(p.standard_error * abs(p.u)) ** 2 * (p.end - p.start) for p in points]
    pooled, dof = pooled_levels([p.omega for p in points], level, [p.dof for p in points])
    return [
        replace(p, standard_error=math.sqrt(new / (p.end - p.start)) / abs(p.u), dof=float(d))
        for p, new, d in zip(points, pooled, dof, strict=True)
    ]


def frequency_error(t: Array, r: Array, omega: float) -> float:
    """Return the frequency of the setpoint minus `omega`, rad/s, from its phase drift."""
    half = (t[-1] - t[0]) / 2
    halves = (t < t[0] + half, t >= t[0] + half)
    first, second = (least_squares(t[k], r[None, k], omega, t[0], 1)[0][0, 0] for k in halves)
    return float(np.angle(second / first) / half) if abs(first) > 0 else 0.0


def estimate_by_lines(
    t: Array, amplitudes: ComplexArray, residual: Array, omega: float, origin: float, q: int
) -> SinePoint:
    """Estimate with the lines beside `omega`; leakage is smooth in the number m of the line."""
    # The phases of the lines refer to the start of the window: so must those of the amplitudes.
    u, y = amplitudes[:2] * np.exp(1j * omega * (t[0] - origin))
    if q == 1 or u == 0:
        # One period has no lines: assume white noise of the residual's variance.
        control_noise = float(np.sqrt(4 * np.mean(residual[0] ** 2) / t.size))
        return SinePoint(complex(y / u) if u else 0j, math.nan, 0.0, control_noise)

    # Up to a quarter of ω on either side, where noise and leakage are still the same as at ω. Six
    # lines give 20 degrees of freedom, and Student's t is within 6 % of the normal distribution.
    count = 1 if q == 2 else min(max(2, int(q / 4 + 0.5)), 6)
    m = np.array([sign * k for k in range(1, count + 1) for sign in (1, -1)])
    lines = np.stack([spectral_line(t, residual[:2], omega * (1 + k / q)) for k in m], axis=-1)

    # The leakage of y - P u is a polynomial in m; `at_omega` @ lines is its value at m = 0.
    smooth = m[:, None] ** np.arange(1 if count == 1 else 2)
    to_polynomial = np.linalg.pinv(smooth)
    at_omega = to_polynomial[0]
    response = (y - at_omega @ lines[1]) / (u - at_omega @ lines[0])

    error = lines[1] - response * lines[0]
    scatter = error - smooth @ (to_polynomial @ error)
    free = m.size - smooth.shape[1]
    noise = sum_of_squares(scatter) / free
    variance = noise * (1 + sum_of_squares(at_omega)) / abs(u) ** 2
    control_noise = float(np.sqrt(np.mean(np.abs(lines[0]) ** 2)))
    return SinePoint(complex(response), float(variance), 2.0 * free, control_noise)


def saturation(u: Array) -> float:
    """Return the share of samples at the control's limits; NaN where rounding hides a flat top."""
    reach = float(np.ptp(u))
    if np.diff(np.unique(u)).min(initial=reach) > RESOLUTION * reach:
        return math.nan
    return float(at_limit(u).mean())
