"""The commands that begin with a log: `greybox inspect` and `greybox response`."""

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.cli.command import FAILED, USABLE, Answer, known
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment, segment_table
from greybox.data.text_table import number, text_table
from greybox.logs.prepare import prepare
from greybox.logs.readers import read
from greybox.logs.segment_detection import find_segments
from greybox.spectral.composite_windows import spectral_response
from greybox.spectral.demodulation import METHODS
from greybox.spectral.multisine_lines import periodic_response
from greybox.spectral.single_sine import finite_frequency
from greybox.spectral.test_quality import Finding, Quality, check, jitter

INSTRUMENT, SETPOINT = "instrument", "setpoint"


def add_inspect_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `greybox inspect`."""
    parser.add_argument("log", metavar="LOG", help="a flight log, or a table of signals")
    _add_test_options(parser)


def add_response_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `greybox response`."""
    add = parser.add_argument
    add("log", metavar="LOG", help="a flight log, or a table of signals")
    add("--input", required=True, metavar="[NAME=]SIGNAL", help="the control, e.g. u=RATE.POut")
    add("--output", required=True, metavar="[NAME=]SIGNAL", help="the output, e.g. theta=ATT.Pitch")
    add("--instrument", metavar="SIGNAL", help="the injected signal, for the joint estimate of a sweep, e.g. SIDD.Targ")
    add("--rate", type=float, metavar="HZ", help="common sampling rate (default: that of the slowest signal)")
    add("--axis", help="use only the tests of this axis")
    add("--tests", metavar="1,3-5", help="use only these tests, numbered as `greybox inspect` does")
    add("--settle", type=float, default=2.0, metavar="SECONDS", help="of a sine, for its transient (default: 2)")
    add("--period", type=float, metavar="SECONDS", help="of a multisine: its lines are used exactly, without windows")
    add("--whole", action="store_true", help="use the whole log where no test is found (open loop only)")
    add("--method", default="least-squares", help="least-squares or quadrature, for sines (default: least-squares)")
    add("--points", type=int, default=40, help="frequencies of a sweep's estimate (default: 40)")
    _add_test_options(parser)


def _add_test_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--announced", default="", metavar="MESSAGE", help="message that announces sine tests, e.g. SINE")
    add("--fields", nargs="+", default=[], metavar="WHAT=FIELD", help="its fields, e.g. omega=W amplitude=Eta axis=Ax")
    add("--setpoint", default="", metavar="SIGNAL", help="setpoint to look for tests in, e.g. ATT.DesPitch")


def inspect(options: argparse.Namespace) -> tuple[Answer, Any]:
    """Say what a log holds; return the answer and a function that draws it."""
    recording = read(options.log)
    segments = _segments(recording, options)
    text = [_about(recording), _contents(recording)]
    text += [segment_table(segments)] if segments else ["no test segments found: name --announced or --setpoint."]
    text += [f"  {finding}" for finding in recording.findings]
    answer = {
        "log": recording.source,
        "checksum": recording.checksum,
        **{key: recording.metadata.get(key) for key in ("vehicle", "firmware")},
        "armed": [list(span) for span in recording.metadata.get("armed", ())],
        "messages": [_message(name, record) for name, record in recording.items()],
        "segments": [_segment(segment) for segment in segments],
        "findings": list(recording.findings),
    }

    def draw() -> Any:
        from greybox.plotting.flight_log import recording as plot_recording  # noqa: PLC0415  (imports matplotlib)

        return plot_recording(recording, segments)[0].figure

    return (answer, "\n\n".join(text[:3]) + "\n" + "\n".join(text[3:]), USABLE), draw


