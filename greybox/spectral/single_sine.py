"""Finite-frequency estimate of a frequency response from single-sine tests, the paper's (3.15)-(3.16)."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record
from greybox.data.test_segment import Segment, checked_segments
from greybox.data.text_table import counted, number, one_line, text_table

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Estimate = tuple[complex, float, float, float]  # response, variance, degrees of freedom, noise of the control
METHODS = ("least-squares", "quadrature")
LINES = 6  # at most so many lines on either side of the frequency tell the noise
BARELY = 3.0  # a control below this many of its standard errors is noise


def demodulate(
    time: Array,
    values: Array,
    omega: float,
    settle: float = 0.0,
    periods: int | None = None,
    method: str = "least-squares",
    harmonics: int = 1,
) -> complex:
    """Return the complex amplitude alpha + j beta of a signal at `omega`, over whole periods: (3.16) with η = 1.

    The signal is alpha sin ω(t - t0) + beta cos ω(t - t0) with t0 = time[0], so that the ratio of two of them has the
    sign of a transfer function at +jω: a lag has a negative phase. The last whole periods after `settle` are used.

    Parameters
    ----------
    time, values : (n,) arrays, s and any unit
        Any sampling; samples that are NaN are left out.
    settle, periods : float, s, and int, optional
        Left out at the start, at least; by default as many periods as there are.
    method : "least-squares" or "quadrature"
        Sine, cosine, constant, trend (and harmonics) fitted together, exact on any sampling; or the sums of (3.16),
        exact where a period is a whole number of equal samples.
    harmonics : int
        The least squares fit those up to this one; more than the first matters only on uneven sampling.

    Raises
    ------
    ValueError
        If there is no whole period, or less than four samples in a period, or an unknown method.
    """
    record = Record(time, {"values": values})  # checks both
    time, values = record.time, record["values"]
    known = np.isfinite(values)
    try:
        rows, _ = _window(time[known], omega, settle, periods)
    except _LeftOutError as reason:
        raise ValueError(f"the signal cannot be demodulated at {omega:g} rad/s: {reason}.") from None
    t, x = time[known][rows], values[known][rows]
    if _known_method(method) == "quadrature":
        return complex(_quadrature(t, x, omega, float(time[0])))
    return complex(_fit(t, x[None], omega, float(time[0]), harmonics)[0][0, 0])


@dataclass(frozen=True)
class FrequencyPoint:
    """What one sine test gave.

    Attributes
    ----------
    omega, response : float, rad/s, and complex
        Output over control, (3.15).
    standard_error, dof : float
        Square root of E|P̂ - P|², both components together (NaN for a single period), and its degrees of freedom.
    periods, start, end : int and floats, s
        The window used.
    u, y, r : complex
        Amplitudes of control, output and setpoint (NaN without one), phase relative to sin ω(t - segment's start).
    distortion, drift : (float, float)
        Of control and output: harmonics over fundamental (root of sum of squares); change of trim over the window.
    saturation : float
        Share of time that the control was at its limit; NaN where it cannot be told.
    """

    omega: float
    response: complex
    standard_error: float
    dof: float
    periods: int
    start: float
    end: float
    u: complex
    y: complex
    r: complex
    distortion: tuple[float, float]
    drift: tuple[float, float]
    saturation: float
    findings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FiniteFrequency:
    """The measured response, what each test gave, and the tests that gave nothing, with the reason."""

    response: FrequencyResponse
    points: tuple[FrequencyPoint, ...]
    left_out: tuple[tuple[Segment, str], ...] = ()

    @property
    def findings(self) -> tuple[str, ...]:
        """What was found wrong, in words."""
        found = [f"{p.omega:g} rad/s: {text}" for p in self.points for text in p.findings]
        return (*found, *(f"{s.kind} from {s.start:.1f} s left out: {reason}" for s, reason in self.left_out))

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.points), "frequency", "frequencies"), f"{len(self.left_out)} left out")

    def __str__(self) -> str:
        header = ("rad/s", "periods", "|u|", "|y|", "gain", "phase °", "error %", "harmonics u, y %", "saturated %")
        table = text_table(header, [_row(p) for p in self.points], left=())
        return "\n".join([str(self.response), table, *self.findings])


def finite_frequency(  # noqa: PLR0913 - one keyword for each choice
    record: Record,
    segments: Iterable[Segment],
    *,
    input: str = "u",
    output: str = "theta",
    setpoint: str = "",
    settle: float = 2.0,
    periods: int | None = None,
    method: str = "least-squares",
    harmonics: int = 3,
    limits: tuple[float, float] | None = None,
) -> FiniteFrequency:
    """Estimate the response from `input` to `output` at the frequencies of single-sine tests, (3.15)-(3.16).

    With "least-squares", control and output are fitted by sine, cosine, constant, trend and harmonics over all q
    periods together. In what is left, e = y - P u is looked at beside ω, on the lines ω(1 ± m/q), m = 1 ... M: whatever
    repeats every period has nothing there, all that changes from period to period is there. A straight line through
    them is the leakage of a plant that ends the window elsewhere than it began (integrators, unstable poles); its value
    at ω is taken off. The scatter about it is the noise near ω, from which the variance follows, with 2(2M - 2)
    degrees of freedom (two periods: 2). The plain scatter of periods would overstate it several times in a closed loop.

    With "quadrature", amplitudes are the sums of (3.16) as printed, and the variance is the scatter of y - P u between
    periods over q, with 2(q - 1) degrees of freedom.

    Noise that the feedback brings into the control is in y and in P u alike and cancels in e. Both amplitudes are taken
    on the setpoint's clock, so that the ratio has no closed-loop bias, as a ratio of spectra of y and u would have.

    Parameters
    ----------
    record : Record
        Holds the signals on one time base.
    segments : iterable of Segment
        What is not usable or not a sine is left out.
    input, output, setpoint : str
        Signal names. With a setpoint, its amplitude is reported and its true frequency used.
    settle, periods, method, harmonics
        As in `demodulate`.
    limits : (low, high), optional
        Of the control; by default its flat tops are looked for.

    Returns
    -------
    FiniteFrequency
        `response` has no variance if a test had one single period: ask for ``periods=2`` or longer tests.

    Raises
    ------
    ValueError
        If no segment can be used, or they are of several axes; the sentence says why.
    """
    segments = checked_segments(segments)
    _known_method(method)
    if len(axes := sorted({s.axis for s in segments if s.usable and s.kind == "sine"})) > 1:
        raise ValueError(f"the segments are of several axes ({', '.join(axes)}): choose those of one, by segment.axis.")
    signals = np.stack([record[name] for name in ((input, output, setpoint) if setpoint else (input, output))])
    known = np.isfinite(signals).all(axis=0)
    data = _Data(record.time[known], signals[:, known], settle, periods, method, harmonics, limits)
    points, left_out = [], []
    for segment in segments:
        try:
            points.append(_point(data, segment))
        except _LeftOutError as reason:
            left_out.append((segment, str(reason)))
    if not points:
        reasons = "; ".join(dict.fromkeys(reason for _, reason in left_out)) or "there is none"
        raise ValueError(f"no segment gives a point of the response: {reasons}.")
    merged = tuple(_merged([p for p in points if p.omega == omega]) for omega in sorted({p.omega for p in points}))
    return FiniteFrequency(_response(merged, record, input, output), merged, tuple(left_out))


class _LeftOutError(ValueError):
    """A segment cannot be used, and why."""


class _Data(NamedTuple):
    time: Array
    signals: Array  # rows: control, output and, if there is one, setpoint
    settle: float
    periods: int | None
    method: str
    harmonics: int
    limits: tuple[float, float] | None


def _known_method(method: str) -> str:
    if method not in METHODS:
        raise ValueError(f"the method is {method!r}: it must be {' or '.join(map(repr, METHODS))}.")
    return method


def _window(time: Array, omega: float, settle: float, periods: int | None) -> tuple[NDArray[np.bool_], int]:
    """Return the rows of the last whole periods after `settle`, and how many periods they are."""
    if not 0 < omega < math.inf:
        raise _LeftOutError(f"the frequency is {omega:g} rad/s: it must be above 0")
    period = 2 * math.pi / omega
    if time.size < 8:
        raise _LeftOutError(f"only {counted(time.size, 'sample')}")
    step = float(np.median(np.diff(time)))
    if step > period / 4:
        raise _LeftOutError(f"a period of {period:.3g} s has less than four samples of {step:.3g} s")
    there = math.floor((time[-1] - time[0] + step - settle) / period + 1e-6)
    count = max(there, 1) if periods is None else periods
    if not 1 <= count <= there:
        long, wanted = (
            f"{time[-1] - time[0]:.3g} s do not hold {settle:g} s of settling and",
            f"{count} x {period:.3g} s",
        )
        raise _LeftOutError(f"{long} {wanted}")
    rows = time > time[-1] + step / 2 - count * period
    in_each = np.histogram(time[rows], count, (time[-1] - count * period, time[-1]))[0]
    if in_each.min() < 0.3 * period / step:
        raise _LeftOutError(f"a whole period is missing after {time[rows][0]:.1f} s")
    return rows, count


def _waves(time: Array, omega: float, origin: float) -> Array:
    return np.stack([np.sin(omega * (time - origin)), np.cos(omega * (time - origin))])


def _fit(t: Array, x: Array, omega: float, origin: float, harmonics: int) -> tuple[Complex, Array, Array]:
    """Fit constant, trend and harmonics to the rows of `x`; amplitudes (rows, h), change over the window, rest."""
    step = float(np.median(np.diff(t)))
    count = max(1, min(harmonics, int(0.8 * math.pi / (omega * step))))
    trend = (t - t.mean()) / (t[-1] - t[0])
    waves = [_waves(t, k * omega, origin) for k in range(1, count + 1)]
    columns = np.concatenate([[np.ones_like(t), trend], *waves])
    c = np.linalg.lstsq(columns @ columns.T, columns @ x.T, rcond=None)[0]  # few columns, well scaled: as good as QR
    return (c[2::2] + 1j * c[3::2]).T, c[1], x - c.T @ columns


def _quadrature(t: Array, x: Array, omega: float, origin: float) -> Complex:
    """Return the sums of (3.16) over all samples; each stands for half the way to its neighbors."""
    step = np.diff(t)
    weight = np.concatenate([[step[0]], (step[1:] + step[:-1]) / 2, [step[-1]]])
    sums = 2 / weight.sum() * (x * weight) @ _waves(t, omega, origin).T
    return sums[..., 0] + 1j * sums[..., 1]


def _point(data: _Data, segment: Segment) -> FrequencyPoint:
    """Estimate one point of the response, or raise `_LeftOutError`."""
    if not segment.usable or segment.kind != "sine":
        raise _LeftOutError("; ".join(segment.findings) or f"a {segment.kind} is not a single sine")
    inside = (data.time >= segment.start) & (data.time <= segment.end)
    time, signals, omega, findings = data.time[inside], data.signals[:, inside], segment.omega, []
    rows, q = _window(time, omega, data.settle, data.periods)
    if len(signals) == 3 and q > 1:
        error = _frequency_error(time[rows], signals[2, rows], omega)
        if abs(error) * 2 * math.pi * q / omega > 0.05:  # rad over the window
            omega += error
            findings.append(f"the setpoint runs at {omega:.5g} rad/s, which was used")
            rows, q = _window(time, omega, data.settle, data.periods)
    t, x = time[rows], signals[:, rows]
    amplitudes, drift, rest = _fit(t, x, omega, segment.start, data.harmonics)
    if data.method == "quadrature":
        amplitudes[:, 0] = _quadrature(t, x, omega, segment.start)
        response, variance, dof, noise = _by_periods(t, x, amplitudes[:, 0], omega, segment.start, q)
    else:
        response, variance, dof, noise = _by_lines(t, amplitudes[:, 0], rest, omega, segment.start, q)
    u, y, *r = map(complex, amplitudes[:, 0])
    if abs(u) <= max(BARELY * noise, 1e-12 * float(np.abs(x[0]).max())):
        raise _LeftOutError(f"barely excited: the control's amplitude is {abs(u):.2g}, its noise {noise:.2g}")
    distortion = np.sqrt(np.sum(np.abs(amplitudes[:2, 1:]) ** 2, axis=1)) / np.maximum(
        np.abs(amplitudes[:2, 0]), 1e-300
    )
    extent, third = (float(t[0]), float(t[-1])), r[0] if r else complex(math.nan, math.nan)
    shape = (float(distortion[0]), float(distortion[1])), (float(drift[0]), float(drift[1]))
    saturation = _saturation(x[0], data.limits)
    point = FrequencyPoint(omega, response, math.sqrt(variance), dof, q, *extent, u, y, third, *shape, saturation)
    missing = 1 - t.size * float(np.median(np.diff(t))) * omega / (q * 2 * math.pi)
    return _with_findings(point, findings + [f"{missing:.0%} of the samples are missing"] * (missing > 0.05))


def _frequency_error(t: Array, r: Array, omega: float) -> float:
    """Return the setpoint's frequency less `omega`, rad/s, from the drift of its phase between the two halves."""
    half = (t[-1] - t[0]) / 2
    first, second = (_fit(t[k], r[None, k], omega, t[0], 1)[0][0, 0] for k in (t < t[0] + half, t >= t[0] + half))
    return float(np.angle(second / first) / half) if abs(first) > 0 else 0.0


def _by_lines(t: Array, amplitudes: Complex, rest: Array, omega: float, origin: float, q: int) -> Estimate:
    """Estimate with the lines beside `omega`, all of one phase at both ends of the window: leakage is smooth in m."""
    u, y = amplitudes[:2] * np.exp(1j * omega * (t[0] - origin))
    if q == 1 or u == 0:
        return complex(y / u) if u else 0j, math.nan, 0.0, float(np.sqrt(4 * np.mean(rest[0] ** 2) / t.size))
    count = 1 if q == 2 else min(max(2, int(q / 4 + 0.5)), LINES)
    m = np.array([sign * k for k in range(1, count + 1) for sign in (1, -1)])
    lines = np.stack([_line(t, rest[:2], omega * (1 + k / q), float(t[0])) for k in m], axis=-1)
    smooth = m[:, None] ** np.arange(1 if count == 1 else 2)
    solve = np.linalg.pinv(smooth)  # its first row: the smooth part at omega
    response = y / u
    for _ in range(4):
        response = (y - solve[0] @ (lines[1] - response * lines[0])) / u
    error = lines[1] - response * lines[0]
    scatter, free = error - smooth @ (solve @ error), m.size - smooth.shape[1]
    variance = np.sum(np.abs(scatter) ** 2) / free * (1 + np.sum(solve[0] ** 2)) / abs(u) ** 2
    return complex(response), float(variance), 2.0 * free, float(np.sqrt(np.mean(np.abs(lines[0]) ** 2)))


def _line(t: Array, x: Array, omega: float, origin: float) -> Complex:
    columns = np.vstack([np.ones_like(t), _waves(t, omega, origin)])
    c = np.linalg.lstsq(columns @ columns.T, columns @ x.T, rcond=None)[0]
    return c[1] + 1j * c[2]


def _by_periods(t: Array, x: Array, whole: Complex, omega: float, origin: float, q: int) -> Estimate:
    """Estimate as printed, from the amplitudes of the `whole`, with the scatter of the periods."""
    u, y = whole[:2]
    response = complex(y / u) if u else 0j
    if q == 1:
        return response, math.nan, 0.0, 0.0
    step = float(np.median(np.diff(t)))
    parts = np.clip(((t - t[-1] - step / 2) * omega / (2 * math.pi) + q).astype(int), 0, q - 1)
    each = np.stack([_quadrature(t[parts == k], x[:, parts == k], omega, origin) for k in range(q)], axis=-1)
    error = each[1] - response * each[0]
    variance = np.sum(np.abs(error - error.mean()) ** 2) / (q - 1) / q / abs(u) ** 2 if u else math.nan
    noise = np.sqrt(np.sum(np.abs(each[0] - each[0].mean()) ** 2) / (q - 1) / q)
    return response, float(variance), 2.0 * (q - 1), float(noise)


def _saturation(u: Array, limits: tuple[float, float] | None) -> float:
    """Return the share of samples at the control's limits, or in flat tops longer than the signal's other steps."""
    reach = float(np.ptp(u))
    if limits is not None:
        return float(np.mean((u <= limits[0] + 1e-6 * reach) | (u >= limits[1] - 1e-6 * reach)))
    if np.diff(np.unique(u)).min(initial=reach) > 5e-4 * reach:
        return math.nan  # too coarse to tell a flat top from a rounded one
    edges = np.flatnonzero(np.r_[True, np.abs(np.diff(u)) > 1e-9 * reach, True])
    length, level = np.diff(edges), u[edges[:-1]]
    extreme = (level >= u.max() - 1e-6 * reach) | (level <= u.min() + 1e-6 * reach)
    flat = extreme & (length >= max(3, 3 * float(np.median(length))))
    return float(length[flat].sum() / u.size)


def _with_findings(p: FrequencyPoint, findings: list[str]) -> FrequencyPoint:
    """Add what is remarkable about a point, in words."""
    for name, sine, share, drift in zip(("control", "output"), (p.u, p.y), p.distortion, p.drift, strict=True):
        if share > 0.1:
            findings.append(f"the {name} has harmonics of {share:.0%} of its sine: the response is not linear there")
        if abs(drift) > 0.3 * abs(sine):
            findings.append(f"the trim of the {name} drifts by {drift:.2g} where its amplitude is {abs(sine):.2g}")
    if p.saturation > 0.02:
        findings.append(f"the control is at its limit for {p.saturation:.0%} of the time")
    if p.periods == 1:
        findings.append("one period only: its error is not known")
    if p.standard_error > 0.3 * abs(p.response):
        findings.append(f"the standard error is {p.standard_error / abs(p.response):.0%} of the response")
    return replace(p, findings=tuple(findings))


def _merged(points: list[FrequencyPoint]) -> FrequencyPoint:
    """Average the tests at one frequency, weighted by their periods and the square of the control's amplitude."""
    if len(points) == 1:
        return points[0]
    weight = np.array([p.periods * abs(p.u) ** 2 for p in points])
    weight, dof = weight / weight.sum(), np.array([p.dof for p in points])
    parts = (weight * [p.standard_error for p in points]) ** 2
    total = float(parts.sum())
    free = float(total**2 / np.sum(parts**2 / dof)) if total > 0 and np.all(dof > 0) else float(dof.sum())
    notes = (f"mean of {len(points)} tests", *dict.fromkeys(text for p in points for text in p.findings))
    mean, periods = complex(weight @ [p.response for p in points]), sum(p.periods for p in points)
    return replace(points[0], response=mean, standard_error=math.sqrt(total), dof=free, periods=periods, findings=notes)


def _response(points: tuple[FrequencyPoint, ...], record: Record, input: str, output: str) -> FrequencyResponse:
    omega, values = np.array([p.omega for p in points]), np.array([p.response for p in points])
    variance = np.array([max(p.standard_error**2, (1e-12 * abs(p.response)) ** 2) for p in points])
    known = (variance, np.array([p.dof for p in points])) if np.isfinite(variance).all() else (None, None)
    return FrequencyResponse(omega, values, input, output, None, *known, record.name, record.source)


def _row(p: FrequencyPoint) -> tuple[str, ...]:
    size, phase = abs(p.response), math.degrees(math.atan2(p.response.imag, p.response.real))
    distortion = ", ".join(f"{100 * share:.1f}" for share in p.distortion)
    error = number(100 * p.standard_error / size if size else math.nan, 2)
    sizes = (number(abs(p.u), 3), number(abs(p.y), 3), number(size, 4))
    return (number(p.omega), str(p.periods), *sizes, f"{phase:.2f}", error, distortion, number(100 * p.saturation, 2))
