"""Saved fits: those that `--out` writes and other commands read."""

import argparse
from pathlib import Path

from greybox.cli.output import require_writable
from greybox.compiled.compiled_problem import AnyProblem
from greybox.estimate.result import Fit
from greybox.files.safe_files import HDF5
from greybox.study.catalog import find_problem


def saved_fit(path: Path, options: argparse.Namespace) -> Fit:
    """Return the fit in a file, with the models of the option.

    Raises
    ------
    ValueError, OSError
        If the file is not a fit.
    """
    from greybox.estimate.storage import load  # noqa: PLC0415  (needs h5py)

    return load(path, models=options.model)


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
    from greybox.estimate.storage import save  # noqa: PLC0415  (needs h5py)

    save(fit, path)
    return [f"saved {path}"]
