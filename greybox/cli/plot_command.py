"""The command `greybox plot`: the figures of a log."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.log_tests import read_log
from greybox.cli.options import add_common_options
from greybox.cli.output import USABLE, Answer, require_figure, save_figure
from greybox.cli.response_command import add_measurement_options, response_json, stated_choices
from greybox.identification.choices import choose
from greybox.identification.measurement import measure

EXAMPLES = (
    "flight.BIN",
    "flight.BIN --axis pitch --out pitch.png",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("log", metavar="LOG", help="a flight log, or a table of signals")
    add(
        "--input",
        default="",
        metavar="[NAME=]SIGNAL",
        help="the control (default: that of the axis)",
    )
    add(
        "--output",
        default="",
        metavar="[NAME=]SIGNAL",
        help="the output (default: the best-sampled angle)",
    )
    add_measurement_options(parser)
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="png, pdf or svg file (default: the name of the log, in this folder)",
    )
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Measure the response, as `identify` does, and draw signals, tests and response."""
    figure = options.out or Path(f"{Path(options.log).stem}_tests.png")
    require_figure(figure, options.force)
    recording = read_log(options)
    settings, choices = choose(recording, **stated_choices(options))
    measured = measure(recording, settings)

    def draw() -> Any:
        from greybox.plotting import measurement  # noqa: PLC0415  (imports matplotlib)

        return measurement(measured, recording)

    notes = save_figure(figure, draw)
    answer = {
        "chosen": [{"what": c.what, "why": c.why, "option": f"--{c.argument}"} for c in choices]
    }
    answer |= response_json(recording, measured) | {"files": [str(figure)]}
    return answer, "\n".join([*map(str, choices), str(measured.quality), *notes]), USABLE
