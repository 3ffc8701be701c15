"""The command `greybox response`: from a log to a measured frequency response."""

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greybox.cli.log_tests import add_test_options, segment_as_json, segments_of
from greybox.cli.options import UsageError, add_common_options
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, require_writable, save_figure
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record, Recording
from greybox.data.response_file import HDF5, write_response
from greybox.data.test_segment import Segment, segment_table
from greybox.data.text_table import alternatives
from greybox.logs.prepare import prepare
from greybox.logs.readers import read
from greybox.spectral.composite_windows import spectral_response
from greybox.spectral.demodulation import METHODS
from greybox.spectral.multisine_lines import periodic_response
from greybox.spectral.single_sine import finite_frequency
from greybox.spectral.test_quality import Finding, Quality, check, jitter

INSTRUMENT, SETPOINT = "instrument", "setpoint"


def add_command(commands: Any) -> None:
    """Declare the command and its options."""
    parser = commands.add_parser("response", help="measure a frequency response from a log", allow_abbrev=False)
    add = parser.add_argument
    add("log", metavar="LOG", help="a flight log, or a table of signals")
    add("--input", required=True, metavar="[NAME=]SIGNAL", help="the control, e.g. u=RATE.POut")
    add("--output", required=True, metavar="[NAME=]SIGNAL", help="the output, e.g. theta=ATT.Pitch")
    add("--instrument", metavar="SIGNAL", help="the injected signal, for the joint estimate of a sweep, e.g. SIDD.Targ")
    add("--rate", type=float, metavar="HZ", help="common sampling rate (default: that of the slowest signal)")
    add("--axis", help="use only the tests of this axis")
    add("--tests", metavar="1,3-5", help="use only these tests, numbered as `greybox inspect` does")
    add(
        "--settle",
        type=float,
        default=2.0,
        metavar="SECONDS",
        help="settling time discarded at the beginning of each sine (default: 2)",
    )
    add(
        "--period",
        type=float,
        metavar="SECONDS",
        help="period of a multisine, to evaluate its lines exactly, without windows",
    )
    add("--whole", action="store_true", help="use the whole log if no test is found (open loop only)")
    add("--method", default="least-squares", help="for sines: least-squares or quadrature (default: least-squares)")
    add("--points", type=int, default=40, help="number of frequencies of a sweep's estimate (default: 40)")
    add_test_options(parser)
    add("--out", type=Path, metavar="FILE", help="save the response to this .csv or .h5 file")
    add("--traces", type=Path, metavar="FILE", help="draw control, output and setpoint of the first test")
    add_common_options(parser, "Bode diagram and coherence")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> Answer:
    """Measure the response; save and draw it where asked to."""
    require_figure(options.plot, options.force)
    require_writable(options.out, options.force)
    if options.out is not None and options.out.suffix.lower() not in (".csv", *HDF5):
        raise UsageError(f"--out {options.out} is not a known kind of file: end it in .csv or .h5.")
    require_figure(options.traces, options.force)
    _require_sound(options)

    recording = read(options.log)
    tests = [] if options.period else _chosen(segments_of(recording, options), options)
    usable = [segment for segment in tests if segment.usable]
    sines = [segment for segment in usable if segment.kind == "sine"]
    used = sines or usable
    if not used and not tests and not (options.whole or options.period or options.instrument):
        raise ValueError("no test was found: give --setpoint, --announced or --instrument, or use the --whole log.")
    _require_one_axis(used)

    signals, (u, y) = _signals(options, recording, sines, used)
    start = min((segment.start for segment in used), default=-math.inf)
    end = max((segment.end for segment in used), default=math.inf)
    record = prepare(recording, signals, options.rate, start=start, end=end)

    judged = [segment for segment in tests if segment in used or not segment.usable]
    quality = _with_jitter(check(record, None, judged, input=u, output=y), recording, options)
    measured = None
    detail = ""
    if quality.usable:
        try:
            measured, detail = _measured(record, sines, used, u, y, options)
            quality = _with_jitter(check(record, measured, judged, input=u, output=y), recording, options)
        except ValueError as error:
            refused = Finding("response", "refusal", math.nan, " ".join(str(error).split()))
            quality = Quality((refused, *quality.findings))

    parts = (segment_table(tests) if tests else "", detail, str(quality), "\n".join(recording.findings))
    text = "\n\n".join(part for part in parts if part)
    answer = _response_json(recording, measured, tests, quality)
    if not quality.usable:
        answer["error"] = " ".join(quality.refusals)
        return answer, text, FAILED

    assert measured is not None
    notes = []
    if options.out is not None:
        write_response(measured, options.out)
        notes.append(f"saved {options.out}")
    notes += save_figure(options.plot, lambda: _bode(measured))
    notes += save_figure(options.traces, lambda: _traces(record, used))
    return answer, "\n".join([text, *notes]), USABLE


