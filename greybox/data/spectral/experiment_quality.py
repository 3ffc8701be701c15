"""Judges whether a test is worth a fit: findings on the record and on the measured response."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from greybox.data.clock import JITTER
from greybox.data.excited_segment import Segments
from greybox.data.files.arrays import Array
from greybox.data.files.numbers_in_text import number, percent
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.wording import counted, some
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, require_time
from greybox.data.saturation import at_limit
from greybox.data.signal_faults import SignalFault, record_faults, signal_faults
from greybox.data.spectral.uniform_stretches import is_interpolated, longest_stretch

Severity = Literal["note", "warning", "refusal"]


@dataclass(frozen=True)
class Limits:
    """Where a number leads to a warning, and where to a refusal of the test."""

    warning: float
    refusal: float


# Share of the time at a limit. A sine that is clipped for 20 % of the time has a third harmonic of
# 1.2 % and loses as much of its fundamental; at 1 %, both are 2e-6.
SATURATED = Limits(warning=0.01, refusal=0.2)

# Distinct values of a signal. Steps of the resolution have an rms error of step/√12: 12 % of a sine
# across eight values, 27 % of one across four.
LEVELS = Limits(warning=8, refusal=4)

# Periods of the lowest frequency. With two periods, the variance has two degrees of freedom and
# Student's t is 4.3; in less than one, a sine looks like a drift.
PERIODS = Limits(warning=3, refusal=1)

# Samples per period of the highest frequency. Linear interpolation between ten samples takes 3 %
# off the amplitude, and half a sample is 18° of phase; 2.5 samples are 0.4 of the sampling rate,
# where the frequencies of `spectral_response` end.
SAMPLES = Limits(warning=10, refusal=2.5)
ROUNDING = 1e-3  # a frequency may exceed the highest one by this share

# Coherence: 0.6 is Tischler and Remple's limit (section 5.5). At 0.2, eight averages leave a
# standard deviation of √((1 - 0.2) / (2 · 0.2 · 8)) = 50 % of the magnitude.
COHERENCE = Limits(warning=0.6, refusal=0.2)

# Standard deviation of one component over the magnitude: at 0.1, the 95 % interval is ±20 % or
# 1.7 dB; at 0.5, it reaches zero.
ERROR = Limits(warning=0.1, refusal=0.5)


@dataclass(frozen=True)
class Finding:
    """One finding: subject, severity, number, sentence, and the frequencies (rad/s) it concerns."""

    about: str
    severity: Severity
    value: float
    text: str
    omega: tuple[float, ...] = ()


Findings = Iterator[Finding]


@public
@dataclass(frozen=True, repr=False)
class Quality(Printed):
    """The verdict on a test: findings, most serious first."""

    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether the test can identify anything; the refusals say why not."""
        return not self.refusals

    @property
    def refusals(self) -> tuple[str, ...]:
        """The reasons to refuse the test."""
        return tuple(f.text for f in self.findings if f.severity == "refusal")

    def with_findings(self, *findings: Finding) -> "Quality":
        """Return the verdict with more findings, sorted by severity."""
        rank = {"refusal": 0, "warning": 1, "note": 2}
        findings = (*self.findings, *findings)
        return Quality(tuple(sorted(findings, key=lambda f: rank[f.severity])))

    def __str__(self) -> str:
        lines = [f"{f.severity}: {f.text}" for f in self.findings]
        return "\n".join(lines or ["no problems found"])


@public
def check(
    record: Record,
    response: FrequencyResponse | None = None,
    segments: Segments = (),
    *,
    input: str = "u",
    output: str = "theta",
    faults: Sequence[SignalFault] | None = None,
) -> Quality:
    """Judge a test before the fit.

    Parameters
    ----------
    record : Record
        Has the control and the output.
    response : FrequencyResponse, optional
        The response estimated from the record; its coherence and variances are judged.
    segments : sequence of Segment
        The excited stretches; by default, the whole record is judged.
    input, output : str
        Signal names.
    faults : sequence of SignalFault, optional
        What a logger did to the samples, where they were resampled since; by default looked for in
        the record.

    Returns
    -------
    Quality
        The findings; `usable` is False if the test cannot identify anything.

    Raises
    ------
    KeyError
        For a signal that the record does not have.
    """
    require_time(record, "a test")
    usable = [segment for segment in segments if segment.usable]
    ends = [edge for segment in usable for edge in segment.band]
    if response is not None:
        # A response shows what was measured; segments show only what was planned.
        ends = response.omega.tolist()
    band = max(ends, default=math.nan), min(ends, default=math.nan)
    findings = [
        *_filters(record, (input, output)),
        *_gaps(record, usable),
        *jitter(record),
        *_faults(record_faults(record, (output,), (input,)) if faults is None else faults),
        *_unstated_hold(record, input),
        *_saturation(record, usable, input),
        *_amplitude(record, input, output),
        *_segments(segments),
        *_spread(*band),
        *_length(record, band[1], usable),
        *_rate(record, band[0], response, usable),
    ]
    if response is not None:
        findings += [*_coherence(response), *_noise(response)]
    return Quality(()).with_findings(*findings)


