"""The command `greybox compare`: saved fits side by side, or the members of a study."""

import argparse

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
OPTIONS = f"""
results RESULT...
    fits of the same data, as greybox fit --out saves them, or the folder of a study
--model
{HELD_OUT}
--by FACTOR
    compare the values of this factor over the data sets of a study: model, criterion, delay, ...;
    or of several, such as model,fixed
--csv FILE
    the estimates of a study, a row for every member and parameter
--latex FILE
    the estimates of a study with standard errors, as tables for the package booktabs
--force
"""
SUMMARY = ("labels", "data", "supported", "verdict", "table", "statements")


def run(options: argparse.Namespace) -> Answer:
    """Read the fits, or the study, and compare."""
    tables = {"to_csv": options.csv, "to_latex": options.latex}
    for path in tables.values():
        require_writable(path, options.force)
    if len(options.results) > 1 or not options.results[0].is_dir():  # a study is a folder
        if any(tables.values()) or options.by:
            raise UsageError("--by, --csv and --latex are for a study: give one folder.")
        comparison = _comparison(options)
        return attributes(comparison, *SUMMARY), str(comparison)
    if options.held_out:
        raise UsageError("--held-out is for fits; for a study, write `held` in its file.")
    # Members of a study may have different data, so that they are listed, not compared by tests.
    study = read_study(options.results[0], options.model)
    answer = as_json(study)
    lines = [str(study)]
    if options.by:
        comparison = study.ranking(*options.by.split(","))
        answer |= attributes(comparison, *SUMMARY)
        lines = [str(comparison)]
    for method, path in tables.items():
        if path is not None:
            write_text(path, getattr(study, method)())
            lines.append(f"wrote {path}")
    return answer, "\n".join(lines)


def _comparison(options: argparse.Namespace) -> Comparison:
    paths = unique(options.results)
    # Stems are short; files with the same name in several folders need their paths.
    names = [path.stem for path in paths]
    labels = names if len(set(names)) == len(names) else list(map(str, paths))
    fits = [saved_fit(path, options) for path in paths]
    return compare(*fits, records=held_out_records(options, fits[0]), labels=labels)
