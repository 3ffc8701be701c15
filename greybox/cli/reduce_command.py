"""The command `greybox reduce`: the smaller structure that a saved fit suggests."""

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
        help="Sobol points for every structure, beside the estimate (default: 8)",
    )
    add_out_option(parser, "save the fit of the smaller structure to this HDF5 file")
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Read the fit, reduce it, and save the fit of the smaller structure."""
    require_fit_file(options.out, options.force)
    fit, problem = stated_fit(options)
    reduction = reduce(fit, problem=problem, starts=options.starts)
    notes = save_fit(reduction.fit, options.out if reduction.taken else None)
    return _summary(reduction), "\n".join([str(reduction), *notes]), USABLE


def _summary(reduction: Reduction) -> dict[str, Any]:
    return {
        "verdict": reduction.verdict,
        "taken": [str(candidate) for candidate in reduction.taken],
        "tried": [
            {
                "limit": str(trial.candidate),
                "cost": None if trial.fit is None else finite(trial.fit.cost),
                "p_value": None if trial.test is None else finite(trial.test.p_value),
                "taken": trial.taken,
            }
            for trial in reduction.tried
        ],
        "p_value": None if reduction.test is None else finite(reduction.test.p_value),
        "large": {"cost": finite(reduction.large.cost), "free": list(reduction.large.free)},
        "fit": summary(reduction.fit),
    }
