"""Saved fits: those that `--out` writes and other commands read."""

import argparse
from pathlib import Path
from typing import Any

from greybox.assessment.result import Fit
from greybox.assessment.storage import load, save
from greybox.cli.options import UsageError
from greybox.cli.output import require_writable
from greybox.data.files.named_values import attributes
from greybox.data.files.safe_files import HDF5
from greybox.data.logs.readers import read
from greybox.data.record import Recording
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.workflows.study.catalog import find_problem
from greybox.workflows.study.data_file import read_data
from greybox.workflows.study.study import Study

HELD_OUT = """
--held-out FILE...
    records that none of two or more fits has seen: how well each predicts them
--columns NAME=COLUMN[:UNIT]...
    the columns of the held-out tables, as in greybox predict
--rate
--gaps
"""


def saved_fit(path: Path, options: argparse.Namespace) -> Fit:
    """Return the fit in a file, with the models of the option.

    Raises
    ------
    ValueError, OSError
        If the file is not a fit.
    """
    return load(path, models=options.model)


def held_out_records(options: argparse.Namespace, first: Fit | Study) -> list[Any]:
    """Return the held-out records of the options, with the signals of the first result.

    All models must have the outputs that are compared.
    """
    if not options.held_out:
        if options.columns or options.rate or options.gaps:
            raise UsageError("--columns, --rate and --gaps go with --held-out.")
        return []
    fit: Any = first if isinstance(first, Fit) else first.done[0].fit
    model = fit.model_of()
    return [
        read_data(path, model, **attributes(options, "columns", "rate", "gaps"))
        for path in options.held_out
    ]


def flight_log(fit: Fit, path: Path, options: argparse.Namespace) -> Recording | None:
    """Return the log whose controllers flew: the stated one, or that of the fit, in its folder.

    Return None if a controller is stated, or if the fit has no log there.

    Raises
    ------
    UsageError
        If the log beside the fit is not the one of the fit, or if a controller is stated as well.
    """
    about = getattr(fit.parts[0].data, "about", {})
    # Only its name: a file from a stranger must not choose the folder.
    beside = path.parent / Path(about.get("log", "")).name
    if not options.log and (options.controller or not beside.is_file()):
        return None
    log = read(options.log or beside)
    if not options.log and log.checksum != about.get("log sha256"):
        raise UsageError(f"{beside} is not the log of {path}: give the right one with --log.")
    for name in ("controller", "set", "rate"):
        if getattr(options, name):
            raise UsageError(
                f"--{name} states a controller, and --log has the one that flew: leave out one of "
                "them."
            )
    return log


def stated_fit(options: argparse.Namespace) -> tuple[Fit, AnyProblem | None]:
    """Return the fit RESULT, and its problem if the option gives it.

    Raises
    ------
    ValueError, OSError
        If they do not exist or are something else.
    """
    # A file contains ties and constraints as texts only, and nothing in a file is executed.
    problem = find_problem(options.problem)[0] if options.problem else None
    return saved_fit(options.result, options), problem


def require_fit_file(path: Path | None, force: bool) -> None:
    """Refuse a file that cannot be written, exists without --force, or has the wrong ending.

    Raises
    ------
    UsageError
        One sentence with the cure.
    """
    require_writable(path, force, HDF5, "saved fit")


def save_fit(fit: Fit, path: Path | None) -> list[str]:
    """Save a fit and return a line that reports it; without a path, do nothing."""
    if path is None:
        return []
    save(fit, path)
    return [f"saved {path}"]
