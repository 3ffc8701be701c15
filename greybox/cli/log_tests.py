"""The log of a command, and its test segments."""

import argparse

from greybox.data.record import Recording
from greybox.data.test_segment import Segment
from greybox.logs.readers import read
from greybox.logs.segment_detection import find_segments


def read_log(options: argparse.Namespace) -> Recording:
    """Return the log of a command; a table without a time has the rate of `--rate`."""
    columns = options.columns or None
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
    return find_segments(recording, options.announced, options.fields or None, options.setpoint)
