"""The command `greybox reduce`: the smaller structure that a saved fit suggests, fitted and compared with it."""

import argparse
from typing import Any

from greybox.cli.options import add_common_options, positive
from greybox.cli.output import USABLE, Answer
from greybox.cli.saved_fits import (
    add_fit_argument,
    add_out_option,
    require_fit_file,
    save_fit,
    stated_fit,
)
from greybox.estimate.summary import summary
from greybox.files.json_numbers import finite
from greybox.validation.reduction import Reduction, reduce

EXAMPLES = (
    "yaw.h5",
    "yaw.h5 --out smaller.h5",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_fit_argument(parser)
    parser.add_argument(
        "--starts",
        type=positive,
        default=8,
        help="of every structure, beside the estimate; 8 by default",
    )
    add_out_option(parser, "save the fit of the smaller structure to this HDF5 file")
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Read the fit, reduce it, and save what is left."""
    require_fit_file(options.out, options.force)
    fit, problem = stated_fit(options)
    found = reduce(fit, problem=problem, starts=options.starts)
    notes = save_fit(found.fit, options.out if found.taken else None)
    return _summary(found), "\n".join([str(found), *notes]), USABLE


def _summary(found: Reduction) -> dict[str, Any]:
    return {
        "taken": [str(candidate) for candidate in found.taken],
        "tried": [
            {
                "limit": str(one.candidate),
                "cost": None if one.fit is None else finite(one.fit.cost),
                "p_value": None if one.test is None else finite(one.test.p_value),
                "taken": one.taken,
            }
            for one in found.tried
        ],
        "p_value": None if found.test is None else finite(found.test.p_value),
        "verdict": "" if found.comparison is None else found.comparison.verdict,
        "large": {"cost": finite(found.large.cost), "free": list(found.large.free)},
        "fit": summary(found.fit),
    }
