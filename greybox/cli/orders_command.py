"""The command `greybox orders`: orders of a transfer function that responses support."""

import argparse
from typing import Any

from greybox.assessment.printed import summary
from greybox.cli.output import Answer
from greybox.cli.saved_fits import require_fit_file, save_fit
from greybox.data.files.named_values import attributes
from greybox.data.response_file import read_response
from greybox.workflows.identification.orders import STARTS, select_orders
from greybox.workflows.identification.selection import Selection
from greybox.workflows.study.stated_problem import filters_of

EXAMPLES = (
    "pitch_response.csv",
    "pitch_response.csv --n 2 3 4 --integrators 1 --no-delay --out chosen.h5",
    "bode.csv --columns frequency=f:Hz magnitude=mag:dB phase=ph:deg --out chosen.h5",
)
# The options that people use; the help shows the others below them.
USED = "--n --m --integrators --no-delay --columns --fix --bounds --out"
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
responses RESPONSE...
    measured frequency responses of one plant, as greybox response saves them
--columns NAME=COLUMN[:UNIT]...
    the columns of a table with other names: frequency=f:Hz
--n N...
    orders of the denominator, integrators included (default: up to four poles besides the
    integrators)
--m K...
    orders of the numerator: 0 1 2
--integrators K...
    numbers of integrators: 0 1 2
--no-delay
    fit structures without a delay
--through FILTER...
    filters between the output and its log, as in greybox fit
--fix
--free
--bounds
--start
--starts N
    number of other starts of the chosen structure (default: {STARTS})
--seed K
    seed of these starts (default: 0)
--out FILE
    save the fit of the chosen structure to this HDF5 file
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the responses, fit the structures of the grid, and choose."""
    require_fit_file(options.out, options.force)
    data = [read_response(path, columns=options.columns) for path in options.responses]
    # The filters are those of the log; all responses of one plant have passed the same ones.
    filters = [f for word in options.through for f in filters_of(word, data[0])]
    selection = select_orders(
        data,
        delay=not options.no_delay,
        through=filters,
        fixed=options.fix,
        **attributes(options, "n", "m", "integrators", "bounds", "start", "starts", "seed"),
    )
    # The table first: it shows which other orders fit nearly as well.
    answer = selection_json(selection)
    text = [str(selection)]
    if selection.fit is not None:
        text += ["", str(selection.fit), *save_fit(selection.fit, options.out)]
    if not selection.explains:
        answer["error"] = selection.verdict
    return answer, *text


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
    fit = selection.fit and summary(selection.fit)
    return {"structures": structures, **attributes(selection, "explains", "verdict"), "fit": fit}
