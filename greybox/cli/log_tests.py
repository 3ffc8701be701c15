"""The test segments of a log, and the options for finding them."""

import argparse

from greybox.cli.options import (
    RECORD,
    add_columns_option,
    add_words,
    stated_columns,
    texts,
)
from greybox.data.record import Recording
from greybox.data.test_segment import Segment
from greybox.logs.readers import read
from greybox.logs.segment_detection import find_segments


def add_test_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options for finding the tests."""
    add = parser.add_argument
    add(
        "--announced",
        default="",
        metavar="MESSAGE",
        help="message that announces sine tests, e.g. SINE",
    )
    about = "fields of that message, e.g. omega=W amplitude=Eta axis=Ax"
    add_words(parser, "--fields", "WHAT=FIELD", about)
    add_columns_option(parser, RECORD)
    add(
        "--setpoint",
        default="",
        metavar="SIGNAL",
        help="setpoint in which to look for tests, e.g. ATT.DesPitch",
    )


def read_log(options: argparse.Namespace) -> Recording:
    """Return the log of a command; a table without a time has the rate of `--rate`."""
    columns = stated_columns(options) or None
    # Only a table without a time needs the rate here; a log is resampled to it later.
    log = read(options.log, columns=columns)
    if options.rate is None or all(record.has_time for record in log.values()):
        return log
    return read(options.log, columns=columns, rate=options.rate)


def segments_of(recording: Recording, options: argparse.Namespace) -> tuple[Segment, ...]:
    """Return the test segments of a log.

    Raises
    ------
    ValueError
        If the options cannot be understood, or the log does not have what they name.
    """
    return find_segments(
        recording, options.announced, stated_fields(options) or None, options.setpoint
    )


def stated_fields(options: argparse.Namespace) -> dict[str, str]:
    """Return the fields of the announcing message that `--fields` names."""
    return texts(options.fields, "--fields", "WHAT=FIELD, e.g. omega=W")
