"""The command `greybox identifiability`: which parameters a structure, or the data of a saved fit, can determine."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.catalog import find_model
from greybox.cli.options import (
    UsageError,
    add_common_options,
    assignments,
    nonnegative,
    positive,
)
from greybox.cli.output import USABLE, Answer
from greybox.cli.saved_fits import add_model_option, saved_fit
from greybox.estimate.identifiability import Identifiability
from greybox.estimate.structural_identifiability import (
    StructuralIdentifiability,
    structural_identifiability,
)
from greybox.files.json_numbers import finite
from greybox.files.safe_files import HDF5

EXAMPLES = (
    "yaw:YawRate",
    "tilt:NonlinearTilt --outputs theta --free T_rotor",
    "yaw.h5",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "subject",
        metavar="MODEL|RESULT",
        help="a structure, tilt:Tilt or my.py:Class: the rank of its sensitivities at random points; or a fit that "
        "greybox fit --out wrote: errors and insensitivities in percent, correlations, determined combinations",
    )
    add(
        "--outputs",
        nargs="+",
        metavar="NAME",
        help="of a structure, what is measured (default: all)",
    )
    add(
        "--at",
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help="operating point at which an ODE is linearized",
    )
    add("--fix", nargs="+", default=[], metavar="NAME=VALUE", help="parameters that are known")
    add(
        "--free",
        nargs="+",
        default=[],
        metavar="NAME",
        help="parameters that the model declares fixed",
    )
    add("--points", type=positive, metavar="N", help="random points, 3 by default")
    add("--seed", type=nonnegative, metavar="N", help="of the points, 0 by default")
    add_model_option(parser)
    add_common_options(parser)


def run(options: argparse.Namespace) -> Answer:
    """Judge the structure, or read the fit and judge its data."""
    settings = {name: getattr(options, name) for name in ("outputs", "free", "points", "seed")}
    settings |= {"at": assignments(options.at, "--at"), "fixed": assignments(options.fix, "--fix")}
    settings = {name: value for name, value in settings.items() if value}
    if Path(options.subject).suffix.lower() not in HDF5:
        structure = structural_identifiability(find_model(options.subject), **settings)
        return _of_structure(structure), str(structure), USABLE
    if settings:
        flag = {"fixed": "fix"}.get(min(settings), min(settings))
        raise UsageError(
            f"--{flag} is for a structure, and {options.subject} is a fit: leave it out."
        )
    fit = saved_fit(Path(options.subject), options)
    judged = fit.identifiability
    return {"problem": fit.name, **_of_fit(judged)}, f"{fit.name}\n\n{judged}", USABLE


def _of_structure(structure: StructuralIdentifiability) -> dict[str, Any]:
    groups = [
        {"names": list(g.names), "initial_states": list(g.states), "to_fix": g.directions}
        for g in structure.groups
    ]
    return {
        "model": structure.model,
        "data": structure.data,
        "identifiable": list(structure.identifiable),
        "not_identifiable": groups,
        "determined": list(structure.combinations),
    }


def _of_fit(judged: Identifiability) -> dict[str, Any]:
    shares = zip(judged.names, judged.error.tolist(), judged.insensitivity.tolist(), strict=True)
    return {
        "parameters": {n: {"error": finite(e), "insensitivity": finite(i)} for n, e, i in shares},
        "beyond": list(judged.beyond),
        "at_bound": list(judged.at_bound),
        "correlated": [list(pair) for pair in judged.correlated],
        "condition": finite(judged.condition),
        "determined": {
            c.formula: {"value": finite(c.value), "standard_error": finite(c.standard_error)}
            for c in judged.combinations
        },
    }
