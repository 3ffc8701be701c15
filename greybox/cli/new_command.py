"""The command `greybox new`: a commented file to start from, of a model or of a problem."""

import argparse
import sys
from pathlib import Path

from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_writable
from greybox.cli.starting_files import model_file, problem_file
from greybox.files.safe_files import write_text

# A file of one of these names would hide the package that it, or its user, imports.
PACKAGES = frozenset(
    "casadi control greybox h5py matplotlib models numpy pandas problems scipy".split()
)

EXAMPLES = (
    "model pitch",
    "problem pitch",
    "problem drag --in-time",
)
OPTIONS = """
kind {model,problem}
    a model alone, or a model with data and a problem
name NAME
    name of the file, NAME.py in this folder, and of its model
--in-time
    an ODE and a record, not a transfer function
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Write the file and print the commands for it."""
    path = Path(options.name if options.name.endswith(".py") else f"{options.name}.py")
    if not path.stem.isidentifier():
        raise UsageError(
            f"{path.stem!r} cannot be the name of a Python file: use letters, digits and "
            "underscores."
        )
    # Python looks for modules in the folder of the script first: numpy.py would replace numpy.
    if path.stem in PACKAGES | sys.stdlib_module_names:
        raise UsageError(
            f"{path.stem} is the name of a Python package, which {path} would hide: choose another "
            "name."
        )

    require_writable(path, options.force)
    write = model_file if options.kind == "model" else problem_file
    write_text(path, write(path.name, _class_name(path.stem), in_time=options.in_time))
    commands = [f"greybox list {path}", f"greybox fit --model {path} --data DATA.csv"]
    if options.kind == "problem":
        commands = [f"greybox fit {path}"]
    lines = [f"next: {command}" for command in commands]
    return {"file": str(path), "next": commands}, f"wrote {path}", *lines


def _class_name(stem: str) -> str:
    """Return ``PitchRate`` for ``pitch_rate``."""
    # File names may begin with an underscore, class names should begin with a letter.
    name = "".join(word[:1].upper() + word[1:] for word in stem.split("_"))
    return name if name[:1].isalpha() else f"Model{name}"
