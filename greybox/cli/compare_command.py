"""The command `greybox compare`: the members of a study side by side, also while it runs."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.batch_command import as_json
from greybox.cli.options import add_common_options
from greybox.cli.output import USABLE, Answer
from greybox.study.study import read_study


def add_command(commands: Any) -> None:
    """Declare the command and its options."""
    parser = commands.add_parser("compare", help="compare the fits of a study, also while it runs", allow_abbrev=False)
    parser.add_argument("study", type=Path, metavar="DIR", help="the folder of the study")
    add_common_options(parser)
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> Answer:
    """Read the study and compare its members."""
    study = read_study(options.study)
    return as_json(study), str(study), USABLE
