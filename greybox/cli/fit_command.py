"""The command `greybox fit`: a problem from many starts."""

import argparse
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

from greybox.assessment.fit import SolverChoice, fit_with_storage
from greybox.assessment.printed import summary
from greybox.assessment.result import Fit
from greybox.assessment.storage import save
from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_figure, save_figure
from greybox.cli.problem_options import PROBLEM_OPTIONS, problem_of
from greybox.cli.saved_fits import require_fit_file
from greybox.cli.workers import stated_executor
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.solve.interruption import (
    Interrupted,
    Response,
    building,
    end_after,
    is_search_over,
    limited,
    responding,
    take_interrupt,
)
from greybox.engine.solve.run_storage import RunStorageError
from greybox.engine.solve.search_method import BATCHED, SEARCHES
from greybox.workflows.study.database import is_study
from greybox.workflows.study.stored_runs import StoredRuns, folder_beside, runs_beside

EXAMPLES = (
    "pitch_hover",
    "my.py --starts 400 --out pitch.h5 --plot pitch.png",
    "--model tilt:Tilt --data response.csv --fix a5=0.16 --bounds a1=-100:0",
    "my.py --prior a4=5.6+-0.2 T_rotor=0.048+-0.005",
    "--model rate:DampedAngle --data bode.csv "
    "--columns frequency=f:Hz magnitude=mag:dB phase=ph:deg",
    "--model my.py:Drag --data flight.csv --columns time=t:ms theta=pitch:deg v=speed "
    "--method collocation",
)
# The options that people use; the help shows the others below them.
USED = "--model --data --columns --fix --free --bounds --criterion --starts --out --plot"
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
{PROBLEM_OPTIONS}
--starts N
    number of starts (default: the problem's; else 200, or 20 with records)
--seed K
    seed of the starts (default: the problem's, or 0)
--search {{{",".join(SEARCHES)}}}
    batched: all starts at once, then IPOPT for every minimum; multistart: IPOPT from every start
    (default: {BATCHED})
--out FILE
    save the result to this HDF5 file; after a kill, the same command continues
--no-profiles
    omit the profiles of parameters whose standard error misleads
--factored
    print the transfer functions at the estimate in factors; all data must be responses
--seconds S
    time limit of the fit
--trust
--workers
--scheduler
--plot FILE
    draw responses, time histories and starts into this png, pdf or svg file
--hz
--details
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Fit the problem of the options; save and draw the result if asked to."""
    # An interrupted fit has saved its best result so far, which the complete one may replace.
    continues = options.out is not None and is_study(folder_beside(options.out))
    require_fit_file(options.out, options.force or continues)
    require_figure(options.plot, options.force or continues)
    end = end_after(options.seconds)
    with limited(end), building():
        stated = _stated_fit(options)
    store = nullcontext() if options.out is None else runs_beside(options.out, trust=options.trust)
    with store as stored, stated_executor(options) as executor, limited(end):
        stated["executor"] = executor
        return _answer(options, stored, *_fitted(stored, stated, options))


def _stated_fit(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `fit_with_storage` that the options state."""
    # A problem file suggests starts and seed; the command line has the last word.
    problem, settings = problem_of(options)
    responses = problem.parts_with(FrequencyResponse)
    if options.factored and len(responses) < len(problem.parts):
        raise UsageError(f"--factored is for frequency responses; {problem.name} has other data.")
    for name in ("starts", "seed"):
        if getattr(options, name) is not None:
            settings[name] = getattr(options, name)
    by = SolverChoice(settings.pop("method", None), options.search)
    return {"problem": problem, "by": by, "profiles": not options.no_profiles, **settings}


def _fitted(
    stored: StoredRuns | None, stated: dict[str, Any], options: argparse.Namespace
) -> tuple[Fit, bool]:
    """Return the fit, or the best one so far after Ctrl-C, and whether it was interrupted."""
    try:
        return fit_with_storage(stored, **stated), False
    except Interrupted as stopped:
        if stopped.fit is None:
            raise
        return stopped.fit, True
    except RunStorageError as error:
        if stored is None or not options.force:
            raise UsageError(
                f"{folder_beside(options.out)} has the runs of another, unfinished fit: repeat its "
                "command, or give --force to start over."
            ) from error
        # A user who allows a fit to be overwritten with --force also allows its runs to be lost.
        stored.remove()
        return _fitted(stored, stated, options)


def _answer(
    options: argparse.Namespace, stored: StoredRuns | None, result: Fit, interrupted: bool
) -> Answer:
    """Save and draw a fit; its runs are stored until it is complete and saved."""
    answer = summary(result)
    if not result.converged:
        answer["error"] = ": ".join([result.status, *result.warnings[:1]]).rstrip(".") + "."
    notes = []
    try:
        if stored is not None:
            with responding(Response.FINISH):
                save(replace(result, command=options.arguments), options.out)
                # Only a complete fit makes its stored runs superfluous.
                if interrupted or is_search_over():
                    stored.write()
                else:
                    stored.remove()
            notes.append(f"saved {options.out}")
        interrupted = take_interrupt() or interrupted
        notes += save_figure(None if interrupted else options.plot, "plot", result, hz=options.hz)
        if options.factored and result.converged:
            answer["factored"] = [
                f"{part.name}: {result.transfer_function(k)}" for k, part in enumerate(result.parts)
            ]
            notes += answer["factored"]
    # Print the answer although the disk is full, or the model has no factors.
    except (OSError, ValueError) as error:
        answer["error"] = str(error)
    except KeyboardInterrupt:
        interrupted = True

    if interrupted:
        answer["error"] = "interrupted."
        notes += [f"{options.plot} is not drawn"] if options.plot is not None else []
    if stored is not None and stored.trouble:
        notes.append(f"the last runs are not stored: {stored.trouble}")
    if stored is not None and stored.count:
        notes.append(f"the same command continues with {counted(stored.count, 'run')}")
    details = ["", result.details] if options.details and result.converged else []
    return answer, str(result), *details, *notes
