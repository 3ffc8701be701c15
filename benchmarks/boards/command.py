"""The command of every board: a table from a folder with the data, printed or written to a file."""

import argparse
import datetime as dt
import platform
from collections.abc import Callable, Collection
from pathlib import Path

import greybox as gb


def heading() -> str:
    """Return the versions and the date of a table."""
    return f"greybox {gb.__version__}, Python {platform.python_version()}, {dt.date.today()}"


def parser(about: str | None) -> argparse.ArgumentParser:
    """Return the arguments that all boards take; `about` begins with a line on the board."""
    arguments = argparse.ArgumentParser(description=(about or "").partition("\n")[0])
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--output", type=Path)
    return arguments


def estimates(fit: gb.Fit, names: Collection[str]) -> list[str]:
    """Return a line for each free parameter of these names: value, standard error, unit."""
    return [
        f"{q.name:6} {q.value:10.5g} "
        + ("at its bound" if q.at_bound else f"± {q.standard_error:.2g} {q.unit}")
        for q in fit.quantities
        if q.kind == "free" and q.name in names
    ]


def judged(label: str, fit: gb.Fit) -> list[str]:
    """Return what a fit says of its model, and the first cause of a misfit."""
    misfit = fit.misfit
    if misfit is None:
        return [f"{label}: not tested for candidate terms"]
    return [
        f"{label}: the model {misfit.verdict}",
        *(f"  {cause.explained}" for cause in misfit.likely[:1]),
    ]


def show(board: Callable[[Path], list[str]], options: argparse.Namespace) -> None:
    """Print the table of a board, and write it to a file on request."""
    text = "\n".join(board(options.folder))
    print(text)
    if options.output:
        options.output.write_text(text + "\n", encoding="utf-8")
