"""From the tests of a log to a measured frequency response, with every choice.

Begin with `measure`.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np

from greybox.data.excited_segment import Segment, Segments, segment_table
from greybox.data.files.arrays import Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import non_empty
from greybox.data.files.numbers_in_text import number, percent
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.files.wording import counted, listed
from greybox.data.frequency_band import require_band
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.intersample import HOLD, described_unstated_hold
from greybox.data.logs.ardupilot.truncated_angles import STEP, is_truncated
from greybox.data.logs.flight_controllers import axis_of, named_filters
from greybox.data.logs.injected_tests import INJECTED
from greybox.data.logs.known_filters import KnownFilters, in_series
from greybox.data.logs.prepare import prepare
from greybox.data.logs.segment_detection import find_segments, present
from greybox.data.record import Record, Recording
from greybox.data.repetition import period_of
from greybox.data.spectral.experiment_quality import (
    Finding,
    Findings,
    Quality,
    check,
    frequencies,
    jitter,
    single_losses,
)
from greybox.data.spectral.frequency_points import FiniteFrequency
from greybox.data.spectral.multisine_lines import periodic_response
from greybox.data.spectral.single_sine import finite_frequency
from greybox.data.spectral.sweeps_and_noise import spectral_response
from greybox.data.units import known_unit
from greybox.workflows.identification.logged_faults import Repaired, repaired
from greybox.workflows.identification.loop import controller_in, loop_text
from greybox.workflows.identification.orders import LinearFit, Orders, best_response, linear_fits
from greybox.workflows.identification.systematic_errors import (
    hold_error,
    motor_saturation,
    systematic_errors,
    truncation_error,
    with_systematic_errors,
)

# Names of the injected signal and of the setpoint among the signals of a measurement.
INSTRUMENT = "instrument"
SETPOINT = "setpoint"

# Subjects of findings that judge the estimate, not the record.
OF_ESTIMATE = ("response", "coherence", "noise")

# Share by which the band of a sweep is extended: the ends of a sweep that is found in a setpoint
# are known from periods of a few samples.
UNCERTAIN_BAND = 0.02

# Fewest points to which a rational function is fitted: their six numbers are more than the smallest
# rational function has unknowns.
FEWEST_REFINED = 3

FEEDBACK = (
    "In a loop, output noise returns through the controller to the input, and biases the direct "
    "estimate toward minus the inverse of the controller"
)


@public
@dataclass(frozen=True)
class Settings:
    """What to measure, and how.

    Attributes
    ----------
    input, output : str
        ``"MESSAGE.Field"``, or with a name of your own ``"u=RATE.POut"``.
    instrument : str
        The injected signal; by default the one that the log states, or the setpoint in which the
        tests were found.
    announced, fields, setpoint
        Where to find the tests, see `greybox.logs.find_segments`.
    axis, tests : str
        Use only the tests of this axis, or these numbers, ``"1,3-5"``.
    rate : float, Hz, optional
    band : (low, high), rad/s, optional
        By default where the excitation is strong.
    settle, period : float, s
        Settling time of a sine; period of a multisine.
    whole : bool
        Use the whole log if no test is found.
    open_loop : bool
        Make the direct estimate, whatever controller the log shows.
    points : int
        Number of frequencies of a sweep.
    conditioned : sequence of str
        Further inputs that move with this one in a sweep or noise, as ``"MESSAGE.Field"`` or with a
        name. Their effect on the output is removed, see `spectral_response`.
    drop_warned : bool
        Leave out the frequencies that the check of the response warns about.
    refined : bool
        Measure sweeps and noise twice: the second time, the local polynomials describe what the
        best rational function leaves.
    """

    input: str
    output: str
    instrument: str = ""
    announced: str = ""
    fields: Mapping[str, str] = field(default_factory=dict)
    setpoint: str = ""
    axis: str = ""
    tests: str = ""
    rate: float | None = None
    band: Interval | None = None
    settle: float = 2.0
    period: float | None = None
    whole: bool = False
    open_loop: bool = False
    points: int = 40
    conditioned: Sequence[str] = ()
    drop_warned: bool = False
    refined: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError for settings that are invalid for any log."""
        if not 0 <= self.settle < math.inf:
            raise ValueError(f"settle={self.settle} must be a number of seconds of at least 0.")
        if self.period is not None and not 0 < self.period < math.inf:
            raise ValueError(
                f"period={self.period:g} must be a number of seconds above 0: leave it out if it "
                "is not known."
            )
        if not 2 <= self.points <= 10_000:
            raise ValueError(f"points={self.points} must lie between 2 and 10000.")
        if self.band is not None:
            require_band(self.band)
        if self.instrument and self.open_loop:
            raise ValueError(
                "open_loop=True asks for the direct estimate, instrument=... for the joint one: "
                "give one of them."
            )
        if self.conditioned and self.period:
            raise ValueError(
                "conditioned=... is for sweeps and noise: multisines on several inputs make a "
                "matrix of responses, which gb.identification.measure_matrix measures."
            )
        _require_consistent(self)

    @property
    def names(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Name and signal of input and output; the name is that of the field by default."""
        return named_signal(self.input), named_signal(self.output)


def _require_consistent(settings: Settings) -> None:
    """Raise ValueError for signals and names that are given twice, reserved or incomplete."""
    arguments = [f"input={settings.input}", f"output={settings.output}"]
    arguments += [f"conditioned={text}" for text in settings.conditioned]
    names_and_signals = [*settings.names, *map(named_signal, settings.conditioned)]
    for j, k in combinations(range(len(arguments)), 2):
        name, signal = names_and_signals[j]
        other_name, other_signal = names_and_signals[k]
        if name == other_name or signal == other_signal:
            raise ValueError(
                f"{arguments[j]} and {arguments[k]} are the same signal or have the same name."
            )
    if settings.fields and not settings.announced:
        raise ValueError(
            f"fields={dict(settings.fields)} are those of a message that announces tests: give "
            "announced=MESSAGE too."
        )
    _, (_, output) = settings.names
    if settings.instrument == output:
        raise ValueError(
            f"instrument={settings.instrument} is the output, whose noise is not independent of "
            "it: give the injected signal."
        )
    for name, _ in names_and_signals:
        if name in (INSTRUMENT, SETPOINT):
            raise ValueError(
                f"the name {name!r} is reserved: give the signal another name, NAME=SIGNAL."
            )


def named_signal(text: str) -> tuple[str, str]:
    """Return name and signal of ``"u=RATE.POut"``; the name is that of the field by default."""
    name, equals, signal = text.partition("=")
    return (name, signal) if equals else (text.rpartition(".")[2], text)


def named_signals(texts: Sequence[str]) -> Mapping[str, str]:
    """Return signals by name; raise ValueError if two have the same name."""
    signals = dict(map(named_signal, texts))
    if len(signals) < len(texts):
        raise ValueError(
            "two signals have the same name: give them names of your own, NAME=SIGNAL."
        )
    return signals


@public
@frozen
class Measurement:
    """A measurement from a log; printed, it is a report.

    Attributes
    ----------
    settings : Settings
    tests, used : tuple of Segment
        The tests that were found and chosen, and those that the response is from.
    signals : mapping of name to "MESSAGE.Field"
    record : Record
        The signals on one time base.
    response : FrequencyResponse or None
        None if it was refused; `quality` has the reason.
    quality : Quality
    filters : mapping of str to tuple of KnownFilter
        Filters of the flight controller by name, if the log has their parameters.
    controller : str
        The signal that shows a closed loop; empty without one.
    detail : str
        The response in words; sines as a table.
    linear : mapping of Orders to LinearFit
        The rational functions that were fitted to refine the response.
    """

    settings: Settings
    tests: tuple[Segment, ...]
    used: tuple[Segment, ...]
    signals: Mapping[str, str]
    record: Record
    response: FrequencyResponse | None
    quality: Quality
    filters: KnownFilters
    controller: str
    detail: str
    linear: Mapping[Orders, LinearFit]

    @property
    def choices(self) -> tuple[str, ...]:
        """What was chosen and dropped, and why."""
        loop = "open loop, as stated" if self.settings.open_loop else loop_text(self.controller)
        choices = [f"{loop}: {self._estimate_text}"]
        conditioned = ", ".join(self.settings.conditioned)
        if conditioned:
            choices.append(f"conditioned: the effect of {conditioned} is removed.")
        about = self.response.about if self.response else {}
        for name in ("dropped", "left out", "converted", "refined", HOLD):
            if name in about:
                choices.append(f"{name}: {about[name]}.")
        unstated = described_unstated_hold(about)
        if unstated:
            choices.append(f"hold of the input: {unstated}.")
        return tuple(choices)

    @property
    def _estimate_text(self) -> str:
        """How the response was estimated."""
        if self.used and self.used[0].kind == "sine":
            return (
                "amplitudes at the frequency of the excitation, whose ratio feedback does not bias."
            )
        if self.settings.period:
            return "averages over whole periods: the more periods, the less bias by feedback."
        if INSTRUMENT in self.signals:
            return (
                "joint input-output estimate with the instrument "
                f"{self.signals[INSTRUMENT]}. {FEEDBACK}."
            )
        return (
            "direct estimate; in a closed loop, give the injected signal for the joint "
            "estimate, instrument=..."
        )

    @property
    def brief(self) -> str:
        """The tests and the response in one line, how it was estimated, and its verdict."""
        return "\n".join(filter(None, [self._extent, *self.choices, str(self.quality)]))

    @property
    def _extent(self) -> str:
        """Which tests were used, and which frequencies the response has."""
        texts = []
        if self.used:
            kinds = Counter(segment.kind for segment in self.used)
            tests = listed([counted(count, kind) for kind, count in kinds.items()])
            texts.append(f"{tests} from {self.used[0].start:.1f} to {self.used[-1].end:.1f} s")
        if self.response is not None:
            omega = self.response.omega
            points = counted(len(omega), "frequency", "frequencies")
            texts.append(f"{points} from {number(omega[0], 4)} to {number(omega[-1], 4)} rad/s")
        if self.response is not None and self.response.variance is not None:
            # A variance is that of both components.
            errors = np.sqrt(self.response.variance / 2) / np.abs(self.response.response)
            texts.append(f"errors of {percent(errors.min())} to {percent(errors.max())} %")
        return f"{'; '.join(texts)}." if texts else ""

    def __repr__(self) -> str:
        return one_line(self, repr(self.response), repr(self.quality))

    def __str__(self) -> str:
        parts = (
            segment_table(self.tests) if self.tests else "",
            "\n".join(self.choices),
            self.detail,
            str(self.quality),
        )
        return "\n\n".join(part for part in parts if part)


@public
def measure(recording: Recording, settings: Settings) -> Measurement:
    """Measure the response of the tests in a log.

    Raises
    ------
    KeyError, ValueError
        For unknown signals and tests, and for a closed loop without a known excitation.
    """
    tests, used = _tests_and_used(recording, settings)
    are_sines = bool(used) and used[0].kind == "sine"
    (u, control), (y, output) = settings.names
    instrument = _instrument(recording, settings, used)
    controller = ""
    if not settings.open_loop:
        controller = controller_in(recording, [control], [output]) or settings.setpoint
    if controller and not (are_sines or instrument or settings.period):
        _refuse_closed_loop(recording, settings, controller)
    signals = _signals(settings, instrument)
    spans = [(segment.start, segment.end) for segment in used]
    record, log = _prepared(recording, settings, used, signals)
    recording = log.recording
    # The jitter is that of the log: the time stamps of the record are uniform.
    logged_output, _ = recording.locate(output)
    logged_output = logged_output.between(*record.span)
    # Tests that were refused stay among the judged ones, so that the verdict names them.
    judged = [segment for segment in tests if segment in used or not segment.usable]

    def quality_of(response: FrequencyResponse | None) -> Quality:
        quality = check(record, response, judged, input=u, output=y, faults=log.remaining or None)
        of_log = *jitter(logged_output), *single_losses(logged_output), *log.findings
        return quality.with_findings(*of_log)

    quality = quality_of(None)
    response = None
    detail = ""
    linear = {}
    # Between tests the vehicle is flown by hand, in closed loop and without an instrument.
    spans = spans or [record.span]
    pieces = [record.between(*span) for span in spans]

    estimated = partial(_estimated, spans=spans, sines=used if are_sines else (), settings=settings)
    if quality.usable:
        try:
            response, points, linear = estimated(record)
            amplitudes = np.array([abs(point.u) for point in points.points]) if points else None
            errors = [
                *systematic_errors(recording, record, response, control, used, amplitudes),
                *truncation_error(
                    recording, record, response, output, lambda other: estimated(other)[0]
                ),
                *hold_error(response),
            ]
            response = with_systematic_errors(response, errors)
            detail = str(response)
            # The table of sines shows the errors of the response, including the systematic ones.
            if points:
                detail = points.with_variance(response.variance).table
            quality = quality_of(response).with_findings(
                *_on_points(points),
                *_beyond_sweep(response, used),
                *motor_saturation(recording, control, spans),
                *(error.finding for error in errors),
            )
            if settings.drop_warned:
                response = _without_warned(response, quality)
        except ValueError as error:
            refused = Finding("response", "refusal", math.nan, " ".join(str(error).split()))
            quality = quality.with_findings(refused)
        if not (are_sines or settings.period):
            quality = _with_period(quality, pieces, u)
    filters = named_filters(recording, axis_of(control))
    if response is not None:
        about = _about(recording, record, response, signals, filters, used, settings)
        response = replace(response, about=about)
    return Measurement(
        settings=settings,
        tests=tests,
        used=tuple(used),
        signals=signals,
        record=record,
        response=response,
        quality=quality,
        filters=filters,
        controller=controller,
        detail=detail,
        linear=linear,
    )


def _signals(settings: Settings, instrument: str) -> dict[str, str]:
    """Return all signals of a measurement by name."""
    # They get one time base, so that a gap in one of them is a gap of the estimate.
    signals = dict(settings.names)
    if instrument:
        signals[INSTRUMENT] = instrument
    if settings.setpoint:
        signals[SETPOINT] = settings.setpoint
    return {**signals, **named_signals(settings.conditioned)}


def _tests_and_used(
    recording: Recording, settings: Settings
) -> tuple[tuple[Segment, ...], list[Segment]]:
    """Return the chosen tests, and those that are evaluated: sines, or else all usable ones."""
    tests: tuple[Segment, ...] = ()
    # A multisine of a stated period is evaluated over the whole log.
    if not settings.period:
        tests = tuple(_chosen(found_tests(recording, settings), settings))
    usable = [segment for segment in tests if segment.usable]
    sines = [segment for segment in usable if segment.kind == "sine"]
    # Sines are evaluated at their own frequency and sweeps over a band: one estimate cannot do
    # both, and sines are more exact.
    used = sines or usable
    if not used and not tests and not (settings.whole or settings.period or settings.instrument):
        raise ValueError(
            "no test was found: give setpoint=..., announced=... or instrument=..., or whole=True "
            "for the whole log."
        )
    _require_one_axis(used)
    if sines and settings.band is not None:
        used = _within_band(sines, settings.band)
    return tests, used


def _prepared(
    recording: Recording, settings: Settings, used: Segments, signals: Mapping[str, str]
) -> tuple[Record, Repaired]:
    """Return the signals of the used tests on one time base, without samples of faults."""
    start = min((segment.start for segment in used), default=-math.inf)
    end = max((segment.end for segment in used), default=math.inf)
    rate = _rate(recording, settings, used)
    record = prepare(recording, signals, rate, start=start, end=end)
    (u, control), (y, output) = settings.names
    log = repaired(recording, {y: output}, {u: control}, record.span)
    if log.removed:
        record = prepare(log.recording, signals, rate, start=start, end=end)
    return record, log


def _refuse_closed_loop(recording: Recording, settings: Settings, controller: str) -> None:
    """Refuse a direct estimate under feedback; signals that do not exist are refused first."""
    for _, signal in settings.names:
        recording.locate(signal)
    raise ValueError(
        f"{recording.source or 'the log'} was flown in closed loop ({controller} is in it) and "
        "no excitation is known, so that a direct estimate tends to minus the inverse of the "
        "controller, whatever its coherence: give the injected signal, instrument=SIGNAL, or "
        "open_loop=True if you know that the loop was open."
    )


def found_tests(recording: Recording, settings: Settings) -> tuple[Segment, ...]:
    """Return the tests that the settings find."""
    segments = find_segments(recording, settings.announced, settings.fields, settings.setpoint)
    # A column r is a setpoint in one log and the yaw rate in another; an output is not a setpoint.
    _, output = settings.names[1]
    measured = {f"setpoint {output}", f"setpoint {output.rpartition('.')[2]}"}
    return tuple(segment for segment in segments if segment.source not in measured)


def _chosen(segments: Segments, settings: Settings) -> list[Segment]:
    """Return the tests with the stated numbers and axis; raise ValueError if there are none."""
    chosen = list(segments)
    if settings.tests:
        chosen = [segments[k - 1] for k in _numbers(settings.tests, len(segments))]
    if settings.axis:
        axes = unique(segment.axis for segment in chosen)
        chosen = [segment for segment in chosen if segment.axis == settings.axis]
        if not chosen:
            raise ValueError(
                f"no test has the axis {settings.axis!r}; there are {', '.join(axes) or 'none'}."
            )
    return chosen


def _numbers(text: str, count: int) -> Iterator[int]:
    """Yield the numbers, from 1 to `count`, in a text such as ``"1,3-5"``."""
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:-(\d+))?\s*", part)
        if not match:
            raise ValueError(
                f"tests={text!r} is not understood: write numbers and ranges, e.g. 1,3-5."
            )
        first, last = int(match[1]), int(match[2] or match[1])
        if not 1 <= first <= last <= count:
            raise ValueError(
                f"tests={part.strip()!r} must lie between 1 and {count}, the number of tests, and "
                "a range must not run backwards."
            )
        yield from range(first, last + 1)


def _require_one_axis(used: Segments) -> None:
    """Raise ValueError if the tests are of several axes."""
    axes = unique(segment.axis for segment in used)
    if len(axes) > 1:
        raise ValueError(
            f"the tests are of several axes ({', '.join(axes)}): choose one, such as "
            f"axis={axes[0]!r}."
        )


def _within_band(sines: Segments, band: Interval) -> list[Segment]:
    """Return the sines with frequencies in the band; raise ValueError if there are none."""
    low, high = band
    within = [segment for segment in sines if low <= segment.omega <= high]
    if not within:
        listed = ", ".join(f"{segment.omega:.4g}" for segment in sines)
        raise ValueError(
            f"no sine lies in the band from {low:g} to {high:g} rad/s; there are {listed} rad/s."
        )
    return within


def _instrument(recording: Recording, settings: Settings, used: Segments) -> str:
    """Return the injected signal of sweeps and noise: stated, or where the tests were found."""
    # With an open loop as stated, there is no instrument.
    if settings.instrument or settings.open_loop:
        return settings.instrument
    if not used:
        return settings.setpoint
    if used[0].kind == "sine":
        return ""
    # SIDD logs the injected signal itself, whatever axis it was added to.
    if used[0].source == "SIDS":
        return next(iter(present(recording, ["SIDD.Targ"])), settings.setpoint)
    # Other tests were found in a setpoint, or in an injected signal.
    return used[0].source.removeprefix("setpoint ").removeprefix(INJECTED)


def _rate(recording: Recording, settings: Settings, used: Segments) -> float | None:
    """Return the stated rate, or that of input and output if a signal is injected."""
    if settings.rate is not None or not used or not used[0].source.startswith(INJECTED):
        return settings.rate
    # The injected signal is held, so that its messages may be slower than the others.
    rates = []
    for _, signal in settings.names:
        record, _ = recording.locate(signal)
        rates.append(1 / record.step)
    return min(rates)


def _estimated(
    record: Record, spans: Sequence[Interval], sines: Segments, settings: Settings
) -> tuple[FrequencyResponse, FiniteFrequency | None, dict[Orders, LinearFit]]:
    """Estimate the response.

    Returns
    -------
    response : FrequencyResponse
    points : FiniteFrequency or None
        The points of sine tests; None for other tests.
    linear : mapping of Orders to LinearFit
        The rational functions that refined the estimate; empty without.
    """
    (u, _), (y, _) = settings.names
    if sines:
        if settings.conditioned:
            raise ValueError("conditioned=... is for sweeps and noise, and the tests are sines.")
        estimate = finite_frequency(
            record,
            sines,
            input=u,
            output=y,
            setpoint=settings.setpoint and SETPOINT,
            settle=settings.settle,
        )
        about = dict(estimate.response.about)
        if estimate.left_out:
            about["dropped"] = f"{len(estimate.left_out)} of {counted(len(sines), 'test')}"
        return replace(estimate.response, about=about), estimate, {}

    instrument = INSTRUMENT if INSTRUMENT in record.signals else None
    pieces = [record.between(*span) for span in spans]
    linear = {}
    if settings.period:
        measured = periodic_response(
            pieces, settings.period, u, y, instrument=instrument, name=record.name
        )
        if settings.band is not None:
            measured = measured.between(*settings.band)
    else:
        estimate = partial(
            spectral_response,
            pieces,
            u,
            y,
            instrument=instrument,
            conditioned=[*named_signals(settings.conditioned)],
            band=settings.band,
            points=settings.points,
            name=record.name,
        )
        measured = estimate()
        # At the lowest frequencies, a response changes much from line to line, and the error of the
        # polynomials exceeds the noise. For the remainder of a rational function, it is far below.
        if settings.refined and len(measured) >= FEWEST_REFINED:
            linear = linear_fits([measured.without_hold()])
            measured = estimate(near=partial(best_response, linear))
            about = {"refined": "the polynomials describe what the best rational function leaves"}
            measured = replace(measured, about={**measured.about, **about})
    return measured, None, linear


def _with_period(quality: Quality, pieces: Sequence[Record], control: str) -> Quality:
    """Add a finding if the excitation repeats itself: it has power only at its own lines.

    An estimate over a band cannot distinguish these lines from noise. Its own refusal is then
    replaced by this finding, which states the cause.
    """
    longest = max(pieces, key=len)
    excitation, title = control, control
    if INSTRUMENT in longest.signals:
        excitation, title = INSTRUMENT, "the instrument"
    period = longest.step * period_of(longest[excitation])
    if math.isnan(period):
        return quality
    text = (
        f"{title} repeats itself every "
        f"{number(period, 6)} s, as multisines do, and has power only at its own lines: state it, "
        f"period={number(period, 6)}."
    )
    if quality.usable:
        return quality.with_findings(Finding("period", "note", period, text))
    others = [f for f in quality.findings if f.about not in OF_ESTIMATE]
    return Quality(tuple(others)).with_findings(Finding("period", "refusal", period, text))


def _on_points(points: FiniteFrequency | None) -> Findings:
    """Yield the findings on the points of sine tests."""
    if points is None:
        return
    for point in points.points:
        for text in point.findings:
            about = f"{point.omega:g} rad/s: {text}."
            yield Finding("sines", "warning", math.nan, about, (point.omega,))
    for segment, reason in points.left_out:
        text = f"{segment.kind} from {segment.start:.1f} s left out: {reason}."
        yield Finding("sines", "warning", math.nan, text)
    for text in points.notes:
        yield Finding("sines", "note", math.nan, f"{text}.")


def _beyond_sweep(response: FrequencyResponse, used: Segments) -> Findings:
    """Yield a warning on the points beyond the sweeps, which only their transients excite."""
    # A test that is not a sweep may excite any frequency.
    bands = [segment.band for segment in used if segment.kind == "sweep"]
    if not bands or len(bands) < len(used):
        return
    omega = response.omega
    # A gap in the log that cuts a sweep leaves a hole between two bands.
    is_excited = np.zeros(len(omega), dtype=bool)
    for low, high in bands:
        is_below = omega < (1 - UNCERTAIN_BAND) * low
        is_above = omega > (1 + UNCERTAIN_BAND) * high
        is_excited |= ~(is_below | is_above)
    beyond = omega[~is_excited]
    if beyond.size:
        text = f"{counted(beyond.size, 'point')} beyond the sweep, at {frequencies(beyond)}."
        yield Finding("band", "warning", math.nan, text, tuple(beyond.tolist()))


def _without_warned(response: FrequencyResponse, quality: Quality) -> FrequencyResponse:
    """Return the response without the points that a warning names, and with a note on them."""
    warned: set[float] = set()
    for finding in quality.findings:
        if finding.severity == "warning":
            warned.update(finding.omega)
    is_warned = np.isin(response.omega, [*warned])
    # A warning on all points stays: without them, nothing would remain.
    if not is_warned.any() or is_warned.all():
        return response
    places = ", ".join(f"{omega:.4g}" for omega in response.omega[is_warned])
    count = counted(int(is_warned.sum()), "point")
    text = f"{count} of {is_warned.size} at {places} rad/s (see the warnings)"
    return replace(response.where(~is_warned), about={**response.about, "left out": text})


def _about(
    recording: Recording,
    record: Record,
    response: FrequencyResponse,
    signals: Mapping[str, str],
    filters: KnownFilters,
    used: Segments,
    settings: Settings,
) -> Mapping[str, str]:
    """Return the origin of a response, for its file."""
    filter_texts = []
    for name in (response.input, response.output):
        for known in record.filters.get(name, ()):
            filter_texts.append(f"{name} was logged behind a {known}")
    band = ""
    if settings.band is not None:
        low, high = settings.band
        band = f"{low:.5g} to {high:.5g} rad/s"
    return non_empty(
        {
            "log": recording.source,
            "log sha256": recording.checksum,
            "signals": ", ".join(f"{name} = {signal}" for name, signal in signals.items()),
            "converted": ", ".join(_conversions(recording, signals)),
            "sampling": f"{record.rate:.5g} Hz",
            "excitation": _excitation(used),
            "estimate": _kind(signals, used, settings),
            "filter": "; ".join(filter_texts),
            **{name: in_series(known) for name, known in filters.items()},
            "band": band,
            **response.about,
        }
    )


def _kind(signals: Mapping[str, str], used: Segments, settings: Settings) -> str:
    """Return the kind of the estimate, in words."""
    if used and used[0].kind == "sine":
        return "single sines"
    kind = "periodic" if settings.period else "spectral"
    if INSTRUMENT in signals:
        return f"{kind}, joint input-output with {signals[INSTRUMENT]}"
    return f"{kind}, direct"


def _excitation(used: Segments) -> str:
    """Return number, axis, amplitudes, band and times of the tests, in words."""
    if not used:
        return ""
    axis = f" of {used[0].axis}" if used[0].axis else ""
    amplitude = ""
    amplitudes = [segment.amplitude for segment in used if math.isfinite(segment.amplitude)]
    if amplitudes:
        ends = unique((number(min(amplitudes), 3), number(max(amplitudes), 3)))
        amplitude = f", amplitude {' to '.join(ends)} {used[0].unit}".rstrip()
    lowest = min(segment.band[0] for segment in used)
    highest = max(segment.band[1] for segment in used)
    band = f"{lowest:.4g} to {highest:.4g} rad/s"
    start = min(segment.start for segment in used)
    end = max(segment.end for segment in used)
    times = f"{start:.2f} to {end:.2f} s"
    return f"{counted(len(used), used[0].kind)}{axis}{amplitude}, {band}, {times}"


def _conversions(recording: Recording, signals: Mapping[str, str]) -> Iterator[str]:
    """Yield which signals were converted to SI, and from which unit."""
    for name, signal in signals.items():
        log, field_name = recording.locate(signal)
        unit = log.units.get(field_name, "")
        conversion = known_unit(unit)
        if conversion and conversion.changes:
            text = f"{name} from {unit} to {conversion.si}"
            if unit == "deg" and is_truncated(signal, log[field_name]):
                text += f" with half a step of {STEP} {unit}, which the log truncates"
            yield text
