"""The options `--columns` and `--rate` of a table: its signals, their units, and their rate."""

import argparse

from greybox.cli.options import add_words, positive_number, texts

RESPONSE_OR_RECORD = (
    "with --data: the columns of a table with other names. For a response frequency=f:Hz "
    "magnitude=mag:dB phase=ph:deg coherence=coh, or alpha and beta; for a record time=t:ms and "
    "the signals of the model, theta=pitch:deg"
)
RECORD = (
    "the columns of a table with other names, time=t:ms theta=pitch:deg; or their numbers if the "
    "table has no header line: time=1 u=2 theta=3:deg"
)


def add_columns_option(parser: argparse.ArgumentParser, about: str = RESPONSE_OR_RECORD) -> None:
    """Declare the option; `about` is its help."""
    add_words(parser, "--columns", "NAME=COLUMN[:UNIT]", about)


def add_rate_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option."""
    about = "sampling rate of a table without a time"
    parser.add_argument("--rate", type=positive_number, metavar="HZ", help=about)


def stated_columns(options: argparse.Namespace) -> dict[str, str]:
    """Return the column of each name, with its unit behind a colon.

    Raises
    ------
    UsageError
        For a word of another form, or a repeated name.
    """
    form = "NAME=COLUMN:UNIT, e.g. frequency=f:Hz"
    return texts(options.columns, "--columns", form)
