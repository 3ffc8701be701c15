"""The command `greybox bootstrap`: errors and intervals of a saved fit from data that are drawn anew."""

import argparse
from pathlib import Path

from greybox.cli.options import UsageError, add_common_options, nonnegative, positive
from greybox.cli.output import FAILED, INTERRUPTED, USABLE, Answer
from greybox.cli.saved_fits import add_fit_argument, stated_fit
from greybox.cli.workers import add_worker_options, stated_executor
from greybox.solve.executors import ExecutorLostError
from greybox.study.bootstrap import bootstrap

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 --replicates 400 --out replicates --workers 2",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add_fit_argument(parser)
    add("--replicates", type=positive, default=1000, metavar="N", help="1000 by default")
    add("--seed", type=nonnegative, default=0, help="of what is drawn, 0 by default")
    add(
        "--level",
        type=float,
        default=0.95,
        help="of the intervals in the JSON object, 0.95 by default",
    )
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="keep the replicates in this folder; the same command goes on there",
    )
    add_worker_options(parser)
    add_common_options(parser)


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and repeat it."""
    if not 0 < options.level < 1:
        raise UsageError(f"--level {options.level} must lie between 0 and 1, e.g. 0.95.")
    if options.out is not None and options.out.exists() and not options.out.is_dir():
        raise UsageError(f"{options.out} is a file: give a folder.")
    fit, problem = stated_fit(options)
    try:
        with stated_executor(options) as executor:
            found = bootstrap(
                fit,
                options.replicates,
                problem=problem,
                seed=options.seed,
                executor=executor,
                folder=options.out,
            )
    except KeyboardInterrupt:
        again = f"; the same command goes on in {options.out}" if options.out is not None else ""
        return {"error": f"interrupted{again}."}, f"interrupted{again}", INTERRUPTED
    except ExecutorLostError as error:
        return {"error": str(error)}, "", FAILED
    answer, status = found.summary(options.level), USABLE
    if found.failed > len(found.values) - 2:
        answer["error"], status = found.warnings[0], FAILED
    return answer, found.text(options.level), status
