"""The command `greybox inspect`: the contents of a log, its test segments and its defects."""

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


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", metavar="LOG", help="a flight log, or a table of signals")
    add_test_options(parser)
    add_common_options(parser, "setpoints, angles and tests")


def run(options: argparse.Namespace) -> Answer:
    """Return the contents of a log, and draw it."""
    require_figure(options.plot, options.force)
    recording = read_log(options)
    segments = segments_of(recording, options)
    # A controller that makes tests makes setpoints that are not manoeuvres.
    manoeuvres: Sequence[Segment] = ()
    if options.setpoint or not segments:
        manoeuvres = find_manoeuvres(recording, options.setpoint)

    def draw() -> Any:
        from greybox.plotting import recording as plot  # noqa: PLC0415  (imports matplotlib)

        return plot(recording, (*segments, *manoeuvres))[0].figure

    notes = save_figure(options.plot, draw)
    command = next_command(recording, segments, manoeuvres, options)
    if command:
        notes.append(f"next: {command}")
    parts = [
        about(recording),
        contents(recording),
        _tests(recording, segments, manoeuvres),
        "\n".join([*(f"  {finding}" for finding in recording.findings), *notes]),
    ]
    answer = {
        "log": recording.source,
        "checksum": recording.checksum,
        **{key: recording.metadata.get(key) for key in ("vehicle", "firmware")},
        "modes": [[time, name] for time, name in recording.metadata.get("modes", ())],
        "messages": [_message(name, record) for name, record in recording.items()],
        "segments": [segment_as_json(segment) for segment in segments],
        "manoeuvres": [segment_as_json(segment) for segment in manoeuvres],
        "findings": list(recording.findings),
        "next": command,
    }
    return answer, "\n\n".join(part for part in parts if part), USABLE


def _tests(recording: Recording, segments: Sequence[Segment], manoeuvres: Sequence[Segment]) -> str:
    text = "no test segments found: give --announced or --setpoint."
    if segments:
        text = segment_table(segments)
    elif not any(record.has_time for record in recording.values()):
        text = "no time column: rows in no order."
    return f"{text}\n\nmanoeuvres\n{segment_table(manoeuvres)}" if manoeuvres else text


def next_command(
    recording: Recording,
    segments: Sequence[Segment],
    manoeuvres: Sequence[Segment],
    options: argparse.Namespace,
) -> str:
    """Return the command to type next, if there is something to identify."""
    if manoeuvres and not segments:
        number = next((k for k, s in enumerate(manoeuvres, 1) if s.kind != "stick input"), 1)
        words = ["greybox", "response", options.log, "--manoeuvre", str(number)]
        words += ["--setpoint", options.setpoint] if options.setpoint else []
        control = manoeuvres[number - 1].axis
        return f"{shlex.join(words)} --input {control} --output SIGNAL --out manoeuvre.csv"
    if not any(segment.usable for segment in segments) and not announcing(recording):
        return ""

    words = ["greybox", "identify", options.log]
    signals = [f"{name}.{field}" for name, record in recording.items() for field in record.signals]
    if not any(axis_of(signal) for signal in signals):  # a table does not tell input from output
        words = ["greybox", "response", options.log, "--input", "u=SIGNAL"]
        words += ["--output", "theta=SIGNAL"]
    words += ["--announced", options.announced] if options.announced else []
    words += ["--setpoint", options.setpoint] if options.setpoint else []
    words += ["--fields", *options.fields] if options.fields else []
    words += ["--columns", *options.columns] if options.columns else []
    return shlex.join(words)


def about(recording: Recording) -> str:
    """Return source, vehicle and modes, one a line."""
    metadata = recording.metadata
    lines = [recording.source, f"SHA-256 {recording.checksum[:16]}..."]
    lines += [str(metadata[key]) for key in ("vehicle", "firmware") if metadata.get(key)]
    modes = [f"{name} from {time:.1f} s" for time, name in metadata.get("modes", ())]
    lines += [f"modes {', '.join(modes)}"] if modes else []
    parameters = metadata.get("parameters")
    lines += [f"{len(parameters)} parameters"] if parameters else []
    return "\n".join(lines)


def contents(recording: Recording) -> str:
    """Return the table of the messages."""
    rows = []
    for name, record in recording.items():
        times = ["-", "-", "-"]
        if record.has_time:
            times = [number(rate(record), 4), f"{record.time[0]:.1f}", f"{record.time[-1]:.1f}"]
        rows.append([name, str(len(record)), *times, _fields(record)])
    return text_table(["message", "samples", "Hz", "from s", "to s", "signals"], rows, (0, 5))


def rate(record: Record) -> float:
    """Return the rate in Hz; for messages that come in bursts, as over a link, the mean rate.

    Bursts are gaps before more than 5 % of the samples: a lossy log loses 1 % or less.
    """
    in_bursts = len(record) > 2 and len(record.pieces) - 1 > 0.05 * len(record)
    return (len(record) - 1) / record.duration if in_bursts else record.rate


def _fields(record: Record) -> str:
    names = [f"{n} ({record.units[n]})" if record.units.get(n) else n for n in record.signals]
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _message(name: str, record: Record) -> dict[str, Any]:
    return {
        "name": name,
        "samples": len(record),
        "rate": finite(rate(record)) if record.has_time else None,
        "start": float(record.time[0]) if record.has_time else None,
        "end": float(record.time[-1]) if record.has_time else None,
        "signals": {signal: record.units.get(signal, "") for signal in record.signals},
    }
