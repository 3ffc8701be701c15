"""The command `greybox export`: a saved fit for other programs."""

import argparse
import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from greybox.assessment.draws import draws
from greybox.assessment.result import Fit
from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_writable
from greybox.cli.saved_fits import saved_fit
from greybox.data.files.delimited_text import write_delimited
from greybox.data.files.safe_files import write_text
from greybox.modeling.colored_disturbance import undisturbed
from greybox.reporting.interop.casadi_function import to_casadi

EXAMPLES = (
    "pitch.h5 pitch.csv",
    "pitch.h5 pitch.c --pade 2",
    "vehicle.h5 vehicle.xml --draws 100",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
result RESULT
    a fit that greybox identify or fit --out wrote
file FILE
    by its ending: .csv a table of the estimate, .json everything that a fit prints, .c derivative
    and outputs of the model at its estimate as C source by CasADi; other endings as the model
    states them in `exports`, such as .xml (MuJoCo) and .py (RotorPy) of a multirotor
--draws N
    write N sets of values instead, drawn from the estimate and its covariance, one file each:
    FILE_001.xml
--seed K
    seed of the draws (default: 0)
--pade K
    order of the Padé approximation of delays in the C source
--model
--force
"""
COLUMNS = ("name", "value", "standard_error", "unit", "about")


def run(options: argparse.Namespace) -> Answer:
    """Write the file."""
    path = options.file
    fit = saved_fit(options.result, options)
    exports = exports_of(fit)
    # Draws have files of their own names.
    force = options.force or bool(options.draws)
    require_writable(path, force, (".csv", ".json", ".c", *exports), "export")
    if options.draws or path.suffix in exports:
        return _written_by_model(fit, exports, options)
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


def exports_of(fit: Fit) -> Mapping[str, Callable[[Mapping[str, float]], str]]:
    """Return what the last model of a fit that has `exports` states, by ending."""
    for part in reversed(range(len(fit.parts))):
        with contextlib.suppress(LookupError):
            exports = getattr(undisturbed(fit.model_of(part)), "exports", {})
            if exports:
                return exports
    return {}


def _written_by_model(
    fit: Fit,
    exports: Mapping[str, Callable[[Mapping[str, float]], str]],
    options: argparse.Namespace,
) -> Answer:
    """Write the files that a model's own function makes, of the estimate or of draws."""
    path = options.file
    if path.suffix not in exports:
        raise UsageError(
            f"--draws is for endings of the model's own exports, and {path.name} is none: give "
            f"{', '.join(exports) or 'a fit whose model has exports'}."
        )
    fit.require_estimate()
    sets: Any = [fit.estimate]
    paths = [path]
    if options.draws:
        sets = draws(fit, options.draws, options.seed)
        digits = max(3, len(str(options.draws)))
        paths = [path.with_stem(f"{path.stem}_{k:0{digits}}") for k in range(1, options.draws + 1)]
    for target in paths:
        require_writable(target, options.force)
    for target, values in zip(paths, sets, strict=True):
        write_text(target, exports[path.suffix](values))
    count = f"{paths[0]} to {paths[-1].name}" if options.draws else str(path)
    return {"files": paths}, f"wrote {count}"