def graded(about: str, value: float, limits: Limits, text: str) -> Findings:
    """Yield a warning or a refusal if a number is beyond these limits."""
    sign = 1 if limits.refusal > limits.warning else -1  # too much, or too little
    if sign * value > sign * limits.warning:
        severity = "refusal" if sign * value > sign * limits.refusal else "warning"
        yield Finding(about, severity, value, text)


def _filters(record: Record, names: Sequence[str]) -> Findings:
    for name in names:
        for low_pass in record.filters.get(name, ()):
            text = (
                f"{name} was logged behind a {low_pass}: fit the plant in series with "
                f"greybox.models.filters.{low_pass.model}."
            )
            yield Finding("filters", "note", math.nan, text)


def _gaps(record: Record, segments: Segments) -> Findings:
    spans = [(s.start, s.end) for s in segments] or [(-math.inf, math.inf)]
    # Gaps between tests lose nothing.
    time = record.time
    within = np.any([(time[1:] > start) & (time[:-1] < end) for start, end in spans], axis=0)
    holes = record.clock.holes
    places = holes[within[holes]]
    is_short = is_interpolated(record)[places]
    short, wide = np.diff(time)[places[is_short]], np.diff(time)[places[~is_short]]
    if short.size:
        count = int(np.sum(np.rint(short / record.step) - 1))
        share = count / (count + np.count_nonzero(within))
        text = (
            f"{counted(count, 'lost row')} in {counted(short.size, 'short gap')} "
            f"({percent(share)} %): spectra are interpolated across."
        )
        yield Finding("gaps", "note", share, text)
    if wide.size:
        share = wide.sum() / np.diff(time)[within].sum()
        # Nothing is interpolated across gaps: a larger share costs data but not accuracy, so the
        # limit is a convention.
        severity = "warning" if share > 0.01 else "note"
        text = (
            f"{counted(wide.size, 'gap')}, the longest {wide.max():.2g} s, "
            f"{'takes' if wide.size == 1 else 'take'} {100 * share:.2g} % of the time: nothing is "
            "interpolated across."
        )
        yield Finding("gaps", severity, float(share), text)


def _faults(faults: Sequence[SignalFault]) -> Findings:
    for fault in faults:
        # Where no sample is right, no point of a response is: errors reach fifty stated ones.
        severity = "warning" if fault.rows.size else "refusal"
        yield Finding("samples", severity, math.nan, str(fault))


def _unstated_hold(record: Record, input: str) -> Findings:
    """Say how much the response changes if the input is held, where nothing states it."""
    if input in record.hold:
        return
    half = 500 * record.step
    text = (
        f"nothing states how {input} runs between its samples: if each is held until the next, as "
        f"commands of a controller are, {number(half, 3)} ms of the delay belong to the hold. "
        f"State it: {input} [held] in the header of the table, or hold={{{input!r}: np.inf}}."
    )
    # Its values may be steps of a command, or those of a slower log.
    for fault in signal_faults(input, record[input], (), is_command=True, hold=0.0):
        if fault.kind == "held":
            text += f" If it is no command that was held, {fault}"
    yield Finding("hold", "note", half, text)


def single_losses(record: Record) -> Findings:
    """Yield a finding on rows that are lost one at a time, which `prepare` interpolates."""
    steps = np.diff(record.time) / record.step
    count = int(np.count_nonzero(np.abs(steps - 2) < JITTER))
    if count and record.clock.kind in ("uniform", "regular"):
        share = count / (count + len(record))
        lost = counted(count, "single row")
        text = f"{lost} {'is' if count == 1 else 'are'} lost ({percent(share)} %): interpolated."
        yield Finding("gaps", "note", share, text)


def jitter(record: Record) -> Findings:
    """Yield a finding if the sampling interval varies."""
    steps = np.diff(record.time)
    # Gaps have a finding of their own.
    steady = np.delete(steps, record.clock.holes)
    jitter = float(np.std(steady) / record.step) if steady.size else 0.0
    # If rows are taken for times, a
    # signal of ten samples per period then has a phase error of 2π/10 · 0.1 = 0.06 rad.
    if jitter > 0.1:
        text = (
            f"the sampling interval varies by {100 * jitter:.0f} %: use the time stamps, as "
            "gb.prepare does, not row numbers."
        )
        yield Finding("jitter", "note", jitter, text)


def _saturation(record: Record, segments: Segments, name: str) -> Findings:
    within = [record.during(s.start, s.end) for s in segments]
    rows = np.flatnonzero(np.any(within, axis=0))
    # Without segments, the whole record is judged.
    values = record[name][rows] if rows.size else record[name]
    share = float(at_limit(values[np.isfinite(values)]).mean())
    text = (
        f"the control {name} rests at its largest or smallest value for {100 * share:.0f} % of the "
        "time, as at a limit, where a linear model is wrong: use a smaller amplitude, unless the "
        "test holds these values by design, as pulses do."
    )
    yield from graded("saturation", share, SATURATED, text)