def response(options: argparse.Namespace) -> tuple[Answer, FrequencyResponse | None, Any]:
    """Measure the response in a log.

    Returns the answer, the response (None if refused), and functions that draw it and the traces of the first test.
    """
    _require_sound(options)
    recording = read(options.log)
    found = [] if options.period else _chosen(_segments(recording, options), options)
    usable = [segment for segment in found if segment.usable]
    sines = [segment for segment in usable if segment.kind == "sine"]
    used = sines or usable
    if not used and not found and not (options.whole or options.period or options.instrument):
        raise ValueError("no test was found: name --setpoint, --announced or --instrument, or ask for the --whole log.")
    _require_one_axis(used)
    signals, (u, y) = _signals(options, recording, sines, used)
    start, end = (min(s.start for s in used), max(s.end for s in used)) if used else (-math.inf, math.inf)
    record = prepare(recording, signals, options.rate, start=start, end=end)
    judged = [segment for segment in found if segment in used or not segment.usable]
    quality = _with_jitter(check(record, None, judged, input=u, output=y), recording, options)
    measured, detail = None, ""
    if quality.usable:
        try:
            measured, detail = _measured(record, sines, used, u, y, options)
            quality = _with_jitter(check(record, measured, judged, input=u, output=y), recording, options)
        except ValueError as error:
            refused = Finding("response", "refusal", math.nan, " ".join(str(error).split()))
            quality = Quality((refused, *quality.findings))
    parts = (segment_table(found) if found else "", detail, str(quality), "\n".join(recording.findings))
    text = "\n\n".join(part for part in parts if part)
    answer = _response_json(recording, measured, found, quality)
    if not quality.usable:
        answer["error"] = " ".join(quality.refusals)
        return (answer, text, FAILED), None, (None, None)

    def draw() -> Any:
        from greybox.plotting.bode import bode  # noqa: PLC0415  (imports matplotlib)

        assert measured is not None
        return bode(measured)[0].figure

    def traces() -> Any:
        from greybox.plotting.flight_log import traces as plot_traces  # noqa: PLC0415  (imports matplotlib)

        return plot_traces(record, used[0] if used else None)[0].figure

    return (answer, text, USABLE), measured, (draw, traces)


def _measured(
    record: Record,
    sines: Sequence[Segment],
    used: Sequence[Segment],
    u: str,
    y: str,
    options: argparse.Namespace,
) -> tuple[FrequencyResponse, str]:
    if sines:
        setpoint = SETPOINT if SETPOINT in record.signals else ""
        how: dict[str, Any] = {"setpoint": setpoint, "settle": options.settle, "method": options.method}
        found = finite_frequency(record, sines, input=u, output=y, **how)
        return found.response, "\n".join([str(found), *found.findings])
    instrument = next((name for name in (INSTRUMENT, SETPOINT) if name in record.signals), None)
    pieces = [record.between(s.start, s.end) for s in used] or [record]
    if options.period:
        measured = periodic_response(pieces, options.period, u, y, instrument=instrument, name=record.name)
    else:
        measured = spectral_response(pieces, u, y, instrument=instrument, points=options.points, name=record.name)
    direct = "" if instrument else "\ndirect estimate: in a closed loop name the injected signal, --instrument."
    return measured, str(measured) + direct


def _require_sound(options: argparse.Namespace) -> None:
    for name, value in (("settle", options.settle), ("period", options.period)):
        if value is not None and not (math.isfinite(value) and value >= 0):
            raise ValueError(f"--{name} {value} must be a number of seconds of at least 0.")
    if options.method not in METHODS:
        raise ValueError(f"--method {options.method!r} is not known: use {' or '.join(METHODS)}.")
    if not 2 <= options.points <= 10_000:
        raise ValueError(f"--points {options.points} must lie between 2 and 10000.")


def _require_one_axis(used: Sequence[Segment]) -> None:
    axes = list(dict.fromkeys(segment.axis for segment in used))
    if len(axes) > 1:
        raise ValueError(f"the tests are of several axes ({', '.join(axes)}): choose one, --axis {axes[0]!r}.")


def _signals(
    options: argparse.Namespace, recording: Recording, sines: Sequence[Segment], used: Sequence[Segment]
) -> tuple[dict[str, str], tuple[str, str]]:
    """Return what to prepare by name, and the names of input and output."""
    (u, control), (y, output) = _named(options.input), _named(options.output)
    if u == y or control == output:
        raise ValueError(f"--input {options.input} and --output {options.output} are one signal or have one name.")
    for name in (u, y):
        if name in (INSTRUMENT, SETPOINT):
            raise ValueError(
                f"the name {name!r} has a meaning of its own here: call the signal otherwise, NAME=SIGNAL."
            )
    signals = {u: control, y: output}
    instrument = options.instrument or ("" if sines else _injected(recording, used))
    signals |= {INSTRUMENT: instrument} if instrument else {}
    signals |= {SETPOINT: options.setpoint} if options.setpoint else {}
    return signals, (u, y)


def _with_jitter(quality: Quality, recording: Recording, options: argparse.Namespace) -> Quality:
    """Add what only the log's own time stamps tell."""
    raw, _ = recording.locate(_named(options.output)[1])
    return Quality((*quality.findings, *jitter(raw)), quality.bands)


