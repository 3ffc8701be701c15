"""The command `greybox new`: a commented file to start from, with a model and its problem."""

import argparse
import shlex
import sys
from pathlib import Path

from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_writable
from greybox.cli.starting_files import problem_file
from greybox.data.files.safe_files import write_text

# A file with one of these names would hide the package that it, or its user, imports.
PACKAGES = frozenset(
    "casadi control greybox h5py matplotlib models numpy pandas problems scipy".split()
)

EXAMPLES = (
    "pitch",
    "drag --in-time",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
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
    # PitchRate for pitch_rate. File names may begin with an underscore, class names should begin
    # with a letter.
    name = "".join(word[:1].upper() + word[1:] for word in path.stem.split("_"))
    name = name if name[:1].isalpha() else f"Model{name}"
    write_text(path, problem_file(path.name, name, in_time=options.in_time))
    command = shlex.join(["greybox", "fit", str(path)])
    return {"file": str(path), "next": [command]}, f"wrote {path}", f"next: {command}"
