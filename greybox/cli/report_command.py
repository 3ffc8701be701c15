"""The command `greybox report`: a page about saved results."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_writable
from greybox.cli.saved_fits import saved_fit
from greybox.estimate.result import Fit
from greybox.study.data_file import read_data
from greybox.study.study import Study, read_study
from greybox.validation.compare import compare
from greybox.validation.comparison import Comparison

EXAMPLES = (
    "pitch.h5",
    "linear.h5 nonlinear.h5 --out comparison.html",
    "results",
)
OPTIONS = """
results RESULT...
    a fit that greybox fit --out or greybox identify wrote, or the folder of a study; several are
    shown side by side
--out FILE
    the page (default: the name of the first result, ending in .html)
--model
--held-out FILE...
    records that none of two or more fits has seen: how well each predicts them
--columns NAME=COLUMN[:UNIT]...
    the columns of the held-out tables, as in greybox predict
--rate
--title TITLE
    heading of the page (default: the name of the fit)
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the results and write the page."""
    from greybox.html_report.report import report  # noqa: PLC0415  (imports matplotlib)

    out = options.out or Path(f"{options.results[0].resolve().stem}.html")
    require_writable(out, options.force, (".html", ".htm"), "page")
    results = [
        read_study(path, options.model) if path.is_dir() else saved_fit(path, options)
        for path in options.results
    ]
    report(results, out, comparison=_held_out(options, results), title=options.title)
    # People mail such pages, and want to know their size.
    size = out.stat().st_size
    answer = {"page": out, "bytes": size, "results": options.results}
    return answer, f"wrote {out} ({size / 1000:.0f} kB)"


def _held_out(options: argparse.Namespace, results: Sequence[Fit | Study]) -> Comparison | None:
    """Return how well the fits predict the held-out records; None without records."""
    if not options.held_out:
        if options.columns or options.rate:
            raise UsageError("--columns and --rate go with --held-out.")
        return None

    # All models must have the outputs that are compared, so the first one names the signals.
    first: Any = results[0].done[0].fit if isinstance(results[0], Study) else results[0]
    records: list[Any] = [
        read_data(path, first.model_of(), columns=options.columns, rate=options.rate)
        for path in options.held_out
    ]
    return compare(*results, records=records)
