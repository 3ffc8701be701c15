"""The command `greybox orders`: orders of a transfer function that responses support."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.columns import add_columns_option, stated_columns
from greybox.cli.options import add_common_options, assignments, intervals, nonnegative, positive
from greybox.cli.output import FAILED, USABLE, Answer
from greybox.cli.parameter_options import add_value_options
from greybox.cli.saved_fits import add_out_option, require_fit_file, save_fit
from greybox.cli.stated_problem import filters_of
from greybox.data.response_file import read_response
from greybox.estimate.summary import summary
from greybox.files.json_numbers import finite
from greybox.identification.orders import select_orders
from greybox.identification.selection import Selection

EXAMPLES = (
    "pitch_response.csv",
    "pitch_response.csv --n 2 3 4 --integrators 1 --no-delay --out chosen.h5",
    "bode.csv --columns frequency=f:Hz magnitude=mag:dB phase=ph:deg --out chosen.h5",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "responses",
        nargs="+",
        type=Path,
        metavar="RESPONSE",
        help="measured frequency responses of one plant, as of greybox response",
    )
    add_columns_option(parser, "what the columns of a table are that names them otherwise")
    add(
        "--n",
        type=positive,
        nargs="+",
        default=[],
        help="orders of the denominator with its integrators (default: up to four poles beside "
        "these)",
    )
    add("--m", type=nonnegative, nargs="+", default=[], help="orders of the numerator, 0 1 2")
    add("--integrators", type=nonnegative, nargs="+", default=[], metavar="K", help="0 1 2")
    add("--no-delay", action="store_true", help="structures without a delay")
    add(
        "--through",
        nargs="+",
        default=[],
        metavar="FILTER",
        help="filters between the output and its log, as of greybox fit",
    )
    add_value_options(parser)
    add_out_option(parser, "save the fit of the chosen structure to this HDF5 file")
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Read the responses, fit the structures of the grid, and choose."""
    require_fit_file(options.out, options.force)
    columns = stated_columns(options) or None
    data = [read_response(path, columns=columns) for path in options.responses]
    selection = select_orders(
        data,
        options.n,
        options.m,
        options.integrators,
        delay=not options.no_delay,
        through=[model for word in options.through for model in filters_of(word, data[0])],
        fixed=assignments(options.fix, "--fix"),
        bounds=intervals(options.bounds, "--bounds"),
        start=assignments(options.start, "--start"),
    )
    answer = selection_json(selection)
    if selection.fit is None:
        return {**answer, "error": selection.verdict}, str(selection), FAILED
    notes = save_fit(selection.fit, options.out)
    text = "\n".join([str(selection), "", str(selection.fit), *notes])
    if not selection.explains:
        return {**answer, "error": selection.verdict}, text, FAILED
    return answer, text, USABLE


def selection_json(selection: Selection) -> dict[str, Any]:
    """Return the structures and the verdict as plain values."""
    structures = [
        {"model": c.label, "free": list(c.fit.free), "about": c.about, "remarks": list(c.remarks)}
        | {"converged": c.fit.converged, "cost": finite(c.fit.cost), "bic": finite(bic)}
        | {"residual_over_noise": finite(c.noise), "chosen": c is selection.chosen}
        for c, bic in zip(selection.candidates, selection.bic, strict=True)
    ]
    return {
        "structures": structures,
        "explains": selection.explains,
        "verdict": selection.verdict,
        "fit": summary(selection.fit) if selection.fit is not None else None,
    }
