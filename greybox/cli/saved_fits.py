"""Fits that `--out` saves and other commands read: the arguments that name them, and what they need beside."""

import argparse
from pathlib import Path

from greybox.cli.catalog import find_problem
from greybox.cli.output import require_writable
from greybox.compiled.compiled_problem import AnyProblem
from greybox.estimate.result import Fit
from greybox.files.safe_files import HDF5


def add_fit_argument(parser: argparse.ArgumentParser) -> None:
    """Declare RESULT, a saved fit, and what was fitted where the file alone does not say it."""
    parser.add_argument(
        "result", type=Path, metavar="RESULT", help="a fit that greybox fit --out wrote"
    )
    parser.add_argument(
        "--problem", metavar="PROBLEM", help="what was fitted, where it has ties or constraints"
    )
    add_model_option(parser)


def add_model_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option."""
    parser.add_argument(
        "--model",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="Python files with models of your own",
    )


def saved_fit(path: Path, options: argparse.Namespace) -> Fit:
    """Return the fit in a file, which knows the models that greybox includes and those that the option gives.

    Raises
    ------
    ValueError, OSError
        If it is none.
    """
    from greybox.estimate.storage import load  # noqa: PLC0415  (needs h5py)

    return load(path, models=options.model)


def stated_fit(options: argparse.Namespace) -> tuple[Fit, AnyProblem | None]:
    """Return the fit that RESULT names, and its problem, if that is stated.

    Raises
    ------
    ValueError, OSError
        If they are none.
    """
    problem = None if options.problem is None else find_problem(options.problem)[0]
    return saved_fit(options.result, options), problem


def add_out_option(
    parser: argparse.ArgumentParser, about: str = "save the fit to this HDF5 file"
) -> None:
    """Declare where a fit is saved."""
    parser.add_argument("--out", type=Path, metavar="FILE", help=about)


def require_fit_file(path: Path | None, force: bool) -> None:
    """Refuse a file that cannot be written, or exists and is not to be overwritten, or would be no saved fit.

    Raises
    ------
    UsageError
        One sentence with the cure.
    """
    require_writable(path, force, HDF5, "saved fit")


def save_fit(fit: Fit, path: Path | None) -> list[str]:
    """Save a fit, and return a line that says so; without a path, nothing."""
    if path is None:
        return []
    from greybox.estimate.storage import save  # noqa: PLC0415  (needs h5py)

    save(fit, path)
    return [f"saved {path}"]
