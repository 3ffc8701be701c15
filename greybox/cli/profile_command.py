"""The command `greybox profile`: intervals by profile likelihood, and regions of two parameters."""

import argparse

from greybox.cli.options import UsageError, add_common_options, add_level_option
from greybox.cli.output import USABLE, Answer, attributes, require_figure, save_figure
from greybox.cli.saved_fits import add_fit_argument, stated_fit
from greybox.estimate.profile import contour, profile

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 a1 a2 --level 0.9 --plot profiles.png",
    "pitch.h5 --contour a1 a2 --plot contour.png",
)

REGION = ("names", "units", "level", "limit", "estimate", "points", "ends")


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
        "--contour",
        nargs=2,
        metavar="NAME",
        help="instead of intervals, the confidence region of two parameters",
    )
    add_level_option(parser)
    add_common_options(parser, figure="the profiles")


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and profile it."""
    require_figure(options.plot, options.force)
    fit, problem = stated_fit(options)
    # A region shows two parameters at once: further names would be ignored.
    if options.contour:
        if options.names:
            raise UsageError("--contour takes two parameters: leave out other names.")
        result = contour(fit, *options.contour, problem=problem, level=options.level)
        answer, figure = attributes(result, *REGION) | {"text": str(result)}, "contour"
    else:
        result = profile(fit, options.names or None, problem=problem, level=options.level)
        answer, figure = result.summary(), "profiles"

    lines = save_figure(options.plot, figure, result)
    return answer, "\n".join([str(result), *lines]), USABLE
