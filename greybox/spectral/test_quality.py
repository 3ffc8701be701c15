"""Whether a test is worth a fit: what a record and a measured response say about it, in words and as data."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import GAP, Record, require_time
from greybox.data.test_segment import Segment
from greybox.files.arrays import Array, BoolArray
from greybox.files.text_table import counted, number, one_line, text_table

Severity = Literal["note", "warning", "refusal"]

# Limits of a warning and, where there are two, of a refusal.

# Share of the time that is lost in gaps. Nothing is interpolated across them, so that a larger
# share costs data but no accuracy; the limit is a convention.
GAPS = 0.01

# Standard deviation of the sampling interval over its median: read by row number, a signal of ten
# samples per period (`SAMPLES`) then has a phase error of 2π/10 · 0.1 = 0.06 rad.
JITTER = 0.1

# Share of the time at a limit. A sine that is clipped for 20 % of the time has a third harmonic of
# 1.2 % and loses as much of its fundamental; at 1 % both are 2e-6. The limits are a convention.
SATURATED = (0.01, 0.2)
AT_LIMIT = 1e-3  # of the distance between the limits

# Values that a signal takes. Steps of the resolution have an error of step/√12 rms: 12 % of a sine
# across eight values, 27 % of one across four.
LEVELS = (8, 4)

# Periods of the lowest frequency. From two periods the variance has two degrees of freedom and
# Student's t is 4.3; in less than one, a sine cannot be told from a drift.
PERIODS = (3, 1)

# Per period of the highest frequency. Linear interpolation between ten samples takes 3 % off the
# amplitude, and half a sample is 18° of phase; 2.5 are 0.4 of the sampling rate, where the
# frequencies of `spectral_response` end.
SAMPLES = (10, 2.5)

# Coherence: 0.6 is Tischler and Remple's limit (section 5.5). At 0.2, eight averages leave a
# standard deviation of √((1 - 0.2) / (2 · 0.2 · 8)) = 50 % of the magnitude, the second limit of
# `ERROR`.
COHERENCE = (0.6, 0.2)

# Standard deviation of one component over the magnitude: at 0.1, an interval of 95 % is ±20 % or
# 1.7 dB; at 0.5 it reaches zero.
ERROR = (0.1, 0.5)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: what it is about, how bad it is, the number and the sentence."""

    about: str
    severity: Severity
    value: float
    text: str


@dataclass(frozen=True)
class Band:
    """An octave of the measured response: points, median coherence, relative error and samples per period.

    `coherence` and `error` (standard deviation of one component over the magnitude) are NaN where
    not known.
    """

    low: float
    high: float
    points: int
    coherence: float
    error: float
    samples: float


@dataclass(frozen=True)
class Quality:
    """The verdict on a test: findings, most serious first, and what each octave holds."""

    findings: tuple[Finding, ...]
    bands: tuple[Band, ...] = ()

    @property
    def usable(self) -> bool:
        """False when the test cannot identify anything; the refusals say why."""
        return not self.refusals

    @property
    def refusals(self) -> tuple[str, ...]:
        """The sentences that refuse the test."""
        return tuple(f.text for f in self.findings if f.severity == "refusal")

    def with_findings(self, *findings: Finding) -> "Quality":
        """Return the verdict with more findings, each in its place."""
        return replace(self, findings=_by_severity((*self.findings, *findings)))

    def __repr__(self) -> str:
        return one_line(
            self, "usable" if self.usable else "not usable", counted(len(self.findings), "finding")
        )

    def __str__(self) -> str:
        lines = [f"{f.severity}: {f.text}" for f in self.findings] or ["no problems found"]
        if self.bands:
            header = ["band rad/s", "points", "coherence", "error %", "samples per period"]
            rows = [
                [f"{b.low:.3g} to {b.high:.3g}", str(b.points), number(b.coherence, 3), number(100 * b.error, 2),
                 number(b.samples, 3)]
                for b in self.bands
            ]  # fmt: skip
            lines += ["", text_table(header, rows)]
        return "\n".join(lines)


def check(
    record: Record,
    response: FrequencyResponse | None = None,
    segments: Sequence[Segment] = (),
    *,
    input: str = "u",
    output: str = "theta",
    limits: tuple[float, float] | None = None,
) -> Quality:
    """Judge a test before the fit.

    Parameters
    ----------
    record : Record
        Holds control and output.
    response : FrequencyResponse, optional
        What was estimated from it: its coherence and variances are judged by octave.
    segments : sequence of Segment
        The excited stretches; without them the record's whole length is judged.
    input, output : str
        Signal names.
    limits : (low, high), optional
        Of the control; by default flat tops are looked for.

    Returns
    -------
    Quality
        `usable` is False when the test cannot identify anything.

    Raises
    ------
    KeyError
        For a signal that the record does not hold.
    """
    require_time(record, "a test")
    findings = [
        *_filters(record, (input, output)),
        *_gaps(record, segments),
        *jitter(record),
        *_saturation(_excited(record, segments), input, limits),
        *_amplitude(record, (input, output)),
        *_segments(segments),
        *_spread(response, segments),
        *_length(record, response, segments),
        *_rate(record, response, segments),
        *_precision(response),
    ]
    bands = () if response is None else tuple(_bands(record, response))
    return Quality(_by_severity(findings), bands)


