"""The command `greybox profile`: intervals of a saved fit that need not be symmetric."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.catalog import find_problem
from greybox.cli.options import add_common_options, add_parser, nonnegative
from greybox.cli.output import USABLE, Answer, require_figure, save_figure
from greybox.cli.saved_fits import add_model_option, saved_fit
from greybox.cli.workers import add_worker_options, stated_executor
from greybox.estimate.profile import profile
from greybox.estimate.profiles import Profiles

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 a1 a2 --level 0.9 --plot profiles.png",
)


def add_command(commands: Any) -> None:
    """Declare the command and its options."""
    parser = add_parser(commands, "profile", "intervals that need not be symmetric", EXAMPLES)
    parser.add_argument("result", type=Path, metavar="RESULT", help="a fit that greybox fit --out wrote")
    parser.add_argument("names", nargs="*", metavar="NAME", help="parameters and derived quantities; all by default")
    parser.add_argument("--problem", metavar="PROBLEM", help="what was fitted, where it has ties or constraints")
    add_model_option(parser)
    parser.add_argument("--level", type=float, default=0.95, help="of the intervals, 0.95 by default")
    parser.add_argument(
        "--fresh-starts",
        type=nonnegative,
        default=2,
        metavar="N",
        help="of every point, beside its neighbors; 2 by default",
    )
    add_worker_options(parser)
    add_common_options(parser, figure="the profiles")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and profile it."""
    require_figure(options.plot, options.force)
    problem = None if options.problem is None else find_problem(options.problem)[0]
    fit = saved_fit(options.result, options)
    settings = {"level": options.level, "fresh_starts": options.fresh_starts}
    with stated_executor(options) as executor:
        found = profile(fit, options.names or None, problem=problem, executor=executor, **settings)
    lines = save_figure(options.plot, lambda: _figure(found))
    return found.summary(), "\n".join([str(found), *lines]), USABLE


def _figure(found: Profiles) -> Any:
    from greybox.plotting.profile import profiles  # noqa: PLC0415  (matplotlib takes long to import)

    return profiles(found)[0].figure