def _amplitude(record: Record, control: str, output: str) -> Findings:
    for name in (control, output):
        levels = np.unique(record[name][np.isfinite(record[name])])
        if levels.size == 1:
            text = f"{name} is constant ({levels[0]:g} throughout): it has no information."
            yield Finding("amplitude", "refusal", 0.0, text)
        # Two values of a control are a binary sequence, whose amplitude is exact.
        elif levels.size > 2 or name != control:
            yield from graded(
                "amplitude",
                float(levels.size),
                LEVELS,
                f"{name} takes only {levels.size} values: its amplitude is close to its "
                "resolution; use a larger one.",
            )


def _segments(segments: Segments) -> Findings:
    for segment in segments:
        if not segment.usable:
            reasons = "; ".join(segment.findings).rstrip(".")
            text = f"the {segment.kind} from {segment.start:.1f} s is not usable: {reasons}."
            yield Finding("segments", "warning", segment.start, text)
    if segments and not any(segment.usable for segment in segments):
        text = "no excited segment is usable: fly the test again."
        yield Finding("segments", "refusal", 0.0, text)


def _spread(high: float, low: float) -> Findings:
    if math.isnan(high):
        text = "there is no test segment and no response: the excitation was not judged."
        yield Finding("spread", "note", math.nan, text)
    elif high == low:
        text = (
            f"only {high:g} rad/s is excited: one frequency gives two numbers, too few to identify "
            "dynamics; add frequencies around the ones of interest."
        )
        yield Finding("spread", "refusal", high, text)
    elif high < 2 * low:
        text = (
            f"the excitation covers {low:g} to {high:g} rad/s, less than an octave: few parameters "
            "are identifiable."
        )
        yield Finding("spread", "warning", high / low, text)


def _length(record: Record, lowest: float, segments: Segments) -> Findings:
    if segments:
        # The shortest test has the largest errors.
        fewest = min(segments, key=lambda s: s.periods)
        periods = fewest.periods
        lowest = fewest.band[0]
    else:
        # Nothing is estimated across a long gap.
        periods = longest_stretch(record) * lowest / math.tau
    yield from graded(
        "length",
        periods,
        PERIODS,
        f"the record has {periods:.2g} periods of its lowest frequency, {lowest:g} rad/s: the "
        "errors there are large; fly longer.",
    )


def _rate(
    record: Record,
    highest: float,
    response: FrequencyResponse | None,
    segments: Segments,
) -> Findings:
    reach = math.tau * record.rate / SAMPLES.refusal
    bands = [segment.band for segment in segments]
    if response is None and any(low < reach for low, _ in bands):
        # Sweeps are cut off at this frequency, and sines above it are left out.
        highest = max(min(high, reach) for low, high in bands if low < reach)

    swept = max((high for low, high in bands if low < high), default=math.nan)
    if swept > reach * (1 + ROUNDING) and highest <= reach * (1 + ROUNDING):
        text = (
            f"the sweep runs to {swept:.4g} rad/s, but {record.rate:.4g} Hz resolve only "
            f"{reach:.4g} rad/s: it is used up to {highest:.4g} rad/s."
        )
        yield Finding("rate", "note", swept, text)

    samples = math.tau * record.rate / highest
    text = f"there are {samples:.2g} samples per period of the highest frequency, {highest:g} "
    yield from graded(
        "rate",
        samples,
        Limits(SAMPLES.warning, SAMPLES.refusal * (1 - ROUNDING)),
        text + "rad/s: log faster, or leave out the highest frequencies.",
    )


def frequencies(omega: Array) -> str:
    """Return frequencies (n,) in rad/s as text: the first ones, and the number of the others."""
    return some([f"{w:.3g}" for w in omega]) + " rad/s"


def _noise(response: FrequencyResponse) -> Findings:
    if response.variance is None:
        return
    errors = response.relative_error
    error = float(np.median(errors))
    yield from graded(
        "noise",
        error,
        ERROR,
        f"half of the points have a standard deviation above {100 * error:.0f} %: excite more or "
        "longer.",
    )
    useless = response.omega[errors > ERROR.refusal]
    if useless.size and error <= ERROR.refusal:
        text = (
            f"the standard deviation is above {100 * ERROR.refusal:.0f} % of the magnitude at "
            f"{frequencies(useless)}: these points hardly count in a fit."
        )
        yield Finding("noise", "note", float(useless.size), text)


def _coherence(response: FrequencyResponse) -> Findings:
    if response.coherence is None:
        return
    weak = response.omega[response.coherence < COHERENCE.warning]
    if 0 < weak.size < response.omega.size:
        text = (
            f"the coherence is below {COHERENCE.warning} at {frequencies(weak)}: "
            "leave out these points, whose errors are understated."
        )
        yield Finding("coherence", "warning", float(weak.size), text, tuple(weak.tolist()))

    median = float(np.median(response.coherence))
    yield from graded(
        "coherence",
        median,
        COHERENCE,
        f"half of the points have a coherence below {median:.2f}: the output is mostly noise or "
        "the effect of other inputs; excite more.",
    )
