"""The command `greybox profile`: intervals by profile likelihood, and regions of two parameters."""

import argparse

from greybox.cli.options import UsageError
from greybox.cli.output import Answer, attributes, require_figure, save_figure
from greybox.cli.saved_fits import stated_fit
from greybox.estimate.profile import contour, profile

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 a1 a2 --level 0.9 --plot profiles.png",
    "pitch.h5 --contour a1 a2 --plot contour.png",
)
OPTIONS = """
result RESULT
    a fit that greybox fit --out wrote
--problem
--model
names [NAME]...
    parameters and derived quantities (default: all of them)
--contour NAME NAME
    instead of intervals, the confidence region of two parameters
--level
--plot FILE
    draw the profiles into this png, pdf or svg file
--force
"""

REGION = ("names", "units", "level", "limit", "estimate", "points", "ends")


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
    return answer, str(result), *lines
