"""The command line: which commands there are, and the parser of their options.

Only the modules of the command at hand are imported, so that help and version are there at once.
"""

import argparse
import contextlib
import io
import mmap
import os
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from typing import Any, NoReturn

from greybox.cli.options import COMMON, FORMS, HelpFormatter, UsageError, declare
from greybox.cli.output import BAD_INPUT, write_answer
from greybox.data.files.spelling import alternatives, nearest
from greybox.data.files.version import __version__

# The command `fit` is the module `greybox.cli.fit_command`.
GROUPS = {
    "log": {
        "inspect": "show what a log contains, its test segments and its defects",
        "identify": "go from a log to a fitted model in one step",
        "response": "measure a frequency response from a log",
    },
    "fit": {
        "list": "list the included models and problems",
        "new": "write a commented file to start from",
        "fit": "fit a problem from many starts",
        "orders": "choose the orders of a rational transfer function",
        "stepwise": "choose terms of a model from a list of candidates, by tests",
    },
    "judge": {
        "compare": "compare saved fits, or the fits of a study",
        "predict": "predict another log with a saved fit, window by window",
        "simulate": "drive a saved model with the inputs of a log",
        "identifiability": "show which parameters a model or a fit can determine",
        "profile": "compute intervals that need not be symmetric",
        "bootstrap": "compute errors and intervals from resampled data",
    },
    "studies": {"batch": "fit many problems, and lose nothing when killed"},
    "hand on": {
        "report": "write a page about results that can be shared",
        "export": "write a fit as a table, JSON or C source",
        "margins": "compute stability margins of a fit in the loop of a controller",
        "tune": "compute safe gains of a controller, and which of them are better than today's",
    },
}
COMMANDS = {name: about for group in GROUPS.values() for name, about in group.items()}

ADDRESSES = 600  # MB of address space: fits take 570 to 610

# argparse has no groups of commands.
ABOUT = "Grey-box estimation of models from flight data." + "".join(
    f"\n\n{group}:" + "".join(f"\n    {name:16} {about}" for name, about in names.items())
    for group, names in GROUPS.items()
)

BEGIN = """\
begin with:
  greybox list
  greybox fit pitch_hover
  greybox new mine
`greybox COMMAND --help` has examples of each."""


class _Parser(argparse.ArgumentParser):
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # type: ignore
        """Refuse unknown options in the parser of the command, which can suggest similar ones."""
        options, unknown = super().parse_known_args(args, namespace)
        several: Any = [a for a in self._get_positional_actions() if a.nargs in ("*", "+")]
        if several and not any(word.startswith("-") for word in unknown):
            # argparse takes the words of an argument from one place only, not a.h5 --json b.h5.
            getattr(options, several[0].dest).extend(map(several[0].type, unknown))
            return options, []
        if unknown:
            near = nearest(unknown[0].partition("=")[0], self._option_string_actions)
            hint = f", did you mean {near}?" if near else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return options, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = alternatives(value, action.choices)
            raise argparse.ArgumentError(action, f"there is no {value!r}; there are {choices}")

    def error(self, message: str) -> NoReturn:
        see = " See" if message.endswith("?") else "; see"
        raise UsageError(f"{message.rstrip('.')}{see} {self.prog} --help.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    0 a usable answer, 1 a run that failed, 2 bad usage or bad input, 130 interrupted by
    Ctrl-C, 143 by SIGTERM.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    # Mistakes in the arguments are answered as JSON too, before anything is parsed.
    as_json = "--json" in arguments
    # Before numpy is imported: each thread of OpenBLAS has a buffer of 128 MB.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        _require_memory()
        parsed = _parse(arguments)
        if not isinstance(parsed, argparse.Namespace):
            return write_answer({}, parsed, as_json)

        # Importing the solvers takes half a second, which help and mistakes need not wait for.
        from greybox.cli.execution import execute  # noqa: PLC0415

        return execute(parsed)
    except KeyboardInterrupt:
        return write_answer({"error": "interrupted."}, "", as_json)
    except UsageError as error:
        return write_answer({"error": str(error)}, "", as_json, BAD_INPUT)


def _require_memory() -> None:
    """Raise UsageError where OpenBLAS would ask for memory forever."""
    try:
        mmap.mmap(-1, ADDRESSES << 20).close()
    except OSError as error:
        raise UsageError(
            f"greybox needs {ADDRESSES} MB of address space: raise the limit (ulimit -v, or that "
            "of the container)."
        ) from error


def parser_of(commands: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Return the parser, with the options of these commands only."""
    parser = _Parser(
        prog="greybox",
        usage="greybox [-h] [--version] COMMAND ...",
        description=ABOUT,
        epilog=BEGIN,
        formatter_class=HelpFormatter,
        allow_abbrev=False,
    )
    # No abbreviations: a new option could make one in a script ambiguous.
    parser.add_argument("--version", action="version", version=f"greybox {__version__}")

    subparsers = parser.add_subparsers(
        prog="greybox", metavar="COMMAND", required=True, help=argparse.SUPPRESS
    )
    for name, about in COMMANDS.items():
        command = subparsers.add_parser(
            name,
            description=f"{about[0].upper()}{about[1:]}.",
            formatter_class=HelpFormatter,
            allow_abbrev=False,
        )
        # Modules of commands import solvers and readers: import only the one that is needed.
        if name in commands:
            module = import_module(f"greybox.cli.{name}_command")
            used = getattr(module, "USED", "").split()
            declare(command, module.OPTIONS + COMMON, used)
            # All options would take twenty lines.
            words = [
                FORMS.get(a.nargs, "{}").format(a.metavar)
                for a in command._get_positional_actions()
            ]
            command.usage = " ".join([f"greybox {name}", *words, "[option ...]"])
            command.set_defaults(command=module.run)
            examples = (f"  greybox {name} {example}".rstrip() for example in module.EXAMPLES)
            command.epilog = "\n".join(["examples:", *examples])

    return parser


def _parse(arguments: Sequence[str]) -> argparse.Namespace | str:
    """Return the options, or the text of --help or --version."""
    # The first word that is not an option is the command, wherever --json is.
    first = [word for word in arguments if not word.startswith("-")][:1]
    help_or_version = io.StringIO()
    try:
        with contextlib.redirect_stdout(help_or_version):
            namespace = argparse.Namespace(arguments=tuple(arguments))
            return parser_of(first).parse_args(arguments, namespace)
    except SystemExit:
        return help_or_version.getvalue().rstrip("\n")
