"""The command `greybox profile`: intervals by profile likelihood, and regions of two parameters."""

import argparse
from typing import Any

from greybox.cli.options import UsageError, add_common_options, probability
from greybox.cli.output import USABLE, Answer, attributes, require_figure, save_figure
from greybox.cli.saved_fits import add_fit_argument, stated_fit
from greybox.estimate.profile import contour, profile
from greybox.estimate.profiles import Contour, Profiles

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
    if options.contour:
        if options.names:
            raise UsageError("--contour takes two parameters: leave out other names.")
        result = contour(fit, *options.contour, problem=problem, level=options.level)
        answer = attributes(result, *REGION) | {"text": str(result)}
    else:
        result = profile(fit, options.names or None, problem=problem, level=options.level)
        answer = result.summary()

    lines = save_figure(options.plot, lambda: _figure(result))
    return answer, "\n".join([str(result), *lines]), USABLE


def _figure(result: Profiles | Contour) -> Any:
    from greybox.plotting import profile as figures  # noqa: PLC0415  (imports matplotlib)

    if isinstance(result, Contour):
        return figures.contour(result).figure
    return figures.profiles(result)[0].figure