def _segments(recording: Recording, options: argparse.Namespace) -> tuple[Segment, ...]:
    fields = {}
    for word in options.fields:
        what, _, field = word.partition("=")
        if not field:
            raise ValueError(f"--fields {word!r} is not understood: write WHAT=FIELD, e.g. omega=W.")
        fields[what] = field
    return find_segments(recording, options.announced, fields or None, options.setpoint)


def _chosen(segments: Sequence[Segment], options: argparse.Namespace) -> list[Segment]:
    wanted = _numbers(options.tests, len(segments)) if options.tests else range(1, len(segments) + 1)
    chosen = [segments[k - 1] for k in wanted]
    if options.axis:
        axes = list(dict.fromkeys(segment.axis for segment in chosen))
        chosen = [segment for segment in chosen if segment.axis == options.axis]
        if not chosen:
            raise ValueError(f"no test has the axis {options.axis!r}; there are {', '.join(axes) or 'none'}.")
    return chosen


def _numbers(text: str, count: int) -> list[int]:
    result: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:-(\d+))?\s*", part)
        if not match:
            raise ValueError(f"--tests {text!r} is not understood: write numbers and ranges, e.g. 1,3-5.")
        first, last = int(match[1]), int(match[2] or match[1])
        outside = [k for k in (first, last) if not 1 <= k <= count]
        if outside:
            raise ValueError(f"there is no test {outside[0]}; the log has {count}.")
        if first > last:
            raise ValueError(f"--tests {part.strip()!r} runs backwards: write {last}-{first}.")
        result += range(first, last + 1)
    return result


def _named(text: str) -> tuple[str, str]:
    """Split ``u=RATE.POut``; without a name it is that of the field."""
    name, equals, signal = text.partition("=")
    return (name, signal) if equals else (text.rpartition(".")[2], text)


def _injected(recording: Recording, segments: Sequence[Segment]) -> str:
    """Return what System Identification mode injected, the natural instrument."""
    injected = any(s.usable and s.source == "SIDS" for s in segments)
    return "SIDD.Targ" if injected and "SIDD" in recording and "Targ" in recording["SIDD"].signals else ""


def _about(recording: Recording) -> str:
    about = recording.metadata
    words = [recording.source, f"SHA-256 {recording.checksum[:16]}..."]
    words += [str(about[key]) for key in ("vehicle", "firmware") if about.get(key)]
    words += [f"armed {start:.1f} to {end:.1f} s" for start, end in about.get("armed", ())]
    words += [f"{len(about['parameters'])} parameters"] if about.get("parameters") else []
    return "\n".join(words)


def _contents(recording: Recording) -> str:
    rows = [
        [
            name,
            str(len(record)),
            number(record.rate, 4),
            f"{record.time[0]:.1f}",
            f"{record.time[-1]:.1f}",
            _fields(record),
        ]
        for name, record in recording.items()
    ]
    return text_table(["message", "samples", "Hz", "from s", "to s", "signals"], rows, (0, 5))


def _fields(record: Record) -> str:
    named = [f"{n} ({record.units[n]})" if record.units.get(n) else n for n in record.signals]
    return ", ".join(named[:8]) + (f" and {len(named) - 8} more" if len(named) > 8 else "")


def _message(name: str, record: Record) -> dict[str, Any]:
    return {
        "name": name,
        "samples": len(record),
        "rate": known(record.rate),
        "start": float(record.time[0]),
        "end": float(record.time[-1]),
        "signals": {signal: record.units.get(signal, "") for signal in record.signals},
    }


def _segment(segment: Segment) -> dict[str, Any]:
    fields = ("start", "end", "kind", "axis", "omega", "amplitude", "offset", "unit", "source", "usable")
    values = {name: getattr(segment, name) for name in fields}
    numbers = {name: known(value) if isinstance(value, float) else value for name, value in values.items()}
    return {**numbers, "band": [known(edge) for edge in segment.band], "findings": list(segment.findings)}


def _response_json(
    recording: Recording, measured: FrequencyResponse | None, segments: Sequence[Segment], quality: Quality
) -> dict[str, Any]:
    columns: Mapping[str, Any] = {}
    if measured is not None:
        columns = {
            name: None if (values := getattr(measured, name)) is None else np.asarray(values).tolist()
            for name in ("omega", "alpha", "beta", "coherence", "variance", "dof")
        }
    return {
        "log": recording.source,
        "checksum": recording.checksum,
        "input": measured.input if measured else None,
        "output": measured.output if measured else None,
        **columns,
        "segments": [_segment(segment) for segment in segments],
        "usable": quality.usable,
        "log_findings": list(recording.findings),
        "findings": [{"about": f.about, "severity": f.severity, "text": f.text} for f in quality.findings],
    }
