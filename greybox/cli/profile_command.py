"""The command `greybox profile`: intervals of a saved fit that need not be symmetric."""

import argparse
from typing import Any

from greybox.cli.options import add_common_options, probability
from greybox.cli.output import USABLE, Answer, require_figure, save_figure
from greybox.cli.saved_fits import add_fit_argument, stated_fit
from greybox.estimate.profile import profile
from greybox.estimate.profiles import Profiles

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 a1 a2 --level 0.9 --plot profiles.png",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_fit_argument(parser)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="parameters and derived quantities (default: all)",
    )
    parser.add_argument(
        "--level",
        type=probability,
        default=0.95,
        help="confidence level of the intervals (default: 0.95)",
    )
    add_common_options(parser, figure="the profiles")


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and profile it."""
    require_figure(options.plot, options.force)
    fit, problem = stated_fit(options)
    result = profile(fit, options.names or None, problem=problem, level=options.level)
    lines = save_figure(options.plot, lambda: _figure(result))
    return result.summary(), "\n".join([str(result), *lines]), USABLE


def _figure(result: Profiles) -> Any:
    from greybox.plotting import profile as figures  # noqa: PLC0415  (imports matplotlib)

    return figures.profiles(result)[0].figure
