"""The command `greybox export`: a saved fit for other programs."""

import argparse

import casadi as ca

from greybox.cli.output import Answer, require_writable
from greybox.cli.saved_fits import saved_fit
from greybox.data.files.delimited_text import write_delimited
from greybox.data.files.safe_files import write_text
from greybox.reporting.interop.casadi_function import to_casadi

EXAMPLES = (
    "pitch.h5 pitch.csv",
    "pitch.h5 pitch.c --pade 2",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
result RESULT
    a fit that greybox identify or fit --out wrote
file FILE
    by its ending: .csv a table of the estimate, .json everything that a fit prints, .c derivative
    and outputs of the model at its estimate as C source by CasADi
--pade K
    order of the Padé approximation of delays in the C source
--model
--force
"""
COLUMNS = ("name", "value", "standard_error", "unit", "about")


def run(options: argparse.Namespace) -> Answer:
    """Write the file."""
    path = options.file
    require_writable(path, options.force, (".csv", ".json", ".c"), "export")
    fit = saved_fit(options.result, options)
    if path.suffix == ".c":
        function = to_casadi(fit, pade=options.pade)
        generator = ca.CodeGenerator(function.name())
        generator.add(function)
        write_text(path, generator.dump())
    elif path.suffix == ".json":
        write_text(path, fit.to_json())
    else:
        columns = {name: [getattr(q, name) for q in fit.quantities] for name in COLUMNS}
        write_delimited(path, {}, columns)
    return {"files": [path]}, f"wrote {path}"
