"""The command `greybox compare`: saved fits side by side, or the members of a study."""

import argparse
from typing import Any

from greybox.assessment.validation.compare import compare
from greybox.assessment.validation.comparison import Comparison
from greybox.cli.batch_command import as_json
from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_writable
from greybox.cli.saved_fits import HELD_OUT, held_out_records, saved_fit
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import attributes
from greybox.data.files.safe_files import write_text
from greybox.workflows.study.study import read_study

EXAMPLES = (
    "linear.h5 nonlinear.h5",
    "linear.h5 nonlinear.h5 --held-out flight_2.csv",
    "results",
    "results --by model",
    "results --latex table.tex --csv table.csv",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
results RESULT...
    fits of the same data, as greybox fit --out saves them, or the folder of a study
--model
{HELD_OUT}
--by WHAT
    compare the values of this factor over the data sets of a study: model, criterion, delay, ...;
    or of several, such as model,fixed
--csv FILE
    the estimates of a study, a row for every member and parameter
--latex FILE
    the estimates of a study with standard errors, as tables for the package booktabs
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the fits, or the study, and compare."""
    for path in (options.csv, options.latex):
        require_writable(path, options.force)
    is_study = len(options.results) == 1 and options.results[0].is_dir()
    if not is_study:
        if options.by or options.csv or options.latex:
            raise UsageError("--by, --csv and --latex are for a study: give one folder.")
        comparison = _comparison(options)
        return _as_json(comparison), str(comparison)
    if options.held_out:
        raise UsageError("--held-out is for fits; for a study, write `held` in its file.")
    # Members of a study may have different data, so that they are listed, not compared by tests.
    study = read_study(options.results[0], options.model)
    answer = as_json(study)
    lines = [str(study)]
    if options.by:
        comparison = study.ranking(*options.by.split(","))
        answer |= _as_json(comparison)
        lines = [str(comparison)]
    if options.csv is not None:
        write_text(options.csv, study.to_csv())
        lines.append(f"wrote {options.csv}")
    if options.latex is not None:
        write_text(options.latex, study.to_latex())
        lines.append(f"wrote {options.latex}")
    return answer, "\n".join(lines)


def _as_json(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as plain values."""
    return attributes(comparison, "labels", "data", "supported", "verdict", "table", "statements")


def _comparison(options: argparse.Namespace) -> Comparison:
    """Compare saved fits."""
    paths = unique(options.results)
    # Stems are short; files with the same name in several folders need their paths.
    names = [path.stem for path in paths]
    labels = names if len(set(names)) == len(names) else list(map(str, paths))
    fits = [saved_fit(path, options) for path in paths]
    return compare(*fits, records=held_out_records(options, fits[0]), labels=labels)
