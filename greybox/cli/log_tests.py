"""The test segments of a log: the options that tell how to find them, and the segments as JSON."""

import argparse
from typing import Any

from greybox.cli.columns import RECORD, add_columns_option, stated_columns
from greybox.data.record import Recording
from greybox.data.test_segment import Segment
from greybox.files.json_numbers import finite
from greybox.logs.readers import read
from greybox.logs.segment_detection import find_segments


def add_test_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that tell how to find the tests."""
    add = parser.add_argument
    add(
        "--announced",
        default="",
        metavar="MESSAGE",
        help="message that announces sine tests, e.g. SINE",
    )
    add(
        "--fields",
        nargs="+",
        default=[],
        metavar="WHAT=FIELD",
        help="fields of that message, e.g. omega=W amplitude=Eta axis=Ax",
    )
    add_columns_option(parser, RECORD)
    add(
        "--setpoint",
        default="",
        metavar="SIGNAL",
        help="setpoint in which to look for tests, e.g. ATT.DesPitch",
    )


def read_log(options: argparse.Namespace) -> Recording:
    """Return the log of a command, with its columns as `--columns` names them."""
    return read(options.log, columns=stated_columns(options) or None)


def segments_of(recording: Recording, options: argparse.Namespace) -> tuple[Segment, ...]:
    """Return the test segments of a log, as the options tell to find them.

    Raises
    ------
    ValueError
        If the options cannot be understood, or name what the log does not have.
    """
    return find_segments(
        recording, options.announced, stated_fields(options) or None, options.setpoint
    )


def stated_fields(options: argparse.Namespace) -> dict[str, str]:
    """Return the fields of the announcing message that `--fields` names; ValueError for another word."""
    fields = {}
    for word in options.fields:
        what, _, field = word.partition("=")
        if not field:
            raise ValueError(
                f"--fields {word!r} is not understood: write WHAT=FIELD, e.g. omega=W."
            )
        fields[what] = field
    return fields


def segment_as_json(segment: Segment) -> dict[str, Any]:
    """Return a segment as JSON has it."""
    fields = (
        "start",
        "end",
        "kind",
        "axis",
        "omega",
        "amplitude",
        "offset",
        "unit",
        "source",
        "usable",
    )
    values = {name: getattr(segment, name) for name in fields}
    numbers = {
        name: finite(value) if isinstance(value, float) else value for name, value in values.items()
    }
    return {
        **numbers,
        "band": [finite(edge) for edge in segment.band],
        "findings": list(segment.findings),
    }
