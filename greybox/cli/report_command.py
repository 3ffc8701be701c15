"""The command `greybox report`: a page about saved results."""

import argparse
from pathlib import Path

from greybox.assessment.validation.compare import compare
from greybox.cli.output import Answer, require_writable
from greybox.cli.saved_fits import HELD_OUT, held_out_records, saved_fit
from greybox.workflows.study.study import read_study

EXAMPLES = (
    "pitch.h5",
    "linear.h5 nonlinear.h5 --out comparison.html",
    "results",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
results RESULT...
    a fit that greybox fit --out or greybox identify wrote, or the folder of a study; several are
    shown side by side
--out FILE
    the page (default: the name of the first result, ending in .html)
--model
{HELD_OUT}
--title TITLE
    heading of the page (default: the name of the fit)
--author NAME
    who answers for the page
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the results and write the page."""
    from greybox.reporting.html_report.report import report  # noqa: PLC0415  (imports matplotlib)

    out = options.out or Path(f"{options.results[0].resolve().stem}.html")
    require_writable(out, options.force, (".html", ".htm"), "page")
    results = [
        read_study(path, options.model) if path.is_dir() else saved_fit(path, options)
        for path in options.results
    ]
    records = held_out_records(options, results[0])
    comparison = compare(*results, records=records) if records else None
    report(results, out, comparison=comparison, title=options.title, author=options.author)
    # People mail such pages, and want to know their size.
    size = out.stat().st_size
    answer = {"page": out, "bytes": size, "results": options.results}
    return answer, f"wrote {out} ({size / 1000:.0f} kB)"
