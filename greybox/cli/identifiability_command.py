"""The command `greybox identifiability`: parameters that a structure, or a fit, can determine."""

import argparse
from pathlib import Path

from greybox.assessment.structural_identifiability import structural_identifiability
from greybox.cli.options import UsageError
from greybox.cli.output import Answer
from greybox.cli.saved_fits import saved_fit
from greybox.data.files.named_values import attributes, non_empty
from greybox.data.files.safe_files import HDF5
from greybox.workflows.study.catalog import find_model

EXAMPLES = (
    "yaw:YawRate",
    "tilt:NonlinearTilt --outputs theta --free T_rotor",
    "yaw.h5",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
subject MODEL|RESULT
    a structure, tilt:Tilt or my.py:Class: the rank of its sensitivities at random points; or a fit
    that greybox fit --out wrote: errors and insensitivities in percent, correlations, determined
    combinations
--outputs NAME...
    measured outputs of a structure (default: all of them)
--at NAME=VALUE...
    operating point at which an ODE is linearized
--fix
--free
--model
"""
STRUCTURE = ("model", "data", "identifiable", "groups", "combinations", "reasons")
DATA = (
    "names",
    "insensitivity",
    "beyond",
    "at_bound",
    "correlated",
    "condition",
    "combinations",
)


def run(options: argparse.Namespace) -> Answer:
    """Judge the structure, or read the fit and judge its data."""
    settings = non_empty(attributes(options, "outputs", "free", "at", "fix"))
    if Path(options.subject).suffix.lower() not in HDF5:
        fixed = settings.pop("fix", {})
        structure = structural_identifiability(find_model(options.subject), fixed=fixed, **settings)
        return attributes(structure, *STRUCTURE), str(structure)
    if settings:
        raise UsageError(
            f"--{min(settings)} is for a structure, and {options.subject} is a fit: leave it out."
        )

    fit = saved_fit(Path(options.subject), options)
    table = fit.identifiability
    # `error` is what an object has where a command failed.
    answer = {"problem": fit.name, "relative_error": table.error, **attributes(table, *DATA)}
    return answer, f"{fit.name}\n\n{table}"
