"""The log of a command."""

import argparse

from greybox.data.logs.readers import read
from greybox.data.record import Recording


def read_log(options: argparse.Namespace) -> Recording:
    """Return the log of a command; a table without a time has the rate of `--rate`."""
    # Only a table without a time needs the rate here; a log is resampled to it later.
    stated = {"columns": options.columns, "gaps": options.gaps or "auto"}
    try:
        log = read(options.log, **stated)
    except ValueError as problem:
        if options.rate is None:
            raise
        # A table whose clock stands still is refused without the rate.
        try:
            return read(options.log, **stated, rate=options.rate)
        except ValueError:
            raise problem from None
    if options.rate is None or all(record.has_time for record in log.values()):
        return log
    return read(options.log, **stated, rate=options.rate)
