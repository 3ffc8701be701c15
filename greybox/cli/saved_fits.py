"""Saved fits: those that `--out` writes and other commands read."""

import argparse
from pathlib import Path
from typing import Any

from greybox.assessment.result import Fit
from greybox.assessment.storage import load, save
from greybox.cli.options import UsageError
from greybox.cli.output import require_writable
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
    """Return the fit in a file, with the models of the option `--model`.

    Raises
    ------
    ValueError, OSError
        If the file is not a fit.
    """
    return load(path, models=options.model)


def held_out_records(options: argparse.Namespace, first: Fit | Study) -> list[Any]:
    """Return the held-out records of the options, with the signals of the first result's model.

    Raises
    ------
    UsageError
        For options of held-out records without `--held-out`.
    ValueError, OSError
        If a record cannot be read.
    """
    if not options.held_out:
        if options.columns or options.rate or options.gaps:
            raise UsageError("--columns, --rate and --gaps go with --held-out.")
        return []
    # All models must have the outputs that are compared, so any of them will do.
    if isinstance(first, Study):
        fit = first.done[0].fit
        assert fit is not None  # a member that is done has a fit
    else:
        fit = first
    model = fit.model_of()
    records = []
    for path in options.held_out:
        record = read_data(
            path, model, columns=options.columns, rate=options.rate, gaps=options.gaps
        )
        records.append(record)
    return records


def flight_log(fit: Fit, path: Path, options: argparse.Namespace) -> Recording | None:
    """Return the flight log with the controllers: that of `--log`, or the one beside the fit.

    Without `--log`, this is the log from which the fit was made, if it lies in the folder of the
    fit and no controller is stated; else None.

    Raises
    ------
    UsageError
        If the log beside the fit is not the one of the fit, or if a controller is stated as well.
    """
    if options.log:
        log = read(options.log)
    else:
        about = getattr(fit.parts[0].data, "about", {})
        # Only the name counts: a file from a stranger must not choose the folder.
        beside = path.parent / Path(about.get("log", "")).name
        if options.controller or not beside.is_file():
            return None
        log = read(beside)
        if log.checksum != about.get("log sha256"):
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
    problem = None
    if options.problem:
        problem, _settings = find_problem(options.problem)
    return saved_fit(options.result, options), problem


def require_fit_file(path: Path | None, force: bool) -> None:
    """Refuse a file that cannot be written, exists without --force, or has the wrong ending.

    Raises
    ------
    UsageError
        For such a file.
    """
    require_writable(path, force, HDF5, "saved fit")


def save_fit(fit: Fit, path: Path | None) -> list[str]:
    """Save a fit and return a line that reports it; without a path, do nothing."""
    if path is None:
        return []
    save(fit, path)
    return [f"saved {path}"]
