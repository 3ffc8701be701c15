"""The command `greybox export`: a saved fit for other programs."""

import argparse

from greybox.cli.output import Answer, require_writable
from greybox.cli.saved_fits import saved_fit
from greybox.files.delimited_text import write_delimited
from greybox.files.safe_files import write_text
from greybox.interop.c_code import write_c
from greybox.interop.matlab_file import write_mat

EXAMPLES = (
    "pitch.h5 pitch.csv",
    "pitch.h5 pitch.c --step 0.0025",
)
OPTIONS = """
result RESULT
    a fit that greybox identify or fit --out wrote
file FILE
    by its ending: .csv a table of the estimate, .json everything that a fit prints, .mat the same
    with the data for MATLAB, .c the model at its estimate as C source
--step SECONDS
    sampling time of the C source (default: 0.01)
--pade K
    order of the Padé approximation of delays in the C source
--model
--force
"""
COLUMNS = ("name", "value", "standard_error", "unit", "about")


def run(options: argparse.Namespace) -> Answer:
    """Write the file, and for C source its header."""
    path = options.file
    files = [path]
    require_writable(path, options.force, (".csv", ".json", ".mat", ".c"), "export")
    fit = saved_fit(options.result, options)
    if path.suffix == ".c":
        files.append(path.with_suffix(".h"))
        require_writable(files[1], options.force)
        write_c(fit, path, step=options.step, pade=options.pade)
    elif path.suffix == ".mat":
        write_mat(fit, path)
    elif path.suffix == ".json":
        write_text(path, fit.to_json())
    else:
        columns = {name: [getattr(q, name) for q in fit.quantities] for name in COLUMNS}
        write_delimited(path, {}, columns)
    return {"files": files}, *(f"wrote {file}" for file in files)