def _by_severity(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    rank = {"refusal": 0, "warning": 1, "note": 2}
    return tuple(sorted(findings, key=lambda f: rank[f.severity]))


def _filters(record: Record, names: Sequence[str]) -> Iterator[Finding]:
    for name in names:
        for known in record.filters.get(name, ()):
            text = f"{name} was logged behind a {known}: fit the plant in series with greybox.models.filters.{known.model}"
            yield Finding("filters", "note", math.nan, f"{text}.")


def _gaps(record: Record, segments: Sequence[Segment]) -> Iterator[Finding]:
    spans = [(s.start, s.end) for s in segments if s.usable] or [(-math.inf, math.inf)]
    before, after = record.time[:-1], record.time[1:]
    within = np.any([(after > start) & (before < end) for start, end in spans], axis=0)
    steps = np.diff(record.time)[within]
    wide = steps[steps > GAP * record.step]
    if wide.size:
        share = wide.sum() / steps.sum()
        severity: Severity = "warning" if share > GAPS else "note"
        text = f"{counted(wide.size, 'gap')}, the longest {wide.max():.2g} s, {100 * share:.2g} % of the time"
        yield Finding(
            "gaps", severity, float(share), f"{text}: nothing is interpolated across them."
        )


def jitter(record: Record) -> Iterator[Finding]:
    """Judge how steadily a message was logged."""
    steps = np.diff(record.time)
    steady = steps[steps <= GAP * record.step]
    jitter = float(np.std(steady) / record.step) if steady.size else 0.0
    if jitter > JITTER:
        text = f"the sampling interval varies by {100 * jitter:.0f} %: use time stamps, as prepare does, not row numbers."
        yield Finding("jitter", "note", jitter, text)


def _excited(record: Record, segments: Sequence[Segment]) -> Record:
    """Return the samples within usable segments, where there are such."""
    inside = np.zeros(len(record), dtype=bool)
    for segment in segments:
        if segment.usable:
            inside |= (record.time >= segment.start) & (record.time <= segment.end)
    return record.rows(np.flatnonzero(inside)) if inside.any() else record


def _saturation(record: Record, name: str, limits: tuple[float, float] | None) -> Iterator[Finding]:
    u = record[name][np.isfinite(record[name])]
    share = float(at_limit(u, limits).mean())
    if share > SATURATED[0]:
        severity: Severity = "refusal" if share > SATURATED[1] else "warning"
        text = f"the control {name} is at a limit for {100 * share:.0f} % of the time: a linear model is wrong there"
        yield Finding("saturation", severity, share, f"{text}; use a smaller amplitude.")


def at_limit(values: Array, limits: tuple[float, float] | None = None) -> BoolArray:
    """Tell which of the values (n,) are at their limits, or in flat tops where these are not known."""
    low, high = limits or (np.nanmin(values), np.nanmax(values))
    margin = AT_LIMIT * (high - low)
    there = (values <= low + margin) | (values >= high - margin)
    if limits is None:  # an extreme value is a limit only if the signal stays there
        there &= np.concatenate([[False], np.diff(values) == 0])
    return there & (high > low)


def _amplitude(record: Record, names: Sequence[str]) -> Iterator[Finding]:
    for name in names:
        values = record[name][np.isfinite(record[name])]
        levels = np.unique(values)
        if levels.size == 1:
            text = (
                f"{name} is constant ({levels[0]:g} throughout): nothing can be identified from it."
            )
            yield Finding("amplitude", "refusal", 0.0, text)
        elif levels.size < LEVELS[0]:
            severity: Severity = "refusal" if levels.size < LEVELS[1] else "warning"
            text = f"{name} takes {levels.size} values only: its amplitude is close to its resolution; excite more."
            yield Finding("amplitude", severity, float(levels.size), text)


def _segments(segments: Sequence[Segment]) -> Iterator[Finding]:
    for segment in segments:
        if not segment.usable:
            text = f"the {segment.kind} from {segment.start:.1f} s is not usable: {'; '.join(segment.findings)}"
            yield Finding("segments", "warning", segment.start, text.rstrip(".") + ".")
    if segments and not any(segment.usable for segment in segments):
        yield Finding(
            "segments",
            "refusal",
            0.0,
            "none of the excited segments is usable: fly the test again.",
        )


def _highest_lowest(
    response: FrequencyResponse | None, segments: Sequence[Segment]
) -> tuple[float, float]:
    if response is not None:
        return float(response.omega.max()), float(response.omega.min())
    ends = [edge for segment in segments if segment.usable for edge in segment.band]
    return (max(ends), min(ends)) if ends else (math.nan, math.nan)


def _spread(response: FrequencyResponse | None, segments: Sequence[Segment]) -> Iterator[Finding]:
    high, low = _highest_lowest(response, segments)
    if math.isnan(high):
        text = "no test segment and no response was given: the excitation has not been judged."
        yield Finding("spread", "note", math.nan, text)
    if response is not None:
        single = len(response) == 1
    else:
        usable = [segment for segment in segments if segment.usable]
        single = bool(usable) and all(segment.kind == "sine" for segment in usable) and high == low
    if single:
        text = f"only {high:g} rad/s is excited: one frequency gives two numbers, too few to identify dynamics"
        yield Finding(
            "spread", "refusal", high, f"{text}; add frequencies around the ones of interest."
        )
    elif high < 2 * low:
        text = f"the excitation covers {low:g} to {high:g} rad/s, less than an octave: few parameters are identifiable."
        yield Finding("spread", "warning", high / low, text)


def _length(
    record: Record, response: FrequencyResponse | None, segments: Sequence[Segment]
) -> Iterator[Finding]:
    usable = [s for s in segments if s.usable]
    if usable:
        fewest = min(usable, key=lambda s: s.periods)
        periods = fewest.periods
        lowest = fewest.band[0]
    else:
        _, lowest = _highest_lowest(response, segments)
        longest = max(piece.duration for piece in record.pieces)
        periods = longest * lowest / (2 * math.pi)
    if periods < PERIODS[1]:
        text = f"the record holds {periods:.2g} periods of its lowest frequency, {lowest:g} rad/s: fly longer."
        yield Finding("length", "refusal", periods, text)
    elif periods < PERIODS[0]:
        text = f"the record holds {periods:.2g} periods of its lowest frequency, {lowest:g} rad/s: errors there are large."
        yield Finding("length", "warning", periods, text)


def _rate(
    record: Record, response: FrequencyResponse | None, segments: Sequence[Segment]
) -> Iterator[Finding]:
    highest, _ = _highest_lowest(response, segments)
    reach = 2 * math.pi * record.rate / SAMPLES[1]
    bands = [segment.band for segment in segments if segment.usable]
    if response is None and any(
        low < reach for low, _ in bands
    ):  # what is above is cut off, or a sine left out
        highest = max(min(high, reach) for low, high in bands if low < reach)
    swept = max((high for low, high in bands if low < high), default=math.nan)
    if swept > reach * (1 + AT_LIMIT) and highest <= reach * (1 + AT_LIMIT):
        text = f"the sweep runs to {swept:.4g} rad/s, but {record.rate:.4g} Hz resolve {reach:.4g} rad/s"
        yield Finding("rate", "note", swept, f"{text}: it is used to {highest:.4g} rad/s.")
    samples = 2 * math.pi * record.rate / highest
    if samples < SAMPLES[0]:
        text = f"there are {samples:.2g} samples per period of the highest frequency, {highest:g} rad/s"
        severity: Severity = "refusal" if samples < SAMPLES[1] * (1 - AT_LIMIT) else "warning"
        yield Finding(
            "rate", severity, samples, f"{text}: log faster, or leave the highest frequencies out."
        )


def _precision(response: FrequencyResponse | None) -> Iterator[Finding]:
    if response is None:
        return
    if response.coherence is not None:
        weak = response.omega[response.coherence < COHERENCE[0]]
        if 0 < weak.size < len(response):
            places = ", ".join(f"{omega:.3g}" for omega in weak[:5]) + (
                " ..." if weak.size > 5 else ""
            )
            text = (
                f"the coherence is below {COHERENCE[0]} at {places} rad/s: leave these points out"
            )
            yield Finding(
                "coherence", "warning", float(weak.size), f"{text}, their errors are understated."
            )
        coherence = float(np.median(response.coherence))
        if coherence < COHERENCE[0]:
            severity: Severity = "refusal" if coherence < COHERENCE[1] else "warning"
            text = f"half of the points have a coherence below {coherence:.2f}: the output is mostly noise"
            yield Finding(
                "coherence", severity, coherence, f"{text} or due to other inputs; excite more."
            )
    if response.variance is not None:
        error = float(np.median(_error(response)))
        if error > ERROR[0]:
            severity = "refusal" if error > ERROR[1] else "warning"
            text = f"half of the points have a standard deviation above {100 * error:.0f} %: excite more or longer."
            yield Finding("noise", severity, error, text)


def _error(response: FrequencyResponse) -> np.ndarray:
    assert response.variance is not None
    return np.sqrt(response.variance / 2) / np.maximum(np.abs(response.response), 1e-300)


def _bands(record: Record, response: FrequencyResponse) -> Iterator[Band]:
    octave = np.floor(np.log2(response.omega / response.omega.min()) + 1e-9).astype(int)
    for k in np.unique(octave):
        there = octave == k
        low, high = response.omega.min() * 2.0**k, response.omega.min() * 2.0 ** (k + 1)
        yield Band(
            low=float(low),
            high=float(high),
            points=int(there.sum()),
            coherence=math.nan
            if response.coherence is None
            else float(np.median(response.coherence[there])),
            error=math.nan
            if response.variance is None
            else float(np.median(_error(response)[there])),
            samples=2 * math.pi * record.rate / float(response.omega[there].max()),
        )
