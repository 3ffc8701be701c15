"""The command `greybox fit`: a problem from many starts."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from greybox.cli.options import UsageError, add_common_options, add_time_options, nonnegative, positive, probability
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, require_writable, save_figure
from greybox.cli.startup import INTERRUPTED
from greybox.cli.stated_problem import add_problem_options, stated_problem
from greybox.cli.workers import add_worker_options, stated_executor
from greybox.compiled.compiled_problem import AnyProblem
from greybox.data.response_file import HDF5
from greybox.estimate.fit import Interrupted, fit
from greybox.estimate.result import Fit
from greybox.estimate.storage import save
from greybox.estimate.summary import summary
from greybox.formulation.starts import UntilFoundAgain
from greybox.solve.interruption import Response, responding, take_interrupt
from greybox.solve.multistart import BATCHED, SEARCHES


def add_command(commands: Any) -> None:
    """Declare the command and its options."""
    parser = commands.add_parser("fit", help="fit a problem from many starts", allow_abbrev=False)
    add_problem_options(parser)
    number = parser.add_mutually_exclusive_group()
    number.add_argument(
        "--starts", type=positive, help="number of starts (default: the problem's; else 200, or 20 with records)"
    )
    number.add_argument(
        "--until-found-again",
        type=probability,
        metavar="ERROR",
        help="as many starts as it takes until the probability of another minimum is at most ERROR, as 0.01",
    )
    parser.add_argument("--seed", type=nonnegative, help="seed of the starts (default: the problem's, or 0)")
    parser.add_argument(
        "--search",
        choices=SEARCHES,
        default=BATCHED,
        help="batched (default): all starts at once, then IPOPT for every minimum; multistart: IPOPT from every start; "
        "global-search: the scatter search of MATLAB's GlobalSearch",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="save the result to this HDF5 file")
    add_time_options(parser, "fit")
    add_worker_options(parser)
    add_common_options(parser, "responses, time histories and starts")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> Answer:
    """Fit the stated problem; save and draw the result where asked to."""
    require_writable(options.out, options.force)
    if options.out is not None and options.out.suffix.lower() not in HDF5:
        raise UsageError(f"--out {options.out} is not a known kind of file: a fit is saved as HDF5, end it in .h5.")
    require_figure(options.plot, options.force)
    problem, settings = stated_problem(options)
    for name in ("starts", "seed", "seconds", "start_seconds"):
        if getattr(options, name) is not None:
            settings[name] = getattr(options, name)
    settings["search"] = options.search
    if options.until_found_again is not None:
        settings["starts"] = UntilFoundAgain(error=options.until_found_again, seed=settings.pop("seed", None) or 0)
    with stated_executor(options) as executor:
        result, interrupted = _fitted(problem, settings | {"executor": executor})

    answer = summary(result)
    status = USABLE if result.converged else FAILED
    if not result.converged:
        answer["error"] = ": ".join([result.status, *result.warnings[:1]]).rstrip(".") + "."
    notes = []
    try:
        if options.out is not None:
            with responding(Response.FINISH):
                save(result, options.out)
            notes.append(f"saved {options.out}")
        interrupted = take_interrupt() or interrupted
        notes += save_figure(None if interrupted else options.plot, lambda: _figure(result))
    except OSError as error:  # a full disk does not take the answer away
        answer["error"] = str(error)
        status = FAILED
    except KeyboardInterrupt:
        interrupted = True
    if interrupted:
        answer["error"] = "interrupted."
        status = INTERRUPTED
        notes += [f"{options.plot} is not drawn"] if options.plot is not None else []
    return answer, "\n".join([str(result), *notes]), status


def _fitted(problem: AnyProblem, settings: Mapping[str, Any]) -> tuple[Fit, bool]:
    """Return the fit, or the best so far if it was interrupted, and whether it was."""
    try:
        return fit(problem, **settings), False
    except Interrupted as stopped:
        if stopped.fit is None:
            raise
        return stopped.fit, True


def _figure(result: Fit) -> Any:
    from greybox.plotting import plot  # noqa: PLC0415  (imports matplotlib)

    return plot(result)
