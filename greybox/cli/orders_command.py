"""The command `greybox orders`: orders of a transfer function that responses support."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.options import (
    add_columns_option,
    add_common_options,
    add_words,
    nonnegative,
    positive,
    stated_columns,
)
from greybox.cli.output import FAILED, USABLE, Answer, attributes
from greybox.cli.parameter_options import add_value_options, stated_values
from greybox.cli.saved_fits import add_out_option, require_fit_file, save_fit
from greybox.cli.stated_problem import filters_of
from greybox.data.response_file import read_response
from greybox.estimate.summary import summary
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
        help="measured frequency responses of one plant, as greybox response saves them",
    )
    add_columns_option(parser, "the columns of a table with other names: frequency=f:Hz")
    add(
        "--n",
        type=positive,
        nargs="+",
        default=[],
        help="orders of the denominator, integrators included (default: up to four poles besides "
        "the integrators)",
    )
    add("--m", type=nonnegative, nargs="+", default=[], help="orders of the numerator: 0 1 2")
    add(
        "--integrators",
        type=nonnegative,
        nargs="+",
        default=[],
        metavar="K",
        help="numbers of integrators: 0 1 2",
    )
    add("--no-delay", action="store_true", help="fit structures without a delay")
    about = "filters between the output and its log, as in greybox fit"
    add_words(parser, "--through", "FILTER", about)
    add_value_options(parser)
    add_out_option(parser, "save the fit of the chosen structure to this HDF5 file")
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Read the responses, fit the structures of the grid, and choose."""
    require_fit_file(options.out, options.force)
    columns = stated_columns(options) or None
    data = [read_response(path, columns=columns) for path in options.responses]
    # The filters are those of the log; all responses of one plant have passed the same ones.
    filters: list[Any] = [f for word in options.through for f in filters_of(word, data[0])]
    selection = select_orders(
        data,
        options.n,
        options.m,
        options.integrators,
        delay=not options.no_delay,
        through=filters,
        **stated_values(options),
    )
    # The table first: it shows which other orders fit nearly as well.
    answer = selection_json(selection)
    text = [str(selection)]
    if selection.fit is not None:
        text += ["", str(selection.fit), *save_fit(selection.fit, options.out)]
    if selection.fit is None or not selection.explains:
        return {**answer, "error": selection.verdict}, "\n".join(text), FAILED
    return answer, "\n".join(text), USABLE


def selection_json(selection: Selection) -> dict[str, Any]:
    """Return the structures and the verdict."""
    structures = [
        {
            "model": candidate.label,
            **attributes(candidate, "about", "remarks"),
            **attributes(candidate.fit, "free", "converged", "cost"),
            "bic": bic,
            "residual_over_noise": candidate.noise,
            "chosen": candidate is selection.chosen,
        }
        for candidate, bic in zip(selection.candidates, selection.bic, strict=True)
    ]
    fit = summary(selection.fit) if selection.fit is not None else None
    return {"structures": structures, **attributes(selection, "explains", "verdict"), "fit": fit}
