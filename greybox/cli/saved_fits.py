"""Fits that `--out` saved, and the option for models of one's own in them."""

import argparse
from pathlib import Path

from greybox.estimate.result import Fit


def add_model_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option."""
    parser.add_argument(
        "--model", type=Path, nargs="+", default=[], metavar="FILE", help="Python files with models of your own"
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