def _bode(measured: FrequencyResponse) -> Any:
    from greybox.plotting import bode  # noqa: PLC0415  (imports matplotlib)

    return bode(measured)[0].figure


def _traces(record: Record, used: Sequence[Segment]) -> Any:
    from greybox.plotting import traces  # noqa: PLC0415  (imports matplotlib)

    return traces(record, used[0] if used else None)[0].figure


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
        estimate = finite_frequency(
            record, sines, input=u, output=y, setpoint=setpoint, settle=options.settle, method=options.method
        )
        return estimate.response, "\n".join([str(estimate), *estimate.findings])

    instrument = next((name for name in (INSTRUMENT, SETPOINT) if name in record.signals), None)
    pieces = [record.between(s.start, s.end) for s in used] or [record]
    if options.period:
        measured = periodic_response(pieces, options.period, u, y, instrument=instrument, name=record.name)
    else:
        measured = spectral_response(pieces, u, y, instrument=instrument, points=options.points, name=record.name)
    direct = "" if instrument else "\ndirect estimate: in a closed loop give the injected signal, --instrument."
    return measured, str(measured) + direct


def _require_sound(options: argparse.Namespace) -> None:
    for name, value in (("settle", options.settle), ("period", options.period)):
        if value is not None and not (math.isfinite(value) and value >= 0):
            raise ValueError(f"--{name} {value} must be a number of seconds of at least 0.")
    if options.method not in METHODS:
        raise ValueError(f"--method {options.method!r} is not known: use {alternatives(options.method, METHODS)}")
    if not 2 <= options.points <= 10_000:
        raise ValueError(f"--points {options.points} must lie between 2 and 10000.")


def _require_one_axis(used: Sequence[Segment]) -> None:
    axes = list(dict.fromkeys(segment.axis for segment in used))
    if len(axes) > 1:
        raise ValueError(f"the tests are of several axes ({', '.join(axes)}): choose one, --axis {axes[0]!r}.")


def _signals(
    options: argparse.Namespace, recording: Recording, sines: Sequence[Segment], used: Sequence[Segment]
) -> tuple[dict[str, str], tuple[str, str]]:
    """Return the signals to prepare by name, and the names of input and output."""
    (u, control), (y, output) = _named(options.input), _named(options.output)
    if u == y or control == output:
        raise ValueError(
            f"--input {options.input} and --output {options.output} are the same signal or have the same name."
        )
    for name in (u, y):
        if name in (INSTRUMENT, SETPOINT):
            raise ValueError(f"the name {name!r} is reserved: give the signal another name, NAME=SIGNAL.")
    signals = {u: control, y: output}
    instrument = options.instrument or ("" if sines else _injected(recording, used))
    signals |= {INSTRUMENT: instrument} if instrument else {}
    signals |= {SETPOINT: options.setpoint} if options.setpoint else {}
    return signals, (u, y)


def _with_jitter(quality: Quality, recording: Recording, options: argparse.Namespace) -> Quality:
    """Add the findings that need the log's own time stamps."""
    raw, _ = recording.locate(_named(options.output)[1])
    return Quality((*quality.findings, *jitter(raw)), quality.bands)


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
    """Split ``u=RATE.POut`` into name and signal; the default name is that of the field."""
    name, equals, signal = text.partition("=")
    return (name, signal) if equals else (text.rpartition(".")[2], text)


def _injected(recording: Recording, segments: Sequence[Segment]) -> str:
    """Return what System Identification mode injected, the natural instrument."""
    injected = any(s.usable and s.source == "SIDS" for s in segments)
    return "SIDD.Targ" if injected and "SIDD" in recording and "Targ" in recording["SIDD"].signals else ""


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
        "segments": [segment_as_json(segment) for segment in segments],
        "usable": quality.usable,
        "log_findings": list(recording.findings),
        "findings": [{"about": f.about, "severity": f.severity, "text": f.text} for f in quality.findings],
    }
