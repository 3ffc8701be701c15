"""The command `greybox inspect`: the contents of a log, its test segments and its defects."""

import argparse
import shlex
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from greybox.cli.options import option_words
from greybox.cli.output import Answer, require_figure, save_figure
from greybox.cli.read_log import read_log
from greybox.data.excited_segment import Segments, segment_table
from greybox.data.files.grouping import grouped
from greybox.data.files.named_values import attributes
from greybox.data.files.numbers_in_text import number
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import listed
from greybox.data.logs.flight_controllers import axis_of
from greybox.data.logs.manoeuvre_detection import find_manoeuvres
from greybox.data.logs.segment_detection import announcing, find_segments
from greybox.data.record import Record, Recording
from greybox.data.signal_faults import record_faults

EXAMPLES = (
    "flight.BIN",
    "flight.BIN --setpoint ATT.DesPitch --plot tests.png",
)
OPTIONS = """
log LOG
    a flight log, or a table of signals
--announced
--fields
--columns
--setpoint
--rate
--gaps
--plot FILE
    draw setpoints, angles and tests into this png, pdf or svg file
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Return the contents of a log, and draw it."""
    require_figure(options.plot, options.force)
    recording = read_log(options)
    segments = find_segments(recording, options.announced, options.fields, options.setpoint)
    # A controller that flies tests moves its own setpoints, which are not manoeuvres of the pilot.
    manoeuvres: Segments = ()
    if options.setpoint or not segments:
        manoeuvres = find_manoeuvres(recording, options.setpoint)

    findings = (*recording.findings, *faults_of_table(recording))
    notes = save_figure(options.plot, "recording", recording, (*segments, *manoeuvres))
    command = next_command(recording, segments, options)
    if command:
        notes.append(f"next: {command}")
    messages = [message(name, record) for name, record in recording.items()]
    parts = [
        about(recording),
        contents(messages),
        _tests(recording, segments, manoeuvres),
        "\n".join([*(f"  {finding}" for finding in findings), *notes]),
    ]
    # The JSON always has these keys, None where the log does not have them.
    metadata = ("vehicle", "firmware", "modes")
    answer = {
        "log": recording.source,
        "checksum": recording.checksum,
        **{name: recording.metadata.get(name) for name in metadata},
        "messages": messages,
        "segments": segments,
        "manoeuvres": manoeuvres,
        "findings": findings,
        "next": command,
    }
    return answer, "\n\n".join(filter(None, parts))


def faults_of_table(recording: Recording) -> tuple[str, ...]:
    """Return what a logger did to the signals of a table, whichever of them are inputs.

    A log has thousands of counters, flags and states that nobody identifies.
    """
    if len(recording) != 1:
        return ()
    (record,) = recording.values()
    said = []  # pairs of a signal and what follows its name
    for name in record.signals:
        certain = record_faults(record, (), (name,))
        texts = [*map(str, certain)]
        # Where a hold is stated, the signal is known to be an input.
        if not certain and not record.hold.get(name):
            faults = record_faults(record, (name,))
            texts += [f"{fault} If it is an input, this may be right." for fault in faults]
        said += [(name, text.removeprefix(name)) for text in texts]
    # A logger treats its signals alike.
    sentences = []
    for (first, text), *alike in grouped(said, itemgetter(1)):
        likewise = f" (likewise {listed([name for name, _ in alike])})" if alike else ""
        sentences.append(f"{first}{likewise}{text}")
    return tuple(sentences)


def _tests(recording: Recording, segments: Segments, manoeuvres: Segments) -> str:
    text = "no sweep or sine was found: name their message, --announced, or signal, --setpoint."
    if segments:
        text = segment_table(segments)
    elif not any(record.has_time for record in recording.values()):
        text = "no time column: rows in no order."
    return f"{text}\n\nmanoeuvres\n{segment_table(manoeuvres)}" if manoeuvres else text


def next_command(
    recording: Recording,
    segments: Segments,
    options: argparse.Namespace,
) -> str:
    """Return the command to type next, if there is something to identify."""
    if not any(segment.usable for segment in segments) and not announcing(recording):
        return ""
    words = ["greybox", "identify", options.log]
    # The names of a table do not tell input from output.
    if not any(map(axis_of, recording.signal_names)):
        words = ["greybox", "response", options.log, "--input", "SIGNAL", "--output", "SIGNAL"]

    reading = attributes(options, "announced", "setpoint", "fields", "columns")
    return shlex.join([*words, *option_words(reading)])


def about(recording: Recording) -> str:
    """Return source, vehicle and modes, one on each line."""
    metadata = recording.metadata
    lines = [recording.source, f"SHA-256 {recording.checksum[:16]}..."]
    lines += [str(metadata[key]) for key in ("vehicle", "firmware") if metadata.get(key)]
    modes = [f"{name} from {time:.1f} s" for time, name in metadata.get("modes", ())]
    lines += [f"modes {', '.join(modes)}"] if modes else []
    parameters = metadata.get("parameters")
    lines += [f"{len(parameters)} parameters"] if parameters else []
    return "\n".join(lines)


def contents(messages: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the messages."""
    rows = []
    for message in messages:
        # Rows without a time have neither a rate nor a beginning.
        times = ["-", "-", "-"]
        if message["rate"] is not None:
            ends = (f"{message[end]:.1f}" for end in ("start", "end"))
            times = [number(message["rate"], 4), *ends]
        names = [f"{n} ({unit})" if unit else n for n, unit in message["signals"].items()]
        # Some messages have thirty fields, which would break every line of the table.
        further = f" and {len(names) - 8} more" if len(names) > 8 else ""
        signals = ", ".join(names[:8]) + further
        rows.append([message["name"], str(message["samples"]), *times, signals])
    return text_table(["message", "samples", "Hz", "from s", "to s", "signals"], rows, (0, 5))


def message(name: str, record: Record) -> dict[str, Any]:
    """Return the facts of a message."""
    times = (rate(record), *record.span) if record.has_time else [None] * 3
    return {
        "name": name,
        "samples": len(record),
        **dict(zip(("rate", "start", "end"), times, strict=True)),
        "signals": {signal: record.units.get(signal, "") for signal in record.signals},
    }


def rate(record: Record) -> float:
    """Return the rate in Hz; for messages that come in bursts, as over a link, the mean rate."""
    # Bursts have gaps before more than 5 % of the samples, while a lossy log loses 1 % or less.
    in_bursts = len(record) > 2 and len(record.pieces) - 1 > 0.05 * len(record)
    is_mean = in_bursts or record.is_irregular
    return (len(record) - 1) / record.duration if is_mean else record.rate
