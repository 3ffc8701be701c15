"""The command `greybox profile`: intervals by profile likelihood."""

import argparse

from greybox.assessment.profile import profile
from greybox.cli.output import Answer, require_figure, save_figure
from greybox.cli.saved_fits import stated_fit

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 a1 a2 --level 0.9 --plot profiles.png",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
result RESULT
    a fit that greybox fit --out wrote
--problem
--model
names [NAME]...
    parameters and derived quantities (default: all of them)
--level
--plot FILE
    draw the profiles into this png, pdf or svg file
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and profile it."""
    require_figure(options.plot, options.force)
    fit, problem = stated_fit(options)
    result = profile(fit, options.names or None, problem=problem, level=options.level)
    return result.summary(), str(result), *save_figure(options.plot, "profiles", result)
