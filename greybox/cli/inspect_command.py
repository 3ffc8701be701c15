"""The command `greybox inspect`: what a log holds, its test segments, its defects."""

import argparse
import shlex
from collections.abc import Sequence
from typing import Any

from greybox.cli.log_tests import add_test_options, read_log, segment_as_json, segments_of
from greybox.cli.options import add_common_options
from greybox.cli.output import USABLE, Answer, require_figure, save_figure
from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment, segment_table
from greybox.files.json_numbers import finite
from greybox.files.text_table import number, text_table
from greybox.logs.flight_controllers import axis_of
from greybox.logs.manoeuvre_detection import find_manoeuvres
from greybox.logs.segment_detection import announcing

EXAMPLES = (
    "flight.BIN",
    "flight.BIN --setpoint ATT.DesPitch --plot tests.png",
)

BURSTS = 0.05  # of the samples that a gap precedes, above which a message comes in bursts: a lossy log drops 1 % or less


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", metavar="LOG", help="a flight log, or a table of signals")
    add_test_options(parser)
    add_common_options(parser, "setpoints, angles and tests")


def run(options: argparse.Namespace) -> Answer:
    """Return what a log holds, and draw it where asked to."""
    require_figure(options.plot, options.force)
    recording = read_log(options)
    segments = segments_of(recording, options)

    # Controllers that make tests make setpoints that are no manoeuvres.
    manoeuvres = (
        () if segments and not options.setpoint else find_manoeuvres(recording, options.setpoint)
    )
    in_time = any(record.has_time for record in recording.values())
    none = (
        "no test segments found: give --announced or --setpoint."
        if in_time
        else "no time column: rows in no order."
    )
    found = segment_table(segments) if segments else none
    found += f"\n\nmanoeuvres\n{segment_table(manoeuvres)}" if manoeuvres else ""
    findings = [f"  {finding}" for finding in recording.findings]
    notes = save_figure(options.plot, lambda: _figure(recording, (*segments, *manoeuvres)))
    parts = [_about(recording), _contents(recording), found]
    text = "\n\n".join(parts) + "\n" + "\n".join([*findings])

    answer = {
        "log": recording.source,
        "checksum": recording.checksum,
        **{key: recording.metadata.get(key) for key in ("vehicle", "firmware", "frame", "board")},
        "modes": [[time, name] for time, name in recording.metadata.get("modes", ())],
        "armed": [list(span) for span in recording.metadata.get("armed", ())],
        "messages": [_message(name, record) for name, record in recording.items()],
        "segments": [segment_as_json(segment) for segment in segments],
        "manoeuvres": [segment_as_json(segment) for segment in manoeuvres],
        "findings": list(recording.findings),
    }
    following = _following(recording, segments, manoeuvres, options)
    answer["next"] = following
    return answer, "\n".join([text, *notes, *([f"next: {following}"] if following else [])]), USABLE


def _following(
    recording: Recording,
    segments: Sequence[Segment],
    manoeuvres: Sequence[Segment],
    options: argparse.Namespace,
) -> str:
    """Return the command to type next, where there is something to identify.

    A table does not say which of its columns is what.
    """
    if manoeuvres and not segments:
        first = next((k for k, s in enumerate(manoeuvres, start=1) if s.kind != "stick input"), 1)
        words = ["greybox", "response", options.log, "--manoeuvre", str(first)]
        words += ["--setpoint", options.setpoint] if options.setpoint else []
        return f"{shlex.join(words)} --input {manoeuvres[first - 1].axis} --output SIGNAL --out manoeuvre.csv"
    signals = [f"{name}.{field}" for name, record in recording.items() for field in record.signals]
    if any(axis_of(signal) for signal in signals):
        words = ["greybox", "identify", options.log]
    else:
        words = [
            "greybox",
            "response",
            options.log,
            "--input",
            "u=SIGNAL",
            "--output",
            "theta=SIGNAL",
        ]
    for flag, value in (("--announced", options.announced), ("--setpoint", options.setpoint)):
        words += [flag, value] if value else []
    words += ["--fields", *options.fields] if options.fields else []
    words += ["--columns", *options.columns] if options.columns else []
    usable = any(segment.usable for segment in segments) or announcing(recording)
    return shlex.join(words) if usable else ""


def _figure(recording: Recording, segments: tuple[Segment, ...]) -> Any:
    from greybox.plotting import recording as draw  # noqa: PLC0415  (imports matplotlib)

    return draw(recording, segments)[0].figure


def _about(recording: Recording) -> str:
    about = recording.metadata
    words = [recording.source, f"SHA-256 {recording.checksum[:16]}..."]
    words += [str(about[key]) for key in ("vehicle", "firmware") if about.get(key)]
    words += [f"{key} {about[key]}" for key in ("frame", "board") if about.get(key)]
    words += (
        [f"modes {', '.join(f'{name} from {time:.1f} s' for time, name in about['modes'])}"]
        if about.get("modes")
        else []
    )
    words += [f"armed {start:.1f} to {end:.1f} s" for start, end in about.get("armed", ())]
    words += [f"{len(about['parameters'])} parameters"] if about.get("parameters") else []
    return "\n".join(words)


def _contents(recording: Recording) -> str:
    rows = [
        [
            name,
            str(len(record)),
            *_times(record),
            _fields(record),
        ]
        for name, record in recording.items()
    ]
    return text_table(["message", "samples", "Hz", "from s", "to s", "signals"], rows, (0, 5))


def _times(record: Record) -> tuple[str, str, str]:
    """Return rate, first and last time; rows have none."""
    if not record.has_time:
        return ("-", "-", "-")
    return (number(_rate(record), 4), f"{record.time[0]:.1f}", f"{record.time[-1]:.1f}")


def _rate(record: Record) -> float:
    """Return the rate, Hz: of messages that come in bursts, as over a link, the mean, as their median means nothing."""
    in_bursts = len(record) > 2 and len(record.pieces) - 1 > BURSTS * len(record)
    return (len(record) - 1) / record.duration if in_bursts else record.rate


def _fields(record: Record) -> str:
    named = [f"{n} ({record.units[n]})" if record.units.get(n) else n for n in record.signals]
    return ", ".join(named[:8]) + (f" and {len(named) - 8} more" if len(named) > 8 else "")


def _message(name: str, record: Record) -> dict[str, Any]:
    return {
        "name": name,
        "samples": len(record),
        "rate": finite(_rate(record)) if record.has_time else None,
        "start": float(record.time[0]) if record.has_time else None,
        "end": float(record.time[-1]) if record.has_time else None,
        "signals": {signal: record.units.get(signal, "") for signal in record.signals},
    }
