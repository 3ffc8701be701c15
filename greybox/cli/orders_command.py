"""The command `greybox orders`: orders of a transfer function that a response supports."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.columns import add_columns_option, stated_columns
from greybox.cli.options import add_common_options, nonnegative, positive
from greybox.cli.output import USABLE, Answer
from greybox.cli.saved_fits import add_out_option, require_fit_file, save_fit
from greybox.data.response_file import read_response
from greybox.estimate.summary import summary
from greybox.files.json_numbers import finite
from greybox.identification.orders import OrderSelection, select_orders

EXAMPLES = (
    "pitch_response.csv",
    "pitch_response.csv --n 2 3 4 --integrators 1 --delays 0 0.1 --out chosen.h5",
    "bode.csv --columns frequency=f:Hz magnitude=mag:dB phase=ph:deg --out chosen.h5",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "response",
        type=Path,
        metavar="RESPONSE",
        help="a measured frequency response, as of greybox response",
    )
    add_columns_option(parser, "what the columns of a table are that names them otherwise")
    add(
        "--n",
        type=positive,
        nargs="+",
        default=[1, 2, 3, 4],
        help="orders of the denominator, 1 2 3 4 by default",
    )
    add("--m", type=nonnegative, nargs="+", help="orders of the numerator (default: all below n)")
    add(
        "--integrators",
        type=nonnegative,
        nargs="+",
        default=[0, 1],
        metavar="K",
        help="0 1 by default",
    )
    add(
        "--delays",
        type=float,
        nargs="+",
        default=[0.0],
        metavar="S",
        help="largest delays, in s; 0 is a structure without one: 0 0.1 tries both (default: 0)",
    )
    add(
        "--starts",
        type=positive,
        default=8,
        help="of every structure, beside linear least squares; 8 by default",
    )
    add("--seed", type=nonnegative, default=0, help="of the starts, 0 by default")
    add_out_option(parser, "save the fit of the chosen structure to this HDF5 file")
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Read the response, fit every structure of the grid, and choose."""
    require_fit_file(options.out, options.force)
    data = read_response(options.response, columns=stated_columns(options) or None)
    grid = (options.n, options.m, options.integrators, options.delays)
    selection = select_orders(data, *grid, starts=options.starts, seed=options.seed)
    notes = save_fit(selection.fit, options.out)
    return _summary(selection), "\n".join([str(selection), "", str(selection.fit), *notes]), USABLE


def _summary(selection: OrderSelection) -> dict[str, Any]:
    structures = [
        {
            "n": c.n,
            "m": c.m,
            "integrators": c.integrators,
            "delay": c.delay,
            "parameters": c.parameters,
        }
        | {"bic": finite(c.bic), "chosen": c is selection.chosen}
        for c in selection.candidates
    ]
    return {
        "verdict": selection.verdict,
        "structures": structures,
        "failed": selection.failed,
        "fit": summary(selection.fit),
    }
